"""Says whether the load is in position, for programs that wait for it: plain Python, run after each answer."""

import math

from backlash_ros.control.servo import Servo
from backlash_ros.foundation.signals import THETA_L, Measurement

RELEASED, MOVING, SETTLED, HOLDING, LIMIT = "released", "moving", "settled", "holding", "limit"
STATES = {
    RELEASED: "no position is held: the node is not active, a fault is latched, or no sample has come yet",
    MOVING: "the setpoint or the load moves, or an experiment moves it",
    SETTLED: "the load has stayed within the window around the end of what was asked for",
    HOLDING: "the load has stayed within the window around where it was found, or `hold` or a stream's end stopped it",
    LIMIT: "the load rests outside of the window: torque, travel or the law's gains do not bring it nearer",
}
"""What ``~/in_position`` says, and what it means."""

_SHARE = 0.25
"""Half the window's width, in gaps: that within which moves count as settled in evaluations."""
_STAYS = 0.1
"""Time for which the load must stay within the window, s: it crosses one of half a gap in less on its way."""
_RESTS = 0.5
"""Time for which the load must rest, s, until nothing more is expected of it: laws try again within less."""
_NO_STEP = 1e-9
"""A change of an angle that is none, rad."""


class InPosition:
    """Observes one servo; ``state`` is one of `STATES`."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._reading, self._count = math.nan, 0.0
        self.release()

    def release(self) -> None:
        """Take it that no position is held, until a sample shows one."""
        self.state, self._anchor, self._reference = RELEASED, math.nan, math.nan
        self._inside = self._rested = 0.0

    @property
    def window(self) -> float:
        """Half the window's width, rad: a quarter of the gap, or a count of the load's encoder if that is wider."""
        gap = self._servo.settings.backlash_angle or self._servo.drive.gear.backlash_angle
        return max(_SHARE * gap, self._count)

    def look(self, measured: Measurement, elapsed: float) -> str:
        """Take an answered sample, and return the state.

        Parameters
        ----------
        measured : as received; nan where not measured
        elapsed : since the previous sample, s
        """
        servo = self._servo
        if not servo.holding or servo.latched:
            self.release()
            return self.state
        self._count_steps(float(measured[THETA_L]))
        load, window = servo.load_angle, self.window
        self._inside = self._inside + elapsed if abs(servo.reference - load) <= window else 0.0
        self._rested += elapsed
        if not abs(load - self._anchor) <= window:  # nan, too
            self._anchor, self._rested = load, 0.0
        # What asks for a new end is a motion, however small: who waits for it sees it begin and end.
        if servo.experimenting or not servo.arrived or servo.reference != self._reference:
            self._inside = self._rested = 0.0
        self._reference = servo.reference
        self.state = self._found()
        return self.state

    def _count_steps(self, reading: float) -> None:
        """Take the smallest change of the load's reading, rad, for a count."""
        step = abs(reading - self._reading)
        if step > _NO_STEP:
            self._count = min(self._count or step, step)
        self._reading = reading

    def _found(self) -> str:
        if self._inside >= _STAYS:
            return SETTLED if self._servo.asked else HOLDING
        return LIMIT if self._inside == 0.0 and self._rested >= _RESTS else MOVING
