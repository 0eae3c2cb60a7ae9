"""A law that is swapped in while the load is held starts from what holds it."""

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from backlash_ros.control import LAWS, GainSet, Servo, ServoSettings
from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.laws.cascade import CascadeParameters
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, THETA_L, THETA_M, Measurement
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
PERIOD = 0.004
LOAD_TORQUE = 0.3

HEAVY = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=4 * NOMINAL_DRIVE.load.inertia))
RUBBING = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, coulomb_friction=0.05))
DRIVES = {"nominal": NOMINAL_DRIVE, "heavy": HEAVY, "rubbing": RUBBING}
DRIVES |= {f"{name}, current": replace(drive, command_interface="current") for name, drive in DRIVES.items()}
SENSORS = {"everything": Sensors(), "positions": Sensors(measured=POSITIONS), "load": Sensors(measured=("theta_l",))}


def settings_of(drive: Drive, law: str, **changes: Any) -> ServoSettings:
    return replace(
        ServoSettings(GainSet.of(drive), law=law, period=PERIOD, backlash_angle=B, identified=True), **changes
    )


class Rig:
    """A servo that holds a simulated drive at 0 under a load torque."""

    def __init__(
        self,
        drive: Drive,
        choice: ServoSettings,
        sensors: Sensors | None = None,
        load_torque: float = LOAD_TORQUE,
        *,
        watched: bool = True,
    ) -> None:
        self.servo = Servo(drive, choice, watched=watched)
        self.plant = SimulatedDrive(drive, PERIOD, sensors=sensors)
        self.load_torque = load_torque

    def run(self, time: float) -> tuple[Array, Array]:
        """Go on for ``time`` seconds; return the load's angle, from now on, and the commands."""
        angles, commands = [self.plant.state[THETA_L]], []
        for _ in range(round(time / PERIOD)):
            commands.append(self.servo.update(self.plant.sample(), self.plant.elapsed))
            self.plant.advance(commands[-1], self.load_torque)
            angles.append(self.plant.state[THETA_L])
        assert self.servo.fault == ""
        return np.array(angles), np.array(commands)

    def farthest(self, time: float) -> float:
        """Go on for ``time`` seconds, with a fault or without; return the largest angle of the load, 0 at least."""
        farthest = 0.0
        for _ in range(round(time / PERIOD)):
            self.plant.advance(self.servo.update(self.plant.sample(), self.plant.elapsed), self.load_torque)
            farthest = max(farthest, self.plant.state[THETA_L])
        return farthest


def beyond(angles: Array) -> float:
    """Return how far the load went beyond both where it was and where it comes to, rad."""
    start, end = angles[0], float(np.mean(angles[-50:]))
    return float(max(np.max(angles) - max(start, end), min(start, end) - np.min(angles)))


ONE_EACH = list(zip(LAWS, [*list(LAWS)[1:], next(iter(LAWS))], strict=True))
"""Each law once as the one before and once as the one that takes over, which alone decides how that goes."""
EVERY_RIG = [*((drive, "everything") for drive in DRIVES), ("nominal", "positions"), ("nominal", "load")]


@pytest.mark.parametrize(
    ("drive", "sensors", "pairs"),
    [
        ("nominal", "everything", ONE_EACH),
        ("rubbing, current", "everything", ONE_EACH),
        ("nominal", "load", ONE_EACH),
        pytest.param(
            *("nominal", "load", [("switched_linear", "planned")]),
            marks=pytest.mark.xfail(
                strict=True, reason="with the load's encoder alone it lands 1.3 b beyond, from 2 b away under 0.3 N m"
            ),
        ),
        *(pytest.param(*rig, list(permutations(LAWS, 2)), marks=pytest.mark.grid) for rig in EVERY_RIG),
    ],
)
def test_law_swapped_under_load_goes_straight_to_where_it_settles(
    drive: str, sensors: str, pairs: list[tuple[str, str]]
) -> None:
    """It neither sags nor overshoots, whichever law held the load before."""
    for old, new in pairs:
        rig = Rig(DRIVES[drive], settings_of(DRIVES[drive], old), SENSORS[sensors])
        rig.run(1.5)
        far = abs(rig.plant.state[THETA_L]) > B
        rig.servo.use(settings_of(DRIVES[drive], new))
        # The law of planned moves rests within a band, and from afar it goes there as in any step.
        most = (0.25 if far else 0.08) if new == "planned" else 0.03
        assert beyond(rig.run(2.0)[0]) <= most * B, f"{old} to {new}"


@pytest.mark.parametrize("sensors", ["everything", "positions"])
@pytest.mark.parametrize("new", ["cascade", "planned"])
def test_law_swapped_while_the_monitor_is_off_starts_from_what_holds_the_load(sensors: str, new: str) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "two_region"), SENSORS[sensors], watched=False)
    held = rig.run(2.5)[1][-1]
    rig.servo.use(settings_of(NOMINAL_DRIVE, new))
    angles, commands = rig.run(1.0)
    assert commands[0] == pytest.approx(held, rel=0.01)
    assert np.ptp(angles) <= 0.01 * B


@pytest.mark.corners(2)
@pytest.mark.parametrize("unknown", [{"identified": False}, {"backlash_angle": 0.0}])
@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_a_law_that_waited_for_the_drive_takes_the_load_over(drive: Drive, unknown: dict[str, Any]) -> None:
    """As from a law of another name: the one that stood in for it held the load."""
    rig = Rig(drive, settings_of(drive, "planned", **unknown))
    held = rig.run(2.5)[1][-1]
    rig.servo.use(settings_of(drive, "planned"))
    angles, commands = rig.run(2.0)
    assert commands[0] == pytest.approx(held, rel=0.1)
    assert beyond(angles) <= 0.08 * B
    rig.servo.use(settings_of(drive, "planned", **unknown))
    assert beyond(rig.run(2.0)[0]) <= 0.03 * B


@pytest.mark.corners(4)
@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
@pytest.mark.parametrize("old", ["fast", "overdamped", "two_region"])
@pytest.mark.parametrize("torque_bandwidth", [40.0, 0.0])
def test_integrator_takes_the_load_over_where_it_is(drive: Drive, old: str, torque_bandwidth: float) -> None:
    """With feedforward before, by which it is held at the target, the load does not move at all."""
    rig = Rig(drive, settings_of(drive, old, torque_bandwidth=torque_bandwidth))
    held = rig.run(2.5)[1][-1]
    rig.servo.use(settings_of(drive, "cascade", torque_bandwidth=torque_bandwidth))
    angles, commands = rig.run(1.0)
    if torque_bandwidth:
        assert commands[0] == pytest.approx(held, rel=0.01)
        assert np.ptp(angles) <= 0.01 * B
    assert beyond(angles) <= 0.01 * B


@pytest.mark.corners(2)
@pytest.mark.parametrize("old", sorted(set(LAWS) - {"elastic_lqg"}))
def test_compensator_begins_with_the_voltage_that_holds_the_load(old: str) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, old))
    held = rig.run(2.5)[1][-1]
    rig.servo.use(settings_of(NOMINAL_DRIVE, "elastic_lqg"))
    assert rig.run(PERIOD)[1][0] == pytest.approx(held, rel=1e-3)


@pytest.mark.corners(4)
@pytest.mark.parametrize("new", ["cascade", "elastic_lqg"])
@pytest.mark.parametrize("moved_for", [0.02, 0.04, 0.06, 0.1])
@pytest.mark.parametrize("load_torque", [0.0, 0.3, -0.3])
def test_law_swapped_on_the_way_does_not_overrun(new: str, moved_for: float, load_torque: float) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "two_region"), load_torque=load_torque)
    rig.run(1.0)
    rig.servo.set_reference(1.0)
    rig.run(moved_for)
    rig.servo.use(settings_of(NOMINAL_DRIVE, new))
    angles, _ = rig.run(2.0)
    assert np.max(angles) <= max(1.0, angles[-1]) + 0.5 * B


def test_integrator_holds_the_load_through_other_gains() -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "cascade"))
    rig.run(2.5)
    softer = settings_of(NOMINAL_DRIVE, "cascade").with_law("cascade", CascadeParameters(speed_bandwidth=40.0))
    rig.servo.use(softer)
    assert np.ptp(rig.run(1.0)[0]) <= 0.01 * B


@pytest.mark.parametrize("law", ["cascade", "elastic_lqg"])
def test_law_goes_on_from_what_holds_the_load_after_an_experiment(law: str) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, law))
    rig.run(2.5)
    rig.servo.start_experiment("limit_cycle")
    held = rig.run(1.0)[1][-1]  # at rest between two kicks
    rig.servo.cancel("test")
    assert rig.servo.take_outcome() is not None
    angles, commands = rig.run(2.5)
    assert commands[0] == pytest.approx(held, rel=0.01)
    assert beyond(angles) <= 0.03 * B


def test_what_holds_the_load_is_forgotten_with_it() -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "cascade"))
    rig.run(2.5)
    assert rig.servo.holding_voltage == pytest.approx(-1.2, rel=1e-3)
    rig.servo.release("test")
    assert rig.servo.holding_voltage == 0.0
    assert rig.servo.update(np.array([math.nan, math.nan, 0.3, math.nan, math.nan])) == 0.0


@pytest.mark.corners(4)
@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("sensors", ["everything", "positions"])
@pytest.mark.parametrize("inertia", [0.25, 4.0])
@pytest.mark.parametrize("moved_for", [0.02, 0.06])
def test_another_load_that_is_told_on_the_way_makes_no_torque(
    watched: bool, sensors: str, inertia: float, moved_for: float
) -> None:
    """The momentum seen so far is another one with another inertia; the difference is no torque on the load."""
    rigs = []
    for told in (False, True):
        start = settings_of(NOMINAL_DRIVE, "two_region")
        rig = Rig(NOMINAL_DRIVE, start, SENSORS[sensors], load_torque=0.0, watched=watched)
        rig.run(1.0)
        rig.servo.set_reference(1.0)
        rig.run(moved_for)
        if told:
            load = replace(NOMINAL_DRIVE.load, inertia=inertia * NOMINAL_DRIVE.load.inertia)
            rig.servo.use(rig.servo.settings, drive=replace(NOMINAL_DRIVE, load=load))
            assert rig.servo.drive.load == load
        before = rig.servo.load_torque_estimate, rig.servo.holding_voltage
        rigs.append((rig, before, rig.run(PERIOD)[1][0], float(rig.servo.memory.monitor.unexplained_torque)))
    (same, torque, command, unexplained), (other, torque_too, command_too, unexplained_too) = rigs
    assert torque == torque_too
    # What is left is what the true load does to the wrong one within a period.
    speed = abs(same.servo.estimate[OMEGA_L])
    assert speed > 2.0
    momentum = abs(inertia - 1.0) * NOMINAL_DRIVE.load.inertia * speed
    assert abs(command_too - command) < 0.25 * 40.0 * momentum * 4.0  # by the law's estimate and k_tau
    assert abs(unexplained_too - unexplained) < 2.0 * momentum  # by the monitor's
    assert other.servo.fault == ""


def times_as_heavy(drive: Drive, factor: float) -> Drive:
    """Return a drive with a load that has ``factor`` times the inertia."""
    return replace(drive, load=replace(drive.load, inertia=factor * drive.load.inertia))


def with_motor(drive: Drive, name: str, factor: float) -> Drive:
    """Return a drive with ``factor`` times a value of its motor."""
    return replace(drive, motor=replace(drive.motor, **{name: factor * getattr(drive.motor, name)}))


@pytest.mark.corners(12)
@pytest.mark.parametrize("sensors", ["everything", "positions"])
@pytest.mark.parametrize("drive", [NOMINAL_DRIVE, HEAVY], ids=["nominal", "heavy"])
@pytest.mark.parametrize("moved_for", [0.0, 0.01, 0.02, 0.04, 0.06, 0.1, 0.15])
@pytest.mark.parametrize("wrong", [1e-4, 0.3, 3.0, 100.0, 1e3, 1e4])
def test_a_wrong_inertia_that_is_told_on_the_way_is_refused_or_does_not_drive_the_load_on(
    drive: Drive, sensors: str, moved_for: float, wrong: float
) -> None:
    rig = Rig(drive, settings_of(drive, "two_region"), SENSORS[sensors], load_torque=0.0)
    told = times_as_heavy(drive, wrong)
    rig.run(1.0)
    assert rig.servo.rejection_reason(rig.servo.limits, told) == ""  # at rest
    rig.servo.set_reference(1.0)
    rig.run(moved_for)
    why = rig.servo.rejection_reason(rig.servo.limits, told)
    if abs(rig.servo.estimate[OMEGA_L]) > 4.0 and wrong >= 100.0:
        factor = told.effective_inertia / drive.effective_inertia
        assert why == (
            "load.inertia must change the inertia at the output by a factor of 3 at most while the load moves, "
            f"got {factor:.3g}"
        )
    if not why:
        rig.servo.use(settings_of(told, "two_region"), drive=told)
        assert rig.farthest(3.0) < 1.0 + (5.0 * B if wrong <= 3.0 else 0.4)


@pytest.mark.corners(6)
@pytest.mark.parametrize("name", ["torque_constant", "resistance"])
@pytest.mark.parametrize("moved_for", [0.0, 0.02, 0.06, 0.15])
@pytest.mark.parametrize("wrong", [1e-2, 0.34, 2.9, 100.0])
def test_a_wrong_motor_that_is_told_on_the_way_is_refused_or_does_not_drive_the_load_on(
    name: str, moved_for: float, wrong: float
) -> None:
    rig = Rig(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "two_region"), SENSORS["positions"], load_torque=0.0)
    told = with_motor(NOMINAL_DRIVE, name, wrong)
    rig.run(1.0)
    assert rig.servo.rejection_reason(rig.servo.limits, told) == ""  # at rest
    rig.servo.set_reference(1.0)
    rig.run(moved_for)
    why = rig.servo.rejection_reason(rig.servo.limits, told)
    if abs(rig.servo.estimate[OMEGA_L]) > 4.0:
        asked = f"motor.{name} must change by a factor of 3 at most while the load moves, got {wrong:g}"
        assert why == (asked if wrong in {1e-2, 100.0} else "")
    if not why:
        rig.servo.use(settings_of(told, "two_region"), drive=told)
        assert rig.farthest(3.0) < 1.0 + (5.0 * B if 0.3 < wrong < 3.0 else 0.4)


def test_another_drive_moves_all_that_is_derived_from_it() -> None:
    servo = Servo(NOMINAL_DRIVE, settings_of(NOMINAL_DRIVE, "elastic_lqg"))
    wide = replace(HEAVY, gear=replace(HEAVY.gear, backlash_angle=3 * B))
    servo.use(servo.settings, drive=wide)
    fresh = Servo(wide, servo.settings)
    np.testing.assert_array_equal(servo.constants, fresh.constants)
    np.testing.assert_array_equal(servo.law_arrays[0], fresh.law_arrays[0])
    before = servo.constants.copy()
    with pytest.raises(ValueError, match=r"laws\.elastic_lqg needs"):
        servo.use(servo.settings.with_law("elastic_lqg", CascadeParameters()), drive=NOMINAL_DRIVE)
    np.testing.assert_array_equal(servo.constants, before)
    assert servo.drive == wide


@pytest.mark.parametrize("missing", [[], [THETA_M]], ids=["both", "alone"])
@pytest.mark.parametrize("law", LAWS)
def test_a_servo_that_is_warm_has_taken_the_load_over_once(
    law: str, missing: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an identification changes the law to had not been compiled: the loop waited seconds for it."""
    if missing and not LAWS[law].one_encoder:
        return
    took: list[ActingLaw] = []
    take_over = ActingLaw.take_over
    monkeypatch.setattr(ActingLaw, "take_over", lambda self, *rest: took.append(self) or take_over(self, *rest))
    gap = NOMINAL_DRIVE.gear.backlash_angle
    settings = ServoSettings(GainSet.of(NOMINAL_DRIVE), identified=True, backlash_angle=gap)
    servo = Servo(NOMINAL_DRIVE, settings.with_law(law))
    at_rest = np.zeros(5)
    at_rest[missing] = math.nan
    servo.warm_up(Measurement(at_rest))
    assert len(took) == 1
