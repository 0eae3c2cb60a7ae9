"""Checks a described drive: what the motor can do, the margins of the loop, what can be learned."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from backlash_ros.control import AUTO, DEFAULT_WEIGHTS, Margins
from backlash_ros.control.design.choice import Choice, chosen_for_rate
from backlash_ros.control.design.start import CannotStartError
from backlash_ros.control.monitoring.wear import HEAVY
from backlash_ros.drive_file.drive_file import (
    Axis,
    Surroundings,
    read_axis,
    read_law,
    read_start,
    read_surroundings,
)
from backlash_ros.drivetrain import Drive
from backlash_ros.studies.judging import PRECISE, threshold

LOWER = "lower the weights (gain_sets.*.q; the first is the square of k1), raise rate, or shorten the delay"
"""Remedy for gains that are too fast."""
IMPLAUSIBLE = 100.0
"""J_l/J_r, or its inverse, that is more likely a mistake than a drive."""
SPEEDS = 10.0, 1e4
"""Speeds of a motor without load, rad/s, outside of which a unit is more likely wrong."""
WIDE, SLOW = 0.2, 0.1
"""Gap, rad, and time constant of a winding, s, above which a unit is more likely wrong."""
COASTS = 1.0
"""J_l/B_l, s, above which a load without dry friction drifts in the gap for long: docs/evaluation.md."""
LOSSY = 0.9
"""Efficiency of a gear below which learning is more often refused: docs/learning.md."""
COARSE_ALONE = 30
"""Counts of the motor's encoder in the gap below which the law of planned moves may rattle without another encoder."""
COARSE = 20
"""Counts of the load's encoder in the gap below which the load swings more often: docs/evaluation.md."""


@dataclass(frozen=True)
class Warned:
    """A possible problem and its remedy."""

    what: str
    remedy: str


@dataclass(frozen=True)
class Checked:
    """Figures of a drive by name, each with its unit, and the warnings; ``fails``: why a controller does not start."""

    figures: Mapping[str, str]
    warnings: tuple[Warned, ...]
    fails: str = ""
    remedy: str = ""


def check_drive(*paths: Path) -> Checked:
    """Check the parameter files of a drive, later ones overriding earlier ones, and its loop; nothing moves.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read, or a parameter is out of bounds: the text names it, the value and the bound.
    """
    read_law(*paths)  # refuses one that there is not
    axis = read_axis(*paths)
    around = read_surroundings(*paths)
    try:
        start = read_start(*paths)
    except CannotStartError as error:
        warnings = tuple(_warnings(axis, around, None, {}))
        return Checked(_figures(axis, around, {}), warnings, error.why, error.remedy)
    margins = start.settings.margins(start.drive)
    chosen = {"chosen for the rate": "; ".join(said)} if (said := chosen_for_rate(start)) else {}
    axis = replace(axis, drive=start.drive)
    return Checked(_figures(axis, around, margins) | chosen, tuple(_warnings(axis, around, start, margins)))


def _counts_in_gap(drive: Drive, around: Surroundings) -> dict[str, float]:
    """Return the gap in counts of each encoder that has counts."""
    sensors, turns = around.sensors, drive.gear.backlash_angle / (2.0 * math.pi)
    found = {"load": turns * sensors.load_counts, "motor": turns * drive.gear.reduction * sensors.motor_counts}
    seen = {"load": "theta_l", "motor": "theta_m"}
    return {name: counts for name, counts in found.items() if counts and seen[name] in sensors.measured}


def _expected(drive: Drive, around: Surroundings) -> str:
    """Return how far a load at rest may be off its target once the drive is identified, in words.

    Of random drives, that many stay within it: the share ``precise`` of docs/evaluation.md and docs/one_encoder.md.
    """
    b, counts, measured = drive.gear.backlash_angle, around.sensors.load_counts, around.sensors.measured
    count = 2.0 * math.pi / counts if counts and "theta_l" in measured else 0.0
    off = threshold(PRECISE, b, count) * b
    held = f"{1e3 * off:.2g} mrad, {math.degrees(60.0 * off):.2g} arcmin, "
    held += "on 19 of 20 drives drawn at random (docs/evaluation.md), once identified"
    return held if "theta_l" in measured else f"{held}; a load that is pushed in the gap is not seen"


def _figures(axis: Axis, around: Surroundings, margins: Mapping[str, Margins]) -> dict[str, str]:
    """Return the figures of a drive with the winding that its controller emulates."""
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
    figures["error of a load at rest"] = _expected(drive, around)
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


def _torque_to_lift(drive: Drive) -> float:
    """Return the torque at the output against weight, dry friction and the losses of the gear, N m."""
    load, gear = drive.load, drive.gear
    behind = (load.gravity_torque + load.coulomb_friction) / gear.efficiency_forward
    return behind + drive.motor.coulomb_friction / gear.ratio


def sag(drive: Drive, start: Choice, torque: float) -> float:
    """Return how far off its target the gains alone hold the load against a torque at the output, rad.

    The voltage k1 e - k3 i drives the current n torque/K_m through the winding: the fast gains everywhere, until a gap
    is learned; the over-damped ones within the region of the two-region law, at whose edge the fast ones go on.
    """
    current = torque * drive.gear.ratio / drive.motor.torque_constant
    gains = start.settings.gains
    near, far = (
        current * (drive.motor.resistance + each.current) / each.position for each in (gains.overdamped, gains.fast)
    )
    width = start.values["laws.two_region.width"] * drive.gear.backlash_angle
    law = start.values["law"]
    if law == "fast":
        return far
    return near if law == "overdamped" or near <= width else max(far, width)


def _sag(drive: Drive, around: Surroundings, start: Choice) -> Iterator[Warned]:
    """Yield how far the load stays off its target where nothing estimates the torque on it."""
    sees, estimates = "theta_m" in around.sensors.measured, start.settings.torque_bandwidth > 0.0
    torque = _torque_to_lift(drive)
    if (sees and estimates) or torque == 0.0 or start.values["law"] not in (AUTO, "two_region", "fast", "overdamped"):
        return
    b, off = drive.gear.backlash_angle, sag(drive, start, torque)
    causes = {
        "weight": drive.load.gravity_torque,
        "friction": drive.load.coulomb_friction + drive.motor.coulomb_friction,
        "the losses of the gear": 1.0 - drive.gear.efficiency_forward,
    }
    what = " and ".join(name for name, there in causes.items() if there)
    alone = "with torque_bandwidth 0" if sees else "with the load's encoder alone, until identify has run,"
    remedy = "" if sees else "call identify, or measure the motor's shaft as well: then the torque is estimated; or "
    remedy += "" if estimates else "set torque_bandwidth to 40; or "
    k1 = torque * drive.gear.ratio * drive.motor.resistance / drive.motor.torque_constant / (0.25 * b)
    yield Warned(
        f"{alone} {what} hold{'' if ' and ' in what else 's'} the load up to {1e3 * off:.3g} mrad, "
        f"{math.degrees(60.0 * off):.3g} arcmin or {off / b:.2g} b, off its target",
        f"{remedy}choose higher gains.*.q, as far as the loop stays stable: within b/4 needs k1 = {k1:.3g} V/rad, "
        "the root of the first weight; or balance the load",
    )


def _tight(around: Surroundings, margins: Mapping[str, Margins]) -> Iterator[Warned]:
    tight = [name for name, margin in margins.items() if margin.tight(1.0 / around.rate)]
    if tight:
        yield Warned(
            f"the {' and '.join(tight)} gains tolerate less than 30 deg of lag, or less than one more period of delay",
            LOWER,
        )


def _by_design(around: Surroundings, advice: str) -> str:
    """Return an ``advice`` that ends with `backlash design`; empty without the load's encoder, which that needs."""
    return advice if "theta_l" in around.sensors.measured else ""


def _inertia(drive: Drive, around: Surroundings, start: Choice | None) -> Iterator[Warned]:
    ratio = drive.load.inertia / drive.reflected_inertia
    default = start is not None and start.values["gains.overdamped.q"] == DEFAULT_WEIGHTS["overdamped"]
    if ratio > HEAVY and default:
        yield Warned(
            f"the load has {ratio:.2g} times the motor's inertia, seen from the output: "
            "the two-region law may keep a slow limit cycle",
            "leave law at auto and call identify: once it has found inertia and friction, law 'planned' acts"
            + _by_design(
                around,
                "; or choose its gains (backlash design DRIVE --out gains.yaml; backlash check DRIVE gains.yaml)",
            ),
        )


def _drift(drive: Drive) -> Iterator[Warned]:
    load = drive.load
    coasts = load.inertia / load.viscous_friction if load.viscous_friction else math.inf
    if load.coulomb_friction == 0.0 and coasts > COASTS:
        yield Warned(
            "nothing but viscous friction stops the load, which takes load.inertia / load.viscous_friction = "
            f"{coasts:.2g} s: it may drift in the gap for as long, with any law",
            "state its load.coulomb_friction (identify finds it), or let a seal or a brake add some",
        )


def _coarse(drive: Drive, around: Surroundings) -> Iterator[Warned]:
    for name, counts in _counts_in_gap(drive, around).items():
        if counts < COARSE:
            yield Warned(
                f"the gap has {counts:.2g} counts of the {name}'s encoder: "
                "the learned backlash is coarse, and the load may swing",
                f"check sensors.{name}_counts, per turn (14 bit are 16384); use a finer encoder"
                + _by_design(around, ", or choose wider regions: backlash design DRIVE --out gains.yaml"),
            )


def _alone(drive: Drive, around: Surroundings) -> Iterator[Warned]:
    """Yield what a load without an encoder means."""
    if "theta_l" in around.sensors.measured:
        return
    yield Warned(
        "the load has no encoder: until the drive is identified, its position in the gap is unknown",
        "describe motor and reduction well, and call identify: a model of the load then stands for its encoder",
    )
    if (counts := _counts_in_gap(drive, around).get("motor", math.inf)) < COARSE_ALONE:
        yield Warned(
            f"the gap has {counts:.2g} counts of the only encoder, the motor's: below {COARSE_ALONE} law 'planned', "
            "and so law auto once the drive is identified, may rattle",
            "set law: two_region, or use a finer encoder; backlash simulate shows both",
        )


def _losses(drive: Drive) -> Iterator[Warned]:
    if (least := min(drive.gear.efficiency_forward, drive.gear.efficiency_backward)) < LOSSY:
        yield Warned(
            f"the gear lets through {100.0 * least:.3g} % of the torque in one direction: learning has no such losses "
            "in its model and may be refused",
            "if ~/learn is refused, set backlash_angle by hand, from the gear's data sheet or a dial gauge",
        )


def _weight(drive: Drive) -> Iterator[Warned]:
    load = drive.load
    if load.gravity_torque > 0.0:
        yield Warned(
            f"the load's weight turns it with up to {load.gravity_torque:.3g} N m, and a command of 0 does not hold it",
            "use a mechanical brake that the drive engages when commands stop",
        )
    if (needed := _torque_to_lift(drive)) > 0.8 * (stall := drive.standstill_torque()):
        yield Warned(
            f"weight and friction of the load take up to {needed:.3g} N m of {stall:.3g} N m at standstill",
            "check motor.torque_constant, motor.voltage_limit and gear.reduction, or use a stronger motor",
        )


def _warnings(
    axis: Axis, around: Surroundings, start: Choice | None, margins: Mapping[str, Margins]
) -> Iterator[Warned]:
    drive = axis.drive
    yield from _tight(around, margins)
    yield from _units(drive)
    yield from _inertia(drive, around, start)
    yield from _drift(drive)
    yield from _coarse(drive, around)
    if start is not None:
        yield from _sag(drive, around, start)
    yield from _losses(drive)
    yield from _alone(drive, around)
    yield from _weight(drive)
    if not axis.has_ends:
        yield Warned(
            "the load's travel has no ends: a wrong reference may turn it anywhere",
            "set limits.position_lower and limits.position_upper, unless it may turn freely",
        )
