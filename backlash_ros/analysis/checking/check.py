"""Checks a described drive: what the motor can do, the margins of the loop, what can be learned."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from backlash_ros.analysis.evaluation.drive_file import (
    Axis,
    Surroundings,
    read_axis,
    read_law,
    read_surroundings,
)
from backlash_ros.control import DEFAULT_WEIGHTS, Margins, design_gains, stability_margins
from backlash_ros.drivetrain import Drive

LOWER = "lower the weights (gain_sets.*.q; the first is the square of k1), raise rate, or shorten the delay"
"""Remedy for gains that are too fast."""
IMPLAUSIBLE = 100.0
"""J_l/J_r, or its inverse, that is more likely a mistake than a drive."""
SPEEDS = 10.0, 1e4
"""Speeds of a motor without load, rad/s, outside of which a unit is more likely wrong."""
WIDE, SLOW = 0.2, 0.1
"""Gap, rad, and time constant of a winding, s, above which a unit is more likely wrong."""
HEAVY = 0.5
"""J_l/J_r above which the two-region law more often keeps a slow limit cycle: docs/evaluation.md."""
COASTS = 1.0
"""J_l/B_l, s, above which a load without dry friction drifts in the gap for long: docs/evaluation.md."""
COARSE = 20
"""Counts of the load's encoder in the gap below which the load swings more often: docs/evaluation.md."""


@dataclass(frozen=True)
class Warned:
    """A possible problem and its remedy."""

    what: str
    remedy: str


@dataclass(frozen=True)
class Checked:
    """Figures of a drive by name, each with its unit, and the warnings; ``fails``: why its gains are refused."""

    figures: Mapping[str, str]
    warnings: tuple[Warned, ...]
    fails: str = ""


def check_drive(*paths: Path) -> Checked:
    """Check the parameter files of a drive, later ones overriding earlier ones, and its loop; nothing moves.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read, or a parameter is out of bounds: the text names it, the value and the bound.
    """
    read_law(*paths)  # refuses one that there is not
    axis = read_axis(*paths)
    around = read_surroundings(axis.drive, *paths)
    margins, fails = {}, ""
    try:
        for name, gains in {"fast": around.fast, "overdamped": around.overdamped}.items():
            margins[name] = stability_margins(axis.drive, gains, 1.0 / around.rate, around.delay.mean)
    except ValueError as error:
        fails = str(error)
    return Checked(_figures(axis, around, margins), tuple(_warnings(axis, around, margins)), fails)


def _counts_in_gap(drive: Drive, around: Surroundings) -> dict[str, float]:
    """Return the gap in counts of each encoder that has counts."""
    sensors, turns = around.sensors, drive.gear.backlash_angle / (2.0 * math.pi)
    found = {"load": turns * sensors.load_counts, "motor": turns * drive.gear.reduction * sensors.motor_counts}
    seen = {"load": "theta_l", "motor": "theta_m"}
    return {name: counts for name, counts in found.items() if counts and seen[name] in sensors.measured}


def _figures(axis: Axis, around: Surroundings, margins: Mapping[str, Margins]) -> dict[str, str]:
    drive = axis.drive
    motor, gear, load = drive.motor, drive.gear, drive.load
    reflected = drive.reflected_inertia
    swing = gear.backlash_angle * reflected / (reflected + load.inertia)  # the load's share by exchange of momentum
    figures = {
        "backlash": f"{1e3 * gear.backlash_angle:.3g} mrad, {math.degrees(60.0 * gear.backlash_angle):.3g} arcmin",
        "torque at standstill": f"{drive.standstill_torque():.3g} N m at the output",
        "speed without load": f"{motor.voltage_limit / motor.torque_constant * gear.ratio:.3g} rad/s at the output",
        "load's inertia over the motor's": f"{load.inertia / reflected:.2g}, seen from the output",
        "swing of a free load with the fast gains": f"{1e3 * swing:.3g} mrad, if it rattles",
    }
    for name, counts in _counts_in_gap(drive, around).items():
        figures[f"gap in counts of the {name}'s encoder"] = f"{counts:.3g}"
    for name, margin in margins.items():
        figures[f"margins of the {name} gains"] = f"{margin.in_words()}, at {around.rate:g} Hz"
    return figures


def _units(drive: Drive) -> Iterator[Warned]:
    """Yield what is more likely a wrong unit than a drive."""
    ratio = drive.load.inertia / drive.reflected_inertia
    if not 1.0 / IMPLAUSIBLE <= ratio <= IMPLAUSIBLE:
        yield Warned(
            f"the load has {ratio:.2g} times the motor's inertia, seen from the output: few drives do",
            "check load.inertia and motor.inertia, both in kg m^2 (1 g cm^2 is 1e-7 kg m^2), and gear.reduction",
        )
    speed = drive.motor.voltage_limit / drive.motor.torque_constant
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        yield Warned(
            f"the motor turns at {speed:.2g} rad/s without load, before the gear: few motors do",
            "check motor.torque_constant in N m/A, which is V s/rad (1 mN m/A is 1e-3, 100 rpm/V are 0.0955), "
            "and motor.voltage_limit",
        )
    if drive.gear.backlash_angle > WIDE:
        yield Warned(
            f"the gap is {drive.gear.backlash_angle:.2g} rad: few gears have so much",
            "check gear.backlash_angle in rad at the output (1 deg is 0.0175, 1 arcmin 2.9e-4)",
        )
    winding = drive.motor.inductance / drive.motor.resistance
    if winding > SLOW:
        yield Warned(
            f"the winding takes motor.inductance / motor.resistance = {winding:.2g} s: few do",
            "check motor.inductance in H (1 mH is 1e-3) and motor.resistance in ohm",
        )


def _warnings(axis: Axis, around: Surroundings, margins: Mapping[str, Margins]) -> Iterator[Warned]:
    drive = axis.drive
    load, stall = drive.load, drive.standstill_torque()
    tight = [name for name, margin in margins.items() if margin.tight(1.0 / around.rate)]
    if tight:
        yield Warned(
            f"the {' and '.join(tight)} gains tolerate less than 30 deg of lag, or less than one more period of delay",
            LOWER,
        )
    yield from _units(drive)
    ratio = load.inertia / drive.reflected_inertia
    chosen = around.overdamped != design_gains("overdamped", drive, DEFAULT_WEIGHTS["overdamped"])
    if ratio > HEAVY and not chosen:
        yield Warned(
            f"the load has {ratio:.2g} times the motor's inertia, seen from the output: "
            "the two-region law may keep a slow limit cycle",
            "choose gains for this drive (backlash design DRIVE --out gains.yaml; backlash check DRIVE gains.yaml); "
            "or, with two encoders, leave law at auto and call identify: "
            "once it has found inertia and friction, law two_encoder acts",
        )
    coasts = load.inertia / load.viscous_friction if load.viscous_friction else math.inf
    if load.coulomb_friction == 0.0 and coasts > COASTS:
        yield Warned(
            "nothing but viscous friction stops the load, which takes load.inertia / load.viscous_friction = "
            f"{coasts:.2g} s: it may drift in the gap for as long, with any law",
            "state its load.coulomb_friction (identify finds it), or let a seal or a brake add some",
        )
    for name, counts in _counts_in_gap(drive, around).items():
        if counts < COARSE:
            yield Warned(
                f"the gap has {counts:.2g} counts of the {name}'s encoder: "
                "the learned backlash is coarse, and the load may swing",
                f"check sensors.{name}_counts, per turn (14 bit are 16384); use a finer encoder, "
                "or choose wider regions: backlash design DRIVE --out gains.yaml",
            )
    if "theta_l" not in around.sensors.measured:
        yield Warned(
            "the load has no encoder: its position in the gap is unknown",
            "expect errors of up to the backlash; learning (relay) needs motor and reduction described well",
        )
    if load.gravity_torque > 0.0:
        yield Warned(
            f"the load's weight turns it with up to {load.gravity_torque:.3g} N m, and a command of 0 does not hold it",
            "use a mechanical brake that the drive engages when commands stop",
        )
    if load.gravity_torque + load.coulomb_friction > 0.8 * stall:
        yield Warned(
            f"weight and friction of the load take up to {load.gravity_torque + load.coulomb_friction:.3g} N m of "
            f"{stall:.3g} N m at standstill",
            "check motor.torque_constant, motor.voltage_limit and gear.reduction, or use a stronger motor",
        )
    if not axis.has_ends:
        yield Warned(
            "the load's travel has no ends: a wrong reference may turn it anywhere",
            "set limits.position_lower and limits.position_upper, unless it may turn freely",
        )
