"""The whole state of a drive with effects: that of every drive, then what the effects add.

The integrator's memory keeps the rest, so that a drive with effects is played as any other one.
"""

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.constants import effects_in
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M

WHEEL, OMEGA_WHEEL, OUTER, OMEGA_OUTER, AGE = range(7, 12)
"""After the states of `signals.PlantState`: angle and speed of the wheel between both stages, at the output, and of the
outer part of the load, rad and rad/s; time since the start, s."""
WHOLE = 12


@compiled
def begin(plant: PlantConstants, state: Array, whole: Array) -> None:
    """Write into ``whole``, shape (WHOLE,), how a drive starts whose ``state``, shape (7,), is given.

    The wheel stands where both gaps are taken up alike; the outer part of the load is at rest on its spring.
    """
    whole[:7] = state
    share, ratio = effects_in(plant.effects).first_gap, plant.R1 / plant.R2
    whole[WHEEL] = (1.0 - share) * ratio * state[THETA_M] + share * state[THETA_L]
    whole[OMEGA_WHEEL] = (1.0 - share) * ratio * state[OMEGA_M] + share * state[OMEGA_L]
    whole[OUTER], whole[OMEGA_OUTER], whole[AGE] = state[THETA_L], state[OMEGA_L], 0.0
