"""Recognising and measuring a cycle in samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backlash_ros.control import find_limit_cycle


def sine(amplitude: float, cycle: float, period: float, seconds: float = 2.0, phase: float = 0.3, offset: float = 0.0):
    t = np.arange(0, seconds, period)
    angle = 2 * np.pi * t / cycle + phase
    return offset + 0.5 * amplitude * np.sin(angle), np.pi * amplitude / cycle * np.cos(angle)


@settings(deadline=None)
@given(
    amplitude=st.floats(1e-4, 1.0),
    samples=st.floats(7.5, 60.0),
    phase=st.floats(0, 6.28),
    offset=st.floats(-10, 10),
)
def test_sine_is_measured_even_from_eight_samples_a_cycle(
    amplitude: float, samples: float, phase: float, offset: float
) -> None:
    position, speed = sine(amplitude, samples * 0.004, 0.004, phase=phase, offset=offset)
    cycle = find_limit_cycle(position, speed, 0.004)
    assert cycle is not None
    assert cycle.amplitude == pytest.approx(amplitude, rel=0.01)
    assert cycle.period == pytest.approx(samples * 0.004, rel=0.01)
    assert cycle.cycles >= (position.size - 1) // samples - 2  # the ends are not whole cycles
    assert cycle.amplitude_spread < 0.02


@pytest.mark.parametrize("position", [np.zeros(500), np.linspace(0, 1, 500), np.full(3, 1.0)])
def test_rest_and_drift_are_no_cycle(position: np.ndarray) -> None:
    assert find_limit_cycle(position, np.zeros(position.size), 0.004) is None


def test_decay_shows_as_spread() -> None:
    position, speed = sine(1.0, 0.05, 0.004)
    decay = np.exp(-np.arange(position.size) * 0.004 / 0.5)
    cycle = find_limit_cycle(position * decay, speed * decay, 0.004)
    assert cycle is not None
    assert cycle.amplitude_spread > 0.25


def test_second_curve_is_measured_over_the_cycles_of_the_first() -> None:
    position, speed = sine(1.0, 0.05, 0.004)
    cycle = find_limit_cycle(position, speed, 0.004, travel=np.repeat(3 * position, 16)[:-15])
    assert cycle is not None
    assert cycle.amplitude == pytest.approx(3.0, rel=0.1)
