"""Tooth contact: the force between the gears as a function of the gap and its rate.

Every contact law returns ``(force, stiffness, damping)``: the force F in N, its derivative by the gap in N/m
and its derivative by the gap rate in N s/m. F is positive when the motor's gear drives the load forward.
"""

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.parameters import PlantConstants


@compiled
def _integer_power(base: float, exponent: int) -> float:
    result = 1.0
    while exponent > 0:
        if exponent & 1:
            result *= base
        base *= base
        exponent >>= 1
    return result


@compiled
def power_law(plant: PlantConstants, gap: float, gap_rate: float) -> tuple[float, float, float]:
    """Nonlinear spring-damper of eq 13, verbatim: F = beta s^n + alpha dv s^(n+1) with s = gap/(d/2).

    It is small but not zero inside the gap, and can pull while the teeth part fast.
    """
    s = gap / plant.half_gap
    n = plant.exponent
    below = _integer_power(s, n - 1)
    at = below * s
    above = at * s
    force = plant.beta * at + plant.alpha * gap_rate * above
    stiffness = (plant.beta * n * below + plant.alpha * gap_rate * (n + 1) * at) / plant.half_gap
    return force, stiffness, plant.alpha * above
