"""The law of planned moves where the reference moves again in flight: the new plan begins where the motor is.

`benchmarks/moved_in_flight.py` counts on many drives how such moves end; docs/evaluation.md has its table.
"""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.control.laws.planned.constants import constants_at
from backlash_ros.control.laws.planned.memory import FLIGHT, memory_at
from backlash_ros.control.laws.planned.plan import evaluate, length_of
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import THETA_L
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import draw_member, told_model
from backlash_ros.studies.evaluation.task import first_reading, settings_for, true_reading
from backlash_ros.studies.judging import OVERSHOOT, QUIET, threshold

JUMP = 0.1
"""Most of the voltage that a difference of plan and motor may command at once, where the plan is new: a share of the
limit. A plan that began at rest, or at the last one's target, would command all of it."""


@pytest.mark.parametrize("number", range(6))
def test_a_plan_made_in_flight_begins_where_the_motor_is_and_ends_quiet(number: int) -> None:
    """So all of a jump of the command is the plan's; without delay, as the motor is observed at the sample itself."""
    member = replace(draw_member(1, number, "core"), delay=Delay())
    drive, b = member.drive, member.drive.gear.backlash_angle
    settings = settings_for(drive, member).with_law("planned")
    servo = Servo(drive, replace(settings, backlash_angle=b, identified=True))
    plant = SimulatedDrive(drive, 1.0 / member.rate, sensors=member.sensors)
    constants, memory = constants_at(servo.law_arrays[0]), memory_at(servo.law_arrays[1])
    random, flown, reference = np.random.default_rng(number), 0, first_reading(member)

    def run(seconds: float) -> np.ndarray:
        angles = []
        for _ in range(max(1, round(seconds * member.rate))):
            plant.advance(servo.update(plant.sample(), plant.elapsed), member.load_torque)
            angles.append(float(plant.state[THETA_L]))
        return np.array(angles)

    run(0.5)
    for _ in range(3):
        for first in (True, False):
            reference += random.choice([-1.0, 1.0]) * random.uniform(0.3, 1.0)
            assert servo.set_reference(reference) == ""
            run(0.0)
            if first:
                run(random.uniform(0.2, 0.8) * length_of(memory.plan))
                flown += memory.phase == FLIGHT
        assert memory.plan.time == pytest.approx(constants.period)  # a new plan
        begins, motor = evaluate(constants, memory, 0.0), memory.motor.estimated
        torque = constants.stiffness * (begins.angle - motor.angle) + constants.damping * (begins.speed - motor.speed)
        assert abs(constants.volts_per_torque * torque) <= JUMP * drive.command_limit
        rest = run(2.5)[-round(member.rate) :]
        assert np.ptp(rest) <= b * threshold(QUIET, b, member.load_count)
    assert servo.fault == ""
    assert flown >= 2


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("torque", "first", "second"), [(0.1, 0.5, 1.0), (0.3, 1.0, 0.6), (0.5, 1.5, 1.0)])
def test_a_load_torque_that_helps_does_not_carry_the_load_past_a_reference_that_comes_in_flight(
    gains: GainSet, torque: float, first: float, second: float, sign: float
) -> None:
    """The load is met on its front side: it must not fall ahead of the motor, however fast it is."""
    b, period = NOMINAL_DRIVE.gear.backlash_angle, 0.004
    settings = replace(ServoSettings(gains).with_law("planned"), backlash_angle=b, identified=True)
    servo = Servo(NOMINAL_DRIVE, settings)
    encoders = Sensors(measured=("theta_m", "theta_l"), motor_counts=4096.0, load_counts=65536.0)
    plant = SimulatedDrive(NOMINAL_DRIVE, period, sensors=encoders)

    def run(seconds: float) -> np.ndarray:
        angles = []
        for _ in range(round(seconds / period)):
            plant.advance(servo.update(plant.sample(), plant.elapsed), sign * torque)
            angles.append(float(plant.state[THETA_L]))
        return sign * np.array(angles)

    run(1.0)
    assert servo.set_reference(sign) == ""
    run(2.0)
    assert servo.set_reference(sign * (1.0 + first)) == ""
    run(period)
    memory = memory_at(servo.law_arrays[1])
    at = float(run(0.5 * length_of(memory.plan))[-1])
    assert memory.phase == FLIGHT
    assert servo.set_reference(sign * (at + second)) == ""
    angles = run(2.0)
    assert np.max(angles) - at - second <= 0.25 * b
    assert np.ptp(angles[-250:]) <= 0.05 * b
    assert servo.fault == ""


def test_a_law_that_takes_a_rattling_load_over_does_not_take_its_blows_for_a_load_torque() -> None:
    """Judged by moves that begin 0.1 s later: with a load torque that is not there, every other one went too far."""
    member = draw_member(20261122, 10, "core")  # the fast gains for its data sheet make it rattle by 1.6 b
    told, known, b = told_model(member, "identified"), told_model(member, "true"), member.drive.gear.backlash_angle
    start, gone_too_far = first_reading(member), 0
    for phase in range(20):
        servo = Servo(told, settings_for(told, member, 0.0))
        plant = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)

        def run(samples: int, servo: Servo = servo, plant: SimulatedDrive = plant) -> np.ndarray:
            angles = []
            for _ in range(samples):
                plant.advance(servo.update(plant.sample(), plant.elapsed), member.load_torque)
                angles.append(float(plant.state[THETA_L]))
            return true_reading(member, np.array(angles))

        run(1)
        assert servo.set_reference(start + 2.0 * b) == ""
        assert np.ptp(run(round(1.2 * member.rate) + phase)[-round(0.3 * member.rate) :]) > b
        settings = replace(settings_for(known, member).with_law("planned"), identified=True, backlash_angle=b)
        servo.use(settings, drive=known)
        run(round(0.1 * member.rate))
        assert servo.set_reference(start + 0.5) == ""
        most = threshold(OVERSHOOT, b, member.load_count)
        gone_too_far += float(np.max(run(round(member.rate)))) > start + 0.5 + most * b
    assert gone_too_far <= 2
