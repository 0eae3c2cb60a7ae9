"""Dry friction that falls with the speed, differs between both directions, and drifts as the gear warms.

    tau = slip tau_c (1 + (static - 1) exp(-(omega/omega_s)^2)) (1 + slip asymmetry) (1 - fall share)

with the share of the drift time that has passed. The first factor is Stribeck's (Armstrong-Helouvry, Control of
Machines with Friction, 1991, with its exponent of 2).
"""

import math

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.foundation.compiled import compiled


@compiled
def drifted(plant: PlantConstants, age: float) -> float:
    """Return the share of the drift that has come after ``age`` seconds."""
    return min(age * effects_in(plant.effects).per_drift_time, 1.0)


@compiled
def left_of_friction(plant: PlantConstants, age: float) -> float:
    """Return the share of all friction that is left after ``age`` seconds."""
    return 1.0 - effects_in(plant.effects).fall * drifted(plant, age)


@compiled
def dry_friction(plant: PlantConstants, coulomb: float, per_stribeck: float, omega: float, slip: float) -> float:
    """Return the dry friction against the ``slip`` of a shaft at a speed (rad/s), N m, before it drifts."""
    effects = effects_in(plant.effects)
    size = coulomb * (1.0 + slip * effects.asymmetry)
    if effects.excess > 0.0:
        ratio = omega * per_stribeck
        size *= 1.0 + effects.excess * math.exp(-ratio * ratio)
    return slip * size


@compiled
def held(plant: PlantConstants, coulomb: float, age: float) -> tuple[float, float]:
    """Return the least and the largest torque that dry friction holds at rest, N m."""
    effects = effects_in(plant.effects)
    size = coulomb * (1.0 + effects.excess) * left_of_friction(plant, age)
    return -size * (1.0 - effects.asymmetry), size * (1.0 + effects.asymmetry)
