"""The effects as the compiled functions take them."""

import math

from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.record import Array, Record, row_of, view_of

_STOP_DAMPING = 0.1
"""Damping ratio of a load against a stop."""


class EffectConstants(Record):
    """The effects as the compiled functions read them; without any of them, every value has no influence.

    ``excess`` is static friction over Coulomb friction, less 1; ``per_stribeck_*`` the reciprocal of the Stribeck speed
    at either shaft, s/rad. ``dead_band`` and ``resolution`` are commands. ``J_outer``, ``k_outer``
    and ``c_outer`` are the outer part of the load and its spring and damper, ``J_wheel`` the wheel of a gear with two
    stages, at the output. ``k_stop`` and ``c_stop`` are spring and damper of the stops at both ends of the travel.
    """

    cogging: float
    cogging_cycles: float
    cogging_phase: float
    ripple: float
    ripple_cycles: float
    ripple_phase: float
    excess: float
    per_stribeck_m: float
    per_stribeck_l: float
    asymmetry: float
    dead_band: float
    resolution: float
    sag: float
    J_outer: float
    k_outer: float
    c_outer: float
    first_gap: float
    J_wheel: float
    growth: float
    fall: float
    per_drift_time: float
    lower_stop: float
    upper_stop: float
    k_stop: float
    c_stop: float


effects_in = view_of(EffectConstants)


def effect_row(drive: Drive) -> Array:
    """Return the effects of a drive as a row of numbers."""
    effects, limit = drive.effects, drive.command_limit
    outer, omega = effects.outer_share * drive.load.inertia, 2.0 * math.pi * effects.outer_frequency
    return row_of(
        EffectConstants,
        cogging=float(effects.cogging),
        cogging_cycles=float(effects.cogging_cycles),
        cogging_phase=float(effects.cogging_phase),
        ripple=float(effects.torque_ripple),
        ripple_cycles=float(effects.torque_ripple_cycles),
        ripple_phase=float(effects.torque_ripple_phase),
        excess=effects.static_friction - 1.0,
        per_stribeck_m=drive.gear.ratio / effects.stribeck_speed,
        per_stribeck_l=1.0 / effects.stribeck_speed,
        asymmetry=float(effects.friction_asymmetry),
        dead_band=effects.dead_band * limit,
        resolution=2.0 * limit / 2.0**effects.command_bits if effects.command_bits else 0.0,
        sag=float(effects.supply_sag),
        J_outer=outer,
        k_outer=outer * omega * omega,
        c_outer=2.0 * effects.outer_damping * omega * outer,
        first_gap=float(effects.first_gap),
        J_wheel=effects.wheel_inertia * drive.load.inertia,
        growth=float(effects.gap_growth),
        fall=float(effects.friction_fall),
        per_drift_time=1.0 / effects.drift_time,
        lower_stop=float(effects.stop_lower),
        upper_stop=float(effects.stop_upper),
        k_stop=float(effects.stop_stiffness),
        c_stop=2.0 * _STOP_DAMPING * math.sqrt(effects.stop_stiffness * drive.load.inertia),
    )
