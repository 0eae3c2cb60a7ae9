"""Wear: what is noticed while the drive works, what is not, and that it is learned anew where that is allowed."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import BacklashEstimate, GainSet, Servo, ServoSettings
from backlash_ros.control.experiment import Deferred
from backlash_ros.control.monitoring.wear import WearWatch
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import draw_member, told_model
from backlash_ros.studies.evaluation.task import first_reading, settings_for

pytestmark = pytest.mark.population

B = NOMINAL_DRIVE.gear.backlash_angle
COUNTED = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)
PERIOD = 0.004


def grown(factor: float, drive: Drive = NOMINAL_DRIVE) -> Drive:
    return replace(drive, gear=replace(drive.gear, backlash_angle=factor * drive.gear.backlash_angle))


class Operated:
    """A servo that goes to and fro, its drive, and the watch; who operates it does nothing."""

    def __init__(
        self,
        settings: ServoSettings,
        drive: Drive = NOMINAL_DRIVE,
        load_torque: float = 0.0,
        sensors: Sensors = COUNTED,
    ) -> None:
        self.servo = Servo(NOMINAL_DRIVE, settings)
        self.watch = WearWatch(self.servo)
        self.plant = SimulatedDrive(drive, settings.period, sensors=sensors)
        self.load_torque = load_torque
        self.learned: list[BacklashEstimate] = []
        self.asked = 0
        self.wrong: Callable[[Measurement], None] | None = None

    def wear(self, factor: float) -> None:
        """Let the gap be so many times as wide from now on."""
        worn = SimulatedDrive(grown(factor), self.servo.settings.period, sensors=COUNTED)
        worn.state[:] = self.plant.state
        self.plant = worn

    def run(self, seconds: float, to_and_fro: float = 2.0, way: float = 0.5) -> Array:
        """Go on; return the load's angles."""
        servo, angles = self.servo, []
        for k in range(round(seconds / PERIOD)):
            if to_and_fro and k % round(to_and_fro / PERIOD) == 0:
                servo.set_reference(0.0 if servo.reference > 0.25 else way)
            measured = self.plant.sample()
            if self.wrong is not None:
                self.wrong(measured)
            command = servo.update(measured, self.plant.elapsed)
            if self.watch.look(measured, self.plant.elapsed):
                self.asked += 1
                servo.start_experiment()
            outcome = servo.take_outcome()
            if isinstance(outcome, Deferred):
                outcome = outcome.work()
            if isinstance(outcome, BacklashEstimate):
                self.learned.append(outcome)
                if outcome.valid:
                    servo.use(replace(servo.settings, backlash_angle=outcome.angle))
            self.plant.advance(command, self.load_torque)
            angles.append(float(self.plant.state[THETA_L]))
        return np.array(angles)


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.parametrize(("gradual", "load_torque"), [(True, 0.0), (False, 0.0), (False, 0.1)])
def test_a_gap_that_grows_five_times_is_learned_anew_and_quiet_again(
    gains: GainSet, gradual: bool, load_torque: float
) -> None:
    axis = Operated(ServoSettings(gains, backlash_angle=B, renew=True), load_torque=load_torque)
    axis.run(4.0)
    assert axis.watch.finding == ""
    for factor in np.linspace(1.0, 5.0, 9)[1:] if gradual else [5.0]:
        axis.wear(factor)
        axis.run(1.0)
    axis.run(10.0)
    assert axis.servo.fault == ""
    axis.run(10.0)
    assert axis.learned[-1].valid
    assert axis.servo.settings.backlash_angle == pytest.approx(5 * B, rel=0.02)
    at_rest = axis.run(2.5, way=0.0)[-250:]
    assert np.ptp(at_rest) <= 0.05 * 5 * B
    assert (axis.watch.finding, axis.servo.fault) == ("", "")


def test_a_grown_gap_is_told_and_nothing_moves_by_itself(gains: GainSet) -> None:
    axis = Operated(ServoSettings(gains, backlash_angle=B))
    axis.wear(2.2)
    axis.run(6.0)
    assert "the gap has grown: the two flanks were 0.0" in axis.watch.finding
    assert "times backlash_angle = 0.02 rad: learn again" in axis.watch.finding
    assert axis.asked == 0


@pytest.mark.corners(3)
@pytest.mark.parametrize("number", range(5))
@pytest.mark.parametrize("population", ["core", "full"])
def test_a_healthy_drive_shows_no_wear(population: str, number: int) -> None:
    member = draw_member(20261123, number, population)
    model = told_model(member, "nominal")
    try:
        settings = settings_for(model, member)
    except ValueError:
        pytest.skip("gains that are unstable at the rate are refused")
    settings = replace(settings, backlash_angle=member.drive.gear.backlash_at(0.0))
    servo, start = Servo(model, settings), first_reading(member)
    watch = WearWatch(servo)
    plant = SimulatedDrive(member.drive, settings.period, sensors=member.sensors, delay=member.delay)
    for k in range(round(6.0 / settings.period)):
        if k % round(1.5 / settings.period) == 50:
            servo.set_reference(start + (0.5 if servo.reference < start + 0.25 else 0.0))
        measured = plant.sample()
        command = servo.update(measured, plant.elapsed)
        watch.look(measured, plant.elapsed)
        plant.advance(command, member.load_torque)
        assert not watch.grown
    assert servo.fault == ""


def test_a_rattle_is_measured_and_its_cause_named(gains: GainSet) -> None:
    axis = Operated(ServoSettings(gains, law="fast", backlash_angle=B))
    angles = axis.run(4.0)[-250:]
    rattle = axis.watch.rattle
    assert rattle is not None
    assert rattle.swing == pytest.approx(np.ptp(angles), rel=0.3)
    upward = np.count_nonzero((angles[1:] > np.mean(angles)) & (angles[:-1] <= np.mean(angles)))
    assert rattle.frequency == pytest.approx(upward, rel=0.15)
    assert 0.5 < rattle.duration < 2.0
    assert "law 'fast' does not adapt to the backlash" in axis.watch.finding
    assert not axis.servo.calmed


def test_a_rattle_is_answered_by_the_over_damped_gains(gains: GainSet) -> None:
    """The region is far too narrow; other settings are tried anew."""
    axis = Operated(ServoSettings(gains, backlash_angle=0.1 * B))
    axis.run(4.0)
    assert axis.servo.calmed
    assert "the over-damped gains act until then" in axis.watch.finding
    assert np.ptp(axis.run(3.0, to_and_fro=0.0)[-250:]) <= 0.05 * B
    axis.servo.use(replace(axis.servo.settings, backlash_angle=B))
    assert not axis.servo.calmed
    assert axis.watch.finding or np.ptp(axis.run(2.0)[-250:]) <= 0.05 * B


def test_what_is_not_known_yet_is_no_wear(gains: GainSet) -> None:
    axis = Operated(ServoSettings(gains, renew=True))
    axis.run(4.0)
    assert "the backlash is not known yet: call learn" in axis.watch.finding
    assert (axis.asked, axis.servo.calmed) == (0, False)


def look_at(gains: GainSet, angle: Callable[[float], float], seconds: float = 4.0) -> WearWatch:
    """Return a watch that was shown a load which moves like this while it is held."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, law="fast"), watched=False)
    watch = WearWatch(servo)
    for k in range(round(seconds / PERIOD)):
        measured = Measurement(np.array([math.nan, math.nan, angle(k * PERIOD), math.nan, math.nan]))
        servo.update(measured, PERIOD)
        watch.look(measured, PERIOD)
    return watch


@pytest.mark.corners(6)
@pytest.mark.parametrize("signal", [THETA_M, THETA_L])
@pytest.mark.parametrize("samples", [1, 3, 10])
@pytest.mark.parametrize("at", [2.05, 3.5])
@pytest.mark.parametrize("sensors", [COUNTED, Sensors(motor_counts=4096.0, load_counts=65536.0)])
def test_wrong_samples_are_no_wear(gains: GainSet, sensors: Sensors, at: float, samples: int, signal: int) -> None:
    """Ten in a row, in motion or at rest: nothing is learned anew for them, which would move the load."""
    axis = Operated(ServoSettings(gains, backlash_angle=B, renew=True), sensors=sensors)
    axis.run(4.0)
    off, count = 2.5 * B / (NOMINAL_DRIVE.gear.ratio if signal == THETA_M else 1.0), itertools.count()

    def wrong(measured: Measurement) -> None:
        measured[signal] += off if 0 <= next(count) - round(at / PERIOD) < samples else 0.0

    axis.wrong = wrong
    axis.run(6.0)
    assert axis.servo.fault == ""
    assert (axis.watch.kind, axis.asked) == ((False, False), 0)


@pytest.mark.parametrize("frequency", [1.0, 7.0, 30.0])
def test_a_rattle_that_lasts_is_told_from_one_that_dies_out(gains: GainSet, frequency: float) -> None:
    def swing(t: float) -> float:
        return 0.01 * math.sin(2 * math.pi * frequency * t)

    seconds = 1.0 + 8.0 / frequency
    lasting = look_at(gains, swing, seconds)
    assert lasting.rattle is not None
    assert lasting.rattle.swing == pytest.approx(0.02, rel=0.1)
    assert lasting.rattle.frequency == pytest.approx(frequency, rel=0.1)
    assert look_at(gains, lambda t: swing(t) * math.exp(-0.25 * frequency * t), seconds).rattle is None
    assert look_at(gains, lambda t: 0.005 * swing(t), seconds).rattle is None
    assert look_at(gains, lambda t: 0.1 * t, seconds).rattle is None


def test_it_does_not_try_for_ever(gains: GainSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Learning fails each time; a minute apart, three times, and then the load is left alone."""
    axis = Operated(ServoSettings(gains, backlash_angle=B, renew=True).with_experiment("limit_cycle"), load_torque=0.2)
    axis.run(1.0, way=0.0)
    monkeypatch.setattr(
        WearWatch, "grown", property(lambda _: True, lambda *_: None), raising=False
    )  # as if it had been seen
    axis.run(30.0, to_and_fro=0.0)
    assert axis.asked == 1
    axis.run(175.0, to_and_fro=0.0)
    assert axis.asked == 3
    assert not any(estimate.valid for estimate in axis.learned)


@pytest.mark.parametrize("signal", [THETA_M, THETA_L])
def test_a_frozen_encoder_is_a_fault_even_where_a_gap_may_grow(gains: GainSet, signal: int) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, backlash_angle=B, renew=True))
    plant = SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=COUNTED)
    for k in range(500):
        if k == 10:
            servo.set_reference(0.5)
        measured = plant.sample()
        measured[signal] = 0.0
        plant.advance(servo.update(measured, plant.elapsed))
    assert servo.fault.startswith("encoders disagree") or "torque" in servo.fault
    assert abs(float(plant.state[THETA_L])) <= 0.5
