"""The paper's laws, state feedback (eq 15): fast; over-damped; two-region, fast only far from the target.

    V = k_tau (tau_l - J_e a_d - B_e omega_d) + k1 (theta_d - theta_l) + k2 (omega_d - omega_l) - k3 i + K_m omega_d/n

with angle, speed and acceleration of the setpoint. The paper takes steps: torque and back-EMF of the wanted motion, the
terms with a_d, B_e and K_m, are not in it.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from backlash_ros.control.command_range import clamp
from backlash_ros.control.design.gains import Gains
from backlash_ros.control.law import FAST_REGION, LAW_SIGNATURE, OVERDAMPED_REGION, ControlLaw, LawState, NamedLaw
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.quantity import Validated, quantity
from backlash_ros.foundation.record import Array, Record, part, row_of, view_of
from backlash_ros.foundation.signals import (
    ACCELERATION,
    CURRENT,
    LOAD_TORQUE,
    OMEGA_L,
    POSITION,
    THETA_L,
    VELOCITY,
    Estimate,
)

if TYPE_CHECKING:
    from backlash_ros.control.settings import ServoSettings


class Feedback(Record):
    """The gains of eq 15."""

    position: float = 0.0  # V/rad, k1
    velocity: float = 0.0  # V s/rad, k2
    current: float = 0.0  # V/A, k3
    load_torque: float = 0.0  # V/(N m), k_tau


class TwoRegionConstants(Record):
    """The gains of both regions, and when these are left."""

    fast: Feedback = part(Feedback)
    overdamped: Feedback = part(Feedback)
    enter: float = 0.0  # rad, error below which the over-damped gains act
    leave: float = 0.0  # rad, error from which on the fast ones act again
    dwell: float = 0.0  # samples, at least so many in a region
    inertia: float = 0.0  # J_e, kg m^2
    friction: float = 0.0  # B_e, N m s/rad
    back_emf: float = 0.0  # K_m/n, V s/rad


class TwoRegionState(LawState):
    """The state of the law."""

    samples: float = 1e9  # in this region; the first region acts from the start, with no dwell time to wait for


_constants_at, _state_at = view_of(TwoRegionConstants), view_of(TwoRegionState)


@dataclass(frozen=True)
class TwoRegionParameters(Validated):
    """Width of the over-damped region, and how the regions are switched."""

    section: ClassVar[str] = "laws.two_region"

    width: float = quantity(
        "error, of either sign, below which the over-damped gains act, in units of backlash_angle",
        "",
        above=0,
        at_most=10,
        default=1.0,
    )
    hysteresis: float = quantity(
        "the over-damped region ends at an error of (1 + hysteresis) width backlash_angle",
        "",
        at_least=0,
        at_most=10,
        default=0.1,
    )
    min_dwell: float = quantity("shortest time in a region", "s", at_least=0, at_most=10, default=0.02)


@compiled_as(LAW_SIGNATURE)
def two_region_step(law: Array, state: Array, estimate: Estimate, path: Array, low: float, high: float) -> float:
    """Choose the region by the error, apply eq 15 with its gains, and clamp to the range."""
    constants, memory = _constants_at(law), _state_at(state)
    error = path[0, POSITION] - estimate[THETA_L]
    memory.samples += 1.0
    if memory.samples >= constants.dwell:
        if memory.region == FAST_REGION and abs(error) < constants.enter:
            memory.region, memory.samples = OVERDAMPED_REGION, 0.0
        elif memory.region == OVERDAMPED_REGION and abs(error) >= constants.leave:
            memory.region, memory.samples = FAST_REGION, 0.0
    gains = constants.fast if memory.region == FAST_REGION else constants.overdamped
    speed_error = path[0, VELOCITY] - estimate[OMEGA_L]
    wanted_torque = constants.inertia * path[0, ACCELERATION] + constants.friction * path[0, VELOCITY]
    voltage = gains.load_torque * (estimate[LOAD_TORQUE] - wanted_torque) + constants.back_emf * path[0, VELOCITY]
    voltage += gains.position * error + gains.velocity * speed_error - gains.current * estimate[CURRENT]
    return clamp(voltage, low, high)


def _with_torque(drive: Drive, gains: Gains) -> tuple[float, float, float, float]:
    """Return k1, k2, k3 and k_tau = -n (R + k3)/K_m."""
    k_tau = -drive.gear.ratio * (drive.motor.resistance + gains.current) / drive.motor.torque_constant
    return gains.position, gains.velocity, gains.current, k_tau


def _law(drive: Drive, settings: "ServoSettings", enter: float, leave: float, min_dwell: float = 0.0) -> ControlLaw:
    constants = row_of(
        TwoRegionConstants,
        fast=_with_torque(drive, settings.gains.fast),
        overdamped=_with_torque(drive, settings.gains.overdamped),
        enter=enter,
        leave=leave,
        dwell=math.ceil(min_dwell / settings.period - 1e-9),
        inertia=drive.effective_inertia,
        friction=drive.effective_friction,
        back_emf=drive.motor.torque_constant / drive.gear.ratio,
    )
    return ControlLaw(two_region_step, constants, row_of(TwoRegionState))


def two_region(drive: Drive, settings: "ServoSettings", parameters: TwoRegionParameters) -> ControlLaw:
    """Over-damped gains within the backlash, fast gains outside, with hysteresis and a dwell time (figs 6, 9)."""
    enter = parameters.width * settings.backlash_angle
    return _law(drive, settings, enter, (1.0 + parameters.hysteresis) * enter, parameters.min_dwell)


def fast(drive: Drive, settings: "ServoSettings", _parameters: Validated) -> ControlLaw:
    """Fast gains throughout (fig 4)."""
    return _law(drive, settings, 0.0, 0.0)


def overdamped(drive: Drive, settings: "ServoSettings", _parameters: Validated) -> ControlLaw:
    """Over-damped gains throughout (fig 5)."""
    return _law(drive, settings, math.inf, math.inf)


LAWS = {
    "fast": NamedLaw("fast state feedback", fast),
    "overdamped": NamedLaw("over-damped state feedback", overdamped),
    "two_region": NamedLaw("two-region law (adaptive)", two_region, TwoRegionParameters(), adapts=True),
}
