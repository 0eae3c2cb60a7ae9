"""The position of one joint: counted on where a driver's begins again, and jumps that look like that named.

Without ROS. A driver that publishes an angle between -pi and pi, or the count of a register that overflows, begins
again at the other end of its range. The controller needs a position that goes on.
"""

import math

SECOND = 10**9

_TURN = 2 * math.pi
_ABOUT = 0.05
"""Share of a range by which a jump, less the motion, may differ from it."""


class Position:
    """The position of one joint from sample to sample.

    ``jump`` says how the last one seems to begin again instead of going on; it is empty if it does not.

    Parameters
    ----------
    wrap : range after which the driver's position begins again, rad; 0: it goes on
    shortest : time between two samples that is long enough to tell a speed, ns
    """

    def __init__(self, wrap: float = 0.0, shortest: int = 0) -> None:
        self._wrap, self._shortest = wrap, shortest
        self._last, self._speed, self._fresh = math.nan, 0.0, True
        self.jump = ""

    def forget(self) -> None:
        """Forget the motion; turns are still counted from the last position on."""
        self._speed, self._fresh, self.jump = 0.0, True, ""

    def take(self, position: float, elapsed: int = 0, fastest: float = math.inf) -> float:
        """Return the position (rad) that goes on from the last one, ``elapsed`` ns ago; nan stays nan.

        It is the one nearest to where the last speed leads, so that a few lost samples lose no turn. A jump is named
        only if no motion explains it: the speed would have changed by more than ``fastest``, rad/s, and the jump is
        not the way of the motion, as that of a position which begins again never is.
        """
        if math.isnan(position):
            return position
        if math.isnan(self._last):
            self._last = position
        ahead = self._speed * elapsed
        if self._wrap:
            position += self._wrap * round((self._last + ahead - position) / self._wrap)
        self.jump = "" if self._fresh else self._named(position, ahead, elapsed, fastest)
        if elapsed > self._shortest and not self._fresh:
            self._speed = (position - self._last) / elapsed
        self._last, self._fresh = position, False
        return position

    def _named(self, position: float, ahead: float, elapsed: int, fastest: float) -> str:
        jump = position - self._last
        size = abs(jump)
        if not abs(jump - ahead) > fastest * elapsed / SECOND or jump * ahead > _ABOUT * size**2:
            return ""

        def about(length: float) -> bool:
            return abs(jump - math.copysign(length, jump) - ahead) <= _ABOUT * length

        told = f"went from {self._last:.4g} to {position:.4g} rad within {elapsed / SECOND:.3g} s"
        if about(_TURN):
            return f"{told}, by about one turn: the position begins again"
        if about(360.0):
            return f"{told}, by about 360: the position is in degrees, not in rad, and begins again"
        turns = 2.0 ** round(math.log2(max(size / _TURN, 2.0)))
        symmetric = size > 1.5 * _TURN and abs(position + self._last) <= _ABOUT * size
        if symmetric or about(turns * _TURN):
            return f"{told}, by about the range of a counter: the position begins again"
        return ""
