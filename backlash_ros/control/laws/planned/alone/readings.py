"""Which readings of the one encoder are believed, and what becomes of the shafts where it has leapt."""

from backlash_ros.control.laws.planned.alone.constants import AloneConstants
from backlash_ros.control.laws.planned.alone.memory import ANGLE, STATES, TORQUE, AloneMemory
from backlash_ros.control.laws.planned.memory import Load
from backlash_ros.control.laws.planned.readings import check_reading, largest_error
from backlash_ros.foundation.compiled import compiled

UNKNOWN_PLACE = 0.29
"""Standard deviation of a place in the gap of which nothing is known, in gaps: it is anywhere."""
_FIRST_TORQUE = 150.0
"""Standard deviation of the load torque of which nothing is known, as acceleration of the motor, rad/s^2."""


@compiled
def forget(constants: AloneConstants, memory: AloneMemory) -> None:
    """Know nothing of the motor's place in the gap, nor of the load torque."""
    for j in range(STATES):
        for k in range(STATES):
            memory.covariance[j, k] = 0.0
    memory.covariance[ANGLE, ANGLE] = (UNKNOWN_PLACE * constants.plans.gap) ** 2
    memory.covariance[TORQUE, TORQUE] = (
        min(_FIRST_TORQUE * constants.plans.motor_inertia, constants.plans.stall_torque) ** 2
    )


@compiled
def believe(constants: AloneConstants, memory: AloneMemory, readings: Load, reading: float, expected: float) -> bool:
    """Return whether a reading is plausible, rad; both shafts go along with an encoder that has leapt."""
    shafts, plans, period = memory.shafts, constants.plans, constants.plans.period
    error, unexpected_motion = reading - expected, reading - readings.angle - period * readings.speed
    readings.angle = reading
    bound = largest_error(plans, memory.plans, readings.count)
    correction = check_reading(readings.doubt, error, unexpected_motion, bound, period)
    if correction.angle != 0.0:
        # The encoder has leapt, or the model is lost: both shafts go along, and the place in the gap counts as unknown.
        shafts.angle += correction.angle
        shafts.load_angle += correction.angle
        shafts.speed = shafts.load_speed = (
            readings.speed + unexpected_motion / period if correction.speed != 0.0 else 0.0
        )
        shafts.load_torque = 0.0
        forget(constants, memory)
    return correction.plausible
