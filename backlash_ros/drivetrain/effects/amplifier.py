"""The amplifier: a dead band, a resolution, and a supply that sags."""

import numpy as np

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.foundation.compiled import compiled


@compiled
def amplified(plant: PlantConstants, command: float) -> float:
    """Return the command that the motor gets, V or A: less by the dead band, then the nearest that can be resolved."""
    effects = effects_in(plant.effects)
    size = max(abs(command) - effects.dead_band, 0.0)
    if effects.resolution > 0.0:
        size = effects.resolution * np.floor(size / effects.resolution + 0.5)
    return float(size if command > 0.0 else -size)


@compiled
def sagged(plant: PlantConstants, command: float, current: float) -> float:
    """Return the voltage at the motor's terminals, V, of a supply that sags with the current."""
    return command * (1.0 - effects_in(plant.effects).sag * abs(current) * plant.per_current)
