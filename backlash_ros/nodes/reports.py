"""The diagnostics of controller and simulator, once a second: computed from gates and counts, without a node."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from backlash_ros.control import Servo
from backlash_ros.gates import CommandGate, SampleGate
from backlash_ros.ros.diagnostics import (
    CLOCKS_DIFFER,
    ERROR,
    OK,
    WARN,
    Since,
    Window,
    age_level,
    milliseconds,
    rate_level,
    status,
)
from backlash_ros.ros.timer import in_ns, now

ONE_IS_LOST = "the {}'s encoder is lost: the axis goes on, slower, with the other one alone"
"""What is said of an encoder that is lost while faults.on_lost_encoder is continue."""


@dataclass(frozen=True)
class NodeFacts:
    """Facts about a node: its name, its state, and the number of publishers with an incompatible QoS.

    ``commanders``: number of command publishers; ``heard``: whether our commands have a subscriber; ``remarks``:
    further judgements.
    """

    name: str
    state: str
    mismatches: int
    commanders: int = 1
    heard: bool = True
    remarks: Sequence[tuple[bytes, str]] = ()

    @property
    def active(self) -> bool:
        """Whether the node is active."""
        return self.state == "active"

    def judged(self) -> list[tuple[bytes, str]]:
        """Return the judgements common to both nodes."""
        judgements = [(OK, self.state), *self.remarks]
        if self.mismatches:
            judgements.append((WARN, f"{self.mismatches} publishers with an incompatible QoS"))
        return judgements


class ControllerReport:
    """Timing of the samples and their answers; ``unstamped``: whether samples without a stamp have come.

    Parameters
    ----------
    rate : nominal, Hz
    timeout : age of a sample that is worth a warning, s
    """

    def __init__(self, rate: float, timeout: float) -> None:
        self._rate, self._timeout = rate, timeout
        self.step_time, self.age, self._since = Window(), Window(), Since()
        self._came = self.unstamped = False

    def statuses(
        self, facts: NodeFacts, joints: Sequence[str], servo: Servo, gate: SampleGate, shown: dict[str, Any]
    ) -> list[DiagnosticStatus]:
        """Return the report on the time since the last call; ``shown`` are parameters to repeat."""
        before, self._came = self._came, facts.active and not gate.waiting
        steady = before and self._came  # samples arrived all the time
        grown = self._since.look(
            at=now(), stamp=gate.stamp or 0, taken=gate.taken, late=gate.late, dropped=gate.dropped
        )
        hardware = ", ".join(joints)
        said = {
            "state": facts.state,
            "fault": servo.fault,
            "fault_name": servo.latched.name if servo.latched else "",
            "lost_encoder": servo.lost_encoder,
            "learning": servo.experimenting,
            "progress": f"{servo.progress:.2f}",
            "samples_answered": gate.taken,
            "messages_dropped": gate.dropped,
            "last_dropped": gate.last_dropped,
        }
        age, step = self.age.take(), self.step_time.take()
        # From the stamps if they are regular: in simulated time the steady clock does not show the drive's rate.
        seconds = 1e-9 * grown["stamp"] if 0 < grown["stamp"] < in_ns(CLOCKS_DIFFER) else grown["at"]
        rate = grown["taken"] / seconds
        timing = [rate_level(rate, self._rate)] if steady and grown["taken"] else [(OK, facts.state)]
        if grown["late"]:
            timing.append((WARN, f"{grown['late']} samples late within {grown['at']:.1f} s"))
        timing.append(age_level(age, self._timeout, unstamped=self.unstamped))
        if step[1] > 1.0 / self._rate:
            timing.append((ERROR, f"one step takes {step[1]:.3g} s, longer than a period"))
        paced = {
            "rate_Hz": f"{rate:.2f}",
            "nominal_rate_Hz": f"{self._rate:g}",
            "late_samples": gate.late,
            "clock_jumps": gate.jumps,
            "state_age": milliseconds(age),
            "step_time": milliseconds(step),
        }
        return [
            status(f"{facts.name}: servo", hardware, self._servo(facts, servo, gate, grown["dropped"]), said | shown),
            status(f"{facts.name}: timing", hardware, timing, paced),
        ]

    @staticmethod
    def _servo(facts: NodeFacts, servo: Servo, gate: SampleGate, dropped: float) -> list[tuple[bytes, str]]:
        judgements = facts.judged()
        if servo.latched:
            judgements.append((ERROR, servo.fault))
        if servo.lost_encoder:
            judgements.append((WARN, ONE_IS_LOST.format(servo.lost_encoder)))
        if facts.active and not facts.heard and (gate.unheard or servo.holding):
            judgements.append((WARN, f"command has no subscriber{' any more' if servo.holding else ''}"))
        elif facts.active and gate.waiting:
            judgements.append((WARN, "waiting for joint_states"))
        if dropped:
            judgements.append((WARN, f"{dropped} messages dropped, the last one: {gate.last_dropped}"))
        if facts.commanders > 1:
            judgements.append((WARN, f"{facts.commanders} publishers on command"))
        return judgements


class SimulatorReport:
    """Timing of the samples, and how many are answered in time.

    ``rate``: nominal, Hz; nan in lockstep, which has none.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self.samples = self.late = self.rejected = 0
        self.step_time, self._since = Window(), Since()

    def begin(self, gate: CommandGate) -> None:
        """Start counting."""
        self._grown(gate)

    def _grown(self, gate: CommandGate) -> dict[str, float]:
        return self._since.look(at=now(), samples=self.samples, late=self.late, answered=gate.answered)

    def statuses(self, facts: NodeFacts, gate: CommandGate, unit: str, load_torque: float) -> list[DiagnosticStatus]:
        """Return the report on the time since the last call."""
        grown = self._grown(gate)
        drive = facts.judged()
        if gate.fault:
            drive.append((ERROR, gate.why))
        timing = [(OK, facts.state)]
        if facts.active and grown["samples"] and self._rate == self._rate:
            timing = [rate_level(grown["samples"] / grown["at"], self._rate)]
            if grown["late"]:
                timing.append((WARN, f"{grown['late']} samples late within {grown['at']:.1f} s"))
        said = {
            "state": facts.state,
            "fault": gate.why,
            "fault_name": gate.fault.name if gate.fault else "",
            f"command_{unit}": gate.value,
            "load_torque_Nm": load_torque,
            "messages_rejected": self.rejected + gate.rejected,
        }
        paced = {
            "rate_Hz": f"{grown['samples'] / grown['at']:.2f}",
            "nominal_rate_Hz": f"{self._rate:g}",
            "samples": self.samples,
            "late_samples": self.late,
            "answered_in_period": gate.answered,
            "answered_late": gate.answered_late,
            "answered_percent": f"{100 * grown['answered'] / grown['samples']:.2f}" if grown["samples"] else "",
            "integration": milliseconds(self.step_time.take()),
        }
        return [
            status(f"{facts.name}: drive", "simulated drive", drive, said),
            status(f"{facts.name}: timing", "simulated drive", timing, paced),
        ]
