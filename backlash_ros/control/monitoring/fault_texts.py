"""The faults that the tick finds: the numbers that it notes for their texts, and the texts."""

from backlash_ros.control.limits import Limits
from backlash_ros.control.monitoring.thresholds import FaultThresholds
from backlash_ros.foundation.record import Record
from backlash_ros.gates.faults import Fault


class FaultDetails(Record):
    """What the text of a fault needs: each fault sets those of these that it uses."""

    value: float = 0.0  # what is wrong, in its unit
    bound: float = 0.0  # what it exceeded, or may deviate by, in the same unit
    expected: float = 0.0  # what it should be about, in the same unit
    low: float = 0.0  # A, smallest plausible current
    high: float = 0.0  # A, largest plausible current
    drift: float = 0.0  # rad, of travel from integrated speed; 0 if that is not what is wrong
    elapsed: float = 0.0  # s, since the previous sample


def describe_fault(
    fault: Fault, details: FaultDetails, limits: Limits, thresholds: FaultThresholds, zero: float = 0.0
) -> str:
    """Return the text of a fault: what was seen, and which bound it exceeded; ``limits`` count from ``zero``, rad."""
    value, bound = details.value, details.bound
    if fault in {Fault.MOTOR_JUMP, Fault.LOAD_JUMP, Fault.MOTOR_OVERSPEED, Fault.LOAD_OVERSPEED}:
        return _too_fast(fault, details, thresholds)
    if fault in {Fault.MOTOR_SPEED, Fault.LOAD_SPEED}:
        return _contradiction(fault, details)
    end = "lower" if fault is Fault.LOWER_END else "upper"
    beyond = (
        f"load at {value - zero:.4g} rad, further than limits.soft_zone = {limits.soft_zone:g} rad "
        f"beyond limits.position_{end} = {getattr(limits, f'position_{end}'):g} rad"
    )
    texts = {
        Fault.ENCODERS_DISAGREE: f"encoders disagree: the shafts moved {value:.3g} rad apart, more than {bound:.3g} "
        "rad by faults.gap or backlash_angle; an encoder stands still, jumps or counts backwards, or the gear slips",
        Fault.UNEXPLAINED_TORQUE: f"unexplained torque of {value:.3g} N m, more than {bound:.3g} N m by "
        "faults.load_torque or limits.command; the motor does not follow its command, the load is blocked, or encoders "
        "stand still or count backwards",
        Fault.TRACKING: f"the load left its reference: within a second it went {value:.3g} rad further away than "
        f"the reference's motion explains, more than {bound:.3g} rad by faults.tracking, backlash and load torque; "
        "something drives the load, or law, gains or units are wrong",
        Fault.RATE: f"samples come every {value:.3g} s, but rate says every {bound:g} s: set rate as the drive has it",
        Fault.NOT_FINITE: "the joint states give no finite command",
        Fault.MOTOR_CURRENT: f"motor current of {value:.3g} A, which the command cannot cause: it allows "
        f"{details.low:.3g} to {details.high:.3g} A; the effort has the wrong unit (it is N m at the motor's shaft) or "
        "sign, or its sensor is broken",
        Fault.LOWER_END: beyond,
        Fault.UPPER_END: beyond,
    }
    return texts[fault]


def _too_fast(fault: Fault, details: FaultDetails, thresholds: FaultThresholds) -> str:
    side = "motor" if fault in {Fault.MOTOR_JUMP, Fault.MOTOR_OVERSPEED} else "load"
    allowed = f"faults.velocity = {thresholds.velocity:g} rad/s"
    if fault in {Fault.MOTOR_OVERSPEED, Fault.LOAD_OVERSPEED}:
        return f"{side} speed of {details.value:.3g} rad/s at the output, {allowed}"
    return (
        f"{side} encoder moved {details.value:.3g} rad at the output within {details.elapsed:.3g} s, "
        f"faster than {allowed}"
    )


def _contradiction(fault: Fault, details: FaultDetails) -> str:
    side = "motor" if fault is Fault.MOTOR_SPEED else "load"
    does = f"moves at {details.expected:.3g} +- {details.bound:.3g} rad/s"
    if details.drift > 0.0:
        does = f"drifted {details.drift:.3g} rad from it in a short time"
    return (
        f"{side} speed of {details.value:.3g} rad/s at the output contradicts its encoder, which {does}; the velocity "
        "has the wrong unit or sign or is broken, the encoder stands still, or rate is not the drive's"
    )
