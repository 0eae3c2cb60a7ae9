"""The teeth as one limit of a simulator: the range, spring and damper closest to the drive's contact law.

Angles and torques are those at the output. At a depth r beyond its edge, which grows at a speed v, a limit carries

    T = max(0, k r (r/D)^(2 p) + c v (r/D)^p)

where D is the depth at the torque of the fit: p = 0 is a spring and damper, p = 3 a spring that rises with the seventh
power. Edge and k give torque and stiffness of the contact law at that torque. After an impact that presses the law's
spring to the same torque, c leaves the same speed as the law.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.contact import gap_at_rest

Torque = Callable[[float, float], float]
"""Torque of the teeth (N m) by the angle between motor and load (rad) and its rate (rad/s), at the output."""

SHARE = 0.5
"""Default torque at which the limit is fitted, as a share of that at standstill."""
LARGEST_POWER = 3
"""p of the steepest limit: a larger one follows a steep law better, but needs shorter time steps."""
_STRAIGHT = 0.01
"""Largest relative change of stiffness at half the torque for which a law counts as linear."""
_NO_GAP = 1e-6
"""Least edge of a limit, as a share of the angle at the torque of the fit: a range needs two ends."""
_TOUCH = 1e-9
"""Torque at which an impact begins, as a share of that of the fit."""
_STEPS = 50
"""Least number of steps in a period of the swing on the spring."""
_LARGEST_RATIO = 1.0
"""Largest damping ratio of a limit: critical damping."""


@dataclass(frozen=True)
class Limit:
    """A limit of the angle between motor and load, as seen at the output.

    Attributes
    ----------
    torque : of the fit, N m
    edge : where the limit begins, to either side of the middle, rad
    depth : D, how far beyond the edge it carries the torque, rad
    power : p, 0 to `LARGEST_POWER`
    stiffness : k, N m/rad; the secant at D
    damping : c, N m s/rad
    speed : of the impact by which c was fitted, rad/s
    restitution : share of that speed after the impact, by the contact law
    restitution_left : the same, by the limit
    """

    torque: float
    edge: float
    depth: float
    power: int
    stiffness: float
    damping: float
    speed: float
    restitution: float
    restitution_left: float

    def torque_at(self, angle: float, rate: float) -> float:
        """Return the torque of the limit (N m) at an angle (rad) and its rate (rad/s)."""
        side = 1.0 if angle > 0.0 else -1.0
        depth = side * angle - self.edge
        if depth <= 0.0:
            return 0.0
        share = (depth / self.depth) ** self.power
        return side * max(0.0, self.stiffness * depth * share * share + self.damping * side * rate * share)


def give(drive: Drive) -> float:
    """Return the acceleration of the gap per torque of the teeth, 1/J_r + 1/J_l, rad/(s^2 N m)."""
    return 1.0 / drive.reflected_inertia + 1.0 / drive.load.inertia


def teeth_of(drive: Drive) -> Torque:
    """Return the contact law of a drive as a torque at the output, with the mean gap."""
    gear = drive.gear
    radius, half_gap = gear.load_radius, 0.5 * gear.backlash
    constants, force = gear.contact.constants(radius, drive.contact_mass), gear.contact.force

    def torque(angle: float, rate: float) -> float:
        return radius * force(constants, half_gap, angle * radius, rate * radius)[0]

    return torque


def restitution(teeth: Torque, per_torque: float, start: float, speed: float, stiffness: float) -> float:
    """Return the speed at which shafts that met at ``speed`` part again, as a share of it.

    Parameters
    ----------
    per_torque : see `give`
    start : angle at which the impact begins and ends, rad
    speed : rad/s
    stiffness : about the largest during the impact, N m/rad: the time steps have to resolve it
    """

    def motion(_: float, state: list[float]) -> tuple[float, float]:
        return state[1], -per_torque * teeth(state[0], state[1])

    def parted(_: float, state: list[float]) -> float:
        return state[0] - start + 1e-12 * start

    parted.terminal, parted.direction = True, -1  # type: ignore[attr-defined]
    swing = 2.0 * math.pi / math.sqrt(stiffness * per_torque)
    done = solve_ivp(
        motion,
        (0.0, 100.0 * swing),
        [start, speed],
        method="LSODA",
        rtol=1e-8,
        atol=[1e-10 * start, 1e-10 * speed],
        max_step=swing / _STEPS,
        events=parted,
    )
    return max(0.0, -float(done.y[1, -1]) / speed) if done.t_events[0].size else 0.0


def fit_limit(drive: Drive, torque: float | None = None) -> Limit:
    """Return the limit that is closest to the teeth of a drive.

    Parameters
    ----------
    torque : at which both agree, N m at the output; by default `SHARE` of that at standstill

    Raises
    ------
    ValueError
        If the torque is not positive, or the teeth cannot carry it.
    """
    if torque is None:
        torque = SHARE * drive.standstill_torque()
    if not 0.0 < torque < math.inf:
        raise ValueError(f"torque must be > 0 N m and finite, got {torque!r}")
    gear, radius, half_gap = drive.gear, drive.gear.load_radius, 0.5 * drive.gear.backlash_angle
    teeth, per_torque = teeth_of(drive), give(drive)
    carried = _where(drive, torque)
    stiffness = _slope(drive, carried)
    straight = abs(_slope(drive, _where(drive, 0.5 * torque)) - stiffness) <= _STRAIGHT * stiffness
    # Not above half of the law's own exponent there, so that a gap is left.
    steps = 0 if straight else int(0.25 * stiffness * carried / torque - 0.5)
    power = min(max(steps, 0), LARGEST_POWER)
    depth = min((2 * power + 1) * torque / stiffness, (1.0 - _NO_GAP) * carried)
    edge = carried - depth
    if abs(edge - half_gap) < 1e-9 * half_gap:
        edge = half_gap
    # The energy from the touch to the torque is what a speed brings there.
    touch = _where(drive, _TOUCH * torque)
    constants = gear.contact.constants(radius, drive.contact_mass)
    energy = (gear.contact.energy(constants, half_gap * radius, at * radius) for at in (carried, touch))
    speed = math.sqrt(2.0 * per_torque * (next(energy) - next(energy)))
    law = restitution(teeth, per_torque, touch, speed, stiffness)

    def limit(ratio: float) -> Limit:
        damping = 2.0 * ratio * math.sqrt(torque / depth / per_torque)
        return Limit(torque, edge, depth, power, torque / depth, damping, speed, law, 0.0)

    def left(ratio: float) -> float:
        return restitution(limit(ratio).torque_at, per_torque, max(edge, _TOUCH * carried), speed, stiffness)

    if left(0.0) <= law:
        ratio = 0.0
    elif left(_LARGEST_RATIO) >= law:
        ratio = _LARGEST_RATIO
    else:
        ratio = float(brentq(lambda value: left(value) - law, 0.0, _LARGEST_RATIO, xtol=1e-9))
    found = limit(ratio)
    return Limit(torque, edge, depth, power, torque / depth, found.damping, speed, law, left(ratio))


def _where(drive: Drive, torque: float) -> float:
    """Return the angle of the teeth under a static torque, rad."""
    gear = drive.gear
    constants = gear.contact.constants(gear.load_radius, drive.contact_mass)
    try:
        gap = gap_at_rest(gear.contact, constants, 0.5 * gear.backlash, torque / gear.load_radius)
    except ValueError as error:
        raise ValueError(f"the teeth cannot carry a torque of {torque:g} N m") from error
    return gap / gear.load_radius


def _slope(drive: Drive, angle: float) -> float:
    """Return the stiffness of the teeth at an angle, N m/rad."""
    gear = drive.gear
    radius = gear.load_radius
    constants = gear.contact.constants(radius, drive.contact_mass)
    return radius**2 * gear.contact.force(constants, 0.5 * gear.backlash, angle * radius, 0.0)[1]
