"""Start with one encoder alone, at the present position, and take a load over from another law."""

import math

from backlash_ros.control.laws.planned.alone.constants import AloneConstants, alone_constants_at
from backlash_ros.control.laws.planned.alone.memory import ANGLE, TORQUE, AloneMemory, alone_memory_at
from backlash_ros.control.laws.planned.alone.readings import forget
from backlash_ros.control.laws.planned.constants import TABLE_SIZE
from backlash_ros.control.laws.planned.load_torque import holds_load, set_load_torque
from backlash_ros.control.laws.planned.start import start
from backlash_ros.control.laws.planned.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Setpoint


@compiled
def start_alone(constants: AloneConstants, memory: AloneMemory, estimate: Estimate, setpoint: Setpoint) -> None:
    """Start at the present position, assumed to be the middle of the gap."""
    plans, shafts = memory.plans, memory.shafts
    start(constants.plans, plans, estimate, setpoint)
    plans.middle = 0.0
    angle = estimate[THETA_L] if constants.sees_load != 0.0 else constants.plans.ratio * estimate[THETA_M]
    shafts.angle = shafts.load_angle = angle
    shafts.load_torque = plans.load_torque.smoothed = plans.load_torque.estimated
    memory.readings.last_reading = memory.readings.angle = angle
    forget(constants, memory)


_RIGID = 1e-3
"""Share of the gap: estimates that differ by less come from one encoder, through the rigid gear."""
_SEEN_PLACE = 0.1
"""Standard deviation of the motor's place in the gap, in gaps, as both encoders have shown it."""
_SEEN_TORQUE = 15.0
"""Standard deviation of the load torque, as acceleration of the motor, rad/s^2, as both encoders have shown it."""


def _go_on_from_both(constants: AloneConstants, memory: AloneMemory, estimate: Estimate, torque: float) -> None:
    """Take what both encoders have shown until now: the place in the gap, the current, and the load torque, N m."""
    known, plans, shafts = constants.plans, memory.plans, memory.shafts
    memory.covariance[ANGLE, ANGLE] = (_SEEN_PLACE * known.gap) ** 2
    memory.covariance[TORQUE, TORQUE] = (_SEEN_TORQUE * known.motor_inertia) ** 2
    per_command, braking = constants.torque_per_command, constants.braking
    shafts.current_torque = (per_command if braking == 0.0 else known.unit * braking / per_command) * estimate[CURRENT]
    plans.sent.commands[:] = (shafts.current_torque + braking * shafts.speed) / per_command
    plans.held = 1.0 if holds_load(known, torque) else 0.0
    plans.load_torque.smoothed = torque
    set_load_torque(plans.load_torque, torque * plans.held, estimate[THETA_L])


def take_over_alone(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Take over from another law that held the load with a voltage: see `law.TakeOver`.

    Estimates of both shafts that differ come from two encoders, of which one is lost now.
    """
    state[1:] = row_of(AloneMemory)[1:]
    constants, memory = alone_constants_at(law), alone_memory_at(state)
    known, plans, shafts = constants.plans, memory.plans, memory.shafts
    start_alone(constants, memory, estimate, setpoint)
    torque = -holding / known.volts_per_torque
    shafts.speed, shafts.load_speed = known.ratio * known.unit * estimate[OMEGA_M], known.unit * estimate[OMEGA_L]
    shafts.current_torque, shafts.load_torque = -torque, torque
    plans.sent.commands[:] = (holding - known.back_emf * estimate[OMEGA_M]) / known.resistance
    apart, farthest = known.ratio * estimate[THETA_M] - estimate[THETA_L], float(known.teeth_distances[TABLE_SIZE - 1])
    distance = 0.0
    if abs(apart) > _RIGID * known.gap:
        distance = min(max(apart, -farthest), farthest)
        _go_on_from_both(constants, memory, estimate, torque)
    elif abs(torque) > known.load_dry_friction + known.motor_dry_friction:
        # What holds a load torque lies on its flank.
        distance = math.copysign(contact_distance(known, torque), -torque)
    if constants.sees_load != 0.0:
        shafts.angle = shafts.load_angle + distance
    else:
        shafts.load_angle = shafts.angle - distance
