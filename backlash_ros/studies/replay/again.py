"""The replay: passes the samples that recorded commands name through the servo again, with the same inputs.

``~/state`` tells the other inputs at each sample: parameters, reference, experiment, the switch of a homing, reset. The
end of an experiment, the faults of the tick and the effects of wear follow from them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backlash_ros.control import Servo
from backlash_ros.control.design.choice import Choice
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.control.telemetry import HOMING, IDENTIFYING
from backlash_ros.foundation.messages import BadSampleError, NotOurJointsError, read_joint_state
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.gates.faults import Fault
from backlash_ros.gates.positions import Position
from backlash_ros.studies.replay.recorded import Activation, Answered, Found, Recorded, nearest
from backlash_ros.studies.replay.what_if import Changes, tuning_of

_ANGLES = [THETA_M, THETA_L]
_OF_GATE = {Fault.NO_SAMPLES, Fault.SECOND_DRIVE, Fault.JOINTS_APART}
"""Faults after which the gate passes no more samples."""
_ACTS = ("parameters_version", "fault", "experiment", "reference")
"""Values of ``~/state`` that may change between two samples without following from them."""


@dataclass(frozen=True)
class Replayed:
    """Commands of one activation, in order, V or A, with the stamps of their samples, ns; shapes (N,).

    ``replayed`` is nan for the ``lost`` samples, which the bag lacks; ``unanswered``: number of samples whose command
    the bag lacks. ``unit`` of the commands; ``notes`` say what could not be placed exactly.
    """

    stamps: Sequence[int]
    recorded: Array
    replayed: Array
    lost: int
    unanswered: int
    unit: str
    notes: tuple[str, ...]

    @cached_property
    def differing(self) -> NDArray[np.intp]:
        """Indices of the commands that are not equal to the last bit."""
        return np.flatnonzero(self.recorded.view(np.int64) != self.replayed.view(np.int64))

    @property
    def equal(self) -> bool:
        """Whether every command was replayed and is equal to the last bit."""
        return not (self.differing.size or self.lost or self.unanswered)

    @property
    def time(self) -> Array:
        """Times of the samples, s after the first one."""
        return 1e-9 * np.array([stamp - self.stamps[0] for stamp in self.stamps])


class _Run:
    """One pass through an activation."""

    def __init__(self, recorded: Recorded, activation: Activation, told: Found, changes: Changes) -> None:
        self._all, self._activation, self._told, self._changes = recorded, activation, told, changes
        first = activation.answers[0]
        begin = nearest(told, first.stamp, first.received)
        self._version, self._homes = min(recorded.in_use), "homing"
        choice = self._choice(self._version, first.received)
        values = choice.values
        self._joint_names = values["motor_joint"], values["load_joint"]
        wraps = (values.get(f"{side}_wrap", 0.0) for side in ("motor", "load"))  # older bags have none
        self._positions = [Position(wrap, round(0.5e9 / values["rate"])) for wrap in wraps]
        self._timeout = round(1e9 * values["state_timeout"])
        self._servo = Servo(choice.drive, choice.settings, choice.limits)
        self._servo.count_from(values["zero"])
        self._wear = WearWatch(self._servo)
        self._missed = begin["samples"] - 1
        self._taken = self._lost = self._unanswered = 0
        self._before: Answered | None = None
        self._joints: tuple[bool, bool] | None = None
        self._fault, self._gated, self._in_force = Fault.NONE, False, 0.0
        self._measured = Measurement(np.empty(5))
        self.notes: list[str] = []

    # What acts on a sample.

    def _choice(self, version: int, received: int) -> Choice:
        values = nearest(self._all.in_use, version, received)
        if values is None:
            raise ValueError(f"version {version} of the parameters in use is not in the bag")
        self._homes = "homing_by_switch" if values["homing.switch"] else "homing"
        return self._changes.applied_to(tuning_of(values), values)

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _use(self, version: int, answered: Answered) -> None:
        """Use each version of the parameters up to a given one, as the controller did."""
        for number in range(self._version + 1, version):
            if number not in self._all.in_use:
                self._note(f"version {number} of the parameters in use is not in the bag")
                continue
            self._swap(self._choice(number, answered.received))
        if version != self._version:
            self._swap(self._choice(version, answered.received))
        self._version = version

    def _swap(self, choice: Choice) -> None:
        zero = choice.values["zero"]
        if why := self._servo.rejection_reason(choice.limits, choice.drive, zero):
            self._note(f"parameters would have been refused: {why}")
            return
        self._servo.use(choice.settings, choice.limits, choice.drive)
        self._servo.count_from(zero)

    def _act(self, told: Mapping[str, float], answered: Answered) -> None:
        """Apply the inputs before a sample that do not follow from the samples."""
        servo = self._servo
        if servo.experimenting and not told["experiment"]:
            servo.cancel("cancelled on request")
            servo.take_outcome()
        self._use(int(told["parameters_version"]), answered)
        fault, before = Fault(int(told["fault"])), self._fault
        self._fault = fault
        if before and not fault:
            servo.reset()
            for position in self._positions:
                position.forget()
            self._before, self._joints, self._gated = None, None, False
        elif fault in _OF_GATE and not before:
            servo.fail(fault, fault.name)
            self._gated = True
        open_to_all = servo.holding and not servo.latched and not servo.experimenting
        another = math.isfinite(told["reference"]) and told["reference"] != servo.reference
        if open_to_all and another and (why := servo.set_reference(told["reference"])):
            self._note(f"the reference would have been refused: {why}")
        if open_to_all and told["experiment"]:
            try:
                servo.start_experiment({IDENTIFYING: "identify", HOMING: self._homes}.get(int(told["experiment"]), ""))
            except ValueError as error:
                self._note(f"the experiment would have been refused: {error}")
            if servo.experiment == "homing_by_switch" and "tripped" not in told:
                self._note("~/state does not tell when home_switch closed: an older controller's")
        if told.get("tripped"):
            servo.trip()

    # A sample.

    def _read(self, answered: Answered) -> bool:
        """Read a sample, of the messages that have its stamp; return whether the gate passes it."""
        constant = self._servo.drive.motor.torque_constant
        self._measured.fill(math.nan)
        found = sorted(self._all.samples[answered.stamp], key=lambda each: abs(each[0] - answered.received))
        for _, message in found:
            try:
                part = read_joint_state(message, *self._joint_names, constant)
            except NotOurJointsError:
                continue
            except BadSampleError:
                return False
            if np.any(np.isnan(self._measured[_ANGLES]) & ~np.isnan(part[_ANGLES])):
                np.copyto(self._measured, part, where=np.isnan(self._measured))
        motor, load = (~np.isnan(self._measured[_ANGLES])).tolist()
        if not (motor or load) or self._joints not in (None, (motor, load)):
            return False
        self._joints = motor, load
        return True

    def _elapsed(self, answered: Answered, told: Mapping[str, float] | None) -> float:
        """Return the time since the previous sample, s, as determined by the gate."""
        if told is not None:
            return told["elapsed"]
        if self._before is None:
            return 0.0
        stamped, arrived = (answered[k] - self._before[k] for k in (1, 0))
        if 0 < stamped < max(arrived, 0) + self._timeout:
            return 1e-9 * stamped
        self._note(f"the clock of joint_states jumped at stamp {_seconds(answered.stamp)}")
        return 1e-9 * max(arrived, 0)

    def _answer(self, answered: Answered, told: Mapping[str, float] | None) -> float:
        """Return the command that answers a sample; nan if the bag lacks the sample."""
        if self._before is not None and answered.stamp == self._before.stamp and not self._gated:
            return self._in_force  # it was sent again
        if answered.stamp not in self._all.samples:
            self._lost += 1
            return math.nan
        if self._gated:
            return 0.0
        servo = self._servo
        if not self._read(answered):
            servo.command = 0.0
            return 0.0
        elapsed = self._elapsed(answered, told)
        for position, angle in zip(self._positions, _ANGLES, strict=True):
            self._measured[angle] = position.take(float(self._measured[angle]), round(1e9 * elapsed))
        self._before = answered
        self._taken += 1
        command = servo.update(self._measured, elapsed)
        self._wear.look(self._measured, elapsed)
        return command

    def commands(self) -> Array:
        """Return the command for each of the recorded ones, shape (N,)."""
        answers = self._activation.answers
        made = np.empty(len(answers))
        for k, answered in enumerate(answers):
            told = nearest(self._told, answered.stamp, answered.received)
            if told is not None:
                self._act(told, answered)
            self._in_force = made[k] = self._answer(answered, told)
            if told is not None:
                self._count(told)
            if self._changes.given and not self._servo.latched:
                self._servo.command = answered.command  # this is what the drive, and so its samples, had
            self._servo.take_outcome()
        return made

    def _count(self, told: Mapping[str, float]) -> None:
        """Compare the number of samples taken with the number in the bag."""
        self._unanswered = max(self._unanswered, int(told["samples"] - self._missed) - self._taken - self._lost)

    def result(self) -> Replayed:
        """Run and return the result."""
        made, answers = self.commands(), self._activation.answers
        return Replayed(
            [each.stamp for each in answers],
            np.array([each.command for each in answers]),
            made,
            self._lost,
            self._unanswered,
            self._servo.drive.command_unit,
            tuple(self.notes),
        )


def _seconds(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


def _told_earlier(replayed: Replayed, activation: Activation, told: Found) -> tuple[Found, str] | None:
    """Return ``~/state`` with an input added where commands first differ, and that in words.

    The bag may lack the ``~/state`` of the sample itself; the next one tells the same.
    """
    if not replayed.differing.size:
        return None
    first = int(replayed.differing[0])
    at = activation.answers[first]
    if at.stamp in told:
        return None
    stamps = [(k, nearest(told, each.stamp, each.received)) for k, each in enumerate(activation.answers)]
    before = next((each for k, each in reversed(stamps[:first]) if each is not None), None)
    later = next(((k, each) for k, each in stamps[first:] if each is not None), None)
    if before is None or later is None or all(later[1][name] == before[name] for name in _ACTS):
        return None
    elapsed = 1e-9 * (at.stamp - activation.answers[first - 1].stamp)
    moved = {**told, at.stamp: [(at.received, {**later[1], "elapsed": elapsed})]}
    where = _seconds(activation.answers[later[0]].stamp), _seconds(at.stamp)
    return moved, "what ~/state tells with stamp {} is taken to act from stamp {} on, where commands differ".format(
        *where
    )


def replay(recorded: Recorded, activation: Activation, changes: Changes) -> tuple[Replayed, Replayed | None]:
    """Replay an activation as it was recorded and, if there are ``changes``, with them.

    With changes, each command is the answer to the recorded samples and to the recorded commands before: the drive
    itself would have moved differently.

    Raises
    ------
    ValueError
        If parameters are missing or are refused.
    """
    told, notes = activation.told, list[str]()
    done = _Run(recorded, activation, told, Changes({})).result()
    while (better := _told_earlier(done, activation, told)) is not None:
        again = _Run(recorded, activation, better[0], Changes({})).result()
        if again.differing.size and again.differing[0] <= done.differing[0]:
            break
        told, done = better[0], again
        notes.append(better[1])
    done = replace(done, notes=(*done.notes, *notes))
    if not changes.given:
        return done, None
    return done, _Run(recorded, activation, told, changes).result()
