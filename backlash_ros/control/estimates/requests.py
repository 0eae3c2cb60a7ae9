"""Requests to learn or identify: starts or refuses experiments, and answers. Without ROS or a clock.

All times are integer nanoseconds of the caller's steady clock.
"""

from concurrent.futures import Executor, Future
from typing import NamedTuple

from backlash_ros.control.experiment import BacklashEstimate, Deferred, DriveEstimate, Outcome, Refusal, ZeroEstimate
from backlash_ros.control.servo import Servo
from backlash_ros.drivetrain.parameters import IDENTIFIED
from backlash_ros.identification.recordings.findings import Finding

EXPERIMENT_OF = {"learn": "", "identify": "identify", "home": "homing"}
"""The services and the experiment that each runs: that of the settings if there is no name."""

PATIENCE = 5 * 10**9
"""Longest time that a request waits for the first sample, ns: discovery takes a while."""

_AGAIN = "identify again at another place, with the load at rest, or set load.* by hand, and identified to true"
"""What to do about a drive that does not count as identified."""


class Reply(NamedTuple):
    """The answer to a request: whether it succeeded, the text, and what was learned, if anything."""

    success: bool
    text: str
    estimate: BacklashEstimate | None = None


class LearnRequests:
    """One request at a time, from asking to answer, for one servo.

    Longer computations are done by ``workers`` while the servo goes on. ``service`` is the one of `EXPERIMENT_OF` that
    the last accepted request came from.
    """

    def __init__(self, servo: Servo, workers: Executor) -> None:
        self._servo, self._workers = servo, workers
        self.service = "learn"
        self._experiment = ""
        self._asked: int | None = None
        self._computed: Future[Outcome] | None = None

    @property
    def computing(self) -> bool:
        """Whether an experiment is over and its outcome is being computed."""
        return self._computed is not None

    def ask(self, now: int, service: str = "learn", experiment: str = "") -> Reply | None:
        """Take a request, for an ``experiment`` other than the usual one of its service if that is given.

        Return its refusal, or None if the answer comes later.
        """
        if self._asked is not None or self._servo.experimenting or self.computing:
            return Reply(False, f"cannot {service}: a run is already in progress")
        if self._servo.latched:
            return Reply(False, f"cannot {service} while this fault is latched: {self._servo.fault}")
        self._asked, self.service, self._experiment = now, service, experiment or EXPERIMENT_OF[service]
        return None

    def begin(self) -> Reply | None:
        """Start the requested experiment before a sample is taken; return the refusal, if any."""
        if self._asked is None or not (self._servo.holding or self._servo.latched):
            return None
        self._asked = None
        if self._servo.latched:
            return self._refused(f" while this fault is latched: {self._servo.fault}")
        if why := self._servo.experiment_refusal(self._experiment):
            return self._refused(f": {why}")
        self._servo.start_experiment(self._experiment)
        return None

    def waited(self, now: int, silence: str) -> Reply | None:
        """Return the refusal of a request that has waited too long; ``silence`` says why."""
        if self._asked is None or now - self._asked < PATIENCE:
            return None
        self._asked = None
        return self._refused(f": {silence} for {PATIENCE / 10**9:g} s")

    def stop(self, why: str) -> Reply | None:
        """Refuse a request whose experiment has not begun, or has ended with only the computation left."""
        if self._asked is None and self._computed is None:
            return None
        if self._computed is not None:
            self._computed.cancel()
        self._asked = self._computed = None
        return self._refused(f": {why}")

    def cancel(self) -> Reply:
        """End the running or requested experiment; return the text for the caller."""
        if self._asked is None and not self._servo.experimenting and not self.computing:
            return Reply(False, "there is no experiment to cancel")
        self._servo.cancel("cancelled on request")
        return Reply(True, "cancelled")

    def end(self) -> Reply | None:
        """Return the answer, once, when the experiment has ended."""
        outcome = self._servo.take_outcome()
        if isinstance(outcome, Deferred):
            self._computed, outcome = self._workers.submit(outcome.work), None
        if self._computed is not None and self._computed.done():
            error = self._computed.exception()
            outcome = self._computed.result() if error is None else Refusal(f"it failed: {error!r}")
            self._computed = None
        if outcome is None:
            return None
        estimate = outcome if isinstance(outcome, BacklashEstimate) and outcome.valid else None
        text = describe_outcome(outcome, identified=self._servo.settings.identified)
        return Reply(outcome.valid, text, estimate)

    def _refused(self, why: str) -> Reply:
        return Reply(False, f"cannot {self.service}{why}")


def describe_outcome(outcome: Outcome, *, identified: bool = False) -> str:
    """Return an outcome in words: the estimate and how it was made, or why there is none.

    ``identified``: whether the drive counted as such before, and so does with any outcome.
    """
    if not (isinstance(outcome, BacklashEstimate) and outcome.valid):
        return outcome.reason
    if isinstance(outcome, ZeroEstimate):
        return f"zero = {outcome.zero:.6g} rad, by {outcome.method.value}, from {outcome.reason}"
    if isinstance(outcome, DriveEstimate):
        told = ", ".join(_describe(each) for each in outcome.findings if each.told)
        missing = "; ".join(f"{each.symbol}: {each.why}" for each in outcome.findings if not each.told)
        rough = ", ".join(_describe(each) for each in outcome.findings if each.rough)
        plans = f"; good enough to plan moves: {rough}" if rough else ""
        lacking = " and ".join(sorted(IDENTIFIED - outcome.parameters.keys()))
        waits = (
            f"; the drive does not count as identified: {lacking} not found; {_AGAIN}"
            if lacking and not identified
            else ""
        )
        return f"{told}, from {outcome.reason}{f'; not told: {missing}' if missing else ''}{plans}{waits}"
    sure = f" +- {outcome.uncertainty:.2g}" if outcome.uncertainty > 0.0 else ""
    return f"backlash {outcome.angle:.6g}{sure} rad at the output, by {outcome.method.value}, from {outcome.reason}"


def _describe(found: Finding) -> str:
    value = found.value if abs(found.value) > 1e-3 * found.uncertainty else 0.0
    return f"{found.symbol} = {value:.4g} +- {found.uncertainty:.2g} {found.unit}".rstrip()
