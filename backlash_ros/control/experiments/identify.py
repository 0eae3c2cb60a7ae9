"""Identifying the drive: the motion of gap probe or relay also shows load and friction."""

from collections.abc import Callable
from functools import partial

from backlash_ros.control.experiment import Deferred, DriveEstimate, Method, NamedExperiment, Outcome, Refusal
from backlash_ros.control.experiments.gap_probe import GapProbe, GapProbeSettings
from backlash_ros.control.experiments.relay import Relay, RelaySettings
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.identify import Identified, identify

_EXPECTED = "expected_load_torque"
_NAMES = {"delay.command": "loop_delay", **{name: name for name in (_EXPECTED, f"{_EXPECTED}_slope")}}
"""Findings that are not values of the drive: the controller's parameter, by the finding's key."""


class _Identifies:
    """What makes a run of an experiment one that identifies the whole drive."""

    _drive: Drive
    outcome: Outcome | Deferred | None
    recording: Callable[[], Recording]

    def cancel(self, reason: str) -> None:
        """End without a result, for ``reason``."""
        if self.outcome is None:
            self.outcome = _nothing(reason)

    def work(self) -> Callable[[], Outcome]:
        """Return the work that identifies the drive from the recording."""
        return partial(_estimate_from, self._drive, self.recording())


class Identify(_Identifies, GapProbe):
    """One run of the gap probe, from which the whole drive is identified."""


class IdentifyByRelay(_Identifies, Relay):
    """One run of the relay, from which the whole drive is identified."""


def _nothing(reason: str) -> Refusal:
    return Refusal(f"nothing was identified: {reason}")


def _estimate_from(drive: Drive, recording: Recording) -> Outcome:
    """Return what a recording shows about a drive."""
    try:
        found = identify(drive, recording, hold_out=False)
    except ValueError as error:
        return _nothing(str(error))
    if not found.valid:
        return _nothing(found.reason or "; ".join(f"{each.symbol}: {each.why}" for each in found.findings))
    gap, values = found.of("gear.backlash_angle"), _parameters_of(found)
    sure = {_NAMES.get(each.key, each.key): each.uncertainty for each in found.findings if each.plans}
    return DriveEstimate(
        gap.value if gap.told else 0.0,
        Method.IDENTIFY,
        valid=True,
        reason=f"{recording.time[-1] - recording.time[0]:.1f} s of motion",
        uncertainty=gap.uncertainty if gap.told else 0.0,
        fit=found.fit,
        drive=values,
        deviations={name: deviation for name, deviation in sure.items() if name in values},
        findings=found.findings,
    )


def _parameters_of(found: Identified) -> dict[str, float | int | str]:
    """Return the values found, by parameter name; the teeth count as one."""
    wanted = tuple(f"{name}." if name == "contact" else name for name in found.replaced)
    values = {name: value for name, value in values_of(found.drive).items() if name.startswith(wanted)}
    others = {_NAMES[each.key]: each.value for each in found.findings if each.told and each.key in _NAMES}
    if found.fit is not None:
        others |= found.fit.load_torque if _EXPECTED in others else {}
        others |= found.fit.unexplained
    return {**values, **others}


EXPERIMENTS = {
    "identify": NamedExperiment(
        "load, friction, gap, teeth and delay from motion across the gap, with both encoders",
        Identify,
        GapProbeSettings(),
        swing="swing",
        law="",
    ),
    "identify_by_relay": NamedExperiment(
        "load, friction, gap and delay with one encoder, by a relay behind it",
        IdentifyByRelay,
        RelaySettings(),
        swing="swing",
        law="",
    ),
}
