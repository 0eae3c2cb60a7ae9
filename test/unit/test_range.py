"""Laws with a memory know the range that they really have: in a soft zone they neither wind up nor predict wrongly.

The reference is beyond what the soft zone lets through, as where the ends of a travel were moved, and a load torque
presses the load back: for 5 s the law asks for more than it gets. Then the reference goes back.
"""

from dataclasses import replace

import numpy as np
import pytest
from samples import sample_of

from backlash_ros.control import GainSet, Limits, Servo, ServoSettings, design_law
from backlash_ros.control.laws.cascade import cascade_state_at
from backlash_ros.control.laws.elastic_lqg import (
    ElasticLqgParameters,
    elastic_lqg_constants_at,
    elastic_lqg_state_at,
)
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, Plant
from backlash_ros.simulation import Scenario, run

PERIOD = 0.001
LIMITS = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.5, soft_zone=0.2)
BEYOND, BACK = 1.0, 0.2
TORQUE = -0.3
HELD_AT = 0.49
"""Where the zone lets 5 % of 24 V through: the 1.2 V that hold the load torque."""


def go_on(servo: Servo, plant: Plant, reference: float, seconds: float) -> np.ndarray:
    """Return the load angle, sample by sample."""
    servo.segments[0, 0] = reference  # as an offline run has it, wherever the ends are
    angles = []
    for _ in range(round(seconds / PERIOD)):
        plant.advance(servo.update(sample_of(plant.state)), TORQUE, PERIOD)
        angles.append(plant.load_angle)
    assert servo.fault == ""
    return np.array(angles)


def settings_of(gains: GainSet, law: str) -> ServoSettings:
    return ServoSettings(gains, law=law, backlash_angle=0.02, period=PERIOD)


def held(choice: ServoSettings, seconds: float = 5.0, limits: Limits = LIMITS) -> tuple[Servo, Plant]:
    """Return a servo that has held the load off its reference, and its plant."""
    servo, plant = Servo(NOMINAL_DRIVE, choice, limits), Plant(NOMINAL_DRIVE, [4.5, 0.0, 0.45, 0.0, 0.0])
    go_on(servo, plant, BEYOND, seconds)
    return servo, plant


def ways_back(choice: ServoSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return the ways back of a servo that was held in the soft zone, and of one that begins where it was held."""
    servo, plant = held(choice)
    assert plant.load_angle == pytest.approx(HELD_AT, abs=1e-9)
    assert servo.command == pytest.approx(1.2, abs=1e-9)
    fresh, other = Servo(NOMINAL_DRIVE, choice, LIMITS), Plant(NOMINAL_DRIVE, plant.state)
    return go_on(servo, plant, BACK, 2.0), go_on(fresh, other, BACK, 2.0)


def test_integrator_of_the_cascade_stands_still_in_the_soft_zone(gains: GainSet) -> None:
    """However long it is held, while the error would make it 300 V a second."""
    for seconds in (1.0, 5.0):
        _, state = held(settings_of(gains, "cascade"), seconds)[0].law_arrays
        assert cascade_state_at(state).integral == 0.0


def test_cascade_goes_back_as_if_it_began_there(gains: GainSet) -> None:
    after, fresh = ways_back(settings_of(gains, "cascade"))
    np.testing.assert_allclose(after, fresh, rtol=0, atol=1e-9)
    assert after[-1] == pytest.approx(BACK + 0.01, abs=1e-9)  # the dead band, on a way of 0.28 rad


def without_lead(gains: GainSet) -> ServoSettings:
    """The compensator with the reference as it is: the zero of its lead cancels the lag."""
    choice, lag_time = settings_of(gains, "elastic_lqg"), ElasticLqgParameters().lag_time
    lead = elastic_lqg_constants_at(design_law(NOMINAL_DRIVE, choice).constants).lead  # slowest/lag_time - 1
    slowest = (lead + 1.0) * lag_time / ElasticLqgParameters().lead
    own = ElasticLqgParameters(lead=lag_time / slowest)
    return choice.with_law("elastic_lqg", own)


def predicted(choice: ServoSettings, limits: Limits) -> np.ndarray:
    """Return what the compensator expects next, with the angles from where the load is held."""
    servo, plant = held(choice, limits=limits)
    angle = plant.load_angle
    expected: np.ndarray = elastic_lqg_state_at(servo.law_arrays[1]).predicted - [10 * angle, 0.0, angle, 0.0, 0.0]
    return expected


def test_elastic_lqg_predicts_with_the_voltage_that_was_applied(gains: GainSet) -> None:
    """As where there is no end, under the same load torque, which it does not know: 1.2 V hold it in both places."""
    choice = settings_of(gains, "elastic_lqg")
    np.testing.assert_allclose(
        predicted(choice, LIMITS), predicted(choice, Limits.of(NOMINAL_DRIVE)), rtol=1e-6, atol=1e-6
    )


def test_elastic_lqg_goes_back_as_if_it_began_there(gains: GainSet) -> None:
    """Without the lead on its reference, on a way of 0.59 rad: within 8 mrad, and 0.2 mrad after 0.5 s."""
    after, fresh = ways_back(without_lead(gains))
    assert np.max(np.abs(after - fresh)) < 8e-3
    assert np.max(np.abs(after - fresh)[500:]) < 2e-4


def test_elastic_lqg_with_its_lead_goes_back_as_from_a_reference_that_holds_it_there(gains: GainSet) -> None:
    """It has no integrator: without an end a reference 0.3 rad ahead holds it there against the load torque.

    The lead is taken from that reference, not from the one that the range did not let through.
    """
    choice = settings_of(gains, "elastic_lqg")
    servo, plant = held(choice)
    free, other = Servo(NOMINAL_DRIVE, choice), Plant(NOMINAL_DRIVE, [4.5, 0.0, 0.45, 0.0, 0.0])
    go_on(free, other, HELD_AT, 3.0)
    go_on(free, other, 2 * HELD_AT - other.load_angle, 3.0)
    assert other.load_angle == pytest.approx(HELD_AT, abs=0.001)
    after, expected = go_on(servo, plant, BACK, 2.0), go_on(free, other, BACK, 2.0)
    assert np.max(np.abs(after - expected)) < 8e-3
    assert np.ptp(expected) > 0.3


def weak(**values: float) -> Drive:
    return replace(NOMINAL_DRIVE, motor=replace(NOMINAL_DRIVE.motor, **values))


@pytest.mark.parametrize(
    ("interface", "limit"), [("voltage", {"voltage_limit": 6.0}), ("current", {"current_limit": 1.5})]
)
def test_plant_keeps_to_its_own_limits_whatever_its_model_says(
    gains: GainSet, interface: str, limit: dict[str, float]
) -> None:
    drive, model = (replace(each, command_interface=interface) for each in (weak(**limit), NOMINAL_DRIVE))
    choice = ServoSettings(gains, backlash_angle=0.02)
    result = run(drive, choice, Scenario(np.ones(300)), model=model)
    assert np.max(np.abs(result.command)) > 2 * drive.command_limit  # what the controller asks for
    plant = Plant(drive)
    for k, command in enumerate(result.command):
        np.testing.assert_allclose(plant.state, result.state[k], rtol=1e-12, atol=1e-12)
        clamped = min(max(float(command), -drive.command_limit), drive.command_limit)
        plant.advance(clamped, 0.0, choice.period)
    known = run(drive, choice, Scenario(np.ones(300)))
    assert np.max(np.abs(known.command)) == drive.command_limit


@pytest.mark.parametrize("law", ["fast", "overdamped", "two_region", "cascade", "elastic_lqg"])
@pytest.mark.parametrize("period", [0.004, 0.001])
@pytest.mark.parametrize("interface", ["voltage", "current"])
def test_load_that_is_held_in_the_soft_zone_comes_to_rest(law: str, period: float, interface: str) -> None:
    """For a current 0 V is that of joined terminals: with 0 A nothing would damp, and the load swing beyond the end."""
    drive = replace(NOMINAL_DRIVE, command_interface=interface)
    gains = GainSet.of(drive)
    choice = ServoSettings(gains, law=law, backlash_angle=0.02, period=period)
    servo, plant = Servo(drive, choice, LIMITS), Plant(drive, [4.5, 0.0, 0.45, 0.0, 0.0])
    angles = []
    for _ in range(round(5.0 / period)):
        servo.segments[0, 0] = BEYOND
        plant.advance(servo.update(sample_of(plant.state)), TORQUE, period)
        angles.append(plant.load_angle)
    assert servo.fault == ""
    assert max(angles) < LIMITS.position_upper + 0.05  # once, from 0.05 rad before it at full voltage
    assert np.ptp(angles[-round(1.0 / period) :]) < 1e-4
