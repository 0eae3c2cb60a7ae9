"""The monitor: every fault is found before it does harm, and a healthy drive shows none."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from drives import varied
from hypothesis import given
from hypothesis import strategies as st
from samples import EVERYTHING, sample_of
from searched import searched

from backlash_ros.control import LAWS, NO_LIMIT, FaultThresholds, GainSet, Limits, Servo, ServoSettings
from backlash_ros.control.command_range import clamp, range_constants, voltage_range
from backlash_ros.control.monitoring.thresholds import mechanical_time_constant
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Contact, Drive, Plant
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact, PowerNoPullContact
from backlash_ros.drivetrain.contacts.restitution import RestitutionContact
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement
from backlash_ros.gates.faults import Fault
from backlash_ros.simulation import Scenario, run

CURRENT_DRIVE = replace(NOMINAL_DRIVE, command_interface="current")
BOTH = pytest.mark.parametrize("drive", [NOMINAL_DRIVE, CURRENT_DRIVE], ids=["voltage", "current"])

LOAD_ONLY = ("theta_l",)
MOTOR_ONLY = ("theta_m",)
MEASURED = {"everything": EVERYTHING, "positions": POSITIONS, "load_only": LOAD_ONLY, "motor_only": MOTOR_ONLY}

HELD = NOMINAL_DRIVE.standstill_torque(24.0)
NO_LOAD_SPEED = 48.0

Tamper = Callable[[Measurement, Measurement], Measurement]


def settings_of(drive: Drive, period: float = 0.004, **changes: float | str) -> ServoSettings:
    known = ServoSettings(GainSet.of(drive), "two_region", period, backlash_angle=0.02, identified=True)
    return replace(known, **changes)


def with_inertias(drive: Drive, factor: float) -> Drive:
    """Of both shafts: the mechanical time constant times ``factor``."""
    return varied(drive, motor_inertia=factor * drive.motor.inertia, load_inertia=factor * drive.load.inertia)


class Rig:
    """A servo and the plant behind it, with what may go wrong between them.

    ``tamper`` gets the true sample and that at which it set in, and returns what the drive reports.
    """

    def __init__(
        self,
        drive: Drive,
        choice: ServoSettings,
        *,
        plant: Drive | None = None,
        limits: Limits | None = None,
        thresholds: FaultThresholds | None = None,
        measured: Sequence[str] = EVERYTHING,
        bits: int | None = None,
        state: Sequence[float] | None = None,
    ) -> None:
        far = replace(Limits.of(drive), step=NO_LIMIT)
        choice = replace(choice, thresholds=thresholds)
        self.servo, self.plant = Servo(drive, choice, limits or far), Plant(plant or drive, state)
        self.load_torque = 0.0
        self.tamper: Tamper | None = None
        self.polarity = 1.0
        self._measured = measured
        self._resolution = 2 * math.pi / 2**bits if bits else 0.0
        self._before: np.ndarray | None = None
        self._elapsed: float | None = None

    def sample(self) -> Measurement:
        true = sample_of(self.plant.state)
        if self.tamper:
            self._before = true.copy() if self._before is None else self._before
            true = self.tamper(true, self._before)
        if self._resolution:
            angles = [THETA_M, THETA_L]
            true[angles] = np.round(true[angles] / self._resolution) * self._resolution
        return sample_of(true, self._measured)

    def run(self, time: float, periods: Sequence[int] = (1,)) -> str:
        """Go on for ``time`` seconds or until a fault, with samples every so many ``periods``; return the fault."""
        end, turn = self.plant.time + time, 0
        while self.plant.time < end - 1e-9:
            command = self.servo.update(self.sample(), self._elapsed)
            if self.servo.fault:
                break
            self._elapsed = periods[turn % len(periods)] * self.servo.settings.period
            turn += 1
            self.plant.advance(self.polarity * command, self.load_torque, self._elapsed)
        return self.servo.fault

    def step(self, target: float, time: float, periods: Sequence[int] = (1,)) -> str:
        """Set the reference to ``target`` and go on."""
        assert self.servo.set_reference(target) == ""
        return self.run(time, periods)


def started(drive: Drive, *, measured: Sequence[str] = EVERYTHING, **changes: float | str) -> Rig:
    """A rig that holds, with three samples seen."""
    rig = Rig(drive, settings_of(drive, **changes), measured=measured)
    assert rig.run(0.012) == ""
    return rig


# Limits and thresholds


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"command": 2e6}, "limits.command must be > 0 V or A and <= 1e+06 V or A, got 2000000.0"),
        ({"soft_zone": 11.0}, "limits.soft_zone must be > 0 rad and <= 10 rad, got 11.0"),
        ({"step": 0.0}, "limits.step must be > 0 rad and <= 1e+09 rad, got 0.0"),
        ({"position_upper": 2e9}, "limits.position_upper must be >= -1e+09 rad and <= 1e+09 rad, got 2000000000.0"),
        (
            {"position_lower": math.nan},
            "limits.position_lower must be a finite number, >= -1e+09 rad and <= 1e+09 rad, got nan",
        ),
        (
            {"position_lower": 1.0, "position_upper": 1.0},
            "limits.position_lower must be < limits.position_upper = 1 rad, got 1.0",
        ),
    ],
)
def test_limit_that_makes_no_sense_is_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        replace(Limits.of(NOMINAL_DRIVE), **changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"velocity": 0.0}, "faults.velocity must be > 0 rad/s and <= 1e+09 rad/s, got 0.0"),
        ({"load_torque": -1.0}, "faults.load_torque must be > 0 N m and <= 1e+09 N m, got -1.0"),
        ({"gap": 0.0}, "faults.gap must be > 0 rad and <= 1e+09 rad, got 0.0"),
    ],
)
def test_threshold_that_makes_no_sense_is_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        replace(FaultThresholds.of(NOMINAL_DRIVE), **changes)


def test_default_limits_and_thresholds_are_what_the_drive_can_do() -> None:
    limits, thresholds = Limits.of(NOMINAL_DRIVE), FaultThresholds.of(NOMINAL_DRIVE)
    assert limits.command == 24.0
    assert (limits.position_lower, limits.position_upper) == (-NO_LIMIT, NO_LIMIT)
    assert thresholds.load_torque == pytest.approx(0.6 * HELD, rel=0.01)
    assert thresholds.velocity > 2.5 * NO_LOAD_SPEED
    assert thresholds.gap > 5 * NOMINAL_DRIVE.gear.backlash_angle


@pytest.mark.parametrize(
    ("reference", "taken"),
    [
        (math.pi, True),  # from one end of a joint's travel to the other
        (45.0, False),  # degrees
        (10.0 * math.pi, False),  # the motor's angle
        (-4096.0, False),  # counts
        (1e9, False),
    ],
)
def test_reference_in_a_wrong_unit_is_refused_by_default(gains: GainSet, reference: float, taken: bool) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    present = -math.pi if taken else 0.0
    servo.update(np.array([10 * present, 0.0, present, 0.0, 0.0]))
    refusal = "" if taken else f"reference must be within limits.step = 6.28319 rad of 0 rad, got {reference:g}"
    assert servo.set_reference(reference) == refusal


def test_default_threshold_on_the_load_is_what_the_law_can_make_of_the_current() -> None:
    """A drive may give more than the voltage, played through the winding, ever asks for; or less."""
    for limit, torque in ((100.0, HELD), (12.0, HELD), (6.0, HELD / 2)):
        drive = replace(CURRENT_DRIVE, motor=replace(CURRENT_DRIVE.motor, current_limit=limit))
        assert FaultThresholds.of(drive).load_torque == pytest.approx(0.6 * torque)


def test_default_gap_takes_a_tiny_nominal_backlash_for_a_guess() -> None:
    drive = varied(gear_backlash_angle=2e-5, gear_contact=ElasticContact())
    assert FaultThresholds.of(drive).gap == 0.1


def test_time_constant_is_the_plants() -> None:
    """Without friction and inductance to speak of, 63 % of the speed at a constant voltage."""
    smooth = varied(motor_viscous_friction=0.0, motor_inductance=1e-6, load_viscous_friction=0.0)
    drive = varied(smooth, gear_backlash_angle=2e-6)
    plant = Plant(drive)
    plant.advance(10.0, 0.0, mechanical_time_constant(drive))
    assert plant.load_speed == pytest.approx((1 - math.exp(-1)) * 20.0, rel=0.01)


# References


@pytest.fixture
def limited(gains: GainSet) -> Servo:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-1.0, position_upper=2.0, step=1.5)
    return Servo(NOMINAL_DRIVE, ServoSettings(gains), limits)


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        (
            -1.01,
            "reference must be within limits.position_lower = -1 rad and limits.position_upper = 2 rad, got -1.01",
        ),
        (2.5, "reference must be within limits.position_lower = -1 rad and limits.position_upper = 2 rad, got 2.5"),
        (1.6, "reference must be within limits.step = 1.5 rad of 0 rad, got 1.6"),
        (math.nan, "reference must be finite, in rad, got nan"),
        (-math.inf, "reference must be finite, in rad, got -inf"),
    ],
)
def test_reference_beyond_a_limit_is_refused_without_effect(limited: Servo, reference: float, text: str) -> None:
    limited.update(np.zeros(5))
    assert limited.set_reference(reference) == text
    assert limited.reference == 0.0
    assert limited.update(np.zeros(5)) == 0.0


def test_reference_is_taken_up_to_the_limits(limited: Servo) -> None:
    limited.update(np.zeros(5))
    for reference in (-1.0, 0.5, 2.0):
        assert limited.set_reference(reference) == ""
        assert limited.reference == reference
        limited.update(np.zeros(5))  # the setpoint is there


def test_reference_is_refused_where_nobody_would_follow_it(limited: Servo) -> None:
    assert limited.set_reference(0.1) == "reference 0.1 rad came while no position is held"
    assert not limited.holding
    limited.update(np.zeros(5))
    limited.start_experiment("limit_cycle")
    assert limited.set_reference(0.1) == "reference 0.1 rad came while learning"
    assert limited.reference == 0.0
    limited.fail(Fault.NO_SAMPLES, "test")
    assert limited.set_reference(0.1) == "reference 0.1 rad came while NO_SAMPLES is latched: call reset_fault"
    assert not limited.holding


@pytest.mark.parametrize("change", [1.9, -1.9])
def test_reference_that_changes_by_more_than_the_step_is_refused_either_way(change: float) -> None:
    present = 0.5 - 0.5 * change
    text = f"reference must be within limits.step = 1.5 rad of {present:g} rad, got {present + change:g}"
    assert replace(Limits.of(NOMINAL_DRIVE), step=1.5).rejection_reason(present + change, present) == text


# The ends of the travel


def softened_at(limits: Limits, command: float, angle: float) -> float:
    """Return what is left of a command with the load at an angle, at rest."""
    estimate = np.array([10 * angle, 0.0, angle, 0.0, 0.0, 0.0])
    return clamp(command, *voltage_range(range_constants(NOMINAL_DRIVE, limits), estimate))


@given(st.floats(-24, 24), st.floats(-3, 3))
def test_command_fades_out_towards_an_end_and_never_on_the_way_back(command: float, angle: float) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-1.0, position_upper=1.0, soft_zone=0.5)
    softened = softened_at(limits, command, angle)
    assert softened * command >= 0.0
    assert abs(softened) <= abs(command)
    if angle >= 1.0:
        assert softened <= 0.0
    if angle <= -1.0:
        assert softened >= 0.0
    if abs(angle) <= 0.5 or command * angle < 0:
        assert softened == command
    else:
        assert abs(softened) == pytest.approx(min(abs(command), 24.0 * max(0.0, 1.0 - abs(angle)) / 0.5))


@given(st.floats(-24, 24), st.floats(-1, 1), st.floats(1e-3, 1))
def test_command_fades_without_a_jump(command: float, angle: float, soft_zone: float) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-0.5, position_upper=0.5, soft_zone=soft_zone)
    nearby = 1e-6 * soft_zone
    here, there = (softened_at(limits, command, each) for each in (angle, angle + nearby))
    assert abs(there - here) <= 24.0 * 1.01e-6


@BOTH
@pytest.mark.parametrize("start", [-0.7, 0.7])
def test_load_that_starts_outside_its_travel_stays_there_until_a_reference_brings_it_back(
    drive: Drive, start: float
) -> None:
    limits = replace(Limits.of(drive), position_lower=-0.3, position_upper=0.3)
    rig = Rig(drive, settings_of(drive), limits=limits, state=[10 * start, 0.0, start, 0.0, 0.0])
    assert rig.run(1.0) == ""
    assert rig.plant.load_angle == pytest.approx(start, abs=1e-6)
    assert rig.servo.rejection_reason(replace(limits, position_upper=0.4)) == ""  # nor does that stand in the way
    assert "position_lower = -0.3 rad and limits.position_upper = 0.3 rad" in rig.servo.set_reference(1.1 * start)
    assert rig.step(0.0, 2.0) == ""
    assert rig.plant.load_angle == pytest.approx(0.0, abs=0.02)


def test_load_that_came_back_in_may_not_go_out_again() -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_upper=0.3)
    patient = replace(FaultThresholds.of(NOMINAL_DRIVE), velocity=NO_LIMIT)
    start = [7.0, 0.0, 0.7, 0.0, 0.0]
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), limits=limits, thresholds=patient, state=start)
    rig.run(0.012)
    assert rig.step(0.3, 1.0) == ""
    rig.load_torque = 2 * HELD
    assert "beyond limits.position_upper = 0.3 rad" in rig.run(1.0)
    assert rig.plant.load_angle < 0.7


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_load_that_creeps_beyond_its_travel_is_a_fault(way: float) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-0.02, position_upper=0.02, soft_zone=0.01)
    servo = Servo(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), limits)
    for angle in way * np.arange(0.0, 0.04, 1e-4):
        servo.update(sample_of(np.array([10.0 * angle, 0.0, angle, 0.0, 0.0]), POSITIONS))
        if servo.latched:
            break
    assert servo.latched is (Fault.UPPER_END if way > 0.0 else Fault.LOWER_END)
    assert angle == pytest.approx(0.03 * way, abs=2e-4)


def test_load_that_is_pushed_beyond_its_travel_is_a_fault() -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-0.3)
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), limits=limits)
    rig.load_torque = -2 * HELD
    fault = rig.run(1.0)
    assert fault.startswith("load at -")
    assert fault.endswith(" rad, further than limits.soft_zone = 0.05 rad beyond limits.position_lower = -0.3 rad")


@BOTH
@pytest.mark.parametrize("law", sorted(LAWS))
def test_no_law_goes_beyond_the_largest_command(drive: Drive, law: str) -> None:
    rig = Rig(drive, settings_of(drive, law=law), limits=replace(Limits.of(drive), command=3.0))
    commands = []
    rig.run(0.004)
    rig.servo.set_reference(4.0)
    for _ in range(1000):
        commands.append(rig.servo.update(rig.sample()))
        rig.plant.advance(commands[-1], 0.0, 0.004)
    assert max(map(abs, commands)) <= 3.0
    if law != "planned":  # which plans for less
        assert max(map(abs, commands)) == 3.0
    assert rig.servo.fault == ""
    assert rig.plant.load_angle == pytest.approx(4.0, abs=0.05)


# Faults: every one is found within so many samples of 4 ms, before the load has run away


def everything_stands_still(sample: Measurement, before: Measurement) -> Measurement:
    return before.copy()


def motor_stands_still(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_M], shown[OMEGA_M] = before[THETA_M], 0.0
    return shown


def load_stands_still(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_L], shown[OMEGA_L] = before[THETA_L], 0.0
    return shown


def encoders_stand_still(sample: Measurement, before: Measurement) -> Measurement:
    return motor_stands_still(load_stands_still(sample, before), before)


def load_counts_backwards(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_L], shown[OMEGA_L] = 2 * before[THETA_L] - sample[THETA_L], -sample[OMEGA_L]
    return shown


def both_count_backwards(sample: Measurement, before: Measurement) -> Measurement:
    shown = load_counts_backwards(sample, before)
    shown[THETA_M], shown[OMEGA_M] = 2 * before[THETA_M] - sample[THETA_M], -sample[OMEGA_M]
    return shown


def load_jumps(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_L] += 0.2
    return shown


def motor_jumps(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_M] -= 2.0
    return shown


def all_jump(sample: Measurement, before: Measurement) -> Measurement:
    shown = sample.copy()
    shown[THETA_M] += 10.0
    shown[THETA_L] += 1.0
    return shown


@BOTH
@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS], ids=["everything", "positions"])
@pytest.mark.parametrize(
    ("tamper", "within", "travel", "text"),
    [
        (load_jumps, 0, 0.0, "encoders disagree"),
        (motor_jumps, 0, 0.0, "encoders disagree"),
        (all_jump, 0, 0.0, "motor encoder moved 1 rad at the output within 0.004 s"),
        (load_stands_still, 5, 0.25, "encoders disagree"),
        (motor_stands_still, 5, 0.25, "encoders disagree"),
        (load_counts_backwards, 4, 0.15, "encoders disagree"),
        (both_count_backwards, 10, 1.5, "unexplained torque"),
        (encoders_stand_still, 25, 9.0, "unexplained torque"),
        (everything_stands_still, 25, 9.0, "unexplained torque"),
    ],
)
def test_encoder_fault_during_a_step_is_found(
    drive: Drive, measured: Sequence[str], tamper: Tamper, within: int, travel: float, text: str
) -> None:
    rig = started(drive, measured=measured)
    rig.tamper = tamper
    rig.sample()  # from here on
    fault = rig.step(1.0, 1.0)
    assert fault.startswith(text)
    assert rig.plant.time - 0.012 <= (within + 0.5) * 0.004
    assert abs(rig.plant.load_angle) <= travel


@BOTH
@pytest.mark.parametrize("measured", [LOAD_ONLY, MOTOR_ONLY], ids=["load_only", "motor_only"])
@pytest.mark.parametrize(
    ("tamper", "within", "travel"), [(both_count_backwards, 10, 1.5), (encoders_stand_still, 25, 9.0)]
)
def test_fault_of_the_only_encoder_during_a_step_is_found(
    drive: Drive, measured: Sequence[str], tamper: Tamper, within: int, travel: float
) -> None:
    rig = started(drive, measured=measured)
    rig.tamper = tamper
    rig.sample()
    assert rig.step(1.0, 1.0).startswith("unexplained torque")
    assert rig.plant.time - 0.012 <= (within + 0.5) * 0.004
    assert abs(rig.plant.load_angle) <= travel


RUNAWAY = ("unexplained torque", "motor current of")
"""What a runaway shows: the second at once, where the current is measured and contradicts the command, too."""


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
@pytest.mark.parametrize("target", [0.3, -1.0])
def test_command_of_the_wrong_sign_is_found(drive: Drive, measured: Sequence[str], target: float) -> None:
    """The load runs away by hardly more than the error at which the command is at its limit anyway."""
    rig = started(drive, measured=measured)
    rig.polarity = -1.0
    assert rig.step(target, 1.0).startswith(RUNAWAY["current" in measured])
    assert rig.plant.time - 0.012 <= 0.05
    assert abs(rig.plant.load_angle) <= 1.5


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
def test_runaway_of_a_slow_drive_is_found_long_before_its_time_constant(drive: Drive, measured: Sequence[str]) -> None:
    slow = with_inertias(drive, 100.0)
    rig = started(slow, measured=measured)
    rig.polarity = -1.0
    assert rig.step(1.0, 0.25 * mechanical_time_constant(slow)).startswith(RUNAWAY["current" in measured])
    assert abs(rig.plant.load_angle) <= 1.0


@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("torque_bandwidth", [0.0, 40.0])
def test_runaway_is_found_with_every_law(law: str, torque_bandwidth: float) -> None:
    for measured in (EVERYTHING, POSITIONS):
        rig = started(NOMINAL_DRIVE, measured=measured, law=law, torque_bandwidth=torque_bandwidth)
        rig.polarity = -1.0
        assert rig.step(1.0, 1.0).startswith(RUNAWAY if "current" in measured else RUNAWAY[0])


def test_runaway_at_a_small_command_limit_is_found() -> None:
    """The threshold of the load torque is never more than what the command can make."""
    limits = replace(Limits.of(NOMINAL_DRIVE), command=3.0)
    for measured in (EVERYTHING, POSITIONS):
        rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), limits=limits, measured=measured)
        rig.run(0.012)
        rig.polarity = -1.0
        assert rig.step(1.0, 1.0).startswith(RUNAWAY["current" in measured])
        assert abs(rig.plant.load_angle) <= 0.5


def test_lower_threshold_on_the_load_torque_finds_frozen_encoders_at_a_small_command() -> None:
    """What stands still at 6 V looks like a load torque of a quarter of the largest."""
    for limit, found in ((0.9 * HELD, False), (0.1 * HELD, True)):
        choice = settings_of(NOMINAL_DRIVE, law="fast", torque_bandwidth=0.0)
        rig = Rig(NOMINAL_DRIVE, choice, thresholds=replace(FaultThresholds.of(NOMINAL_DRIVE), load_torque=limit))
        rig.run(0.012)
        rig.tamper = encoders_stand_still
        rig.sample()
        assert bool(rig.step(0.2, 0.2)) == found


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
def test_blocked_load_is_found(drive: Drive, measured: Sequence[str]) -> None:
    rig = Rig(drive, settings_of(drive), plant=varied(drive, load_inertia=50.0), measured=measured)
    rig.run(0.012)
    assert rig.step(1.0, 0.15).startswith("unexplained torque")


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
def test_load_torque_that_the_drive_cannot_hold_is_a_fault(drive: Drive, measured: Sequence[str]) -> None:
    rig = started(drive, measured=measured)
    rig.load_torque = -1.5 * HELD
    assert rig.run(0.5).startswith("unexplained torque")


@pytest.mark.parametrize(("place", "side", "value"), [(OMEGA_M, "motor", 1500.0), (OMEGA_L, "load", -150.0)])
def test_measured_overspeed_is_a_fault(gains: GainSet, place: int, side: str, value: float) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains))
    sample = Measurement(np.zeros(5))
    servo.update(sample)
    sample[[THETA_M, OMEGA_M, THETA_L, OMEGA_L]] = np.array([5.6, 1400.0, 0.56, 140.0]) * np.sign(value)
    sample[place] = value
    assert servo.update(sample) == 0.0
    assert servo.fault == f"{side} speed of 150 rad/s at the output, faults.velocity = 147 rad/s"


# What follows from a fault


@BOTH
def test_fault_is_latched_until_reset_and_then_the_present_position_is_held(drive: Drive) -> None:
    rig = started(drive)
    rig.tamper = load_stands_still
    rig.sample()
    fault = rig.step(1.0, 1.0)
    rig.tamper = None
    for _ in range(100):
        assert rig.servo.update(rig.sample()) == 0.0
        rig.plant.advance(0.0, 0.0, 0.004)
    rig.servo.fail(Fault.NO_SAMPLES, "another one")
    assert rig.servo.fault == fault
    rig.servo.reset()
    angle = rig.plant.load_angle
    assert rig.run(1.0) == ""
    assert rig.servo.reference == pytest.approx(angle)
    assert rig.plant.load_angle == pytest.approx(angle, abs=0.02)


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
def test_unexplained_torque_is_forgotten_at_a_reset(drive: Drive, measured: Sequence[str]) -> None:
    rig = started(drive, measured=measured)
    rig.polarity = -1.0
    assert rig.step(1.0, 1.0, (1, 10)).startswith(RUNAWAY)  # by far, with samples missing
    rig.polarity, rig._elapsed = 1.0, None
    rig.servo.reset()
    assert rig.run(1.0) == ""


@BOTH
def test_fault_ends_learning_with_its_reason(drive: Drive) -> None:
    rig = started(drive)
    rig.servo.start_experiment("limit_cycle")
    assert rig.run(0.1) == ""
    rig.tamper = load_jumps
    fault = rig.run(0.1)
    estimate = rig.servo.take_outcome()
    assert estimate is not None
    assert not estimate.valid
    assert estimate.reason == f"no valid cycle: {fault}"
    assert not rig.servo.experimenting


# A healthy drive shows no fault


def with_margin(drive: Drive, share: float) -> FaultThresholds:
    """A share of the default thresholds: what a healthy drive stays within."""
    own = FaultThresholds.of(drive)
    return FaultThresholds(share * own.velocity, share * own.load_torque, share * own.gap, share * own.tracking)


def exercise(rig: Rig, periods: Sequence[int] = (1,)) -> str:
    """Steps there and back, large and small, one while still on the way."""
    rig.run(0.1, periods)
    return next(
        (
            fault
            for target, time in ((10.0, 0.15), (-5.0, 0.3), (0.1, 0.3))
            if (fault := rig.step(target, time, periods))
        ),
        "",
    )


@BOTH
@pytest.mark.parametrize("period", [0.01, 0.004, 0.001])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_steps_are_no_fault_with_half_the_thresholds(drive: Drive, law: str, period: float) -> None:
    rig = Rig(drive, settings_of(drive, period, law=law), thresholds=with_margin(drive, 0.5))
    assert exercise(rig) == ""


@BOTH
@pytest.mark.parametrize("measured", [POSITIONS, LOAD_ONLY, MOTOR_ONLY], ids=["positions", "load_only", "motor_only"])
@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize("period", [0.01, 0.001])
def test_counts_are_no_fault_with_half_the_thresholds(
    drive: Drive, measured: Sequence[str], bits: int, period: float
) -> None:
    rig = Rig(drive, settings_of(drive, period), thresholds=with_margin(drive, 0.5), measured=measured, bits=bits)
    assert exercise(rig) == ""


@BOTH
@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("share", [0.55, -0.55])
def test_load_torque_within_the_default_threshold_is_no_fault(drive: Drive, law: str, share: float) -> None:
    """Nor is the speed to which it drives the load on a long way."""
    rig = started(drive, law=law)
    rig.load_torque = share * HELD
    rig.run(0.3)
    assert rig.servo.fault == ""
    for target in (10.0, -10.0):
        assert rig.step(target, 0.5) == ""


@pytest.mark.population
@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
@pytest.mark.parametrize(
    "changes",
    [
        {"load_inertia": 0.25 * 5e-4},
        {"load_inertia": 4 * 5e-4},
        {"load_viscous_friction": 0.0},
        {"load_viscous_friction": 10 * 5e-3},
        {"load_coulomb_friction": 0.3 * HELD},
    ],
    ids=str,
)
def test_wrong_model_of_the_load_is_no_fault(drive: Drive, measured: Sequence[str], changes: dict[str, float]) -> None:
    rig = Rig(
        drive,
        settings_of(drive),
        plant=varied(drive, **changes),
        thresholds=with_margin(drive, 0.6),
        measured=measured,
    )
    assert exercise(rig) == ""


@BOTH
@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
def test_knock_on_a_fast_drive_is_no_fault(drive: Drive, measured: Sequence[str]) -> None:
    """Over before it counts, though the drive's speed follows it."""
    rig = started(with_inertias(drive, 0.1), measured=measured, period=0.001)
    rig.load_torque = 2 * HELD
    assert rig.run(0.003) == ""
    rig.load_torque = 0.0
    assert rig.run(0.3) == ""


@pytest.mark.parametrize("factor", [0.25, 4.0, 10.0])
@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS], ids=["everything", "positions"])
def test_wrong_inertia_of_a_load_that_outweighs_the_motor_is_no_fault(factor: float, measured: Sequence[str]) -> None:
    """The unexplained torque is more than any that the drive holds, yet the momentum goes the drive's way."""
    drive = varied(load_inertia=0.02)
    plant = varied(drive, load_inertia=0.02 * factor)
    rig = Rig(drive, settings_of(drive), plant=plant, thresholds=with_margin(drive, 0.5), measured=measured)
    assert exercise(rig) == ""


@BOTH
@pytest.mark.parametrize(
    "contact",
    [
        PowerContact(),
        PowerNoPullContact(),
        *(ElasticContact(wind_up=give, damping=0.0) for give in (4e-3, 1e-3)),
        *(RestitutionContact(wind_up=give, restitution=1.0) for give in (4e-3, 1e-3)),
    ],
    ids=str,
)
def test_impacts_of_the_limit_cycle_are_no_fault(drive: Drive, contact: Contact) -> None:
    """With hard teeth and soft ones, without loss; the fast gains keep the cycle up."""
    drive = varied(drive, gear_contact=contact)
    rig = Rig(drive, settings_of(drive, law="fast"), thresholds=with_margin(drive, 0.8))
    assert exercise(rig) == ""
    assert rig.run(1.0) == ""


@BOTH
@pytest.mark.parametrize("measured", [EVERYTHING, POSITIONS, LOAD_ONLY], ids=["everything", "positions", "load_only"])
def test_learning_is_no_fault_with_half_the_thresholds(drive: Drive, measured: Sequence[str]) -> None:
    rig = Rig(drive, settings_of(drive), thresholds=with_margin(drive, 0.5), measured=measured, bits=14)
    rig.run(0.1)
    rig.servo.start_experiment("limit_cycle")
    assert rig.run(2.0) == ""


@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
@pytest.mark.parametrize("periods", [(1, 2, 1, 1), (1, 1, 10), (3,)], ids=str)
def test_missing_samples_are_no_fault(measured: Sequence[str], periods: Sequence[int]) -> None:
    rig = Rig(
        NOMINAL_DRIVE,
        settings_of(NOMINAL_DRIVE, 0.002),
        thresholds=with_margin(NOMINAL_DRIVE, 0.6),
        measured=measured,
        bits=14,
    )
    assert exercise(rig, periods) == ""


@pytest.mark.parametrize("speeds_up_after", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("silence", [0.1, 0.4, 0.8])
def test_silence_while_the_load_falls_is_no_broken_speed(silence: float, speeds_up_after: float) -> None:
    """The machine stood still: what the drive did meanwhile nobody saw, and no speed contradicts an encoder by it."""
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE))
    rig.run(0.1)
    rig.plant.advance(0.0, 0.0, speeds_up_after)
    rig.plant.advance(0.0, 0.3, silence)
    rig.servo.update(rig.sample(), silence + speeds_up_after)
    assert "speed of" not in rig.run(0.2)


@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
@pytest.mark.parametrize("period", [0.01, 0.001])
def test_start_while_the_drive_turns_at_full_speed_is_no_fault(measured: Sequence[str], period: float) -> None:
    turning = [0.0, 10 * NO_LOAD_SPEED, 0.0, NO_LOAD_SPEED, 0.0]
    half = with_margin(NOMINAL_DRIVE, 0.5)
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, period), thresholds=half, measured=measured, state=turning)
    assert rig.run(0.5) == ""


@pytest.mark.parametrize("period", [0.01, 0.001])
def test_samples_closer_together_than_a_period_do_not_look_like_speed(gains: GainSet, period: float) -> None:
    """Stamps jitter; the way is that of a period all the same."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, period=period))
    thresholds = FaultThresholds.of(NOMINAL_DRIVE)
    servo.update(np.zeros(5))
    way = thresholds.gap + 0.9 * thresholds.velocity * period
    servo.update(np.array([10 * way, math.nan, way, math.nan, math.nan]), 0.1 * period)
    assert servo.fault == ""


@pytest.mark.parametrize("error", [0.98, 1.02])
def test_gear_ratio_that_is_slightly_wrong_is_no_fault_on_a_long_way(error: float) -> None:
    model = varied(gear_reduction=10 / error)
    rig = Rig(model, settings_of(model), plant=NOMINAL_DRIVE)
    rig.run(0.1)
    for target in (20.0, 40.0, 0.0):
        assert rig.step(target, 1.5) == ""


@searched(
    25,
    60,
    given(
        ratio=st.floats(0.02, 0.5),
        inertia=st.floats(0.2, 5),
        time_constant=st.floats(0.01, 0.3),
        backlash=st.floats(0.1, 4),
        resistance=st.floats(0.5, 4),
        interface=st.sampled_from([NOMINAL_DRIVE, CURRENT_DRIVE]),
        law=st.sampled_from(["fast", "two_region"]),
        contact_law=st.sampled_from(list(CONTACTS)),
        measured=st.sampled_from([EVERYTHING, POSITIONS]),
        bits=st.sampled_from([None, 12, 16]),
        share=st.floats(-0.5, 0.5),
    ),
)
def test_practical_drive_shows_no_fault(
    ratio: float,
    inertia: float,
    time_constant: float,
    backlash: float,
    resistance: float,
    interface: Drive,
    law: str,
    contact_law: str,
    measured: Sequence[str],
    bits: int | None,
    share: float,
) -> None:
    """Load over reflected inertia, mechanical time constant and backlash over the nominal one's are given."""
    rotor = time_constant * 0.05**2 / resistance / (1 + inertia)
    motor = replace(interface.motor, resistance=resistance, inertia=rotor, current_limit=24.0 / resistance)
    gear = replace(interface.gear, reduction=1 / ratio, backlash_angle=0.02 * backlash, contact=CONTACTS[contact_law]())
    drive = replace(interface, motor=motor, gear=gear, load=replace(interface.load, inertia=inertia * rotor / ratio**2))
    rig = Rig(drive, settings_of(drive, 0.002, law=law), measured=measured, bits=bits)
    rig.run(0.02)
    assert rig.step(0.1 / time_constant * ratio, 0.1) == ""
    rig.load_torque = share * drive.standstill_torque()
    rig.run(0.3)
    assert rig.servo.fault == ""
    assert rig.step(-3.0, 0.3) == ""


@pytest.mark.parametrize("measured", MEASURED.values(), ids=MEASURED)
@pytest.mark.parametrize("factor", [2, 4])
def test_drive_with_a_higher_rate_is_a_fault_before_it_is_given_a_reference(
    measured: Sequence[str], factor: int
) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), measured=measured)
    for _ in range(100):
        rig.servo.update(rig.sample(), 0.004 / factor)
    assert rig.servo.fault.startswith("samples come every 0.00")
    assert rig.servo.fault.endswith("s, but rate says every 0.004 s: set rate as the drive has it")


@pytest.mark.parametrize("elapsed", [math.nan, 0.0, -1.0])
def test_elapsed_time_that_is_none_is_the_period(elapsed: float) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE))
    rig.run(0.012)
    rig.plant = Plant(NOMINAL_DRIVE, [50.0, 0.0, 5.0, 0.0, 0.0])
    rig.servo.update(rig.sample(), elapsed)
    assert rig.servo.fault.startswith("motor encoder moved 5 rad at the output within 0.004 s")


@pytest.mark.parametrize("bits", [6, 9])
@pytest.mark.parametrize("motor_alone", [False, True])
def test_coarse_encoders_are_used_for_what_they_show(bits: int, motor_alone: bool) -> None:
    """64 counts a turn of the motor, or 512: what the monitor lets through moves the load as without a monitor."""
    names = ("theta_m",) if motor_alone else POSITIONS
    sensors = Sensors(measured=names, motor_counts=2**bits, load_counts=2**12)
    choice = settings_of(NOMINAL_DRIVE, law="overdamped")
    watched, free = (
        run(NOMINAL_DRIVE, choice, Scenario(np.full(1000, 0.3), sensors=sensors), watched=each)
        for each in (True, False)
    )
    assert watched.fault == ""
    assert np.max(watched.load_angle) < np.max(free.load_angle) + 0.005
    assert np.ptp(watched.load_angle[-250:]) < np.ptp(free.load_angle[-250:]) + 0.005


@pytest.mark.parametrize("pattern", [(0.2, 1.8), (0.1, 0.1, 2.8), (3.0, 0.2, 0.4, 0.4)], ids=str)
def test_samples_that_come_late_and_in_a_bunch_are_no_other_rate(pattern: Sequence[float]) -> None:
    """As from a machine that is busy: their mean is the period, or more where some were lost."""
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE), measured=POSITIONS)
    for k in range(400):
        rig.servo.update(rig.sample(), 0.004 * pattern[k % len(pattern)])
    assert rig.servo.fault == ""
