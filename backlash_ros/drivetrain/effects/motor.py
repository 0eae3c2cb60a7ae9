"""Cogging, which brakes the rotor between its poles, and the ripple of the torque constant with the rotor's angle.

tau = cogging sin(m theta_m + phase)         with the potential (cogging/m) (1 - cos(m theta_m + phase))
K   = K_m (1 + ripple cos(6 theta_m + phase)), of the torque and of the back-EMF alike, so that no energy is made
"""

import math

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.foundation.compiled import compiled


@compiled
def cogging_torque(plant: PlantConstants, theta_m: float) -> float:
    """Return the torque by which cogging brakes the motor, N m."""
    effects = effects_in(plant.effects)
    if effects.cogging == 0.0:
        return 0.0
    return effects.cogging * math.sin(effects.cogging_cycles * theta_m + effects.cogging_phase)


@compiled
def cogging_energy(plant: PlantConstants, theta_m: float) -> float:
    """Return the potential of the cogging torque, J."""
    effects = effects_in(plant.effects)
    return (
        effects.cogging
        / effects.cogging_cycles
        * (1.0 - math.cos(effects.cogging_cycles * theta_m + effects.cogging_phase))
    )


@compiled
def torque_constant(plant: PlantConstants, theta_m: float) -> float:
    """Return the torque constant where the motor stands, N m/A."""
    effects = effects_in(plant.effects)
    if effects.ripple == 0.0:
        return plant.K_m
    return plant.K_m * (1.0 + effects.ripple * math.cos(effects.ripple_cycles * theta_m + effects.ripple_phase))
