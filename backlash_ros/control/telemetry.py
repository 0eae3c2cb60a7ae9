"""The telemetry of a servo: names, units and meanings in one table, with the words for enumerated values."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from backlash_ros.control.law import FAST_REGION, OVERDAMPED_REGION
from backlash_ros.control.laws.planned.memory import PHASES
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.control.servo import Servo
from backlash_ros.foundation.signals import (
    ACCELERATION,
    CURRENT,
    OMEGA_L,
    OMEGA_M,
    POSITION,
    THETA_M,
    VELOCITY,
)
from backlash_ros.gates.faults import Fault

NO, YES = 0, 1
LEARNING, IDENTIFYING, HOMING = 1, 2, 3
_EXPERIMENTS = {
    "": 0,
    "identify": IDENTIFYING,
    "identify_by_relay": IDENTIFYING,
    "homing": HOMING,
    "homing_by_switch": HOMING,
}


@dataclass(frozen=True)
class Plotted:
    """One quantity: its unit, its meaning, and the words for its values if these are enumerated."""

    unit: str
    meaning: str
    words: Mapping[int, str] = field(default_factory=dict)


TELEMETRY = {
    "active": Plotted("", "whether the node is active", {NO: "no", YES: "yes"}),
    "fault": Plotted("", "fault that is latched", {fault.value: fault.name for fault in Fault}),
    "holding": Plotted("", "whether a position is held", {NO: "no", YES: "yes"}),
    "parameters_version": Plotted("", "version of the parameters in use"),
    "samples": Plotted("", "samples taken since the node started"),
    "elapsed": Plotted("s", "time since the previous sample, 0 for the first; nan in a message sent between samples"),
    "reference": Plotted("rad", "target angle of the load; nan while no position is held"),
    "setpoint": Plotted("rad", "angle that the load should have now"),
    "setpoint_velocity": Plotted("rad/s", "speed that the load should have now"),
    "setpoint_acceleration": Plotted("rad/s^2", "acceleration that the load should have now"),
    "error": Plotted("rad", "setpoint minus load angle, without the experiment's offset"),
    "motor_angle": Plotted("rad", "estimate, at the motor's shaft"),
    "motor_velocity": Plotted("rad/s", "estimate, at the motor's shaft"),
    "load_angle": Plotted("rad", "estimate, at the output"),
    "load_velocity": Plotted("rad/s", "estimate, at the output"),
    "current": Plotted("A", "estimate of the motor's current"),
    "load_torque": Plotted("N m", "estimate of the torque on the output; 0 with the load encoder alone"),
    "command": Plotted("V or A", "command to the drive"),
    "range_low": Plotted("V", "smallest voltage that the law may ask for"),
    "range_high": Plotted("V", "largest voltage that the law may ask for"),
    "region": Plotted(
        "", "which gains act", {0: "none", FAST_REGION: "fast gains", OVERDAMPED_REGION: "over-damped gains"}
    ),
    "phase": Plotted("", "what the law of planned moves is doing", {0: "none", **PHASES}),
    "flank": Plotted(
        "",
        "flank on which the law of planned moves has the load, or on which its move ends",
        {-1: "holds the load back", 0: "none", 1: "drives the load forward"},
    ),
    "backlash_angle": Plotted("rad", "backlash as learned or given; 0: unknown"),
    "gap_seen": Plotted("rad", "distance between both flanks, from where the teeth rested; 0 until both were seen"),
    "rattle": Plotted("rad", "peak-to-peak swing of a load that rattles while held; 0: no rattle"),
    "calmed": Plotted("", "whether the over-damped gains act because the load rattled", {NO: "no", YES: "yes"}),
    "experiment": Plotted(
        "",
        "experiment that is running",
        {0: "none", LEARNING: "learning", IDENTIFYING: "identifying", HOMING: "homing"},
    ),
    "tripped": Plotted("", "whether the switch has closed that this homing waits for", {NO: "no", YES: "yes"}),
    "progress": Plotted("", "progress of the experiment, from 0 to 1"),
    "offset": Plotted("rad", "what the experiment adds to the setpoint"),
    "torque": Plotted("N m", "torque that the experiment asks of the motor, at the output"),
}
"""Everything that ``~/state`` has, in its order."""


def telemetry(
    servo: Servo, wear: WearWatch, *, active: bool, parameters_version: int, samples: int, elapsed: float
) -> dict[str, float]:
    """Return the present values, by the names of `TELEMETRY`."""
    estimate, setpoint, excitation = servo.estimate, servo.setpoint, servo.excitation
    return {
        "active": int(active),
        "fault": servo.latched.value,
        "holding": int(servo.holding),
        "parameters_version": parameters_version,
        "samples": samples,
        "elapsed": elapsed,
        "reference": servo.reference,
        "setpoint": float(setpoint[POSITION]),
        "setpoint_velocity": float(setpoint[VELOCITY]),
        "setpoint_acceleration": float(setpoint[ACCELERATION]),
        "error": servo.tracking_error,
        "motor_angle": float(estimate[THETA_M]) - servo.zero / servo.drive.gear.ratio,
        "motor_velocity": float(estimate[OMEGA_M]),
        "load_angle": servo.load_angle,
        "load_velocity": float(estimate[OMEGA_L]),
        "current": float(estimate[CURRENT]),
        "load_torque": servo.load_torque_estimate,
        "command": servo.command,
        "range_low": servo.memory.low,
        "range_high": servo.memory.high,
        "region": servo.region if servo.holding else 0,
        "phase": servo.shown("phase") if servo.holding else 0,
        "flank": servo.shown("flank") if servo.holding else 0,
        "backlash_angle": servo.settings.backlash_angle,
        "gap_seen": wear.gap,
        "rattle": wear.rattle.swing if wear.rattle else 0.0,
        "calmed": int(servo.calmed),
        "experiment": _EXPERIMENTS.get(servo.experiment, LEARNING),
        "tripped": int(servo.tripped),
        "progress": servo.progress,
        "offset": excitation.offset,
        "torque": excitation.torque,
    }
