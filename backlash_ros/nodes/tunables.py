"""The parameters that can be tuned while the controller runs: declared once, validated together, swapped as one value.

A request that is refused changes nothing. What is in use is published each time with a new version.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterEvent, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from backlash_ros.control import (
    AUTO,
    DEFAULT_WEIGHTS,
    EXPERIMENTS,
    LAWS,
    FaultThresholds,
    Gains,
    GainSet,
    Limits,
    Margins,
    ServoSettings,
    stability_margins,
)
from backlash_ros.control.design.choice import APPLY_BOUND, Choice, Tuning, check_set_names, delay_bound
from backlash_ros.control.design.gain_sets import CUSTOM, NO_WEIGHTS, REGIONS
from backlash_ros.control.design.start import emulated, explained
from backlash_ros.control.homing import HOMING
from backlash_ros.control.motion.profile_parameters import PROFILE_MODES, STEP, ProfileParameters
from backlash_ros.control.settings import ON_LOST_ENCODER, STOP, ZERO
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.parameters import drive_of
from backlash_ros.ros.parameters import (
    ALL,
    Declarations,
    declare,
    declare_number,
    declare_quantities,
    in_use,
)

_K = "gains [k1, k2, k3] of V = -k1 (load angle - reference) - k2 load speed - k3 current"
_K_UNIT = "V/rad, V s/rad, V/A"
_K_BOUND = "k1 > 0 V/rad, all within +-1e+06, stable at the rate"
_Q_UNIT = "1/rad^2, s^2/rad^2"
_Q_BOUND = "Q11 > 0 and <= 1e+12, Q22 >= 0 and <= 1e+12; or [0, 0] for none"


def _gain_names(prefix: str) -> list[str]:
    return [f"{prefix}.{region}.{kind}" for region in REGIONS for kind in ("k", "q")]


def _set_names(node: Node) -> list[str]:
    text = "names of the gain sets, each defined under gain_sets.<name>; the first is in use at the start"
    bound = f"different from each other and from {CUSTOM!r}"
    names: list[str] = declare(node, "gain_set_names", ["nominal"], text, constraint=bound, read_only=True)
    check_set_names(names)
    return names


def _declare_parameters_of(node: Node, registry: Mapping[str, Any]) -> dict[str, Any]:
    """Declare the parameters of all laws, or of all experiments, and return what the user set."""
    values: dict[str, Any] = {}
    for parameters in {each.parameters.section: each.parameters for each in registry.values()}.values():
        values |= declare_quantities(node, parameters, dynamic=ALL)
    return values


def _declare_beside_gains(node: Node, drive: Drive, rate: float) -> dict[str, Any]:
    """Declare the dynamic parameters other than the gains and the drive, and return what the user set."""
    delay = declare_number(node, "loop_delay", 0.0, delay_bound(rate), read_only=False)
    drive, values = emulated(drive, 1.0 / rate, delay), {"loop_delay": delay}
    text = "control law; auto: 'planned' once backlash and drive are identified, until then 'two_region'"
    values["law"] = declare(node, "law", AUTO, text, constraint=f"one of {sorted([AUTO, *LAWS])}")
    values |= _declare_parameters_of(node, LAWS)
    text = "experiment that ~/learn runs; auto: chosen by the encoders that are present"
    name, bound = "learning.experiment", f"one of {sorted([AUTO, *EXPERIMENTS])}"
    values[name] = declare(node, name, AUTO, text, constraint=bound)
    text = (
        "whether load and friction were identified on this drive; "
        "until then laws 'planned' and 'dual_loop' use the over-damped gains"
    )
    values["identified"] = declare(node, "identified", False, text)
    text = "whether to learn the backlash again, which moves the load, when wear is noticed and the load is at rest"
    values["learning.renew"] = declare(node, "learning.renew", False, text)
    values |= _declare_parameters_of(node, EXPERIMENTS)
    values["zero"] = declare_number(node, "zero", 0.0, ZERO, read_only=False)
    values |= _declare_parameters_of(node, HOMING)
    text = "whether ~/home goes until home_switch closes, and not against a stop"
    values["homing.switch"] = declare(node, "homing.switch", False, text)
    text = "when a valid estimate is applied: at once, or on ~/apply_estimate"
    values["learning.apply"] = declare(node, "learning.apply", "auto", text, constraint=APPLY_BOUND)
    values |= declare_quantities(node, Limits.of(drive), dynamic=ALL)
    values |= declare_quantities(node, FaultThresholds.of(drive), dynamic=ALL)
    text = "whether an encoder that is lost is a fault, or the axis goes on with the other one, slower"
    name, bound = "faults.on_lost_encoder", f"one of {list(ON_LOST_ENCODER)}"
    values[name] = declare(node, name, STOP, text, constraint=bound)
    text = "how the setpoint goes to a reference: in a step, within the three limits, or within what the drive can do"
    values["profile.mode"] = declare(node, "profile.mode", STEP, text, constraint=f"one of {list(PROFILE_MODES)}")
    values |= declare_quantities(node, ProfileParameters(), dynamic=ALL)
    any_gains = Gains(1.0, 0.0, 0.0)
    return values | declare_quantities(node, ServoSettings(GainSet(any_gains, any_gains)), dynamic=ALL)


def tunable_names(given: Mapping[str, Any]) -> set[str]:
    """Return the names that `Tunables` declares with the overrides ``given``, without designing anything."""
    names: Any = Declarations()
    _declare_beside_gains(names, NOMINAL_DRIVE, 1.0)
    sets = [*_set_names(names), *(given.get("gain_set_names") or [])]
    return {
        *names.declared,
        "gain_set",
        *_gain_names("gains"),
        *(n for s in sets for n in _gain_names(f"gain_sets.{s}")),
    }


def _declare_gain_sets(node: Node) -> dict[str, Any]:
    """Declare the gain sets and return how each region of each set is given."""
    fixed, sets = partial(declare, node, read_only=True), {}
    for name in _set_names(node):
        defaults = DEFAULT_WEIGHTS if name == "nominal" else dict.fromkeys(REGIONS, NO_WEIGHTS)
        chosen = {}
        for region in REGIONS:
            prefix = f"gain_sets.{name}.{region}"
            text, bound = f"{_K}; [0, 0, 0] if weights are given", f"{_K_BOUND}; or [0, 0, 0] for none"
            k = fixed(f"{prefix}.k", [0.0, 0.0, 0.0], text, unit=_K_UNIT, constraint=bound)
            text = "LQR weights [Q11, Q22] of eq 14, instead of gains"
            weights = NO_WEIGHTS if any(k) else defaults[region]
            q = fixed(f"{prefix}.q", weights, text, unit=_Q_UNIT, constraint=_Q_BOUND)
            chosen[region] = {"q": q, "k": k}
        sets[name] = chosen
    return sets


def declare_tunables(node: Node, drive_values: Mapping[str, Any], rate: float) -> tuple[Tuning, Choice]:
    """Declare the tunable parameters; return their rules and the values at the start.

    Parameters
    ----------
    drive_values : values of the drive's parameters, already declared
    rate : of the samples, Hz
    """
    tuning, drive = Tuning(_declare_gain_sets(node), rate), drive_of(drive_values)
    values = {**drive_values, **_declare_beside_gains(node, drive, rate)}
    delay = values["loop_delay"]
    with explained(drive, 1.0 / rate, delay):
        sets = tuning.sets(drive, delay)
        first = next(iter(sets))
        text, bound = "gain set in use; setting it sets the gains", f"one of {[*sets, CUSTOM]}"
        given = {"gain_set": declare(node, "gain_set", first, text, constraint=bound)}
        for region in REGIONS:
            k, q = f"gains.{region}.k", f"gains.{region}.q"
            given[k] = declare(node, k, sets[first][k], f"{_K}, in use", unit=_K_UNIT, constraint=_K_BOUND)
            text = "LQR weights [Q11, Q22] from which the gains in use were designed; [0, 0]: none"
            given[q] = declare(node, q, sets[first][q], text, unit=_Q_UNIT, constraint=_Q_BOUND)
        values |= tuning.gains_at_start(given, drive, delay)
        changed = [
            Parameter(name, value=value)
            for name, value in values.items()
            if name.startswith("gain") and node.get_parameter(name).value != value
        ]
        if changed:
            node.set_parameters_atomically(changed)
        return tuning, tuning.choice(values)


class Tunables:
    """The tunable parameters of one controller, and the drive, settings and limits that they define, ``in_use``.

    ``rejection_reason`` returns why limits, drive and zero cannot be used now, empty if they can; ``changed`` is called
    with the names after each swap.

    Parameters
    ----------
    drive : values of the drive's parameters, already declared
    rate : of the samples, Hz
    """

    def __init__(self, node: Node, drive: Mapping[str, Any], rate: float) -> None:
        self._node = node
        self._tuning, self.in_use = declare_tunables(node, drive, rate)
        self._candidate = self.in_use
        self.version = 1
        self.rejection_reason: Callable[[Limits, Drive, float], str] = lambda _limits, _drive, _zero: ""
        self.changed: Callable[[set[str]], None] = lambda _names: None
        node.add_pre_set_parameters_callback(self._complete)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._swap)

    @property
    def values(self) -> dict[str, Any]:
        """The parameters in use, by name."""
        return self.in_use.values

    def margins(self) -> dict[str, dict[str, Margins]]:
        """Return the stability margins of each gain set, and of the gains in use, by set and region."""
        values, drive, sets, settings, _ = self.in_use
        period, delay = settings.period, settings.loop_delay
        return {
            name: {
                region: stability_margins(drive, Gains(*gains[f"gains.{region}.k"]), period, delay)
                for region in REGIONS
            }
            for name, gains in {**sets, values["gain_set"]: values}.items()
        }

    def message(self) -> ParameterEvent:
        """Return all parameters in use, including the fixed ones, with their version, as a message."""
        return in_use(self._node, self.version, self.values)

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add the consequences of a request: a set's gains, gains from weights, values that another drive changes."""
        changes = {p.name: p.value for p in parameters}
        try:
            full = self._tuning.completed(changes, self.in_use)
        except (ValueError, TypeError):
            return parameters  # refused with a reason when it is validated
        kept = [p for p in parameters if full[p.name] is p.value]
        names = {p.name for p in kept}
        return kept + [Parameter(name, value=value) for name, value in full.items() if name not in names]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        values = {**self.values, **{p.name: p.value for p in parameters if p.name in self.values}}
        try:
            self._candidate = self._tuning.choice(values)
        except (ValueError, TypeError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        candidate = self._candidate
        reason = self.rejection_reason(candidate.limits, candidate.drive, candidate.values["zero"])
        return SetParametersResult(successful=not reason, reason=reason)

    def _swap(self, parameters: list[Parameter]) -> None:
        names = {p.name for p in parameters if p.name in self.values}
        if names:
            self.in_use = self._candidate
            self.version += 1
            self.changed(names)
