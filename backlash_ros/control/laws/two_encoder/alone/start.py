"""Start with one encoder alone, at the present position, and take a load over from another law."""

from backlash_ros.control.laws.two_encoder.alone.constants import AloneConstants, alone_constants_at
from backlash_ros.control.laws.two_encoder.alone.memory import AloneMemory, alone_memory_at
from backlash_ros.control.laws.two_encoder.alone.readings import forget
from backlash_ros.control.laws.two_encoder.start import start
from backlash_ros.control.laws.two_encoder.teeth import contact_distance
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Estimate, Setpoint


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


def take_over_alone(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Take over from another law that held the load with a voltage: see `law.TakeOver`."""
    state[1:] = row_of(AloneMemory)[1:]
    constants, memory = alone_constants_at(law), alone_memory_at(state)
    known, plans, shafts = constants.plans, memory.plans, memory.shafts
    start_alone(constants, memory, estimate, setpoint)
    torque = -holding / known.volts_per_torque
    shafts.speed, shafts.load_speed = known.ratio * estimate[OMEGA_M], estimate[OMEGA_L]
    shafts.current_torque, shafts.load_torque = -torque, torque
    plans.sent.commands[:] = (holding - known.back_emf * estimate[OMEGA_M]) / known.resistance
    # What holds a load torque lies on its flank.
    if abs(torque) > known.load_dry_friction + known.motor_dry_friction:
        distance = contact_distance(known, torque) * (-1.0 if torque > 0.0 else 1.0)
        if constants.sees_load != 0.0:
            shafts.angle = shafts.load_angle + distance
        else:
            shafts.load_angle = shafts.angle - distance
