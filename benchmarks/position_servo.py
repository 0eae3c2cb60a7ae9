"""A position servo with one encoder at its output: recordings, parameters, and a free simulation.

Firmware. The goal acts after a delay and travels at a limited speed; the duty is gain (goal - angle), a little more to
start with, and clipped:

    g' = clip((goal(t - delay) - g)/dt, +- speed_limit)
    u = clip(gain (g - q) + start_duty sign(g - q), +- largest_duty)

Winding (eq 7 without inductance, seen at the output) and shaft (eqs 1 and 2 added up, the teeth in contact):

    T = torque_per_volt (u supply - back_emf w),   0 while the servo is disabled: the winding is open
    (inertia + load_inertia) w' = T - viscous w - c sign(w) - weight sin(q + gravity_offset)
    c = coulomb + stribeck exp(-|w|/stribeck_speed) + motor_share |T| + weight_share |weight sin(q + gravity_offset)|

Friction that grows with the torque a gear carries, separately for that of the motor and that of the load, is the fifth
model of Duclusaud et al., Extended Friction Models for the Physics Simulation of Servo Actuators (2024). Friction
holds what stands still. With a backlash angle, motor and load are two shafts that meet without bouncing back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple

import numpy as np

from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array

_STEP = 1.3e-3
"""Longest step between two samples, s."""
_FARTHEST = 8.0 * math.pi
"""Largest magnitude of an angle, rad: reveals degrees."""
_FEWEST = 3
NO_LIMIT = 1e6
"""Speed limit of a goal that jumps, rad/s."""


@dataclass(frozen=True)
class PositionServo(Validated):
    """The parameters to identify, all as seen at the output."""

    section: ClassVar[str] = "servo"

    torque_per_volt: float = quantity("standstill torque per volt", "N m/V", above=0, at_most=1e5)
    back_emf: float = quantity("back-EMF per rad/s", "V s/rad", above=0, at_most=1e5)
    inertia: float = quantity("inertia of motor and gear", "kg m^2", above=0, at_most=1e5)
    viscous_friction: float = quantity("viscous friction", "N m s/rad", at_least=0, at_most=1e5, default=0.0)
    coulomb_friction: float = quantity("Coulomb friction", "N m", at_least=0, at_most=1e5, default=0.0)
    stribeck_friction: float = quantity("more friction, near standstill", "N m", at_least=0, at_most=1e5, default=0.0)
    stribeck_speed: float = quantity("speed at which 1/e of it is left", "rad/s", above=0, at_most=1e3, default=0.3)
    motor_share: float = quantity("friction per N m of the motor", "", at_least=0, at_most=0.95, default=0.0)
    weight_share: float = quantity("friction per N m of the weight", "", at_least=0, at_most=0.95, default=0.0)
    gravity_offset: float = quantity(
        "angle between the load and straight down when the encoder reads 0",
        "rad",
        at_least=-6.3,
        at_most=6.3,
        default=0.0,
    )
    delay: float = quantity("delay until a goal acts", "s", at_least=0, at_most=1, default=0.0)
    speed_limit: float = quantity("speed of the goal inside the servo", "rad/s", above=0, at_most=1e6, default=NO_LIMIT)
    start_duty: float = quantity("additional duty, independent of the error", "", at_least=0, at_most=1, default=0.0)
    backlash_angle: float = quantity("gap between motor and load", "rad", at_least=0, at_most=3.2, default=0.0)


PARAMETERS = tuple(field.name for field in fields(PositionServo))


@dataclass(frozen=True)
class ServoRun:
    """A recording of one run: the servo's commands, and the angle of its output.

    Parameters
    ----------
    time : of the samples, s, equally spaced; shape (N,), and so all arrays
    angle : of the output, rad
    goal : rad, linear between samples
    enabled : whether the servo drives
    supply : V
    gain : duty for each rad of error
    largest_duty : at which the firmware clips
    load_inertia : kg m^2
    weight_torque : m g l of the load, N m

    Raises
    ------
    ValueError
        If a value is not finite, out of order, or recognisably in another unit.
    """

    time: Array
    angle: Array
    goal: Array
    enabled: Array
    supply: Array
    gain: float
    largest_duty: float = 1.0
    load_inertia: float = 0.0
    weight_torque: float = 0.0

    def __post_init__(self) -> None:
        series = {"time": "s", "angle": "rad", "goal": "rad", "enabled": "0 or 1", "supply": "V"}
        for name, unit in series.items():
            values = np.ascontiguousarray(getattr(self, name), dtype=float)
            if values.ndim != 1 or values.size < _FEWEST:
                raise ValueError(f"run.{name} must have >= {_FEWEST} samples in one row, got shape {values.shape}")
            if values.shape != np.shape(self.time):
                raise ValueError(f"run.{name} must have {np.size(self.time)} samples as run.time, got {values.size}")
            if not np.all(np.isfinite(values)):
                first = int(np.argmin(np.isfinite(values)))
                raise ValueError(f"run.{name} must be finite, {unit}, got {values[first]} at sample {first}")
            object.__setattr__(self, name, values)
        steps = np.diff(self.time)
        if not (steps[0] > 0 and np.allclose(steps, steps[0], rtol=0.01)):
            raise ValueError(
                f"run.time must rise in equal steps, s, got steps from {steps.min():g} to {steps.max():g} s"
            )
        for name in ("angle", "goal"):
            farthest = float(np.max(np.abs(getattr(self, name))))
            if farthest > _FARTHEST:
                raise ValueError(
                    f"run.{name} must be within +-{_FARTHEST:.1f} rad, got {farthest:g}; is it in degrees or counts?"
                )
        if self.supply.min() < 0 or self.supply.max() > 1e3:
            raise ValueError(f"run.supply must be 0 to 1000 V, got {self.supply.min():g} to {self.supply.max():g} V")
        for name, unit, above in (
            ("gain", "1/rad", True),
            ("largest_duty", "", True),
            ("load_inertia", "kg m^2", False),
            ("weight_torque", "N m", False),
        ):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0 or (above and value == 0):
                raise ValueError(f"run.{name} must be {'>' if above else '>='} 0 {unit}".rstrip() + f", got {value!r}")
        if self.largest_duty > 1:
            raise ValueError(f"run.largest_duty must be <= 1, got {self.largest_duty!r}")

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return float(self.time[-1] - self.time[0]) / (self.time.size - 1)


class _Constants(NamedTuple):
    """`PositionServo` as compiled functions take it."""

    torque_per_volt: float
    back_emf: float
    inertia: float
    viscous: float
    coulomb: float
    stribeck: float
    stribeck_speed: float
    motor_share: float
    weight_share: float
    gravity_offset: float
    delay: float
    speed_limit: float
    start_duty: float
    backlash_angle: float


@compiled
def _next_speed(speed: float, torque: float, inertia: float, viscous: float, friction: float, step: float) -> float:
    """Return the speed after a step, by the trapezoidal rule; dry friction brakes and holds, but never drives."""
    half = 0.5 * step * viscous / inertia
    free = ((1.0 - half) * speed + step / inertia * torque) / (1.0 + half)
    brake = step / inertia * friction / (1.0 + half)
    if free > brake:
        return free - brake
    return free + brake if free < -brake else 0.0


@compiled
def _goal_at(goal: Array, where: float) -> float:
    """Return the goal at a number of samples after the first, which held before."""
    if where <= 0.0:
        return float(goal[0])
    k = min(int(where), goal.shape[0] - 2)
    return float(goal[k] + (where - k) * (goal[k + 1] - goal[k]))


class _Inputs(NamedTuple):
    """What a `ServoRun` gives, as compiled functions take it."""

    goal: Array
    enabled: Array
    supply: Array
    gain: float
    largest_duty: float
    load_inertia: float
    weight: float


@compiled
def _play(servo: _Constants, period: float, steps: int, run: _Inputs, angle: Array) -> None:
    """Fill in the angles after the first, where the servo is at rest, in ``steps`` between two samples."""
    goal, enabled, supply, gain, largest_duty, load_inertia, weight = run
    h = period / steps
    half_gap = 0.5 * servo.backlash_angle
    q, w, inner = angle[0], 0.0, goal[0]
    # The load rests on the flank that its weight presses it on.
    motor_q, motor_w = q + math.copysign(half_gap, math.sin(q + servo.gravity_offset)), 0.0
    before = 0.0
    for sample in range(goal.shape[0] - 1):
        for step in range(steps):
            target = _goal_at(goal, sample + (step + 1.0) / steps - servo.delay / period)
            travel = max(-servo.speed_limit * h, min(servo.speed_limit * h, target - inner))
            middle_q = q + 0.5 * h * w
            error = inner + 0.5 * travel - middle_q
            inner += travel
            duty = gain * error + (math.copysign(servo.start_duty, error) if error != 0.0 else 0.0)
            duty = max(-largest_duty, min(largest_duty, duty))
            middle_w = 1.5 * motor_w - 0.5 * before
            before = motor_w
            stalled, viscous, torque = 0.0, servo.viscous, 0.0
            if enabled[sample] > 0.5:
                stalled = servo.torque_per_volt * duty * supply[sample]
                viscous += servo.torque_per_volt * servo.back_emf
                torque = stalled - servo.torque_per_volt * servo.back_emf * middle_w
            pull = -weight * math.sin(middle_q + servo.gravity_offset)
            friction = servo.coulomb + servo.stribeck * math.exp(-abs(middle_w) / servo.stribeck_speed)
            friction += servo.motor_share * abs(torque) + servo.weight_share * abs(pull)
            ahead = motor_q - q
            if half_gap <= 0.0 or (abs(ahead) >= half_gap - 1e-12 and abs(motor_w - w) < 1e-9):
                inertia = servo.inertia + load_inertia
                new = _next_speed(w, stalled + pull, inertia, viscous, friction, h)
                between = load_inertia * (new - w) / h - pull
                if half_gap <= 0.0 or between * ahead >= 0.0:  # the teeth push
                    q += 0.5 * h * (w + new)
                    motor_q, motor_w, w = q + ahead, new, new
                    continue
            new = _next_speed(motor_w, stalled, servo.inertia, viscous, friction, h)
            motor_q += 0.5 * h * (motor_w + new)
            motor_w = new
            new = w + h / load_inertia * pull
            q += 0.5 * h * (w + new)
            w = new
            ahead = motor_q - q
            if abs(ahead) > half_gap:
                over = ahead - math.copysign(half_gap, ahead)
                share = load_inertia / (servo.inertia + load_inertia)
                motor_q -= share * over
                q += (1.0 - share) * over
                if (motor_w - w) * over > 0.0:
                    w = motor_w = share * w + (1.0 - share) * motor_w
        angle[sample + 1] = q


def simulate(servo: PositionServo, runs: Sequence[ServoRun]) -> list[Array]:
    """Return the angles of the output, rad, one array per run: each is simulated freely from its first sample, at rest.

    Raises
    ------
    ValueError
        If the servo has a gap, and the load of a run has no inertia.
    """
    constants = _Constants(*(float(getattr(servo, name)) for name in PARAMETERS))
    angles = []
    for run in runs:
        if servo.backlash_angle > 0 and run.load_inertia <= 0:
            raise ValueError(f"run.load_inertia must be > 0 kg m^2 beyond a gap, got {run.load_inertia!r}")
        angle = np.empty_like(run.angle)
        angle[0] = run.angle[0]
        inputs = _Inputs(
            run.goal,
            run.enabled,
            run.supply,
            float(run.gain),
            float(run.largest_duty),
            float(run.load_inertia),
            float(run.weight_torque),
        )
        _play(constants, run.period, math.ceil(run.period / _STEP), inputs, angle)
        angles.append(angle)
    return angles
