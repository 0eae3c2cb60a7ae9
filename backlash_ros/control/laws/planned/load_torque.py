"""The load torque: what both shafts gain in momentum beyond what the current gives.

In motion the friction is known, at rest only its bound. From rest to rest the momentum changes by nothing, so over a
whole flight a wrong inertia cancels.
"""

import math

from backlash_ros.control.command_range import clamp
from backlash_ros.control.laws.planned.constants import Constants
from backlash_ros.control.laws.planned.load import STANDSTILL
from backlash_ros.control.laws.planned.memory import FLIGHT, HOLD, LoadTorque, Memory
from backlash_ros.control.laws.planned.motor import REST_SPEED, known_torque, momentum_at
from backlash_ros.control.laws.planned.teeth import teeth_are_apart
from backlash_ros.foundation.compiled import compiled

LEAST_SHOWN = 3.0
"""What a flight must show of a load torque at least, as acceleration of the motor, rad/s^2. Tuned on the
populations."""
FRICTION_ERROR = 0.1
"""Share of a dry friction by which it may be off: it is not known better."""
_SMOOTHING_TIME = 0.05
"""Time, s, over which the torque from the momentum is smoothed, and the peak of the speed fades. Tuned on the
populations."""
_TURNING_SPEED = 0.2
"""Speed of the load, rad/s, from which on its friction is known. Tuned on the populations."""
_LEAST_TIME = 0.05
"""Time, s, for which a flight must show the load torque. Tuned on the populations."""
_DISPROVED = 2.0
"""The expected slope is wrong if the load torque is so many times as far off with it as without. Tuned on the
populations."""
SETTLE_TIME = 0.1
"""Time in hold, s, after which what is seen at rest shows the load torque, and where a held load lies. Tuned on the
populations."""
_UNSURE = 5.0
"""By how much the load torque may be off while the teeth seem apart, as acceleration of the motor, rad/s^2. Tuned on
the populations."""
_LAG_RATE = 20.0
"""By how much the load torque may be off, as acceleration of the load for each rad/s of its recent peak speed, 1/s.
Tuned on the populations."""


@compiled
def load_torque_at(load_torque: LoadTorque, angle: float) -> float:
    """Return the load torque in plans at an angle of the load (rad), N m."""
    return load_torque.constant + load_torque.sine * math.sin(angle) + load_torque.cosine * math.cos(angle)


@compiled
def set_load_torque(load_torque: LoadTorque, torque: float, angle: float) -> None:
    """Take a torque (N m) for the load torque at an angle of the load, rad, and with it what it is elsewhere."""
    load_torque.estimated = torque
    load_torque.constant += torque - load_torque_at(load_torque, angle)


@compiled
def take_expected_slope(constants: Constants, load_torque: LoadTorque, angle: float) -> None:
    """Take how the load torque is expected to grow with the load's angle, if that is new; for a load at rest."""
    sine, cosine = constants.expected_sine, constants.expected_cosine
    if sine != load_torque.expected_sine or cosine != load_torque.expected_cosine:
        load_torque.sine = load_torque.expected_sine = sine
        load_torque.cosine = load_torque.expected_cosine = cosine
        set_load_torque(load_torque, load_torque.estimated, angle)


@compiled
def holds_load(constants: Constants, torque: float) -> bool:
    """Return whether a load torque (N m) holds the load on a flank, because it exceeds friction."""
    return abs(torque) > constants.load_dry_friction + constants.holding_excess


@compiled
def _gained_momentum(constants: Constants, memory: Memory) -> float:
    """Return what both shafts gained in this period beyond what current and viscous friction give, N m s."""
    motor, load_speed, load_torque = memory.motor.estimated, memory.load.speed, memory.load_torque
    momentum = momentum_at(constants, motor.speed, load_speed)
    gained, load_torque.momentum = momentum - load_torque.momentum, momentum
    return gained - constants.period * known_torque(constants, motor, load_speed)


@compiled
def _smooth(load_torque: LoadTorque, gained: float, period: float) -> None:
    """Let the smoothed torque follow what the momentum shows."""
    load_torque.smoothed += min(1.0 / _SMOOTHING_TIME, 1.0 / period) * (gained - period * load_torque.smoothed)


@compiled
def _observe_motion(constants: Constants, memory: Memory, gained: float) -> None:
    """Sum up what a flight, or a setpoint in motion, shows of the load torque; ``gained`` is a momentum, N m s."""
    load_torque, period, speed = memory.load_torque, constants.period, memory.load.speed
    turns = abs(speed) > _TURNING_SPEED
    if not turns:
        _smooth(load_torque, gained, period)
    # A motor that stands tells nothing: its dry friction is unknown.
    if constants.motor_dry_friction != 0.0 and abs(memory.motor.estimated.speed) <= REST_SPEED:
        return
    if turns:
        load_torque.unexplained_momentum += period * math.copysign(constants.load_dry_friction, speed)
    friction_is_known = turns or constants.load_dry_friction == 0.0
    if friction_is_known:
        planned = load_torque_at(load_torque, memory.load.angle)
        load_torque.observed_time += period
        load_torque.unexplained_momentum -= period * planned
        load_torque.slope_momentum += period * (planned - load_torque.estimated)
    if friction_is_known or memory.held == 0.0:
        braked = math.copysign(constants.motor_dry_friction, memory.motor.estimated.speed)
        load_torque.unexplained_momentum += gained + period * braked


@compiled
def _observe_rest(constants: Constants, memory: Memory) -> None:
    """Change the load torque as far as what is seen at rest contradicts it."""
    load_torque, angle, friction = memory.load_torque, memory.load.angle, constants.load_dry_friction
    unknown = friction + constants.motor_dry_friction
    unknown += _LAG_RATE * constants.load_inertia * load_torque.recent_peak_speed
    if teeth_are_apart(constants, memory):
        unknown += _UNSURE * constants.motor_inertia
        # Nothing but friction holds a load that stands there.
        if abs(memory.load.speed) < STANDSTILL:
            set_load_torque(load_torque, clamp(load_torque.estimated, -friction, friction), angle)
            return
    least, most = load_torque.smoothed - unknown, load_torque.smoothed + unknown
    possible = clamp(load_torque.estimated, least, most)
    # Friction leaves a range of possible values. Without it there is one value, which is noisy.
    share = 1.0 if friction > 0.0 else min(constants.period / _SMOOTHING_TIME, 1.0)
    set_load_torque(load_torque, load_torque.estimated + share * (possible - load_torque.estimated), angle)


@compiled
def learn_load_torque(constants: Constants, memory: Memory) -> None:
    """Learn the load torque from the momentum that both shafts gain beyond what the current gives."""
    load_torque, period = memory.load_torque, constants.period
    gained = _gained_momentum(constants, memory)
    faded = load_torque.recent_peak_speed * (1.0 - period / _SMOOTHING_TIME)
    load_torque.recent_peak_speed = max(abs(memory.load.speed), faded)
    if memory.phase != HOLD:
        _observe_motion(constants, memory, gained)
        return
    _smooth(load_torque, gained, period)
    if memory.hold.time_since_landing > SETTLE_TIME:
        _observe_rest(constants, memory)


@compiled
def _shown_by_motion(constants: Constants, load_torque: LoadTorque, planned: float) -> float:
    """Return the load torque that the motion has shown where ``planned`` was expected, N m."""
    time, least = load_torque.observed_time, LEAST_SHOWN * constants.motor_inertia
    error = load_torque.unexplained_momentum / time
    error_without_slope = (load_torque.unexplained_momentum + load_torque.slope_momentum) / time
    if abs(error) > _DISPROVED * abs(error_without_slope) + 2.0 * least:
        load_torque.sine = load_torque.cosine = 0.0
        planned, error = load_torque.estimated, error_without_slope
    shown = planned + error
    unsure, expected = least + FRICTION_ERROR * constants.motor_dry_friction, constants.expected_load_torque
    if abs(shown) >= unsure:
        return shown
    return expected if abs(shown - expected) < unsure else 0.0


@compiled
def use_what_motion_showed(constants: Constants, memory: Memory) -> None:
    """Use the load torque that the last motion has shown; a load that stood still bounds it by its friction."""
    load_torque = memory.load_torque
    angle = memory.target if memory.phase == FLIGHT else memory.load.angle
    torque = load_torque_at(load_torque, angle)
    if load_torque.observed_time > _LEAST_TIME:
        torque = _shown_by_motion(constants, load_torque, torque)
        # There is no plan while following a setpoint.
        if memory.phase == FLIGHT:
            load_torque.smoothed = -memory.plan.rest_torque
    else:
        unknown = constants.load_dry_friction + constants.motor_dry_friction
        torque = clamp(torque, load_torque.smoothed - unknown, load_torque.smoothed + unknown)
    set_load_torque(load_torque, torque, angle)
    load_torque.unexplained_momentum = load_torque.slope_momentum = load_torque.observed_time = 0.0
