"""Gains: the design against the frozen reference, and what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from backlash_ros.control import Gains, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE, rigid_model

REFERENCE = yaml.safe_load((Path(__file__).parent / "data" / "nominal_drive.yaml").read_text())["gains"]
POLES = {"fast": [-941, -116.6, -28.8], "overdamped": [-947, -55.6, -3.80]}


@pytest.mark.parametrize("region", ["fast", "overdamped"])
def test_designed_gains_are_the_reference_gains(region: str) -> None:
    gains = design_gains(region, NOMINAL_DRIVE, REFERENCE[region]["q"])
    np.testing.assert_allclose(gains.as_array(), REFERENCE[region]["k"], rtol=1e-6)


@pytest.mark.parametrize("region", ["fast", "overdamped"])
def test_closed_loop_poles_are_the_reference_poles(region: str) -> None:
    a, b = rigid_model(NOMINAL_DRIVE)
    k = design_gains(region, NOMINAL_DRIVE, REFERENCE[region]["q"]).as_array()
    poles = np.sort(np.linalg.eigvals(a - b[:, :1] @ k[None, :]).real)
    np.testing.assert_allclose(poles, POLES[region], rtol=2e-3)


def test_rigid_model_has_the_load_torque_of_eq_4_as_second_input() -> None:
    a, b = rigid_model(NOMINAL_DRIVE)
    assert b[1, 1] == pytest.approx(1 / (5e-4 + 2e-5 / 0.01))
    assert b[2, 0] == pytest.approx(1 / 2e-3)
    assert a[1, 1] == pytest.approx(-(5e-3 + 2e-5 / 0.01) / 2.5e-3)
    # At rest under a load torque eq 4 leaves K_m i / n = -tau_l.
    rest = np.linalg.solve(a[1:, 1:], -b[1:, 1] * 0.1 - b[1:, 0] * (-2.0 * 0.1 * 0.1 / 0.05))
    np.testing.assert_allclose(rest, [0.0, -0.1 * 0.1 / 0.05], atol=1e-12)


@pytest.mark.parametrize(
    ("k", "says"),
    [
        ([1.0, 2.0], "gains.fast.k must be three gains"),
        ([math.nan, 0.0, 0.0], r"k1 \(position\) must be finite and within .* V/rad, got nan"),
        ([1.0, math.inf, 0.0], r"k2 \(velocity\) must be finite and within .* V s/rad, got inf"),
        ([1.0, 0.0, 1e7], r"k3 \(current\) must be finite and within .* V/A, got 10000000.0"),
        ([0.0, 0.0, 0.0], r"k1 \(position\) must be > 0 V/rad, got 0.0"),
    ],
)
def test_unusable_gains_are_refused_by_name(k: list[float], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Gains.from_sequence("gains.fast.k", k)


@pytest.mark.parametrize(
    ("q", "says"),
    [
        ([1.0], r"must be two weights \[Q11, Q22\], got 1"),
        ([0.0, 1.0], "Q11 must be > 0"),
        ([1.0, -1.0], "Q22 must be >= 0"),
        ([math.nan, 0.0], "Q11 must be > 0 .* got nan"),
        ([1.0, math.inf], "Q22 must be >= 0 .* got inf"),
        ([1e-300, 0.0], "no gains can be computed from Q11 = 1e-300, Q22 = 0.0"),
    ],
)
def test_unusable_weights_are_refused_by_name(q: list[float], says: str) -> None:
    with pytest.raises(ValueError, match=rf"gains.fast.q:? ?{says}"):
        design_gains("gains.fast.q", NOMINAL_DRIVE, q)
