"""Jogging: the load moves for as long as somebody holds a button down.

A press is a motion to the end of what one press may do, of which only the next moment is ever sent: as setpoints. When
no more come, the controller brings the load to rest by itself. So it stops whatever is lost on the way from the hand to
the drive: the button, the browser, the network, or this process.
"""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from backlash_ros.control import FaultThresholds, Gains, GainSet, Limits, ServoSettings
from backlash_ros.control.design.start import emulated
from backlash_ros.control.motion.motion_limits import motion_limits
from backlash_ros.control.motion.profile import MotionLimits, Profile
from backlash_ros.control.motion.profile_parameters import OF_DRIVE, ProfileParameters
from backlash_ros.control.motion.setpoint import DURATION
from backlash_ros.dashboard.axis import SILENCE, Axis
from backlash_ros.dashboard.state import refusal
from backlash_ros.drivetrain.parameters import drive_of
from backlash_ros.foundation.quantity import take
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import POSITION, Setpoint

SHARES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Speeds to choose from, as shares of what the drive can do with its load; the first until one chooses."""
HELD = 0.5
"""Longest time between two signs that the button is held, s."""
_AHEAD = 0.2
"""Time by which setpoints are sent before they are due, s: this process may be held up for so long."""
_INTERVAL = 0.02
"""Time between two setpoints, s."""
_AT_ONCE = 5
"""Setpoints that are sent together, at most: a subscriber keeps ten."""
_LONGEST_TIMEOUT = 0.5
"""Largest ``setpoint_timeout``, s: the load goes on for so long if this process dies."""
_THERE = 1e-6
"""Way that is none, rad."""
_ANSWERS = 0.5
"""Time within which the setpoint moves, s, if the controller follows."""
_PAUSE = 0.1
"""Pause between two streams beyond ``setpoint_timeout``, s: the time of the samples is known about as well."""


class Hand:
    """Whether a button is held: its browser says so again and again. A sign that comes too late changes nothing."""

    def __init__(self) -> None:
        self._until = time.monotonic() + HELD

    def sign(self) -> None:
        """Take a sign that it is held."""
        if self.holds:
            self._until = time.monotonic() + HELD

    def let_go(self) -> None:
        """Take the end of it."""
        self._until = -math.inf

    @property
    def lost(self) -> str:
        """What is missing if it neither holds nor has let go."""
        return "" if self.holds or math.isinf(self._until) else f"the page did not answer for {HELD:g} s: press again"

    @property
    def holds(self) -> bool:
        """Whether it is held."""
        return time.monotonic() < self._until


def abilities(values: Mapping[str, Any]) -> MotionLimits:
    """Return how fast a jog may be with the parameters in use: as references with the profile `OF_DRIVE`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If the parameters are another version's.
    """
    period, delay = 1.0 / values["rate"], values["loop_delay"]
    settings = take(
        ServoSettings,
        values,
        gains=GainSet(*(Gains(*values[f"gains.{region}.k"]) for region in ("fast", "overdamped"))),
        period=period,
        loop_delay=delay,
        thresholds=take(FaultThresholds, values),
        profile=take(ProfileParameters, values, mode=OF_DRIVE),
    )
    able = motion_limits(emulated(drive_of(values), period, delay), settings, take(Limits, values))
    assert able is not None  # with this profile
    return able


async def jog_while_told(connection: Any, start: Callable[[Hand], Awaitable[str]]) -> None:
    """Jog for as long as messages come over a web socket that say so; then tell why it ended, and close.

    Nothing moves before the first one.
    """
    await connection.accept()
    try:
        first = await asyncio.wait_for(connection.receive(), HELD)
    except asyncio.TimeoutError:
        await connection.close()
        return
    if first["type"] == "websocket.disconnect":
        return
    hand = Hand()

    async def listen() -> None:
        while (await connection.receive())["type"] != "websocket.disconnect":
            hand.sign()
        hand.let_go()

    listening = asyncio.create_task(listen())
    try:
        why = await start(hand)
        with suppress(RuntimeError, OSError):  # it may have been closed just now
            if not listening.done():
                await connection.send_text(why)
                await connection.close()
    finally:
        listening.cancel()


async def jog(axis: Axis, way: int, share: float, hand: Hand) -> str:
    """Move the load while the hand holds, then let it come to rest; return why it moves no more, empty if let go.

    Where this is cancelled, the controller brings the load to rest by itself.

    Parameters
    ----------
    way : 1 or -1
    share : of the speed that the drive can do
    """
    values, version = axis.told.values, axis.told.version
    try:
        able, limits, timeout = abilities(values), take(Limits, values), float(values["setpoint_timeout"])
    except (KeyError, ValueError, TypeError):
        return "nothing was sent: the controller is of another version"
    if timeout > _LONGEST_TIMEOUT:
        return f"nothing was sent: setpoint_timeout must be <= {_LONGEST_TIMEOUT:g} s, got {timeout:g} s"
    able, end = replace(able, velocity=share * able.velocity), math.nan
    why = await _rest(axis, timeout, hand)
    if why or not hand.holds:
        return why
    while hand.holds and not why:
        begin = axis.last_state["setpoint"]
        end = limits.clamp(begin + way * limits.step) if math.isnan(end) else end
        if not way * (end - begin) > _THERE:
            return f"one press moves the load to {end:.6g} rad: the end of the travel, or limits.step away"
        why = await _send(axis, Profile(Setpoint(np.array([begin, 0.0, 0.0])), end, able).rows, hand)
        why = why or await _rest(axis, timeout, hand)
        if axis.told.version != version:
            why = "the parameters have changed: press again"
    answer = await axis.call("hold")
    return why or hand.lost or ("" if answer.success else answer.text)


async def _send(axis: Axis, plan: Array, hand: Hand) -> str:
    """Send a plan as it comes due, until it is over; return why the load does not follow it.

    It may stop since this process was held up: that is no reason not to begin again.
    """
    lasts, version = float(np.sum(plan[:, DURATION])), axis.told.version
    first, due, late = axis.time, 0.0, False
    while hand.holds and axis.told.version == version and not hindrance(axis):
        passed = axis.time - first
        late = late or 0.0 < due < passed
        told = axis.last_state
        stands = told["time"] > first + _ANSWERS and not told["setpoint_velocity"]
        if stands and (late or abs(told["setpoint"] - plan[-1, POSITION]) <= _THERE):
            return ""
        if stands or passed > lasts + 2.0 * _ANSWERS:
            return "the controller does not follow, or follows something else: its log says why"
        for _ in range(_AT_ONCE):
            if due <= passed + _AHEAD and due < lasts + _INTERVAL:  # the last one is at rest
                axis.aim(first + min(due, lasts), _setpoint(plan, min(due, lasts)))
                due += _INTERVAL
        await asyncio.sleep(_INTERVAL)
    return ""


def _setpoint(plan: Array, when: float) -> list[float]:
    """Return position, speed and acceleration of a plan; in plain Python, since the first call must not take long."""
    ends = np.cumsum(plan[:, DURATION])
    row = min(int(np.searchsorted(ends, when, side="right")), len(plan) - 1)
    motion = np.polynomial.Polynomial(plan[row, :DURATION])
    return [float(motion.deriv(k)(when - ends[row] + plan[row, DURATION])) for k in range(3)]


async def _rest(axis: Axis, timeout: float, hand: Hand) -> str:
    """Let the setpoint come to rest, so that a stream may begin; return why none can. The hand may let go meanwhile."""
    asked = False
    while not (why := hindrance(axis)) and hand.holds:
        moves = bool(axis.last_state["setpoint_velocity"])
        if not moves and axis.time > axis.aimed + timeout + _PAUSE:
            return ""
        if moves and not asked:
            asked = True
            await axis.call("hold")
        await asyncio.sleep(_INTERVAL)
    return why


def hindrance(axis: Axis) -> str:
    """Return why an axis does not jog now; empty if it does."""
    if axis.silent >= 0.5 * SILENCE:
        return "no joint states come from the drive"
    if axis.last_state.get("experiment", 0.0):
        return "an experiment moves the load"
    return refusal(axis)
