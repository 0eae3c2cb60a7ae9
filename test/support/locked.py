"""Ramps of torque on a locked output, made from a gap, friction and stiffness that are known."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def ramp(peaks: Sequence[float], samples: int = 400) -> Array:
    """Return a torque that goes from 0 to each peak in turn and back to 0, so many samples for each way."""
    ends = [0.0, *peaks, 0.0]
    ways = [np.linspace(a, b, samples, endpoint=False) for a, b in pairwise(ends)]
    return np.append(np.concatenate(ways), 0.0)


def locked(torque: Array, gap: float = 0.02, friction: float = 0.5, stiffness: float = 300.0) -> Array:
    """Return the motor's angle at the output, rad: friction holds it, then it slips; teeth are springs with a gap."""
    held, teeth = 0.0, np.empty(torque.size)
    for k, each in enumerate(torque):
        held = teeth[k] = min(max(held, each - friction), each + friction)
    return np.asarray(0.5 * gap * np.sign(teeth) + teeth / stiffness)


def example() -> str:
    """Return the table docs/examples/locked_output.csv: a noisy torque, coarse times, a first ramp that differs."""
    chance = np.random.default_rng(5)
    torque = ramp([6.0, -6.0] * 4, 160)
    angle = locked(torque, gap=0.012, friction=0.8, stiffness=900.0)
    angle[:400] -= 0.0008  # the gear had not settled yet
    degrees = np.round(np.degrees(angle) / 0.005) * 0.005
    shown = torque + 0.05 * chance.standard_normal(torque.size)
    rows = zip(np.arange(torque.size), degrees, shown, strict=True)
    return "t,angle,torque,temperature\n" + "".join(
        f"{0.016 * (k // 2):.3f},{angle:.3f},{each:.3f},24.5\n" for k, angle, each in rows
    )


if __name__ == "__main__":
    place = Path(__file__).parents[2] / "docs" / "examples" / "locked_output.csv"
    place.write_text(example())
