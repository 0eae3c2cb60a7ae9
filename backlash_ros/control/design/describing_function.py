"""Harmonic balance: predicts the limit cycle that state feedback keeps up in the gap, without a simulation.

The teeth are the nonlinearity. For a sinusoidal gap of amplitude A and frequency w the fundamental of the contact
force is N(A, w) times the gap (describing function; Slotine & Li, Applied Nonlinear Control, ch. 5). Everything else is
linear: G(jw) from contact force to gap, through both shafts, the motor and the sampled feedback with its hold. A limit
cycle has G(jw) N(A, w) = 1. The method assumes a nearly sinusoidal gap.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from backlash_ros.control.design.gains import Gains
from backlash_ros.drivetrain import Drive, rigid_model
from backlash_ros.drivetrain.constants import PlantConstants, plant_constants
from backlash_ros.drivetrain.contact import Contact, ForceFunction
from backlash_ros.foundation.compiled import specialize, unbound

_POINTS = 400
"""Of the sinusoid that the contact law is evaluated at."""
_FREQUENCIES_PER_DECADE = 40
_SLOWEST = 1e-8
"""Over half the sample rate: the lowest frequency that is looked at."""
_LARGEST_RATIO = 1e3
"""Of the gap's amplitude to d/2, up and down: beyond it the teeth are linear, or do not touch."""


@dataclass(frozen=True)
class PredictedCycle:
    """A predicted limit cycle.

    Parameters
    ----------
    amplitude : of the load's angle, peak to peak, rad
    gap_travel : of the gap, peak to peak, m
    period : s
    """

    amplitude: float
    gap_travel: float
    period: float


_force: ForceFunction = unbound


def _fundamental(plant: PlantConstants, amplitude: float, frequency: float) -> complex:
    in_phase, quadrature = 0.0, 0.0
    for point in range(_POINTS):
        phase = 2.0 * math.pi * (point + 0.5) / _POINTS
        sine, cosine = math.sin(phase), math.cos(phase)
        rate = amplitude * frequency * cosine
        force = _force(plant.contact, plant.half_gap, amplitude * sine, rate)[0]
        in_phase += force * sine
        quadrature += force * cosine
    return complex(in_phase, quadrature) * 2.0 / (_POINTS * amplitude)


@cache
def _fundamental_with(law: type[Contact]) -> Callable[[PlantConstants, float, float], complex]:
    """Return `_fundamental` compiled for a contact law."""
    return specialize(_fundamental, _force=law.force)


def describing_function(drive: Drive, amplitude: float, frequency: float) -> complex:
    """Return N(A, w) of the drive's contact law, N/m: the force's fundamental over the gap.

    Parameters
    ----------
    amplitude : of the sinusoidal gap, m
    frequency : rad/s

    Examples
    --------
    Teeth that are far apart most of the time are soft:

    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> shallow, deep = (describing_function(NOMINAL_DRIVE, ratio * 0.5e-3, 200.0) for ratio in (1.0, 1.1))
    >>> shallow.real < deep.real
    True
    """
    fundamental = _fundamental_with(type(drive.gear.contact))  # type: ignore[arg-type]
    return complex(fundamental(plant_constants(drive), float(amplitude), float(frequency)))


def _linear_part(drive: Drive, gains: Gains, period: float, delay: float, frequency: float) -> NDArray[np.complex128]:
    """Return theta_m, omega_m, theta_l, omega_l, i per newton of contact force, under sampled state feedback."""
    motor, gear, load = drive.motor, drive.gear, drive.load
    s = 1j * frequency
    hold = (1 - np.exp(-s * period)) / (s * period) * np.exp(-s * delay)
    if drive.takes_current:  # the whole command is held, and the current gain sees the previous one
        back_emf, winding = hold * motor.torque_constant, motor.resistance + np.exp(-s * period) * gains.current
    else:
        back_emf, winding = motor.torque_constant, s * motor.inductance + motor.resistance + hold * gains.current
    balance = np.array(
        [
            [s, -1.0, 0.0, 0.0, 0.0],
            [0.0, s * motor.inertia + motor.viscous_friction, 0.0, 0.0, -motor.torque_constant],
            [0.0, 0.0, s, -1.0, 0.0],
            [0.0, 0.0, 0.0, s * load.inertia + load.viscous_friction, 0.0],
            [0.0, back_emf, hold * gains.position, hold * gains.velocity, winding],
        ]
    )
    push = np.array([0.0, -gear.motor_radius, 0.0, gear.load_radius, 0.0], dtype=complex)
    return np.asarray(np.linalg.solve(balance, push))


def _gap(drive: Drive, states: NDArray[np.complex128]) -> complex:
    """Return R1 theta_m - R2 theta_l."""
    return complex(drive.gear.motor_radius * states[0] - drive.gear.load_radius * states[2])


def _amplitude(drive: Drive, loop: complex, frequency: float) -> float:
    """Return the gap's amplitude, m, that makes the magnitude of G N one, G = ``loop``; nan where there is none."""
    plant, half = plant_constants(drive), 0.5 * drive.gear.backlash
    fundamental = _fundamental_with(type(drive.gear.contact))  # type: ignore[arg-type]

    def excess(logarithm: float) -> float:
        stiffness = abs(fundamental(plant, half * math.exp(logarithm), frequency))
        return math.log(max(stiffness * abs(loop), 1e-300))

    low = high = 0.0
    while excess(low) > 0:
        low -= 0.5
        if low < -math.log(_LARGEST_RATIO):
            return math.nan
    while excess(high) < 0:
        high += 0.5
        if high > math.log(_LARGEST_RATIO):
            return math.nan
    return half * math.exp(float(brentq(excess, low, high, xtol=1e-12))) if high > low else half


def _frequency_range(drive: Drive, gains: Gains, period: float) -> tuple[float, float]:
    """Return the frequencies between which cycles are looked for, rad/s.

    Below the slowest pole of the loop in contact the feedback is at rest; from half the sample rate on the hold's model
    fails.
    """
    a, b = rigid_model(drive)
    poles = np.linalg.eigvals(a - b[:, :1] @ gains.as_array()[None, :])
    highest = math.pi / period
    return highest * float(np.clip(0.3 * np.min(np.abs(poles)) / highest, _SLOWEST, 0.1)), highest


def predict_limit_cycle(drive: Drive, gains: Gains, period: float, delay: float = 0.0) -> PredictedCycle | None:
    """Return the limit cycle of largest amplitude that harmonic balance finds, or None.

    At each frequency, from below the slowest pole of the loop in contact to half the sample rate, one amplitude makes
    the magnitude of G N one. There is a cycle where its phase passes 0. The voltage is taken as unlimited: no cycle is
    found for a loop that is unstable at any depth of contact, whose growth only the voltage limit ends.

    Parameters
    ----------
    drive, gains : the drive and the state feedback that acts throughout
    period : of the controller's samples, s
    delay : from the instant of a measurement to that at which its command acts on the motor, s

    Examples
    --------
    >>> from backlash_ros.control import design_gains
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> cycle = predict_limit_cycle(NOMINAL_DRIVE, design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0]), period=0.001)
    >>> print(f"{cycle.amplitude / NOMINAL_DRIVE.gear.backlash_angle:.2f} b")
    0.91 b
    >>> predict_limit_cycle(NOMINAL_DRIVE, design_gains("overdamped", NOMINAL_DRIVE, [4.0, 0.0]), period=0.001)
    """

    def balance(logarithm: float) -> tuple[float, float]:
        """Return the amplitude, m, and the phase of G N, rad, at exp(``logarithm``) rad/s."""
        frequency = math.exp(logarithm)
        loop = _gap(drive, _linear_part(drive, gains, period, delay, frequency))
        amplitude = _amplitude(drive, loop, frequency)
        if math.isnan(amplitude):
            return math.nan, math.nan
        return amplitude, float(np.angle(loop * describing_function(drive, amplitude, frequency)))

    low, high = np.log(_frequency_range(drive, gains, period))
    grid = np.linspace(low, high, math.ceil((high - low) / math.log(10) * _FREQUENCIES_PER_DECADE) + 1)
    phases = np.array([balance(logarithm)[1] for logarithm in grid])
    found: list[PredictedCycle] = []
    for index in np.flatnonzero(phases[:-1] * phases[1:] <= 0):
        if abs(phases[index + 1] - phases[index]) > 0.5 * math.pi:
            continue  # passes pi, not 0
        root = float(brentq(lambda logarithm: balance(logarithm)[1], grid[index], grid[index + 1], xtol=1e-10))
        amplitude, frequency = balance(root)[0], math.exp(root)
        states = _linear_part(drive, gains, period, delay, frequency)
        share = float(abs(states[2] / _gap(drive, states)))
        found.append(PredictedCycle(2 * amplitude * share, 2 * amplitude, 2 * math.pi / frequency))
    return max(found, key=lambda cycle: cycle.amplitude, default=None)
