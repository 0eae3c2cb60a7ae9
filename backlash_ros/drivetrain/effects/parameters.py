"""The effects of real axes as values; by default there are none."""

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, TypeVar

from backlash_ros.foundation.quantity import Validated, quantity

DATA_SHEET_ERRORS = ("resistance_error", "inductance_error", "torque_constant_error", "inertia_error")
"""The effects that change the motor's values and nothing else."""

_SIZES = (
    *("cogging", "torque_ripple", "static_friction", "friction_asymmetry", "dead_band", "command_bits", "supply_sag"),
    *("outer_share", "first_gap", "gap_growth", "friction_fall", "stop_lower", "stop_upper"),
)
"""The effects that change the equations of motion; the other parameters say how."""
_TURN = 6.3
NO_STOP = 1e9
"""Means no stop, rad."""
M = TypeVar("M", bound=Validated)


@dataclass(frozen=True)
class Effects(Validated):
    """What a simulated drive has beside the equations of its motor, gear and load.

    A controller is never told: its drive has no effects. ``*_error``: the motor that is built differs from its data
    sheet, ``motor.*``, by this share.
    """

    section: ClassVar[str] = "effects"

    cogging: float = quantity(
        "amplitude of the torque that brakes the motor by cogging sin(cogging_cycles theta_m + cogging_phase)",
        "N m",
        at_least=0,
        at_most=1e3,
        default=0.0,
    )
    cogging_cycles: int = quantity(
        "periods of the cogging torque in one turn of the motor", "", at_least=1, at_most=1000, whole=True, default=12
    )
    cogging_phase: float = quantity(
        "phase of the cogging torque at a motor angle of 0", "rad", at_least=-_TURN, at_most=_TURN, default=0.0
    )
    torque_ripple: float = quantity(
        "ripple of the torque constant and of the back-EMF: K_m (1 + torque_ripple cos(torque_ripple_cycles theta_m + "
        "torque_ripple_phase))",
        "",
        at_least=0,
        at_most=0.5,
        default=0.0,
    )
    torque_ripple_cycles: int = quantity(
        "periods of the torque ripple in one turn of the motor", "", at_least=1, at_most=1000, whole=True, default=6
    )
    torque_ripple_phase: float = quantity(
        "phase of the torque ripple at a motor angle of 0", "rad", at_least=-_TURN, at_most=_TURN, default=0.0
    )
    static_friction: float = quantity(
        "dry friction at rest divided by Coulomb friction, on both shafts; it falls with the speed as "
        "exp(-(speed/stribeck_speed)^2)",
        "",
        at_least=1,
        at_most=10,
        default=1.0,
    )
    stribeck_speed: float = quantity(
        "speed of the load at which the dry friction has fallen to Coulomb friction by 63 %; of the motor, by the gear",
        "rad/s",
        at_least=1e-4,
        at_most=1e3,
        default=0.1,
    )
    friction_asymmetry: float = quantity(
        "dry friction is larger by this share while a shaft turns forward, and smaller by it while it turns back",
        "",
        at_least=-0.9,
        at_most=0.9,
        default=0.0,
    )
    dead_band: float = quantity(
        "the amplifier takes this share of the largest command from every command: smaller ones have no effect",
        "",
        at_least=0,
        at_most=0.5,
        default=0.0,
    )
    command_bits: int = quantity(
        "resolution of the amplifier between both largest commands; 0: exact",
        "bit",
        at_least=0,
        at_most=32,
        whole=True,
        default=0,
    )
    supply_sag: float = quantity(
        "share of the voltage that is missing at the current at standstill, in proportion to the current; no effect on "
        "a commanded current",
        "",
        at_least=0,
        at_most=0.5,
        default=0.0,
    )
    resistance_error: float = quantity(
        "the motor's resistance less that of the data sheet, as a share of it",
        "",
        at_least=-0.5,
        at_most=1,
        default=0.0,
    )
    inductance_error: float = quantity(
        "the motor's inductance less that of the data sheet, as a share of it",
        "",
        at_least=-0.5,
        at_most=1,
        default=0.0,
    )
    torque_constant_error: float = quantity(
        "the motor's torque constant less that of the data sheet, as a share of it",
        "",
        at_least=-0.5,
        at_most=1,
        default=0.0,
    )
    inertia_error: float = quantity(
        "the rotor's inertia less that of the data sheet, as a share of it", "", at_least=-0.5, at_most=1, default=0.0
    )
    outer_share: float = quantity(
        "share of the load's inertia that is behind a spring; 0: the load is rigid",
        "",
        at_least=0,
        at_most=0.95,
        default=0.0,
    )
    outer_frequency: float = quantity(
        "frequency of that outer part while the load is held", "Hz", at_least=0.1, at_most=1e4, default=30.0
    )
    outer_damping: float = quantity(
        "damping ratio of the outer part while the load is held", "", at_least=0, at_most=2, default=0.02
    )
    first_gap: float = quantity(
        "share of the backlash between motor and wheel of a gear with two stages; the rest is between wheel and load; "
        "1: one stage",
        "",
        at_least=0.01,
        at_most=1,
        default=1.0,
    )
    wheel_inertia: float = quantity(
        "inertia of the wheel between both stages, at the output, as a share of the load's",
        "",
        at_least=1e-3,
        at_most=10,
        default=0.1,
    )
    gap_growth: float = quantity(
        "share by which the backlash grows within drift_time, then no more", "", at_least=0, at_most=2, default=0.0
    )
    friction_fall: float = quantity(
        "share of all friction, dry and viscous, that is lost within drift_time, as the gear warms; then no more",
        "",
        at_least=0,
        at_most=0.95,
        default=0.0,
    )
    drift_time: float = quantity(
        "time in which backlash and friction drift, from the start", "s", at_least=1e-3, at_most=1e6, default=600.0
    )

    stop_lower: float = quantity(
        "angle of the stop at the lower end of the load's travel", "rad", at_least=-NO_STOP, at_most=0, default=-NO_STOP
    )
    stop_upper: float = quantity(
        "angle of the stop at its upper end", "rad", at_least=0, at_most=NO_STOP, default=NO_STOP
    )
    stop_stiffness: float = quantity(
        "stiffness of both stops, which damp a tenth of what would be critical",
        "N m/rad",
        above=0,
        at_most=1e8,
        default=1e4,
    )

    @property
    def acts(self) -> bool:
        """Whether the equations of motion differ, and not only the motor's values."""
        return any(getattr(self, each.name) != each.default for each in fields(self) if each.name in _SIZES)

    @property
    def without_errors(self) -> "Effects":
        """The same effects with a motor as its data sheet says."""
        none: dict[str, Any] = dict.fromkeys(DATA_SHEET_ERRORS, 0.0)
        return replace(self, **none)

    def built(self, motor: M) -> M:
        """Return a `parameters.Motor` as it is built, from its data sheet; ValueError if it is out of bounds."""
        errors = {name.removesuffix("_error"): getattr(self, name) for name in DATA_SHEET_ERRORS}
        if not any(errors.values()):
            return motor
        values: dict[str, Any] = {name: getattr(motor, name) * (1.0 + error) for name, error in errors.items()}
        return replace(motor, **values)
