"""The texts of the faults that the tick finds: what was seen, and which bound it exceeded."""

from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.foundation.record import Array
from backlash_ros.gates.faults import Fault

DETAILS = 3
"""Number of values that a fault's text needs."""


def describe_fault(fault: Fault, details: Array, limits: Limits, thresholds: FaultThresholds) -> str:
    """Return the text of a fault: what was seen, and which bound it exceeded."""
    a, b, c = details.tolist()
    side = "motor" if fault in {Fault.MOTOR_JUMP, Fault.MOTOR_OVERSPEED, Fault.MOTOR_SPEED} else "load"
    end = "lower" if fault is Fault.LOWER_END else "upper"
    texts = {
        Fault.ENCODERS_DISAGREE: f"encoders disagree: the shafts moved {a:.3g} rad apart, more than {b:.3g} rad by "
        "faults.gap or backlash_angle; an encoder stands still, jumps or counts backwards, or the gear slips",
        Fault.UNEXPLAINED_TORQUE: f"unexplained torque of {a:.3g} N m, more than {b:.3g} N m by faults.load_torque or "
        "limits.command; the motor does not follow its command, the load is blocked, or encoders stand still or count "
        "backwards",
        Fault.TRACKING: f"the load left its reference: within a second it went {a:.3g} rad further away than "
        f"the reference's motion explains, more than {b:.3g} rad by faults.tracking, backlash and load torque; "
        "something drives the load, or law, gains or units are wrong",
        Fault.RATE: f"samples come every {a:.3g} s, but rate says every {b:g} s: set rate as the drive has it",
        Fault.NOT_FINITE: "the joint states give no finite command",
        Fault.MOTOR_CURRENT: f"motor current of {a:.3g} A, which the command cannot cause: it allows {b:.3g} to "
        f"{c:.3g} A; the effort has the wrong unit (it is N m at the motor's shaft) or sign, or its sensor is broken",
    }
    jump = (
        f"{side} encoder moved {a:.3g} rad at the output within {b:.3g} s, faster than "
        f"faults.velocity = {thresholds.velocity:g} rad/s"
    )
    overspeed = f"{side} speed of {a:.3g} rad/s at the output, faults.velocity = {thresholds.velocity:g} rad/s"
    apart = f"moves at {b:.3g} +- {c:.3g} rad/s" if c >= 0 else f"drifted {-c:.3g} rad from it in a short time"
    contradiction = (
        f"{side} speed of {a:.3g} rad/s at the output contradicts its encoder, which {apart}; the velocity has the "
        "wrong unit or sign or is broken, the encoder stands still, or rate is not the drive's"
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
