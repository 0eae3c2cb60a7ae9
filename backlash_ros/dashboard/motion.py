"""Continuous references: back and forth, and a sine."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass

_STEP = 0.02
"""Time between two references of a sine, s."""


@dataclass(frozen=True)
class Wave:
    """A wave about ``middle`` with an ``amplitude``, rad, and a ``period``, s; a sine if ``smooth``, else steps."""

    middle: float
    amplitude: float
    period: float
    smooth: bool


async def wave(what: Wave, move: Callable[[float], None]) -> None:
    """Send the references of a wave until cancelled."""
    clock = asyncio.get_running_loop().time
    began = clock()
    while True:
        phase = (clock() - began) / what.period
        if what.smooth:
            move(what.middle + what.amplitude * math.sin(2.0 * math.pi * phase))
            await asyncio.sleep(_STEP)
        else:
            move(what.middle + (what.amplitude if phase % 1.0 < 0.5 else -what.amplitude))
            await asyncio.sleep(what.period * (0.5 - phase % 0.5))
