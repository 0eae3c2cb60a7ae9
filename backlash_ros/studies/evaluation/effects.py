"""The effects of real axes, drawn for a drive of a population: one function an effect, and mixtures of them.

What an effect draws depends on the seed, the drive's number and the effect alone. T_s is the stall torque at the output
by the data sheet, b the gap.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from backlash_ros.drivetrain import CONTACTS
from backlash_ros.drivetrain.contacts.hunt_crossley import dissipation_for
from backlash_ros.studies.evaluation.member import Member

Draw = Callable[[], float]
"""Returns the next random number, even within [0, 1)."""

_DRIFT_TIME = 600.0
_FLEXIBLE_SHARE, _FLEXIBLE_DAMPING = 0.4, 0.02
_FIRST_GAP, _WHEEL = 0.6, 0.1
_JITTER = 0.1
_CHANCES = 999
"""Place of the random numbers that decide which effects a drive has."""


def _between(draw: Draw, low: float, high: float) -> float:
    return low + (high - low) * draw()


def _log_between(draw: Draw, low: float, high: float) -> float:
    return float(low * (high / low) ** draw())


def _phase(draw: Draw) -> float:
    return _between(draw, -math.pi, math.pi)


def _with_effects(member: Member, **effects: Any) -> Member:
    return replace(member, drive=replace(member.drive, effects=replace(member.drive.effects, **effects)))


def _with_teeth(member: Member, law: str, **parameters: float) -> Member:
    gear = replace(member.drive.gear, contact=CONTACTS[law](**parameters))
    return replace(member, drive=replace(member.drive, gear=gear))


def _quarter_torque(member: Member) -> float:
    return 0.25 * member.drive.standstill_torque()


def _hunt_crossley(member: Member, draw: Draw, exponent: float, low: float, high: float) -> Member:
    """Give the teeth an exponent, a wind-up in b at T_s/4, and a restitution of 0.6 to 0.9.

    The restitution is that at the speed which T_s/4 gives the motor alone over the gap.
    """
    torque, b = _quarter_torque(member), member.drive.gear.backlash_angle
    wind_up, restitution = b * _log_between(draw, low, high), _between(draw, 0.6, 0.9)
    speed = math.sqrt(2.0 * b * torque / member.drive.reflected_inertia)
    return _with_teeth(
        member,
        "hunt_crossley",
        wind_up=wind_up,
        torque=torque,
        exponent=exponent,
        dissipation=dissipation_for(restitution, speed),
    )


def lively(member: Member, draw: Draw) -> Member:
    """Give it teeth of steel: linear, hardly damped; T_s/4 winds them up by 0.02 to 0.1 b."""
    return _hunt_crossley(member, draw, 1.0, 0.02, 0.1)


def hertz(member: Member, draw: Draw) -> Member:
    """Give it round teeth, exponent 1.5, hardly damped; T_s/4 winds them up by 0.05 to 0.2 b."""
    return _hunt_crossley(member, draw, 1.5, 0.05, 0.2)


def soft(member: Member, draw: Draw) -> Member:
    """Give it soft teeth or couplings: T_s/4 winds them up by 0.3 b, with a damping ratio of 0.1 to 0.3."""
    drive = member.drive
    wind_up = 0.3 * drive.gear.backlash_angle / _quarter_torque(member)
    stiffness = 1.0 / (wind_up * drive.gear.load_radius**2)
    damping = 2.0 * _between(draw, 0.1, 0.3) * math.sqrt(stiffness * drive.contact_mass)
    return _with_teeth(member, "elastic", wind_up=wind_up, damping=damping)


def cogging(member: Member, draw: Draw) -> Member:
    """Let its motor cog with 0.5 to 1.5 % of T_s, 7 to 24 times a turn of the motor."""
    torque = _between(draw, 0.005, 0.015) * member.drive.standstill_torque() * member.drive.gear.ratio
    return _with_effects(member, cogging=torque, cogging_cycles=int(_between(draw, 7, 25)), cogging_phase=_phase(draw))


def ripple(member: Member, draw: Draw) -> Member:
    """Let its torque constant ripple by 1.5 to 4.5 %, six times a turn of the motor."""
    return _with_effects(member, torque_ripple=_between(draw, 0.015, 0.045), torque_ripple_phase=_phase(draw))


def _with_friction(member: Member, draw: Draw, *, always: bool) -> Member:
    """Give both sides Coulomb friction of 0.3 to 3 % of T_s; unless ``always``, only where there is none."""
    drive = member.drive
    stall, ratio = drive.standstill_torque(), drive.gear.ratio
    load, motor = _log_between(draw, 0.003, 0.03) * stall, _log_between(draw, 0.003, 0.03) * stall * ratio
    if not always and (drive.load.coulomb_friction or drive.motor.coulomb_friction):
        return member
    rubbed = replace(
        drive,
        motor=replace(drive.motor, coulomb_friction=motor),
        load=replace(drive.load, coulomb_friction=load),
    )
    return replace(member, drive=rubbed)


def stribeck(member: Member, draw: Draw) -> Member:
    """Give it static friction of 1.2 to 2 times Coulomb's, which falls over 0.05 to 0.2 rad/s."""
    rubbed = _with_friction(member, draw, always=True)
    static, speed = _between(draw, 1.2, 2.0), _log_between(draw, 0.05, 0.2)
    return _with_effects(rubbed, static_friction=static, stribeck_speed=speed)


def direction(member: Member, draw: Draw) -> Member:
    """Give it friction that is up to 30 % larger in one direction, and smaller in the other."""
    rubbed = _with_friction(member, draw, always=False)
    return _with_effects(rubbed, friction_asymmetry=_between(draw, -0.3, 0.3))


def datasheet(member: Member, draw: Draw) -> Member:
    """Build its motor not as the data sheet says: R -5 to +20 %, K_m -7 to +5 %, J_m -5 to +15 %, L -20 to +20 %."""
    return _with_effects(
        member,
        resistance_error=_between(draw, -0.05, 0.2),
        torque_constant_error=_between(draw, -0.07, 0.05),
        inertia_error=_between(draw, -0.05, 0.15),
        inductance_error=_between(draw, -0.2, 0.2),
    )


def dead_band(member: Member, draw: Draw) -> Member:
    """Let its amplifier take 0.3 to 1 % of the largest command from every command."""
    return _with_effects(member, dead_band=_between(draw, 0.003, 0.01))


def supply(member: Member, draw: Draw) -> Member:
    """Let its supply sag by 3 to 9 % at the stall current, and give its amplifier 8 to 12 bit."""
    return _with_effects(member, supply_sag=_between(draw, 0.03, 0.09), command_bits=int(_between(draw, 8, 13)))


def encoders(member: Member, draw: Draw) -> Member:
    """Make its encoders err: 2 mrad once a turn at the motor, 0.3 to 0.5 mrad once and twice at the load."""
    sensors, once, twice = member.sensors, _between(draw, 3e-4, 5e-4), _between(draw, 3e-4, 5e-4)
    phase = _phase(draw)
    return replace(
        member,
        sensors=replace(
            sensors,
            motor_eccentricity=2e-3,
            load_eccentricity=sensors.load_eccentricity + once,
            load_ellipticity=twice,
            eccentricity_phase=sensors.eccentricity_phase if sensors.load_eccentricity else phase,
        ),
    )


def losses(member: Member, draw: Draw) -> Member:
    """Let it lose power in proportion to the load: efficiency e of 0.7 to 0.97 forward, 2 - 1/e backward."""
    forward = _between(draw, 0.7, 0.97)
    gear = replace(member.drive.gear, efficiency_forward=forward, efficiency_backward=2.0 - 1.0 / forward)
    return replace(member, drive=replace(member.drive, gear=gear))


def worm(member: Member, draw: Draw) -> Member:  # noqa: ARG001 - as every effect
    """Make it a worm gear: efficiency 0.35 forward; self-locking."""
    gear = replace(member.drive.gear, efficiency_forward=0.35, efficiency_backward=0.0)
    return replace(member, drive=replace(member.drive, gear=gear))


def flexible(member: Member, draw: Draw) -> Member:
    """Put 40 % of its load behind a spring: 15 to 60 Hz, damping ratio 0.02."""
    frequency = _log_between(draw, 15.0, 60.0)
    return _with_effects(
        member, outer_share=_FLEXIBLE_SHARE, outer_frequency=frequency, outer_damping=_FLEXIBLE_DAMPING
    )


def two_stages(member: Member, draw: Draw) -> Member:  # noqa: ARG001 - as every effect
    """Give it gaps of 60 and 40 % of b with a wheel of 0.1 J_l between them."""
    return _with_effects(member, first_gap=_FIRST_GAP, wheel_inertia=_WHEEL)


def jitter(member: Member, draw: Draw) -> Member:  # noqa: ARG001 - as every effect
    """Take its readings up to a tenth of a period earlier or later than their stamps say."""
    return replace(member, delay=replace(member.delay, stamp_jitter=_JITTER / member.rate))


def drift(member: Member, draw: Draw) -> Member:  # noqa: ARG001 - as every effect
    """Let its gap grow by 10 % and its friction fall by 30 % in ten minutes."""
    return _with_effects(member, gap_growth=0.1, friction_fall=0.3, drift_time=_DRIFT_TIME)


EFFECTS: dict[str, Callable[[Member, Draw], Member]] = {
    effect.__name__: effect
    for effect in (
        *(lively, hertz, soft, cogging, ripple, stribeck, direction, datasheet, dead_band, supply, encoders),
        *(losses, worm, flexible, two_stages, jitter, drift),
    )
}
"""Each effect by its name. The order is part of what is drawn: new ones come last."""

TEETH = ("lively", "hertz", "soft")
"""Of these a drive has one at most."""
MIXTURES = {
    "mild": ("lively", "cogging", "stribeck", "datasheet", "dead_band", "encoders"),
    "all": tuple(name for name in EFFECTS if name not in ("soft", "worm", "flexible", "two_stages")),
    "wild": tuple(name for name in EFFECTS if name != "worm"),
}
"""The effects of a population; half of its drives have each."""


def _draws(seed: int, number: int, place: int) -> Draw:
    """Return random numbers of a drive that nothing else takes."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number, 1 + place))))
    return lambda: float(random.random())


def put_on(member: Member, seed: int, names: Sequence[str]) -> Member:
    """Return a drive with every effect of ``names``; ValueError names one that there is not."""
    for name in names:
        if name not in EFFECTS:
            raise ValueError(f"effects must be of {list(EFFECTS)}, got {name!r}")
        member = EFFECTS[name](member, _draws(seed, member.number, list(EFFECTS).index(name)))
    return replace(member, effects=(*member.effects, *names))


def draw_mixture(member: Member, seed: int, population: str) -> Member:
    """Return a drive with each effect of a mixture by an even chance; of several kinds of teeth, with one of them."""
    chance = _draws(seed, member.number, _CHANCES)
    drawn = [name for name in EFFECTS if chance() < 0.5 and name in MIXTURES[population]]
    teeth = [name for name in drawn if name in TEETH]
    kept = teeth[int(chance() * len(teeth))] if teeth else ""
    return put_on(member, seed, [name for name in drawn if name == kept or name not in TEETH])
