"""One wrong sample, or ten, of any signal, any finite value: the load hardly moves, or a fault is latched at once."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from bad_samples import GAINS, SENSORS, SITUATIONS, B, Harm, allowed, harm, holds, play
from hypothesis import example, given
from hypothesis import strategies as st
from searched import searched

from backlash_ros.control import LAWS, Servo, ServoSettings
from backlash_ros.control.monitoring.side import PATIENCE
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, STATE_NAMES, THETA_L, THETA_M, Measurement

FINITE = st.floats(allow_nan=False, allow_infinity=False)
NEAR = st.floats(-1.0, 1.0).map(lambda x: math.copysign(10 ** (4 * abs(x) - 3), x))
"""From 1 thousandth to 10, either sign: what is close enough to the truth to be believed."""


@pytest.mark.population
@searched(
    40,
    100,
    given(
        kind=st.sampled_from(sorted(SENSORS)),
        name=st.sampled_from(sorted(SITUATIONS)),
        law=st.sampled_from(sorted(LAWS)),
        period=st.sampled_from([0.004, 0.001]),
        choice=st.integers(0, 4),
        value=st.one_of(FINITE, NEAR),
        added=st.booleans(),
        samples=st.integers(1, 10),
    ),
)
@example("all signals", "at rest", "fast", 0.004, CURRENT, 10.0 / 0.05, False, 1)  # 10 N m once
@example("all signals", "at rest", "fast", 0.004, CURRENT, 1e9 / 0.05, False, 1)
@example("all signals", "in the limit cycle", "fast", 0.004, CURRENT, 1e9 / 0.05, False, 1)
@example("positions alone", "at rest", "two_region", 0.004, THETA_L, 0.03, True, 10)
def test_bad_samples_hardly_move_the_load_or_are_a_fault_at_once(
    kind: str, name: str, law: str, period: float, choice: int, value: float, added: bool, samples: int
) -> None:
    sensors, situation = SENSORS[kind], SITUATIONS[name]
    signal = STATE_NAMES.index(sensors.measured[choice % len(sensors.measured)])

    def bad(true: float, _turn: int) -> float:
        shown = true + value if added else value
        return shown if math.isfinite(shown) else true

    found = harm(law, situation, sensors, period, bad, signal, samples)
    assert holds(found, allowed(situation, law, sensors, period)), found


@searched(
    40,
    100,
    given(
        name=st.sampled_from(["at rest", "in the limit cycle", "learning"]),
        law=st.sampled_from(sorted(LAWS)),
        signal=st.sampled_from([OMEGA_M, OMEGA_L, CURRENT]),
        values=st.lists(NEAR, min_size=1, max_size=10),
    ),
)
def test_bad_samples_that_differ_from_each_other(name: str, law: str, signal: int, values: list[float]) -> None:
    situation, sensors = SITUATIONS[name], SENSORS["all signals"]
    found = harm(law, situation, sensors, 0.004, lambda true, k: true + values[k], signal, len(values))
    assert holds(found, allowed(situation, law, sensors, 0.004)), found


FOREVER = 10**6
UNITS: dict[str, tuple[int, float]] = {
    "efforts x5": (CURRENT, 5.0),
    "efforts x10": (CURRENT, 10.0),
    "efforts of the output": (CURRENT, 20.0),
    "motor in rpm": (OMEGA_M, 60 / (2 * math.pi)),
    "load in rpm": (OMEGA_L, 60 / (2 * math.pi)),
    "motor in degrees": (OMEGA_M, 180 / math.pi),
    "load in degrees": (OMEGA_L, 180 / math.pi),
    "motor reversed": (OMEGA_M, -1.0),
    "load reversed": (OMEGA_L, -1.0),
    "motor's speed behind the gear": (OMEGA_M, 0.1),
    "load's speed before the gear": (OMEGA_L, 10.0),
    "motor's speed stands": (OMEGA_M, 0.0),
    "load's speed stands": (OMEGA_L, 0.0),
}


@pytest.mark.corners(26)
@pytest.mark.parametrize("name", ["arriving", "learning"])
@pytest.mark.parametrize("law", ["fast", "two_region", "cascade", "planned"])
@pytest.mark.parametrize(("signal", "factor"), UNITS.values(), ids=UNITS)
def test_wrong_unit_or_sign_is_a_fault_during_the_first_move(name: str, law: str, signal: int, factor: float) -> None:
    """Wrong from the first sample on, at rest, where it shows nothing yet: the move is a step of 1 rad, or the kick."""
    situation = SITUATIONS[name]._replace(since=0.05)
    sensors = SENSORS["all signals"]
    true = play(law, situation, sensors, 0.004)
    wrong = play(law, situation, sensors, 0.004, lambda value, _: factor * value, signal, FOREVER, wrong_from=0.0)
    quantity = "motor current" if signal == CURRENT else "motor speed" if signal == OMEGA_M else "load speed"
    assert wrong.fault.startswith(quantity)
    latched = wrong.latched
    assert 0.004 * latched - situation.since <= 0.11
    assert np.max(np.abs(wrong.angle - true.angle)[: latched + 1]) <= 0.2
    after = np.abs(wrong.angle[latched:] - wrong.angle[latched])
    assert np.max(after) <= 0.2 + 0.02 * np.max(np.abs(true.speed))


def test_wrong_effort_under_a_load_torque_is_a_fault_before_anything_moves() -> None:
    situation = SITUATIONS["at rest"]._replace(load_torque=0.3)
    for factor in (5.0, -1.0):
        wrong = play(
            "fast",
            situation,
            SENSORS["all signals"],
            0.004,
            lambda x, _, f=factor: f * x,
            CURRENT,
            FOREVER,
            wrong_from=0.0,
        )
        assert wrong.fault.startswith("motor current")
        assert abs(wrong.angle[wrong.latched]) <= 2 * B


@pytest.mark.parametrize(
    ("signal", "bad"),
    [
        (CURRENT, lambda _true, _k: 1e9),
        (OMEGA_M, lambda _true, _k: -1000.0),
        (OMEGA_L, lambda _true, _k: 100.0),
    ],
    ids=["current", "omega_m", "omega_l"],
)
def test_a_signal_is_a_fault_at_its_third_bad_sample_and_not_before(
    signal: int, bad: Callable[[float, int], float]
) -> None:
    for samples in range(1, PATIENCE + 1):
        played = play("fast", SITUATIONS["at rest"], SENSORS["all signals"], 0.004, bad, signal, samples)
        assert played.latched == (PATIENCE - 1 if samples == PATIENCE else -1)
        if samples < PATIENCE:
            np.testing.assert_allclose(played.angle, 0.0, atol=1e-3)


def test_one_encoder_that_stands_while_the_other_moves_is_a_fault() -> None:
    for signal, speed in ((THETA_M, OMEGA_M), (THETA_L, OMEGA_L)):
        for sensors in SENSORS.values():
            situation = SITUATIONS["arriving"]._replace(since=0.05)
            stands = play("fast", situation, sensors, 0.004, lambda _x, _k: 0.0, signal, FOREVER, wrong_from=0.0)
            assert "encoder" in stands.fault, (signal, speed)
            assert np.max(np.abs(stands.angle)) <= 0.6


def test_the_property_can_fail() -> None:
    assert not holds(Harm(0.05, 0.0, 0), (0.04, 0.2))
    assert not holds(Harm(0.05, 0.0, PATIENCE + 1), (0.04, 0.2))
    assert not holds(Harm(0.0, 0.3, 1), (0.04, 0.2))
    assert holds(Harm(0.5, 0.1, PATIENCE), (0.04, 0.2))


def test_an_encoder_that_jumps_once_makes_no_speed() -> None:
    """By positions alone, within the gap: as if the sample were not there."""
    for samples in (1, PATIENCE - 1):
        jumps = play(
            "fast",
            SITUATIONS["at rest"],
            SENSORS["positions alone"],
            0.004,
            lambda true, _: true + 0.03,
            THETA_L,
            samples,
        )
        assert jumps.fault == ""
        np.testing.assert_array_equal(jumps.angle, 0.0)


@pytest.mark.parametrize("signal", [THETA_M, THETA_L])
def test_the_only_encoder_that_slips_makes_no_speed_on_either_side(signal: int) -> None:
    servo = Servo(NOMINAL_DRIVE, ServoSettings(GAINS))
    for k in range(10):
        shown = Measurement(np.full(5, math.nan))
        shown[signal] = (0.4 if signal == THETA_M else 0.04) * (k >= 5)
        servo.update(shown)
        assert abs(servo.estimate[OMEGA_L]) < 1e-9
        assert abs(servo.estimate[OMEGA_M]) < 1e-9
    assert servo.load_angle == pytest.approx(0.04)
    assert servo.fault == ""


def test_a_blow_is_believed_at_its_third_sample() -> None:
    """The load is hit and moves: by positions alone its speed is known one sample after it is believed."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(GAINS, period=0.001))
    speeds = []
    for k in range(10):
        way = 0.02 * max(0, k - 2)  # 20 rad/s from one sample to the next
        servo.update(Measurement(np.array([math.nan, math.nan, way, math.nan, math.nan])))
        speeds.append(float(servo.estimate[OMEGA_L]))
    assert servo.fault == ""
    assert speeds[:5] == [0.0] * 5
    assert speeds[5:] == pytest.approx([20.0] * 5)
