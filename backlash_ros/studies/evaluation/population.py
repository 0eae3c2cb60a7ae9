"""The population: a random drive, with sensors, delay, rate and load torque, as a function of a seed and a number.

Drive k of a seed does not depend on the number of drives. `core` and `full` share their draws: drive k of `core` is
drive k of `full` without motor friction, eccentricity, varying gap and gravity, and with motor and reduction of the
drive that the population is drawn around. The ranges are in `_Drawn.of`, and in docs/evaluation.md. `wild` is `full`
with the effects of real axes, `mild` and `all` are `core` with some and with most of them: see `effects`.
"""

import math
from dataclasses import dataclass, replace
from typing import TypeVar

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

T = TypeVar("T")

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
    drawn = _Drawn.of(_Draws(seed, number))
    scale = centre.standstill_torque() / NOMINAL_DRIVE.standstill_torque(24.0)
    drive = _drive_of(drawn, centre, scale, own_motor=full and around is None, full=full, own_contact=around is None)
    gap = drive.gear.backlash_angle
    sensors = _sensors_of(drawn, gap, ENCODERS[encoders], full=full)
    delay = Delay(command=drawn.late / drawn.rate)
    member = Member(number, drive, sensors, delay, drawn.rate, scale * drawn.load_torque, scale * drawn.change)
    if population in MIXTURES:
        member = draw_mixture(member, seed, population)
    return put_on(member, seed, effects) if effects else member


class _Draws:
    """The random numbers of one drive, in their order."""

    def __init__(self, seed: int, number: int) -> None:
        # Plain doubles of PCG64 are the same with every version of numpy; what is made of them is said here.
        random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(number,))))
        self._next = iter(random.random(_DRAWS).tolist()).__next__

    def between(self, low: float, high: float) -> float:
        return float(low + (high - low) * self._next())

    def log_between(self, low: float, high: float) -> float:
        return float(low * (high / low) ** self._next())

    def often(self, value: float) -> float:
        """Return 0 for one half of the drives."""
        return value if self._next() < 0.5 else 0.0

    def one_of(self, first: T, second: T) -> T:
        return first if self._next() < 0.5 else second


@dataclass(frozen=True)
class _Drawn:
    """What is drawn for a drive, before it is put on the centre of the population: most are factors on its values.

    Frictions are shares of the standstill torque, ``load_torque`` and ``gravity`` N m where the centre is the nominal
    drive, ``eccentricity`` is a share of the gap. ``late``: periods of delay.
    """

    reduction: float
    winding: float
    inertia: float
    viscous: float
    gap: float
    variation: float
    gap_phase: float
    load_torque: float
    gravity: float
    gravity_offset: float
    load_friction: float
    motor_friction: float
    contact: str
    motor_bits: int
    load_bits: int
    motor_offset: float
    load_offset: float
    eccentricity: float
    phase: float
    late: float
    rate: float
    change: float

    @classmethod
    def of(cls, draw: _Draws) -> "_Drawn":
        """Draw in the order of the fields: another order makes other drives."""
        return cls(
            reduction=draw.log_between(0.5, 20.0),
            winding=draw.log_between(0.25, 4.0),
            inertia=draw.log_between(0.25, 4.0),
            viscous=draw.log_between(0.5, 2.0),
            gap=draw.log_between(0.2, 5.0),
            variation=draw.often(draw.between(0.0, 0.3)),
            gap_phase=draw.between(-math.pi, math.pi),
            load_torque=draw.often(draw.between(-0.5, 0.5)),
            gravity=draw.often(draw.between(0.0, 0.3)),
            gravity_offset=draw.between(-math.pi, math.pi),
            load_friction=draw.often(draw.log_between(0.001, 0.05)),
            motor_friction=draw.often(draw.log_between(0.001, 0.05)),
            contact=draw.one_of("power", "elastic"),
            motor_bits=int(draw.between(12, 19)),
            load_bits=int(draw.between(12, 19)),
            motor_offset=draw.between(-math.pi, math.pi),
            load_offset=draw.between(-math.pi, math.pi),
            eccentricity=draw.often(draw.between(0.0, 0.1)),
            phase=draw.between(-math.pi, math.pi),
            late=int(draw.between(0, 3)) / 2,
            rate=draw.one_of(250.0, 1000.0),
            change=draw.one_of(0.2, -0.2),
        )


def _moved(drawn: _Drawn, centre: Drive) -> Drive:
    """Return the centre with another reduction and winding: the motor as it is seen at the output stays."""
    motor = replace(
        centre.motor,
        torque_constant=centre.motor.torque_constant / drawn.reduction,
        inertia=centre.motor.inertia / drawn.reduction**2,
        viscous_friction=centre.motor.viscous_friction / drawn.reduction**2,
        resistance=centre.motor.resistance * drawn.winding,
        inductance=centre.motor.inductance * drawn.winding,
    )
    return replace(centre, motor=motor, gear=replace(centre.gear, reduction=centre.gear.reduction * drawn.reduction))


def _drive_of(drawn: _Drawn, centre: Drive, scale: float, *, own_motor: bool, own_contact: bool, full: bool) -> Drive:
    """Return the drive; ``own_motor``, ``own_contact``: as drawn, not the centre's; ``full``: with all of it."""
    moved = _moved(drawn, centre) if own_motor else centre
    stall, gear = moved.standstill_torque(), moved.gear
    return Drive(
        replace(moved.motor, coulomb_friction=drawn.motor_friction * stall * gear.ratio if full else 0.0),
        replace(
            gear,
            backlash_angle=gear.backlash_angle * drawn.gap,
            backlash_variation=drawn.variation if full else 0.0,
            backlash_phase=drawn.gap_phase if full else 0.0,
            contact=CONTACTS[drawn.contact]() if own_contact else gear.contact,
        ),
        replace(
            centre.load,
            inertia=centre.load.inertia * drawn.inertia,
            viscous_friction=centre.load.viscous_friction * drawn.viscous,
            coulomb_friction=drawn.load_friction * stall,
            gravity_torque=scale * drawn.gravity if full else 0.0,
            gravity_offset=drawn.gravity_offset if full else 0.0,
        ),
        centre.command_interface,
    )


def _sensors_of(drawn: _Drawn, gap: float, measured: tuple[str, ...], *, full: bool) -> Sensors:
    return Sensors(
        measured=measured,
        motor_counts=2.0**drawn.motor_bits,
        load_counts=2.0**drawn.load_bits,
        motor_offset=drawn.motor_offset,
        load_offset=drawn.load_offset,
        load_eccentricity=drawn.eccentricity * gap if full else 0.0,
        eccentricity_phase=drawn.phase if full else 0.0,
    )


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
