"""Start at the present position, and take a load over from another law."""

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants, constants_at
from backlash_ros.control.laws.planned.load import UNKNOWN_COUNT
from backlash_ros.control.laws.planned.load_torque import (
    holds_load,
    load_torque_at,
    set_load_torque,
    take_expected_slope,
)
from backlash_ros.control.laws.planned.memory import HOLD, Memory, memory_at
from backlash_ros.control.laws.planned.middle import set_middle_by_contact
from backlash_ros.control.laws.planned.motor import STUCK_SPEED, momentum_at
from backlash_ros.control.laws.planned.parking import LONG
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array, row_of
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, POSITION, THETA_L, THETA_M, Estimate, Setpoint

_BLOW_RATE = 150.0
"""Rate, 1/s: times the load's momentum, it is the torque by which blows may falsify what held the load; it may rattle.
Tuned on the populations."""


@compiled
def start(constants: Constants, memory: Memory, estimate: Estimate, setpoint: Setpoint) -> None:
    """Start at the present position, assumed to be the middle of the gap."""
    motor, load, load_torque = memory.motor, memory.load, memory.load_torque
    angle, load_angle, friction = constants.ratio * estimate[THETA_M], estimate[THETA_L], constants.load_dry_friction
    motor.estimated.angle = memory.motor_target = motor.last_reading = motor.count.reading = angle
    load.angle = load.last_reading = load_angle
    memory.middle = angle - load_angle
    load.count = UNKNOWN_COUNT * constants.gap
    # A target that is far away means a flight: the law sees that it is new.
    far = abs(setpoint[POSITION] - load_angle) > LONG * constants.gap
    memory.target = load_angle if far else setpoint[POSITION]
    memory.phase, memory.hold.error_share, memory.started = HOLD, 1.0, 1.0
    take_expected_slope(constants, load_torque, load.angle)
    load_torque.constant = constants.expected_load_torque
    # At rest the load torque is no larger than the friction that hides it.
    set_load_torque(load_torque, clamp(load_torque_at(load_torque, load.angle), -friction, friction), load.angle)


@compiled
def _believed_torque(constants: Constants, memory: Memory, shown: float) -> float:
    """Return the load torque at a take-over, N m; ``shown``: by what the other law held the load with."""
    load_torque, friction = memory.load_torque, constants.load_dry_friction
    hidden = friction + constants.motor_dry_friction
    # The load may rattle: the torque that held it is mostly blows.
    if load_torque.recent_peak_speed > STUCK_SPEED:
        hidden += _BLOW_RATE * constants.load_inertia * load_torque.recent_peak_speed
        return clamp(load_torque_at(load_torque, memory.load.angle), shown - hidden, shown + hidden)
    if holds_load(constants, shown):
        return shown
    return clamp(clamp(load_torque.estimated, shown - hidden, shown + hidden), -friction, friction)


@compiled
def _take_over(constants: Constants, memory: Memory, estimate: Estimate, holding: float) -> None:
    """Go on where another law has held the load with a voltage, V."""
    motor, load, load_torque = memory.motor.estimated, memory.load, memory.load_torque
    motor.speed, load.speed = constants.ratio * constants.unit * estimate[OMEGA_M], constants.unit * estimate[OMEGA_L]
    load_torque.momentum = momentum_at(constants, motor.speed, load.speed)
    load_torque.smoothed = -holding / constants.volts_per_torque
    load_torque.recent_peak_speed = abs(load.speed)
    torque = _believed_torque(constants, memory, load_torque.smoothed)
    set_load_torque(load_torque, torque, estimate[THETA_L])
    memory.held = 1.0 if holds_load(constants, load_torque.estimated) else 0.0
    if load_torque.recent_peak_speed <= STUCK_SPEED:
        set_middle_by_contact(constants, memory, load_torque.estimated)
    memory.sent.commands[:] = (holding - constants.back_emf * estimate[OMEGA_M]) / constants.resistance
    memory.sent.teeth_torques[:] = -load_torque.estimated * memory.held
    motor.current_torque = holding / constants.volts_per_torque
    motor.disturbance = memory.motor.compensation = -load_torque.estimated * (1.0 - memory.held)


def take_over(law: Array, state: Array, estimate: Estimate, setpoint: Setpoint, holding: float) -> None:
    """Take over from another law that held the load with a voltage: see `law.TakeOver`."""
    state[1:] = row_of(Memory)[1:]
    constants, memory = constants_at(law), memory_at(state)
    start(constants, memory, estimate, setpoint)
    _take_over(constants, memory, estimate, holding)
