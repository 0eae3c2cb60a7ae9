"""Moves of the motor from rest to rest, and a loop on its own encoder that follows them, for experiments without a law.

The loop is stable with any load. It also bounds the load's motion: the load stays within half the gap of the motor.
"""

import math
from dataclasses import dataclass

from backlash_ros.control.observer import low_pass_gain
from backlash_ros.drivetrain import Drive
from backlash_ros.identification.fitting.problem import motor_side


@dataclass(frozen=True)
class Move:
    """A move from rest to rest, at the output, rad, rad/s and rad/s^2; or a wait."""

    start: float
    end: float
    up: float
    down: float
    peak: float
    length: float

    @staticmethod
    def of(start: float, end: float, up: float, down: float, speed: float) -> "Move":
        """Return a move with at most ``speed``."""
        way = abs(end - start)
        peak = min(speed, math.sqrt(2.0 * way * up * down / (up + down)))
        length = way / peak + 0.5 * peak * (1.0 / up + 1.0 / down) if way > 0.0 else 0.0
        return Move(start, end, up, down, peak, length)

    @staticmethod
    def rest(position: float, length: float) -> "Move":
        """Return a wait, s, at rest."""
        return Move(position, position, 1.0, 1.0, 0.0, length)

    def at(self, time: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration."""
        sign, left = math.copysign(1.0, self.end - self.start), self.length - time
        if left <= 0.0 or self.peak == 0.0:
            return self.end, 0.0, 0.0
        if time * self.up < self.peak:
            return self.start + sign * 0.5 * self.up * time * time, sign * self.up * time, sign * self.up
        if left * self.down < self.peak:
            return self.end - sign * 0.5 * self.down * left * left, sign * self.down * left, -sign * self.down
        begun = time - 0.5 * self.peak / self.up
        return self.start + sign * self.peak * begun, sign * self.peak, 0.0


@dataclass(frozen=True)
class Throw:
    """To one side and back, from rest to rest, turning as fast as possible: at the output, rad, rad/s and rad/s^2.

    The motor accelerates to ``speed`` with ``soft``, reverses with ``hard`` until it is as fast the other way, and
    brakes to where it began. A load that a torque pulls to ``side``, 1 or -1, is thrown against the torque and falls
    back. So both stay near their start while the motor gains on the load, twice as long as from rest to that speed.
    """

    home: float
    side: float
    speed: float
    soft: float
    hard: float

    @staticmethod
    def fastest(way: float, soft: float, hard: float) -> float:
        """Return the speed of a throw that reaches a distance ``way``, rad."""
        return math.sqrt(2.0 * way * soft * hard / (soft + hard))

    @property
    def way(self) -> float:
        """Its largest distance, rad."""
        return 0.5 * self.speed**2 * (1.0 / self.soft + 1.0 / self.hard)

    @property
    def length(self) -> float:
        """Its duration, s."""
        return 2.0 * self.speed * (1.0 / self.soft + 1.0 / self.hard)

    def at(self, time: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration."""
        after = time - 0.5 * self.length
        left = 0.5 * self.length - abs(after)
        if left <= 0.0:
            return self.home, 0.0, 0.0
        if abs(after) * self.hard < self.speed:
            place, speed, acceleration = 0.5 * self.hard * after**2 - self.way, self.hard * after, self.hard
        else:
            place, acceleration = -0.5 * self.soft * left**2, -self.soft
            speed = math.copysign(self.soft * left, after)
        return self.home + self.side * place, self.side * speed, self.side * acceleration


class MotorLoop:
    """Follows the moves on the motor's encoder: feedforward and a PID on the error.

    Parameters
    ----------
    drive, period : for the motor; the sample period in s
    most : largest standstill torque, N m at the output
    holding : what holds the motor at the start, N m at the output, as far as ``most`` allows
    """

    def __init__(self, drive: Drive, period: float, most: float, holding: float = 0.0) -> None:
        self.side = motor_side(drive)
        self._most = most
        bandwidth = min(120.0, 0.2 / period)
        self._gains = tuple(
            share * self.side.inertia * bandwidth**power for share, power in ((1.0, 2), (1.8, 1), (0.15, 3))
        )
        self._smooth = low_pass_gain(800.0, period)
        self._before = math.nan
        self._speed, self._integral = 0.0, min(max(holding, -most), most)

    def torque(self, position: float, wanted: tuple[float, float, float], elapsed: float) -> float:
        """Return the standstill torque, N m at the output, from a reading, the time since the last, s, and a target."""
        if math.isnan(self._before):
            self._before = position
        self._speed += self._smooth * ((position - self._before) / elapsed - self._speed)
        self._before = position
        reference, speed, acceleration = wanted
        stiff, damp, slow = self._gains
        error = reference - position
        torque = self.side.inertia * acceleration + self.side.viscous * speed + stiff * error
        torque += damp * (speed - self._speed) + self._integral
        if abs(torque) < 0.8 * self._most:
            self._integral += slow * error * elapsed
        return min(max(torque, -self._most), self._most) + self.side.braking * speed
