"""The population: a random drive, with sensors, delay, rate and load torque, as a function of a seed and a number.

Drive k of a seed does not depend on the number of drives. `core` and `full` share their draws: drive k of `core` is
drive k of `full` without motor friction, eccentricity, varying gap and gravity, and with motor and reduction of the
drive that the population is drawn around. The ranges are in `draw_member`, and in docs/evaluation.md. `wild` is `full`
with the effects of real axes, `mild` and `all` are `core` with some and with most of them: see `effects`.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Effects
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.studies.evaluation.effects import MIXTURES, draw_mixture, put_on
from backlash_ros.studies.evaluation.member import Member

__all__ = ["ENCODERS", "MODELS", "POPULATIONS", "Member", "draw_member", "told_model"]

POPULATIONS = ("full", "core", "wild", "mild", "all")
ENCODERS = {"both": POSITIONS, "load": ("theta_l",), "motor": ("theta_m",)}
"""The measured angles for each value of ``--encoders``."""
MODELS = ("nominal", "true", "identified")

_DRAWS = 64
"""Numbers drawn for each drive: more than are used, so that a new quantity does not change the others."""


def draw_member(
    seed: int,
    number: int,
    population: str = "full",
    encoders: str = "both",
    around: Drive | None = None,
    effects: tuple[str, ...] = (),
) -> Member:
    """Return one drive of a population.

    Parameters
    ----------
    seed, number : whole numbers >= 0
    population : one of `POPULATIONS`
    encoders : one of `ENCODERS`
    around : the drive at the centre; the nominal one by default. If it is given, all drives have its motor, reduction
        and contact, and torques scale with its stall torque
    effects : of `effects.EFFECTS`, which the drive has in any case

    Raises
    ------
    ValueError
        If there is no such population or effect.

    Examples
    --------
    >>> draw_member(1, 7) == draw_member(1, 7)
    True
    >>> draw_member(1, 7).drive.gear.reduction == draw_member(1, 8).drive.gear.reduction
    False
    """
    if population not in POPULATIONS:
        raise ValueError(f"population must be one of {list(POPULATIONS)}, got {population!r}")
    full, centre = population in ("full", "wild"), around or NOMINAL_DRIVE
    # Plain doubles of PCG64 are the same with every version of numpy; what is made of them is said here.
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number,))))
    draws: Iterator[float] = iter(random.random(_DRAWS).tolist())

    def between(low: float, high: float) -> float:
        return low + (high - low) * next(draws)

    def log_between(low: float, high: float) -> float:
        return float(low * (high / low) ** next(draws))

    def often(value: float) -> float:
        """Return 0 for one half of the drives."""
        return value if next(draws) < 0.5 else 0.0

    reduction = log_between(0.5, 20.0)
    winding = log_between(0.25, 4.0)
    motor, gear = centre.motor, centre.gear
    if full and around is None:
        motor = replace(
            motor,
            torque_constant=motor.torque_constant / reduction,
            inertia=motor.inertia / reduction**2,
            viscous_friction=motor.viscous_friction / reduction**2,
            resistance=motor.resistance * winding,
            inductance=motor.inductance * winding,
        )
        gear = replace(gear, reduction=gear.reduction * reduction)
    moved = replace(centre, motor=motor, gear=gear)
    stall = moved.standstill_torque()
    scale = centre.standstill_torque() / NOMINAL_DRIVE.standstill_torque(24.0)

    inertia = centre.load.inertia * log_between(0.25, 4.0)
    viscous = centre.load.viscous_friction * log_between(0.5, 2.0)
    gap = gear.backlash_angle * log_between(0.2, 5.0)
    variation, gap_phase = often(between(0.0, 0.3)), between(-math.pi, math.pi)
    load_torque = scale * often(between(-0.5, 0.5))
    gravity, gravity_offset = scale * often(between(0.0, 0.3)), between(-math.pi, math.pi)
    load_friction = often(log_between(0.001, 0.05) * stall)
    motor_friction = often(log_between(0.001, 0.05) * stall * gear.ratio)
    contact = CONTACTS["power" if next(draws) < 0.5 else "elastic"]()
    motor_bits, load_bits = int(between(12, 19)), int(between(12, 19))
    motor_offset, load_offset = between(-math.pi, math.pi), between(-math.pi, math.pi)
    eccentricity, phase = often(between(0.0, 0.1) * gap), between(-math.pi, math.pi)
    late = int(between(0, 3)) / 2
    rate = 250.0 if next(draws) < 0.5 else 1000.0
    change = scale * (0.2 if next(draws) < 0.5 else -0.2)

    drive = Drive(
        replace(motor, coulomb_friction=motor_friction if full else 0.0),
        replace(
            gear,
            backlash_angle=gap,
            backlash_variation=variation if full else 0.0,
            backlash_phase=gap_phase if full else 0.0,
            contact=gear.contact if around else contact,
        ),
        replace(
            centre.load,
            inertia=inertia,
            viscous_friction=viscous,
            coulomb_friction=load_friction,
            gravity_torque=gravity if full else 0.0,
            gravity_offset=gravity_offset if full else 0.0,
        ),
        centre.command_interface,
    )
    sensors = Sensors(
        measured=ENCODERS[encoders],
        motor_counts=2.0**motor_bits,
        load_counts=2.0**load_bits,
        motor_offset=motor_offset,
        load_offset=load_offset,
        load_eccentricity=eccentricity if full else 0.0,
        eccentricity_phase=phase if full else 0.0,
    )
    member = Member(number, drive, sensors, Delay(command=late / rate), rate, load_torque, change)
    if population in MIXTURES:
        member = draw_mixture(member, seed, population)
    return put_on(member, seed, effects) if effects else member


def told_model(member: Member, model: str, around: Drive | None = None) -> Drive:
    """Return the drive that the controller assumes: one of `MODELS`.

    It always knows the data sheet: motor and reduction. ``nominal``, and ``identified`` at first, have gap, contact and
    load of the population's centre and no dry friction; ``true`` is the drive as it is built. No controller knows the
    effects.
    """
    if model == "true":
        return replace(member.drive.as_built, effects=Effects())
    centre, drive = around or NOMINAL_DRIVE, member.drive
    return Drive(
        replace(drive.motor, coulomb_friction=0.0),
        replace(centre.gear, reduction=drive.gear.reduction),
        replace(centre.load, coulomb_friction=0.0, gravity_torque=0.0, gravity_offset=0.0),
        drive.command_interface,
    )
