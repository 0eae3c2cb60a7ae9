"""The experiment that a servo runs: which one, whether it may begin, and how it ended."""

from backlash_ros.control.acting import IDLE, ActingExperiment, at_once, swing_name, swing_of
from backlash_ros.control.experiment import Deferred, NamedExperiment, Outcome
from backlash_ros.control.experiments import EXPERIMENTS
from backlash_ros.control.homing import HOMING
from backlash_ros.control.laws import design_law
from backlash_ros.control.limits import Limits
from backlash_ros.control.settings import AUTO, ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Validated


def choose(name: str, settings: ServoSettings, *, both_encoders: bool) -> tuple[str, NamedExperiment]:
    """Return an experiment or a homing by name, or that of the settings.

    `AUTO` and ``identify`` choose by the encoders.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name in HOMING:
        return name, HOMING[name]
    name = name or settings.experiment
    if name == AUTO:
        name = "gap_probe" if both_encoders else "relay"
    elif name == "identify" and not both_encoders:
        name = "identify_by_relay"
    return name, EXPERIMENTS.choose("learning.experiment", name, AUTO)


def parameters_of(name: str, settings: ServoSettings) -> Validated:
    """Return the parameters of an experiment in ``settings``, or their defaults."""
    default = HOMING[name] if name in HOMING else EXPERIMENTS[name]
    return dict(settings.experiment_parameters).get(name, default.parameters)


def swing_refusal(chosen: NamedExperiment, parameters: Validated, limits: Limits, least: float, largest: float) -> str:
    """Return why an experiment would exceed ``limits`` from a plan between ``least`` and ``largest``, rad."""
    if not chosen.swing or chosen.finds_zero:
        return ""
    swing, leap = swing_of(chosen, parameters), at_once(chosen, parameters)
    turns = ((least - swing, leap), (largest + swing, -leap))
    reasons = (limits.rejection_reason(there, there + back) for there, back in turns)
    why = next(filter(None, reasons), "")
    return why and f"it swings by {swing_name(chosen, parameters)} = {swing:g} rad to either side, but {why}"


class ExperimentInUse:
    """At most one experiment, and its outcome until that is taken."""

    def __init__(self) -> None:
        self.run: ActingExperiment | None = None
        self._outcome: Outcome | Deferred | None = None

    @property
    def pending(self) -> bool:
        """Whether one is running, or its outcome has not been taken."""
        return self.run is not None or self._outcome is not None

    def start(
        self,
        name: str,
        chosen: NamedExperiment,
        parameters: Validated,
        drive: Drive,
        settings: ServoSettings,
        limits: Limits,
    ) -> ActingExperiment:
        """Start one; it keeps drive, settings and limits.

        Raises
        ------
        ValueError
            If the parameters are another's, or its law cannot be designed.
        """
        right = type(chosen.parameters)
        if type(parameters) is not right:
            raise ValueError(f"{name} needs parameters of type {right.__name__}, got {type(parameters).__name__}")
        law = design_law(drive, settings.with_law(chosen.law)) if chosen.law else IDLE
        overdamped = design_law(drive, settings.with_law("overdamped"))
        self.run = ActingExperiment(name, chosen, parameters, law, overdamped, drive, settings.period, limits)
        return self.run

    def conclude(self) -> ActingExperiment | None:
        """Return the run, once, if it has ended; its outcome waits to be taken."""
        if self.run is None or self.run.outcome is None:
            return None
        ended, self._outcome, self.run = self.run, self.run.outcome, None
        return ended

    def take_outcome(self) -> Outcome | Deferred | None:
        """Return, once, how one ended or the work that will tell; None before."""
        outcome, self._outcome = self._outcome, None
        return outcome
