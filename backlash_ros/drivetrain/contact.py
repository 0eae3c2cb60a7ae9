"""Tooth contact: the force between the gears as a function of the gap and its rate, by four laws with one interface.

Every law answers ``(force, stiffness, damping, elastic, elastic_stiffness)``: the force F in N, positive when the
motor's gear drives the load forward, its derivatives by the gap (N/m) and by the gap rate (N s/m), the part of the
force that stores energy (N) and its derivative by the gap (N/m). What F has beyond the elastic part is lost.

power           F = beta s^n + alpha dv s^(n+1), s = gap/(d/2): eq 13 of the paper, verbatim. Small but not zero inside
                the gap, and it pulls while the teeth part fast.
power_no_pull   The same, zero where it would pull.
elastic         Dead zone and linear spring, F = k delta + c ddelta/dt with delta the depth beyond the gap, the damping
                part never larger than the spring's: no jump at contact, no pull (Nordin, Galic & Gutman, Int. J. Adapt.
                Control Signal Process. 11, 1997; Modelica.Mechanics.Rotational.Components.ElastoBacklash2).
restitution     Dead zone and linear spring-damper that lets go when its force is zero, with the damping that makes two
                free gears part with a given share e of the speed at which they met (Schwager & Poeschel, Granular
                Matter 9, 2007), as an impact with restitution has it (Sarkar, Ellis & Moore, MSSP 11(3), 1997).
"""

import math

from scipy.optimize import brentq

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.parameters import ELASTIC, POWER, PlantConstants

Contact = tuple[float, float, float, float, float]


def restitution_of(damping_ratio: float) -> float:
    """Return the share of its speed that a linear spring-damper contact leaves which lets go at zero force.

    ``damping_ratio`` is c/(2 sqrt(k m)) with the reduced mass m of the two bodies, 0 <= ratio < 1.
    """
    root = math.sqrt(1.0 - damping_ratio**2)
    # The phase, in the damped oscillation, at which k delta + c ddelta/dt first vanishes.
    phase = math.atan2(2.0 * damping_ratio * root, 2.0 * damping_ratio**2 - 1.0)
    return math.exp(-damping_ratio / root * phase)


def damping_ratio_of(restitution: float) -> float:
    """Return the damping ratio that leaves ``restitution``, above 0.19 (nearly critical damping) and at most 1."""
    return float(brentq(lambda ratio: restitution_of(ratio) - restitution, 0.0, 0.999, xtol=1e-14))


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
def _power(plant: PlantConstants, gap: float, gap_rate: float) -> Contact:
    s = gap / plant.half_gap
    n = plant.exponent
    below = _integer_power(s, n - 1)
    at = below * s
    above = at * s
    elastic = plant.beta * at
    elastic_stiffness = plant.beta * n * below / plant.half_gap
    force = elastic + plant.alpha * gap_rate * above
    stiffness = elastic_stiffness + plant.alpha * gap_rate * (n + 1) * at / plant.half_gap
    return force, stiffness, plant.alpha * above, elastic, elastic_stiffness


@compiled
def _linear(plant: PlantConstants, gap: float, gap_rate: float) -> Contact:
    depth = abs(gap) - plant.half_gap
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    side = 1.0 if gap > 0.0 else -1.0
    spring = plant.tooth_stiffness * depth
    damper = plant.tooth_damping * gap_rate * side
    if plant.law == ELASTIC:
        if damper > spring:
            return 2.0 * side * spring, 2.0 * plant.tooth_stiffness, 0.0, side * spring, plant.tooth_stiffness
        if damper < -spring:
            return 0.0, 0.0, 0.0, side * spring, plant.tooth_stiffness
    elif spring + damper < 0.0:
        return 0.0, 0.0, 0.0, side * spring, plant.tooth_stiffness
    force = side * (spring + damper)
    return force, plant.tooth_stiffness, plant.tooth_damping, side * spring, plant.tooth_stiffness


@compiled
def contact(plant: PlantConstants, gap: float, gap_rate: float) -> Contact:
    """Return force, stiffness, damping, elastic force and its stiffness at a gap (m) and gap rate (m/s)."""
    if plant.law >= ELASTIC:
        return _linear(plant, gap, gap_rate)
    force, stiffness, damping, elastic, elastic_stiffness = _power(plant, gap, gap_rate)
    if plant.law != POWER and force * gap < 0.0:
        return 0.0, 0.0, 0.0, elastic, elastic_stiffness
    return force, stiffness, damping, elastic, elastic_stiffness


@compiled
def elastic_energy(plant: PlantConstants, gap: float) -> float:
    """Return the energy that the teeth store at a gap, J."""
    if plant.law >= ELASTIC:
        depth = max(0.0, abs(gap) - plant.half_gap)
        return 0.5 * plant.tooth_stiffness * depth * depth
    n = plant.exponent + 1
    return plant.beta * plant.half_gap / n * _integer_power(gap / plant.half_gap, n)
