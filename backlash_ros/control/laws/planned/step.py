"""One step of the law: it observes both shafts, chooses a phase, and moves the motor.

In flight the motor follows its plan on its own encoder; the load only shows where the middle of the gap is. In hold
the law acts by events.
"""

from backlash_ros.control.command_range import clamp
from backlash_ros.control.law import LAW_SIGNATURE
from backlash_ros.control.laws.planned.command import Wanted, remember, voltage_for
from backlash_ros.control.laws.planned.constants import Constants, constants_at
from backlash_ros.control.laws.planned.follow import follow_path
from backlash_ros.control.laws.planned.hold import hold_load
from backlash_ros.control.laws.planned.load import observe_load
from backlash_ros.control.laws.planned.load_torque import learn_load_torque, take_expected_slope
from backlash_ros.control.laws.planned.memory import FOLLOW, HOLD, NO_MOVE, Memory, memory_at
from backlash_ros.control.laws.planned.middle import learn_middle
from backlash_ros.control.laws.planned.motor import observe_motor, predict_motor
from backlash_ros.control.laws.planned.phases import choose_phase
from backlash_ros.control.laws.planned.plan import fly_on
from backlash_ros.control.laws.planned.start import start
from backlash_ros.control.laws.planned.take_off import take_off
from backlash_ros.foundation.compiled import compiled, compiled_as
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, THETA_L, THETA_M, Estimate, Setpoint, as_setpoint


@compiled
def _observe(constants: Constants, memory: Memory, estimate: Estimate, setpoint: Setpoint) -> None:
    """Take a sample: both shafts, the middle of the gap, the load torque; then predict the motor over the delay."""
    if memory.started == 0.0:
        start(constants, memory, estimate, setpoint)
    else:
        observe_motor(constants, memory, constants.ratio * estimate[THETA_M])
        observe_load(constants, memory, estimate[THETA_L])
    learn_middle(constants, memory)
    learn_load_torque(constants, memory)
    # A slope that is set in flight counts from the next move on.
    if memory.phase == HOLD:
        take_expected_slope(constants, memory.load_torque, memory.load.angle)
    predict_motor(constants, memory.motor, memory.sent)


@compiled
def _wanted(constants: Constants, memory: Memory, path: Array) -> Wanted:
    """Return what the motor is to do in this period."""
    if memory.phase == FOLLOW:
        return follow_path(constants, memory, path)
    if memory.phase == HOLD and memory.next_move == NO_MOVE:
        wanted = hold_load(constants, memory, path[0, POSITION])
        # Holding may just have chosen a move.
        if memory.next_move == NO_MOVE:
            return wanted
    if memory.next_move != NO_MOVE:
        take_off(constants, memory)
    return fly_on(constants, memory)


@compiled_as(LAW_SIGNATURE)
def planned_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """Observe, plan if the setpoint has jumped or the load is off its target, and move the motor."""
    constants, memory = constants_at(law), memory_at(state)
    _observe(constants, memory, estimate, as_setpoint(path[0]))
    choose_phase(constants, memory, path)
    wanted = _wanted(constants, memory, path)
    voltage = clamp(voltage_for(constants, memory, wanted), low, high)
    remember(constants, memory.sent, voltage, wanted.teeth_torque, estimate)
    return voltage
