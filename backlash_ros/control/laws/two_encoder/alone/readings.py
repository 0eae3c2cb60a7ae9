"""Which readings of the one encoder are believed, and what becomes of the shafts where it has leapt."""

from backlash_ros.control.laws.two_encoder.alone.constants import AloneConstants
from backlash_ros.control.laws.two_encoder.alone.memory import AloneMemory
from backlash_ros.control.laws.two_encoder.memory import Load
from backlash_ros.control.laws.two_encoder.readings import check_reading, largest_error
from backlash_ros.foundation.compiled import compiled


@compiled
def believe(constants: AloneConstants, memory: AloneMemory, readings: Load, reading: float, expected: float) -> bool:
    """Return whether a reading is plausible, rad; both shafts go along with an encoder that has leapt."""
    shafts, plans, period = memory.shafts, constants.plans, constants.plans.period
    error, unexpected_motion = reading - expected, reading - readings.angle - period * readings.speed
    readings.angle = reading
    bound = largest_error(plans, memory.plans, readings.count)
    correction = check_reading(readings.doubt, error, unexpected_motion, bound, period)
    if not correction.plausible:
        shafts.angle += correction.angle
        shafts.load_angle += correction.angle
        shafts.speed += correction.speed
        shafts.load_speed += correction.speed
    return correction.plausible
