"""The reference in motion, now and in the time that the law sees ahead, and the torque that the load needs for it."""

import math
from typing import NamedTuple

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load_torque import holds_load, load_torque_at
from backlash_ros.control.laws.planned.memory import Drag, Follow, Learned, Memory
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import ACCELERATION, POSITION, VELOCITY

CREEPS = 0.1
"""Speed of a reference, in gaps per second, up to which it is held like one at rest. Holding lets the load be off by a
twelfth of the gap, so nothing is lost."""
_NO_DIRECTION = 1e-6
"""Speed, rad/s, and acceleration, rad/s^2, that are rounding."""
_NOISE_SHARE = 1e-3
"""Share of the stall torque within which a drag is not told from noise. Without this dead band the drag that is learned
chooses flanks at random."""

_LARGE = 4.0
"""A drag that is so many times as large as that noise is believed as it is. Tuned on random drives."""


class Reference(NamedTuple):
    """The reference at an instant."""

    angle: float  # rad
    speed: float  # rad/s
    acceleration: float  # rad/s^2


@compiled
def reference_at(constants: Constants, path: Array, k: float) -> Reference:
    """Return the reference k periods after the sample: between rows by an even jerk, after the last at its speed."""
    last, i, period = path.shape[0] - 1, int(k + 1e-9), constants.period
    unit, unit_squared = constants.unit, constants.unit * constants.unit
    if i >= last:
        speed = unit * path[last, VELOCITY]
        return Reference(path[last, POSITION] + (k - last) * period * speed, speed, 0.0)
    time, speed, acceleration = (k - i) * period, unit * path[i, VELOCITY], unit_squared * path[i, ACCELERATION]
    jerk = (unit_squared * path[i + 1, ACCELERATION] - acceleration) / period
    angle = path[i, POSITION] + time * (speed + time * (0.5 * acceleration + time * jerk / 6.0))
    return Reference(angle, speed + time * (acceleration + 0.5 * time * jerk), acceleration + time * jerk)


@compiled
def moves_within(constants: Constants, path: Array, first: float, rows: int) -> bool:
    """Return whether the reference moves at one of so many rows of the path, the first of them given."""
    crossing_time, creeps = constants.unit * constants.crossing_time, CREEPS * constants.gap / constants.unit
    for k in range(int(first), min(int(first) + rows, path.shape[0])):
        if abs(path[k, VELOCITY]) + crossing_time * abs(path[k, ACCELERATION]) > creeps:
            return True
    return False


@compiled
def direction_at(reference: Reference, last: float) -> float:
    """Return in which direction the reference goes, or begins to go; the last one if it rests."""
    if abs(reference.speed) > _NO_DIRECTION:
        return math.copysign(1.0, reference.speed)
    if abs(reference.acceleration) > _NO_DIRECTION:
        return math.copysign(1.0, reference.acceleration)
    return last


@compiled
def learned_of(follow: Follow, direction: float) -> Learned:
    """Return what was learned of a direction and its flank."""
    return follow.forward if direction > 0.0 else follow.backward


@compiled
def weight_shares(drag: Drag, angle: float) -> tuple[float, float]:
    """Return what the drag's sine and cosine count at an angle of the load, rad."""
    way = angle - drag.origin
    return math.sin(way), 1.0 - math.cos(way)


@compiled
def drag_at(drag: Drag, angle: float, direction: float) -> float:
    """Return what motion in a direction costs beyond the model at an angle of the load, rad, N m; 0: a load at rest."""
    sine, cosine = weight_shares(drag, angle)
    return drag.load + direction * drag.friction + sine * drag.sine + cosine * drag.cosine


@compiled
def _sure_drag(constants: Constants, memory: Memory, angle: float, direction: float) -> float:
    """Return it without what may be noise: nothing of a small one, all of a large one."""
    drag, noise = drag_at(memory.follow.drag, angle, direction), _NOISE_SHARE * constants.stall_torque
    beyond = drag - clamp(drag, -noise, noise)
    return drag if abs(drag) > _LARGE * noise else beyond * _LARGE / (_LARGE - 1.0)


@compiled
def resting_torque(constants: Constants, memory: Memory, angle: float) -> float:
    """Return the load torque on a load that comes to rest at an angle, rad, as far as its motion has shown it, N m."""
    return load_torque_at(memory.load_torque, angle) - _sure_drag(constants, memory, angle, 0.0)


@compiled
def needed_torque(constants: Constants, memory: Memory, path: Array, k: float) -> float:
    """Return the torque that the teeth must give the load k periods after the sample, N m."""
    reference = reference_at(constants, path, k)
    if abs(reference.speed) < _NO_DIRECTION and abs(reference.acceleration) < _NO_DIRECTION:
        # At rest the flank carries what holds the load, if anything does.
        load_torque = resting_torque(constants, memory, reference.angle)
        return -load_torque if holds_load(constants, load_torque) else 0.0
    direction = direction_at(reference, memory.follow.direction)
    torque = constants.load_inertia * reference.acceleration + constants.load_friction * reference.speed
    torque += direction * constants.load_dry_friction + _sure_drag(constants, memory, reference.angle, direction)
    return torque - load_torque_at(memory.load_torque, reference.angle)
