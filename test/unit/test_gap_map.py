"""The map of the gap around the turn: what it finds, how far and how fast it goes, what ends it, what it never says."""

import math
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from experiments import Broken, frozen, missing, reversed_, swapped
from hypothesis import given
from hypothesis import strategies as st
from recorded import probed, stepped
from searched import searched

from backlash_ros.control import BacklashEstimate, GainSet, GapMapSettings, Limits, Method, Servo, ServoSettings
from backlash_ros.control.estimates import Estimates
from backlash_ros.control.estimates.requests import describe_outcome
from backlash_ros.control.experiment import Deferred, Outcome
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement
from backlash_ros.identification import gap_map
from backlash_ros.identification.fitting.candidates import free_teeth
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.fitting.parameters import parameters_of
from backlash_ros.identification.gap import Gap
from backlash_ros.identification.gap_map import incomplete, map_gaps
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.identify import identify
from backlash_ros.identification.recordings.places import gap_around, map_findings, visits
from backlash_ros.simulation import SimulatedDrive

pytestmark = pytest.mark.population

RATIO = NOMINAL_DRIVE.gear.ratio
FEW = GapMapSettings(places=6)


@dataclass(frozen=True)
class Machine:
    """A drive of which the gap varies around the turn, and what it shows of itself."""

    variation: float = 0.3
    cycles: int = 1
    phase: float = 1.0
    friction: float = 0.02
    eccentricity: float = 1e-3
    eccentricity_phase: float = 0.7
    torque: float = 0.0
    rate: float = 250.0

    @property
    def drive(self) -> Drive:
        gear = replace(
            NOMINAL_DRIVE.gear,
            backlash_variation=self.variation,
            backlash_cycles=self.cycles,
            backlash_phase=self.phase,
        )
        return replace(NOMINAL_DRIVE, gear=gear, load=replace(NOMINAL_DRIVE.load, coulomb_friction=self.friction))

    @property
    def sensors(self) -> Sensors:
        return Sensors(
            measured=POSITIONS,
            motor_counts=4096.0,
            load_counts=65536.0,
            load_eccentricity=self.eccentricity,
            eccentricity_phase=self.eccentricity_phase,
        )

    @property
    def mirrored(self) -> "Machine":
        return replace(self, phase=-self.phase, eccentricity_phase=-self.eccentricity_phase, torque=-self.torque)


VARYING = Machine()
PUSHED = Machine(variation=0.2, cycles=2, phase=-0.5, friction=0.0, eccentricity=5e-4, torque=0.2, rate=1000.0)


class Rig:
    """A servo with a simulated drive, where an experiment has been started."""

    def __init__(
        self,
        gains: GainSet,
        machine: Machine = VARYING,
        parameters: GapMapSettings = FEW,
        law: str = "overdamped",
    ) -> None:
        self.machine = machine
        self.servo = Servo(NOMINAL_DRIVE, ServoSettings(gains, period=1.0 / machine.rate, law=law))
        self.plant = SimulatedDrive(machine.drive, 1.0 / machine.rate, sensors=machine.sensors)
        self.farthest = 0.0
        self.rows: list[tuple[float, float, float, float]] = []
        self.step()
        self.servo.start_experiment("gap_map", parameters)

    def step(self, spoil: Callable[[Measurement], None] = lambda _: None, torque: float | None = None) -> None:
        measured = self.plant.sample()
        spoil(measured)
        command = self.servo.update(measured, self.plant.elapsed)
        self.rows.append((self.plant.time, RATIO * measured[THETA_M], measured[THETA_L], command))
        self.plant.advance(command, self.machine.torque if torque is None else torque)
        self.farthest = max(self.farthest, abs(float(self.plant.state[THETA_L])))

    def play(self, most: int = 100_000) -> Outcome | Deferred | None:
        """Go on until there is an outcome, or a fault."""
        for _ in range(most):
            self.step()
            if (outcome := self.servo.take_outcome()) is not None:
                return outcome
        return None

    def recording(self) -> Recording:
        """Return all that was seen, with what was before and after the experiment."""
        return Recording.of(*(column.copy() for column in np.array(self.rows).T))

    def rest(self, seconds: float = 3.0) -> None:
        for _ in range(round(seconds * self.machine.rate)):
            self.step()


@cache
def recorded(gains: GainSet, machine: Machine) -> tuple[Recording, BacklashEstimate]:
    """Return a run of the experiment, with a rest behind it, and what it found."""
    rig = Rig(gains, machine)
    outcome = rig.play()
    assert isinstance(outcome, Deferred)
    found = outcome.work()
    assert isinstance(found, BacklashEstimate)
    rig.rest()
    return rig.recording(), found


def mapped(gains: GainSet, machine: Machine) -> BacklashEstimate:
    return recorded(gains, machine)[1]


@pytest.mark.population
@pytest.mark.parametrize(
    "machine",
    [
        pytest.param(VARYING, id="friction, 250 Hz"),
        pytest.param(PUSHED, id="load torque, 1 kHz", marks=pytest.mark.grid),
    ],
)
def test_the_gap_is_found_at_each_place_and_the_eccentricity_apart_from_it(gains: GainSet, machine: Machine) -> None:
    found = mapped(gains, machine)
    assert found.valid, found.reason
    assert found.method is Method.GAP_MAP
    assert found.map is not None
    seen, count = found.map, 2.0 * math.pi / machine.sensors.load_counts
    assert len(seen.places) == FEW.places
    for place, gap, uncertainty in zip(seen.places, seen.gaps, seen.uncertainties, strict=True):
        error = abs(gap - machine.drive.gear.backlash_at(place))
        assert error < max(0.03 * gap, count)
        assert error < 3.0 * uncertainty
        assert uncertainty < 0.05 * gap
    error = seen.eccentricity * np.exp(1j * seen.phase)
    error -= machine.eccentricity * np.exp(1j * machine.eccentricity_phase)
    assert abs(error) < min(3.0 * seen.eccentricity_uncertainty, 0.1 * machine.eccentricity)


def test_the_largest_gap_is_the_one_that_is_used(gains: GainSet) -> None:
    found = mapped(gains, VARYING)
    assert found.map is not None
    seen = found.map
    assert found.angle == max(seen.gaps) == seen.gaps[seen.largest]
    assert found.uncertainty == seen.uncertainties[seen.largest]
    assert min(seen.gaps) < seen.mean < max(seen.gaps)
    assert found.fit is not None
    text = describe_outcome(found)
    assert text.startswith(f"backlash {found.angle:.6g} +- ")
    assert "by gap_map, from 6 of 6 places: the gap is " in text
    assert f"{min(seen.gaps):.4g} rad where it is smallest, at {seen.places[seen.smallest]:.3g} rad" in text
    assert "the load's angle is off by 0.001 +- " in text


@pytest.mark.grid
def test_a_mirrored_drive_gives_a_mirrored_map(gains: GainSet) -> None:
    here, there = mapped(gains, VARYING).map, mapped(gains, VARYING.mirrored).map
    assert here is not None
    assert there is not None
    assert np.allclose(here.places, [-place for place in reversed(there.places)], atol=0.03)
    assert np.allclose(here.gaps, there.gaps[::-1], rtol=0.02)
    assert here.phase == pytest.approx(-there.phase, abs=0.1)


@pytest.mark.corners(2)
@pytest.mark.parametrize("torque", [0.0, 0.3])
@pytest.mark.parametrize(("turn", "swing"), [(1.0, 0.2), (2.0 * math.pi, 0.3)])
def test_it_stays_within_its_range_and_speed_and_comes_back(
    gains: GainSet, turn: float, swing: float, torque: float
) -> None:
    rig = Rig(gains, replace(VARYING, torque=torque), GapMapSettings(places=6, turn=turn, swing=swing, speed=2.0))
    progress, outcome = [], None
    while outcome is None:
        rig.step()
        run = rig.servo._experiment.run
        if run is not None and run._run._probe is None:  # type: ignore[attr-defined]
            assert abs(RATIO * float(rig.plant.state[OMEGA_M])) < 1.3 * 2.0 + 0.5
        outcome = rig.servo.take_outcome()
        if outcome is None:
            progress.append(rig.servo.progress)
    assert isinstance(outcome, Deferred)
    assert rig.farthest <= turn * 5 / 12 + swing + 0.03
    assert rig.farthest >= turn * 5 / 12 - 0.03
    assert progress == sorted(progress)
    assert progress[-1] > 0.98
    rig.rest()
    assert rig.servo.fault == ""
    assert abs(float(rig.plant.state[THETA_L])) < 0.02
    assert abs(float(rig.plant.state[OMEGA_L])) < 0.01


@searched(
    6,
    10,
    given(
        after=st.integers(1, 7000),
        torque=st.sampled_from([0.0, 0.25, -0.1]),
        law=st.sampled_from(["overdamped", "two_region"]),
    ),
)
def test_it_is_cancelled_at_any_sample_and_is_held_where_it_is(
    gains: GainSet, after: int, torque: float, law: str
) -> None:
    """It does not leap back; with the over-damped gains it rests. The backlash is not known, so the others rattle."""
    rig = Rig(gains, replace(VARYING, torque=torque), law=law)
    assert rig.play(after) is None
    where = float(rig.plant.state[THETA_L])
    rig.servo.cancel("test")
    outcome = rig.servo.take_outcome()
    assert isinstance(outcome, BacklashEstimate)
    assert not outcome.valid
    assert outcome.reason == "no map of the gap: test"
    for _ in range(1000):
        rig.step()
        assert abs(float(rig.plant.state[THETA_L]) - where) < FEW.swing
    assert rig.servo.fault == ""
    assert abs(rig.servo.tracking_error) < 0.03
    assert law != "overdamped" or abs(float(rig.plant.state[OMEGA_L])) < 0.01


def test_a_load_that_leaves_the_swing_ends_it_and_is_held_there(gains: GainSet) -> None:
    machine = replace(VARYING, torque=0.3)
    rig = Rig(gains, machine, GapMapSettings(places=6, turn=3.0, swing=0.08))
    outcome = rig.play()
    assert isinstance(outcome, BacklashEstimate)
    assert "from the place at -1.2" in outcome.reason
    assert "beyond learning.gap_map.swing = 0.08 rad" in outcome.reason
    where = float(rig.plant.state[THETA_L])
    rig.rest()
    assert abs(float(rig.plant.state[THETA_L]) - where) < 0.08
    assert abs(float(rig.plant.state[OMEGA_L])) < 0.01


def test_when_its_time_is_over_it_goes_back_and_says_how_far_it_came(gains: GainSet) -> None:
    rig = Rig(gains, parameters=replace(FEW, time=5.0))
    outcome = rig.play()
    assert 5.0 < rig.plant.time < 20.0
    assert abs(float(rig.plant.state[THETA_L])) < 0.03
    assert isinstance(outcome, Deferred)
    found = outcome.work()
    assert not found.valid
    assert found.reason == ("no map of the gap within learning.gap_map.time = 5 s: only 1 of 6 places were reached")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_upper": 3.0}, r"got 3\.44"),
        ({"position_lower": -3.0}, r"got -3\.44"),
        ({"step": 0.2}, r"within limits\.step = 0\.2 rad of"),
    ],
)
def test_limits_that_are_too_narrow_refuse_it(gains: GainSet, change: dict[str, float], message: str) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), **change))
    servo.update(Measurement(np.zeros(5)))
    why = servo.experiment_refusal("gap_map")
    assert why.startswith(
        "it swings by half of learning.gap_map.turn and learning.gap_map.swing = 3.44159 rad to either side, but "
    )
    assert re.search(message, why)


def test_a_step_limit_bounds_what_it_does_at_each_place_and_not_the_slow_way(gains: GainSet) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), replace(Limits.of(NOMINAL_DRIVE), step=0.5))
    servo.update(Measurement(np.zeros(5)))
    assert servo.experiment_refusal("gap_map") == ""


def test_a_joint_with_ends_maps_what_is_between_them(gains: GainSet) -> None:
    limits = replace(Limits.of(NOMINAL_DRIVE), position_lower=-0.9, position_upper=0.9)
    servo = Servo(NOMINAL_DRIVE, ServoSettings(gains), limits)
    servo.update(Measurement(np.zeros(5)))
    assert servo.experiment_refusal("gap_map", GapMapSettings(turn=1.2, swing=0.25)) == ""


@pytest.mark.corners(5)
@pytest.mark.population
@pytest.mark.parametrize("start", [1, 300, 1200, 5000], ids=["from the start", "on the way", "at a place", "late"])
@pytest.mark.parametrize("signal", [THETA_M, THETA_L], ids=["motor", "load"])
@pytest.mark.parametrize("broken", [frozen, reversed_, swapped, missing])
def test_a_broken_encoder_ends_it_near_and_gives_no_map(
    gains: GainSet, broken: Broken, signal: int, start: int
) -> None:
    rig = Rig(gains)
    outcome, before, where = None, rig.plant.sample().copy(), math.nan

    def change(measured: Measurement) -> None:
        broken(measured, before, signal)
        before[:] = measured

    for k in range(20_000):
        if k == start:
            where = float(rig.plant.state[THETA_L])
        rig.step(change if k >= start else lambda _: None)
        outcome = rig.servo.take_outcome()
        if outcome is not None or rig.servo.latched:
            break
    assert abs(float(rig.plant.state[THETA_L]) - where) < FEW.swing
    assert rig.servo.latched or (isinstance(outcome, BacklashEstimate) and not outcome.valid)


@searched(
    6,
    12,
    given(
        at=st.integers(1, 3000),
        samples=st.sampled_from([1, 3, 10]),
        signal=st.sampled_from([THETA_M, THETA_L]),
        size=st.floats(0.005, 1e4),
        way=st.sampled_from([1.0, -1.0]),
    ),
)
def test_wrong_samples_do_not_take_the_load_astray(
    gains: GainSet, at: int, samples: int, signal: int, size: float, way: float
) -> None:
    rig = Rig(gains)

    def jump(measured: Measurement) -> None:
        measured[signal] += way * size

    for k in range(3200):
        rig.step(jump if at <= k < at + samples else lambda _: None)
        if rig.servo.take_outcome() is not None or rig.servo.latched:
            break
    assert rig.farthest <= 0.5 * FEW.turn + FEW.swing


@pytest.mark.grid
def test_a_load_torque_that_changes_on_the_way_gives_no_wrong_map(gains: GainSet) -> None:
    """Its place is missing, or right; the others are right."""
    machine = replace(VARYING, friction=0.0)
    rig, outcome, k = Rig(gains, machine), None, 0
    while outcome is None:
        k += 1
        rig.step(torque=0.25 if k > 2600 else 0.1)
        outcome = rig.servo.take_outcome()
    assert isinstance(outcome, Deferred)
    found = outcome.work()
    assert isinstance(found, BacklashEstimate)
    assert found.map is not None
    for place, gap in zip(found.map.places, found.map.gaps, strict=True):
        assert gap == pytest.approx(machine.drive.gear.backlash_at(place), rel=0.03)


def test_lost_samples_change_nothing(gains: GainSet) -> None:
    """Every fortieth is lost: the moves go by the time that has passed."""
    rig, outcome, k = Rig(gains, parameters=replace(FEW, turn=1.0)), None, 0
    while outcome is None:
        k += 1
        if k % 40 == 0:
            rig.plant.sample()
            rig.plant.advance(rig.servo.command, 0.0)
        rig.step()
        outcome = rig.servo.take_outcome()
    assert isinstance(outcome, Deferred)
    assert rig.servo.fault == ""
    assert rig.farthest < 0.9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"places": 5}, r"learning\.gap_map\.places must be a whole number >= 6 and <= 64, got 5"),
        ({"turn": 7.0}, r"learning\.gap_map\.turn must be >= 0\.1 rad and <= 6\.3 rad, got 7"),
        ({"swing": 0.0}, r"learning\.gap_map\.swing must be > 0 rad and <= 3\.2 rad, got 0"),
        ({"speed": 0.0}, r"learning\.gap_map\.speed must be > 0 rad/s and <= 100 rad/s, got 0"),
        ({"time": math.nan}, r"learning\.gap_map\.time must be a finite number"),
    ],
)
def test_settings_out_of_bounds_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GapMapSettings(**change)  # type: ignore[arg-type]


# The same map from a recording alone.


@pytest.mark.grid
@pytest.mark.parametrize("machine", [VARYING, PUSHED], ids=["friction, 250 Hz", "load torque, 1 kHz"])
def test_a_recording_of_it_tells_the_same_map_and_the_drive_at_one_place(gains: GainSet, machine: Machine) -> None:
    recording, estimate = recorded(gains, machine)
    told = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=1e-3))
    found = identify(told, recording, hold_out=False)
    seen, same = found.around.map, estimate.map
    assert seen is not None, found.around.reason
    assert same is not None
    assert np.allclose(seen.places, same.places, atol=0.02)
    for gap, other, uncertainty in zip(seen.gaps, same.gaps, same.uncertainties, strict=True):
        assert abs(gap - other) < uncertainty
    assert seen.eccentricity == pytest.approx(same.eccentricity, abs=same.eccentricity_uncertainty)
    assert found.stretch.endswith("s, at one of 6 places around the turn")
    assert found.recording is not None
    place = float(found.recording.load[0])
    assert found.of("b").value == pytest.approx(machine.drive.gear.backlash_at(place), rel=0.03)
    assert found.of("J_l").value == pytest.approx(NOMINAL_DRIVE.load.inertia, rel=0.05)
    rows = {row.symbol: row for row in map_findings(seen)}
    assert (rows["b min"].value, rows["b max"].value) == (min(seen.gaps), max(seen.gaps))
    assert rows["b mean"].value == seen.mean
    assert rows["e"].value == seen.eccentricity


def test_lost_samples_and_repeated_visits_leave_each_place_once(gains: GainSet) -> None:
    recording, _ = recorded(gains, VARYING)
    places = [part.load[0] for part in visits(recording)]
    assert len(places) == FEW.places
    again = Recording(*map(np.concatenate, zip(recording, recording, strict=True)))
    again.time[recording.time.size :] += recording.time[-1] + 0.004
    assert [part.load[0] for part in visits(again)] == places
    lost = recording._replace(motor=recording.motor.copy())
    lost.motor[np.random.default_rng(1).random(lost.motor.size) < 0.03] = math.nan
    assert np.allclose([part.load[0] for part in visits(lost)], places, atol=0.01)


def test_a_place_with_a_hole_is_none(gains: GainSet) -> None:
    recording, _ = recorded(gains, VARYING)
    first, *others = visits(recording)
    middle = 0.5 * (first.time[0] + first.time[-1])
    kept = np.abs(recording.time - middle) > 0.1
    left = visits(Recording(*(column[kept] for column in recording)))
    assert [part.load[0] for part in left] == [part.load[0] for part in others]
    assert gap_around(NOMINAL_DRIVE, left).reason == (
        "the teeth went to and fro across the gap, after a rest, at 5 places around the turn, and there must be 6"
    )


@pytest.mark.parametrize("number", [0, *(pytest.param(number, marks=pytest.mark.grid) for number in (1, 2, 3))])
@pytest.mark.parametrize("motion", [probed, stepped], ids=["probe", "steps"])
def test_other_motions_are_no_map(motion: Callable[[int, str], tuple[object, Recording]], number: int) -> None:
    _, recording = motion(number, "core")
    found = gap_around(NOMINAL_DRIVE, visits(recording))
    assert found.map is None
    assert "around the turn, and there must be 6" in found.reason


def test_a_recording_at_rest_is_no_map() -> None:
    still = np.zeros(500)
    assert visits(Recording.of(0.004 * np.arange(500), still, still, still)) == []
    assert visits(Recording.of(0.004 * np.arange(5), *np.zeros((3, 5)))) == []


def test_places_beyond_a_turn_are_no_map() -> None:
    parts = [Recording.of(*np.full((4, 3), place)) for place in np.linspace(0.0, 7.0, 6)]
    found = gap_around(NOMINAL_DRIVE, parts)
    assert found == (None, "the places are spread over 7 rad, more than a turn", None)


@pytest.mark.corners(1)
@pytest.mark.parametrize("signal", ["motor", "load"])
@pytest.mark.parametrize("share", [0.15, 0.6])
def test_an_encoder_that_freezes_gives_no_map_or_a_right_one(gains: GainSet, signal: str, share: float) -> None:
    recording, _ = recorded(gains, VARYING)
    angle = getattr(recording, signal).copy()
    k = round(share * angle.size)
    angle[k:] = angle[k]
    found = gap_around(NOMINAL_DRIVE, visits(recording._replace(**{signal: angle})))
    assert found.map is None
    assert found.reason


# What becomes of the fits, without any.


class Seen(NamedTuple):
    """The gap at a place, rad, and how far its middle is from where it is on average."""

    gap: float
    middle: float


def combined(monkeypatch: pytest.MonkeyPatch, places: Array, seen: list[Seen | None]) -> gap_map.Mapped:
    """Return the map where the fits have found what was ``seen``."""

    def measure(_drive: Drive, recording: Recording, *_: object) -> Gap:
        place = seen[list(places).index(recording.load[0])]
        if place is None:
            return Gap(0.0, 0.0, False, "no flank")
        x = parameters_of(ln_half_gap=math.log(0.5 * place.gap), offset=0.4 + place.middle)
        little = 1e-10 * np.eye(x.size)
        fit = Fit(free_teeth(1e-3), x, little, little, (1e-3,) * 4, (1, 1), (1e-4, 1e-4), (-1, 1), 0.05, 6.0)
        return Gap(place.gap, 1e-5, True, "", fit)

    monkeypatch.setattr(gap_map, "measure_gap", measure)
    recordings = [Recording(*np.full((5, 3), place)) for place in places]
    return map_gaps(NOMINAL_DRIVE, recordings, 6.0, len(places), closed=True)


AROUND = np.array(GapMapSettings().offsets)


@given(amplitude=st.floats(0.0, 0.01), phase=st.floats(-3.1, 3.1), ratio=st.floats(-2e-3, 2e-3))
def test_eccentricity_is_told_from_a_gap_that_varies_and_from_a_reduction_that_is_off(
    amplitude: float, phase: float, ratio: float
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        found = combined(
            patch,
            AROUND,
            [Seen(0.02 + 0.005 * math.cos(r), -amplitude * math.sin(r + phase) + ratio * r) for r in AROUND],
        ).map
    assert found is not None
    error = found.eccentricity * np.exp(1j * found.phase) - amplitude * np.exp(1j * phase)
    assert abs(error) < 1e-5 + 3.0 * found.eccentricity_uncertainty
    assert found.eccentricity_uncertainty < 1e-4
    assert max(found.gaps) == pytest.approx(0.025, rel=0.02)


def test_a_coupling_that_slips_makes_the_eccentricity_unsure(monkeypatch: pytest.MonkeyPatch) -> None:
    found = combined(monkeypatch, AROUND, [Seen(0.02, 0.006 * (k > 4)) for k in range(8)]).map
    assert found is not None
    assert found.eccentricity_uncertainty > 5e-4


@pytest.mark.parametrize("lost", [(2, 5), (1, 2), (0, 7), (0, 2, 4)])
def test_a_quarter_of_the_places_may_be_missing_and_no_two_neighbours(
    monkeypatch: pytest.MonkeyPatch, lost: tuple[int, ...]
) -> None:
    found = combined(monkeypatch, AROUND, [None if k in lost else Seen(0.02, 0.0) for k in range(8)])
    if lost == (2, 5):
        assert found.map is not None
        assert found.reason.startswith("6 of 8 places: ")
        assert len(found.map.gaps) == 6
    else:
        assert found.map is None
        assert f"only {8 - len(lost)} of 8 places were measured" in found.reason
        assert found.reason.endswith("no flank")


def test_the_diagnostics_have_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    found = combined(monkeypatch, AROUND, [Seen(0.02 + 0.001 * k, 0.0) for k in range(8)]).map
    kept = Estimates(lambda _: "", ThreadPoolExecutor(1))
    assert "gap_map_rad" not in kept.values()
    estimate = BacklashEstimate(0.027, Method.GAP_MAP, valid=True, reason="", map=found)
    kept.learned(estimate, "", 0, apply=True)
    values = kept.values()
    assert values["estimate_method"] == "gap_map"
    assert values["gap_smallest_rad"] == pytest.approx(0.02)
    assert values["gap_smallest_at_rad"] == AROUND[0]
    assert values["gap_largest_rad"] == pytest.approx(0.027) == values["estimate_rad"]
    assert values["gap_map_rad"].startswith("-2.749: 0.02, -1.963: 0.021, ")
    kept.forget()
    assert "gap_map_rad" not in kept.values()


def test_the_ends_of_a_part_of_the_turn_are_no_neighbours() -> None:
    measured = [False, True, True, True, True, True, True, False]
    assert incomplete(measured, closed=True)
    assert not incomplete(measured, closed=False)
    assert GapMapSettings().closed
    assert not GapMapSettings(turn=5.5).closed
