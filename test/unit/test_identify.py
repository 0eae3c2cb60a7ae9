"""Identification against the plant: drives drawn at random, found again from their recordings; broken ones refused."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recorded import probed, stepped, true_gap, without

from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.identification.fitting.parameters import place_of
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import NOISE, SPEEDS, SURE_INERTIA, findings_of
from backlash_ros.identification.recordings.identify import Identified, _replaced, identify
from backlash_ros.identification.recordings.plausible import implausible, suspicion
from backlash_ros.identification.recordings.stretch import informative
from backlash_ros.identification.regression import guess_of
from backlash_ros.recordings.samples import Columns, Reading, recording_of
from backlash_ros.studies.evaluation.population import Member, told_model

pytestmark = pytest.mark.population

MOTIONS = {"probe": probed, "steps": stepped, "uneven": lambda k, population: stepped(k, population, uneven=True)}


def truth_of(member: Member) -> dict[str, tuple[float, float]]:
    """Return what is true, and by how much it may be missed."""
    load, gap, period = member.drive.load, true_gap(member), 1.0 / member.rate
    result = {
        "J_l": (load.inertia, 0.05 * load.inertia),
        "b": (gap, max(0.03 * gap, member.load_count)),
        "delay": (member.delay.command, 0.25 * period),
    }
    for speed in SPEEDS:
        friction = load.viscous_friction * speed + load.coulomb_friction
        result[f"{speed:g} B_l + c_l"] = friction, max(0.1 * friction, 2e-3)
    return result


def as_read(member: Member, recording: Recording) -> Recording:
    """Return a recording as it comes from a file."""
    names = ("time", "motor", "load", "command")
    columns = Columns(*recording[:4], names, lambda k: f"in row {k}")
    return recording_of(columns, Reading(motor_at="output"), member.drive)[0]


@cache
def identified(number: int, population: str, motion: str, lost: float = 0.0) -> tuple[Member, Identified]:
    member, recording = MOTIONS[motion](number, population)
    recording = as_read(member, without(recording, lost, number) if lost else recording)
    return member, identify(told_model(member, "nominal"), recording)


CASES = [
    (1, "full", "probe", 0.0),
    (0, "core", "probe", 0.03),
    (1, "core", "probe", 0.03),
    (3, "core", "steps", 0.03),
    (3, "core", "uneven", 0.0),
    (1, "full", "uneven", 0.03),
]


each_case = pytest.mark.parametrize(
    "case",
    [CASES[0], *(pytest.param(case, marks=pytest.mark.grid) for case in CASES[1:])],
    ids=lambda case: "-".join(map(str, case)),
)


@each_case
def test_what_is_told_is_right(case: tuple[int, str, str, float]) -> None:
    member, found = identified(*case)
    assert found.valid, found.reason
    told = {symbol: found.of(symbol) for symbol in truth_of(member)}
    untold = {symbol: finding.why for symbol, finding in told.items() if not finding.told}
    if case[2] == "probe":
        assert untold == {}
    # Steps alone may tell the load's inertia from the motor's gain too poorly.
    assert set(untold) <= {"J_l"}
    assert all("its standard uncertainty is" in why for why in untold.values())
    for symbol, (value, near) in truth_of(member).items():
        if symbol in untold:
            continue
        assert abs(told[symbol].value - value) <= near, (symbol, told[symbol], value)
        assert abs(told[symbol].value - value) <= 3.0 * told[symbol].uncertainty, (symbol, told[symbol], value)

    values = values_of(found.drive)
    for row in found.findings:
        if row.key in found.replaced & values.keys():
            assert values[row.key] == pytest.approx(row.value), row


@pytest.mark.parametrize("untold", ["K_m", "R"])
def test_motor_constant_and_resistance_are_taken_together_or_stay_as_told(untold: str) -> None:
    member, found = identified(*CASES[0])
    assert found.fit is not None
    rows = [replace(row, why="not sure") if row.symbol == untold else row for row in found.findings]
    told = told_model(member, "nominal")
    drive, replaced = _replaced(told, found.fit, rows)
    assert not {"motor.torque_constant", "motor.resistance"} & replaced
    assert drive.motor == replace(told.motor, coulomb_friction=drive.motor.coulomb_friction)


def test_a_drive_explains_what_it_was_not_fitted_to() -> None:
    _, found = identified(*CASES[0])
    assert found.score is not None
    assert found.score.rms < 1.3
    assert found.score.error < 0.05 * found.score.told_error


def test_what_the_recording_cannot_tell_is_named() -> None:
    """The load leans on one flank throughout: no gap, but its inertia and what acts on it."""
    member, recording = stepped(2, "core", length=2.5)
    found = identify(told_model(member, "nominal"), as_read(member, recording), hold_out=False)
    assert found.valid
    assert not found.of("b").told
    assert "far flank was not seen" in found.of("b").why
    assert math.isnan(found.of("b").value)
    assert found.drive.gear == told_model(member, "nominal").gear
    for symbol in ("J_l", "tau_l", "delay"):
        assert found.of(symbol).told, found.of(symbol).why
    assert found.of("J_l").value == pytest.approx(member.drive.load.inertia, rel=0.05)
    assert found.of("tau_l").value == pytest.approx(member.standing_torque, abs=3.0 * found.of("tau_l").uncertainty)


def test_friction_told_apart_poorly_is_told_together() -> None:
    _, found = identified(*CASES[0])
    assert found.fit is not None
    assert found.gap is not None
    blurred = found.fit.covariance.copy()
    v, c = place_of("ln_load_viscous"), place_of("load_coulomb")
    viscous = float(np.exp(found.fit.values.ln_load_viscous))
    # As when one speed alone was seen, 5 rad/s: what one friction gains the other loses.
    blurred[v, v], blurred[c, c] = 0.5**2, (5.0 * viscous * 0.5) ** 2
    blurred[v, c] = blurred[c, v] = -0.99 * 0.5 * 5.0 * viscous * 0.5
    rows = findings_of(found.drive, found.gap, replace(found.fit, covariance=blurred), 1e-3)
    by_symbol = {row.symbol: row for row in rows}
    assert "told apart poorly" in by_symbol["B_l"].why or not by_symbol["10 B_l + c_l"].told
    assert not by_symbol["B_l"].told


@pytest.mark.parametrize(("factor", "plans"), [(3.0, True), (30.0, False)])
def test_a_load_that_is_roughly_known_is_not_told_and_is_planned_with(factor: float, plans: bool) -> None:
    """Only where the gap is known: a fit with unknown teeth is wrong by more than it says."""
    _, found = identified(*CASES[0])
    assert found.fit is not None
    assert found.gap is not None
    blurred = found.fit.covariance.copy()
    place = place_of("ln_load_inertia")
    blurred[place, place] = (factor * SURE_INERTIA / NOISE) ** 2
    blurred[place, :place] = blurred[:place, place] = blurred[place, place + 1 :] = blurred[place + 1 :, place] = 0.0
    rough = replace(found.fit, covariance=blurred)
    rows = findings_of(found.drive, found.gap, rough, 1e-3)
    (inertia,) = (row for row in rows if row.symbol == "J_l")
    assert (inertia.told, inertia.rough, inertia.plans) == (False, plans, plans)
    assert "standard uncertainty" in inertia.why
    told = replace(found.drive, load=replace(found.drive.load, inertia=1.0))
    drive, used = _replaced(told, rough, rows)
    assert ("load.inertia" in used) == plans
    assert (drive.load.inertia == pytest.approx(math.exp(rough.values.ln_load_inertia))) == plans
    lost = findings_of(found.drive, replace(found.gap, valid=False, reason="lost"), rough, 1e-3)
    assert not any(row.rough for row in lost)


def shifted_half(values: np.ndarray, way: float) -> np.ndarray:
    result = values.copy()
    result[result.size // 2 :] += way
    return result


def stopped_half(values: np.ndarray) -> np.ndarray:
    result = values.copy()
    result[result.size // 2 :] = result[result.size // 2]
    return result


DEGREE = math.degrees(1.0)
BROKEN: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "motor in degrees": (
        lambda r: r._replace(motor=DEGREE * r.motor),
        "motor's angle seems to be in degrees|motor turned",
    ),
    "load in degrees": (lambda r: r._replace(load=DEGREE * r.load), "load's angle seems to be in degrees|load turned"),
    "both in degrees": (lambda r: r._replace(motor=DEGREE * r.motor, load=DEGREE * r.load), "degrees|turned at"),
    "motor before the gear": (lambda r: r._replace(motor=10.0 * r.motor), "at the motor, before the gear|turned at"),
    "motor reversed": (lambda r: r._replace(motor=-r.motor), "encoders count in opposite directions"),
    "load reversed": (lambda r: r._replace(load=-r.load), "encoders count in opposite directions"),
    "both reversed": (lambda r: r._replace(motor=-r.motor, load=-r.load), "backwards"),
    "swapped": (lambda r: r._replace(motor=r.load, load=r.motor), "."),
    "milliseconds": (lambda r: r._replace(time=1e3 * r.time), "."),
    "load stops": (lambda r: r._replace(load=stopped_half(r.load)), "."),
    "coupling slips": (lambda r: r._replace(load=shifted_half(r.load, 0.3 * np.ptp(r.travel))), "."),
    "millivolts": (lambda r: r._replace(command=1e3 * r.command), "obeys at most 24 V"),
    "no command": (lambda r: r._replace(command=0.0 * r.command), "never changes"),
    "load at rest": (lambda r: r._replace(load=0.0 * r.load), "the load moved by 0 rad"),
    "too short": (lambda r: r.part(slice(50)), "at least 100 samples"),
}


SEARCHED = ("both reversed", "swapped", "load stops", "coupling slips")
"""What only a fit finds out; that of the first one is as if the command was reversed (test_identification.py)."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.grid if n in SEARCHED else []) for n in BROKEN])
def test_a_broken_recording_is_refused_with_the_reason(name: str) -> None:
    member, recording = stepped(3, "core")
    broken, reason = BROKEN[name]
    found = identify(told_model(member, "nominal"), broken(recording))
    assert not found.valid
    assert found.findings == ()
    assert found.drive == told_model(member, "nominal")
    assert re.search(reason, found.reason), found.reason


def test_a_command_in_amperes_is_suspected() -> None:
    member, recording = stepped(3, "core")
    drive, delays = told_model(member, "nominal"), [0.0, member.delay.command]
    assert suspicion(drive, recording, delays) == ""
    wrong = recording._replace(command=recording.command / drive.motor.resistance)
    assert suspicion(drive, wrong, delays) == "the command seems to be in amperes"


@each_case
def test_a_sound_recording_is_plausible(case: tuple[int, str, str, float]) -> None:
    member, recording = MOTIONS[case[2]](case[0], case[1])
    assert implausible(told_model(member, "nominal"), recording) == ""


def test_first_guess_takes_uneven_samples() -> None:
    guesses = []
    for uneven in (False, True):
        member, recording = stepped(3, "core", uneven=uneven)
        guesses.append(guess_of(motor_side(told_model(member, "nominal")), recording, member.delay.command))
        assert guesses[-1].load_torque == pytest.approx(member.standing_torque, abs=0.02)
        assert guesses[-1].inertia == pytest.approx(member.drive.load.inertia, rel=0.5)
    assert guesses[1].inertia == pytest.approx(guesses[0].inertia, rel=0.1)


def test_the_stretch_with_most_between_the_shafts_is_used() -> None:
    time = 0.01 * np.arange(4000)
    busy = (time > 22.0) & (time < 30.0)
    load = np.sin(time)
    motor = load + np.where(busy, 0.01 * np.sign(np.sin(20.0 * time)), 0.0)
    part, told = informative(Recording.of(time, motor, load, np.sin(time)))
    assert part.time[-1] - part.time[0] == pytest.approx(12.0, abs=0.02)
    assert part.time[0] <= 22.0
    assert part.time[-1] >= 29.9
    assert f"{part.time[0]:.2f} to {part.time[-1]:.2f} s of 39.99 s" in told


def test_a_hole_ends_a_stretch() -> None:
    time = 0.01 * np.arange(1000)
    time[300:] += 5.0
    load = np.sin(3.0 * time)
    part, told = informative(Recording.of(time, load + 0.01 * np.sign(np.cos(3.0 * time)), load, np.cos(time)))
    assert part.time[0] == pytest.approx(8.0)
    assert part.time.size == 700
    assert "of 14.99 s" in told
