"""Lost motion from ramps of torque on a locked output: right where it is known, and refused where nothing is shown."""

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from locked import Array, locked, ramp
from searched import searched

from backlash_ros.identification.locked_output.ramps import Figure, Ramps, ramps_of
from backlash_ros.identification.recordings.slow_torque import ramps_findings

TORQUE, GAP, FRICTION, STIFFNESS = 4.0, 0.02, 0.5, 300.0
RAMPS = ramp([TORQUE, -TORQUE] * 4)
AT = 0.12


def only(torque: Array, angle: Array, at: float = AT) -> Ramps:
    found = ramps_of(torque, angle, at)
    assert len(found) == 1
    return found[0]


def test_known_gap_friction_and_stiffness_are_found() -> None:
    found = only(RAMPS, locked(RAMPS))
    assert found.valid, found.reason
    assert (found.number, found.torque) == (4, pytest.approx(TORQUE, rel=0.01))
    assert found.at_zero.mean == pytest.approx(GAP + 2.0 * FRICTION / STIFFNESS, rel=1e-3)
    assert found.at_torque.mean == pytest.approx(GAP + 2.0 * (AT + FRICTION) / STIFFNESS, rel=1e-3)
    assert found.without_friction.mean == pytest.approx(GAP + 2.0 * AT / STIFFNESS, rel=1e-3)
    assert found.width.mean >= found.at_zero.mean
    for figure, direction in zip(found.breakaway, (-1.0, 1.0), strict=True):
        assert figure.mean == pytest.approx(direction * FRICTION, abs=0.02)
    for figure in found.stiffness:
        assert figure.mean == pytest.approx(STIFFNESS, rel=0.01)
    assert found.at_zero.spread < 1e-9


@searched(
    30,
    60,
    given(
        gap=st.floats(1e-3, 0.1),
        friction=st.floats(0.01, 0.6),
        stiffness=st.floats(200.0, 1e5),
        scale=st.floats(1e-3, 1e3),
        noise=st.floats(0.0, 0.03),
        seed=st.integers(0, 99),
    ),
)
def test_lost_motion_is_found_for_any_gear_and_any_scale(
    gap: float, friction: float, stiffness: float, scale: float, noise: float, seed: int
) -> None:
    """The torque's noise, less than friction, shifts the angles by no more than it winds up the flanks."""
    noise = min(noise, friction)
    shape = ramp([1.0, -1.0] * 4)
    angle = locked(shape, gap, friction, stiffness)
    shown = scale * (shape + noise * np.random.default_rng(seed).standard_normal(shape.size))
    found = only(shown, angle, 0.0)
    assert found.valid, found.reason
    true = gap + 2.0 * min(friction, 1.0 - friction) / stiffness
    assert found.at_zero.mean == pytest.approx(true, rel=0.02, abs=0.02 * true + 6.0 * noise / stiffness)


def test_the_mirror_image_has_the_same_figures() -> None:
    torque, angle = RAMPS + 0.05, locked(RAMPS)
    one, other = only(torque, angle), only(-torque, -angle)
    assert other.at_zero.mean == pytest.approx(one.at_zero.mean, rel=0.01)
    assert other.breakaway[0].mean == pytest.approx(-one.breakaway[1].mean, abs=0.02)


def test_the_first_ramp_is_told_apart_and_does_not_count() -> None:
    angle = locked(RAMPS)
    angle[400:800] += 0.003  # the first way down
    found = only(RAMPS, angle)
    assert found.at_zero.first == pytest.approx(0.003, rel=0.01)
    assert found.at_zero.mean == pytest.approx(GAP + 2.0 * FRICTION / STIFFNESS, rel=1e-3)
    assert found.at_zero.spread < 1e-9
    assert "the first ramp, which does not count, is +0.17 deg off" in found.in_words()


def test_the_uncertainty_covers_ramps_that_scatter() -> None:
    chance, covered = np.random.default_rng(3), 0
    for _ in range(60):
        angle = locked(RAMPS)
        for k in range(1, 9):
            angle[400 * k : 400 * (k + 1)] += 2e-4 * chance.standard_normal()
        found = only(RAMPS, angle)
        covered += abs(found.at_zero.mean - (GAP + 2.0 * FRICTION / STIFFNESS)) <= 2.0 * found.at_zero.uncertainty
    assert 51 <= covered <= 60


def test_a_noisy_torque_and_a_coarse_angle() -> None:
    chance = np.random.default_rng(1)
    for count in (0.0, 2e-3):
        angle = locked(RAMPS)
        angle = np.round(angle / count) * count if count else angle
        found = only(RAMPS + 0.15 * chance.standard_normal(RAMPS.size), angle)
        assert found.valid, found.reason
        error = abs(found.at_zero.mean - (GAP + 2.0 * FRICTION / STIFFNESS))
        assert error < max(0.03 * GAP, 2.0 * found.at_zero.uncertainty)


def test_a_torque_in_a_few_long_steps() -> None:
    levels = ramp([TORQUE, -TORQUE] * 3, 10)
    late = np.repeat(locked(levels), 30)
    late[29:] = np.convolve(late, np.full(30, 1.0 / 30.0), mode="valid")  # the angle follows slowly
    found = only(np.repeat(levels, 30), late)
    assert found.valid, found.reason
    assert found.at_zero.mean == pytest.approx(GAP + 2.0 * FRICTION / STIFFNESS, rel=0.02)


def test_small_and_large_ramps_are_two_sets() -> None:
    torque = ramp([4.0, -4.0] * 5 + [40.0, -40.0] * 3)
    small, large = ramps_of(torque, locked(torque))
    assert (small.number, large.number) == (5, 3)
    assert (small.torque, large.torque) == (pytest.approx(4.0, rel=0.02), pytest.approx(40.0, rel=0.02))
    assert small.at_zero.mean == pytest.approx(large.at_zero.mean, rel=0.02)


def test_a_lost_motion_beyond_the_torque_is_not_told_and_the_rest_is() -> None:
    found = only(RAMPS, locked(RAMPS), at=5.0)
    rows = {row.symbol: row for row in ramps_findings(found)}
    assert rows["lost motion T"].why == "the torque reaches only 4 N m"
    assert rows["lost motion 0"].told


def sine(turns: float = 8.0) -> Array:
    return np.asarray(TORQUE * np.sin(np.linspace(0.0, 2.0 * math.pi * turns, 4000)))


@pytest.mark.parametrize(
    ("torque", "angle", "reason"),
    [
        (lambda: np.zeros(500), np.zeros_like, "the torque stays at 0 N m"),
        (lambda: np.linspace(0.0, 4.0, 500), lambda t: 0.001 * t, "must go to both sides of zero at least twice"),
        (lambda: 2.0 + 0.5 * sine(), lambda t: 0.001 * t, r"to 4 N m and must go to both sides of zero"),
        (lambda: ramp([4.0, -4.0]), locked, "has 2 turns beyond zero"),
        (lambda: RAMPS[:10], locked, "there are 10 samples, and must be at least 20"),
        (lambda: RAMPS, np.zeros_like, "the angle stands still under the torque"),
        (lambda: RAMPS, lambda t: -locked(t), "the angle falls while the torque rises"),
        (lambda: RAMPS, lambda t: locked(t) + 5e-5 * np.arange(t.size), "move by 0.04 rad from ramp to ramp"),
        (sine, lambda t: 1e-3 * np.cumsum(t), "the output is not locked"),
        (sine, lambda t: 1e-3 * t, "the branches meet at zero torque"),
    ],
)
def test_what_is_no_ramp_of_a_locked_output_is_refused(
    torque: Callable[[], Array], angle: Callable[[Array], Array], reason: str
) -> None:
    found = only(torque(), angle(torque()))
    assert not found.valid
    assert re.search(reason, found.reason), found.reason


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.floats(-1e15, 1e15), st.floats(-1e15, 1e15)), max_size=80), st.booleans())
def test_any_numbers_have_an_answer(rows: list[tuple[float, float]], repeated: bool) -> None:
    torque, angle = np.array(rows or [(0.0, 0.0)]).T
    if repeated:
        torque, angle = np.tile(torque, 8), np.tile(angle, 8)
    for found in ramps_of(torque, angle, 1.0):
        assert found.valid == (not found.reason)
        for row in ramps_findings(found):
            assert row.told == math.isfinite(row.value)


def test_a_figure_that_no_ramp_has_is_not_found() -> None:
    assert not Figure().found
