"""What the faults that the tick finds say: what was seen, and beyond which bound."""

from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.drivetrain.signals import Array
from backlash_ros.gates.faults import Fault

DETAILS = 3
"""How many numbers go with a fault, for its text."""


def describe_fault(fault: Fault, details: Array, limits: Limits, thresholds: FaultThresholds) -> str:
    """Return the text of a fault: what was seen, and beyond which bound."""
    a, b, c = details.tolist()
    side = "motor" if fault in {Fault.MOTOR_JUMP, Fault.MOTOR_OVERSPEED, Fault.MOTOR_SPEED} else "load"
    end = "lower" if fault is Fault.LOWER_END else "upper"
    texts = {
        Fault.ENCODERS_DISAGREE: f"encoders disagree: the shafts moved {a:.3g} rad apart, more than {b:.3g} rad by "
        "faults.gap or backlash_angle; an encoder stands still, jumps or counts backwards, or the gear slips",
        Fault.UNEXPLAINED_TORQUE: f"unexplained torque of {a:.3g} N m, more than {b:.3g} N m by faults.load_torque or "
        "limits.command; the motor does not follow its command, the load is blocked, or encoders stand still or count "
        "backwards",
        Fault.RATE: f"samples come every {a:.3g} s, and rate says every {b:g} s: it must be the drive's",
        Fault.NOT_FINITE: "no finite command follows from the joint states",
        Fault.MOTOR_CURRENT: f"motor current of {a:.3g} A, which the command cannot make: from {b:.3g} to {c:.3g} A "
        "follow from it; effort in the wrong unit (it is N m at the motor's shaft), of the wrong sign, or broken",
    }
    jump = (
        f"{side} encoder moved {a:.3g} rad at the output within {b:.3g} s, faster than "
        f"faults.velocity = {thresholds.velocity:g} rad/s"
    )
    overspeed = f"{side} speed of {a:.3g} rad/s at the output, faults.velocity = {thresholds.velocity:g} rad/s"
    apart = f"moves at {b:.3g} +- {c:.3g} rad/s" if c >= 0 else f"has come {-c:.3g} rad off it within a short while"
    contradiction = (
        f"{side} speed of {a:.3g} rad/s at the output contradicts its encoder, which {apart}; velocity in the wrong "
        "unit, of the wrong sign, or broken, an encoder that stands still, or a rate that is not the drive's"
    )
    beyond = (
        f"load at {a:.4g} rad, further than limits.soft_zone = {limits.soft_zone:g} rad "
        f"beyond limits.position_{end} = {getattr(limits, f'position_{end}'):g} rad"
    )
    texts |= dict.fromkeys((Fault.MOTOR_JUMP, Fault.LOAD_JUMP), jump)
    texts |= dict.fromkeys((Fault.MOTOR_OVERSPEED, Fault.LOAD_OVERSPEED), overspeed)
    texts |= dict.fromkeys((Fault.MOTOR_SPEED, Fault.LOAD_SPEED), contradiction)
    texts |= dict.fromkeys((Fault.LOWER_END, Fault.UPPER_END), beyond)
    return texts[fault]
