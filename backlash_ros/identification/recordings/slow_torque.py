"""The hysteresis curve from one recording: a torque that goes slowly up and down on an output at rest.

The experiment `hysteresis` records such a curve, and so may a user by hand. The torque comes from the command and the
motor's speed, its branches from its reversals; the results come from the experiment's own code: see
`identification.locked_output.hysteresis`.
"""

import math

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.locked_output.hysteresis import measure_lost_motion
from backlash_ros.identification.locked_output.lost_motion import Curve, LostMotion
from backlash_ros.identification.locked_output.ramps import Figure, Ramps, smoothed
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.plausible import wrong_command
from backlash_ros.identification.recordings.stretch import HOLE

_MOVEMENT = 0.005
"""Largest motion of an output at rest, rad; tuned."""
_OF_WAY = 0.25
"""Largest motion of an output at rest, a share of the shafts' relative travel, where this is more; tuned."""
_DIFFERENCE = 0.01
"""Half the time over which a speed is taken, s; tuned."""
_SMOOTH = 0.04
"""Averaging time of the torque before its reversals are sought, s; tuned."""
_TURNS = 7
"""Smallest number of reversals of the torque; tuned."""
_TURNED = 0.25
"""Return of the torque after a reversal, as a share of its range; tuned."""
_SLOW = 0.5
"""Shortest median time between reversals, s."""
_MIDDLE = 0.25
"""Share of the way of the shafts against each other, to either side of its middle, in which the gap is crossed."""
_MOVING = 0.1
"""Share of the largest speed there from which on the motor crosses the gap."""
_BORNE = 0.8
"""Largest torque for the lost motion, as a share of the recorded torque."""
_SEEN = 0.3
"""Largest relative standard uncertainty of a stiffness that is reported."""
_FRICTION = 0.02
"""Part of the friction's uncertainty beside the noise and the teeth's loss, as a share of the friction."""


def turns_of(torque: Array) -> list[int]:
    """Return the reversals of a torque: the rows of its extremes from which it comes back by a share of its range."""
    back = _TURNED * float(np.ptp(torque))
    turns: list[int] = []
    high, low, way = 0, 0, 0
    for k, value in enumerate(torque.tolist()):
        high = k if value > torque[high] else high
        low = k if value < torque[low] else low
        if way >= 0 and value < torque[high] - back:
            turns.append(high)
            low, way = k, -1
        elif way <= 0 and value > torque[low] + back:
            turns.append(low)
            high, way = k, 1
    return [turn for turn in turns if turn > 0]


def torque_of(drive: Drive, time: Array, motor: Array, command: Array) -> tuple[Array, Array]:
    """Return the motor's torque, N m at the output, and its speed there, rad/s.

    Parameters
    ----------
    time, motor : s; n theta_m, rad
    command : that acted, V or A
    """
    side = motor_side(drive)
    near = max(1, round(_DIFFERENCE / float(np.median(np.diff(time)))))
    speed = np.zeros_like(motor)
    speed[near:-near] = (motor[2 * near :] - motor[: -2 * near]) / (time[2 * near :] - time[: -2 * near])
    return side.gain * command - side.braking * speed, speed


def movement(held: Array, travel: Array, side: str = "load") -> str:
    """Return by how much a ``side`` that should be at rest moved, if that is too much; empty if not. Both in rad."""
    moved, way = float(np.nanmax(held) - np.nanmin(held)), float(np.ptp(travel))
    if moved > (allowed := max(_MOVEMENT, _OF_WAY * way)):
        what = "an output" if side == "load" else f"a {side}"
        return f"the {side} moved by {moved:.2g} rad; {what} at rest may move by {allowed:.2g} rad"
    return ""


def curve_of(drive: Drive, recording: Recording) -> tuple[Curve, float]:
    """Return the curve of a recording without holes, and the speed at which its motor crosses the gap, rad/s.

    Parameters
    ----------
    drive : for its motor; the torque is that at the output
    """
    read = np.isfinite(recording.motor + recording.load)
    time, motor, load, command, _ = recording.part(read)
    known = np.maximum.accumulate(np.where(np.isfinite(command), np.arange(command.size), 0))
    command = np.nan_to_num(command[known])
    torque, speed = torque_of(drive, time, motor, np.append(command[:1], command[:-1]))
    period = float(np.median(np.diff(time)))
    size = max(1, round(_SMOOTH / period))
    smooth = smoothed(torque, size)
    branch = np.searchsorted(turns_of(smooth), np.arange(time.size), side="right").astype(float)
    between = motor - load
    off = np.abs(between - 0.5 * (np.max(between) + np.min(between)))
    crossing = np.abs(speed[off <= max(_MIDDLE * float(np.ptp(between)), float(np.min(off)))])
    crossing = crossing[crossing >= _MOVING * np.max(crossing)]  # it may have stood there, too
    return Curve(time - time[0], motor, load, torque, branch), float(np.median(crossing))


def hysteresis_of(drive: Drive, recording: Recording, at: float) -> LostMotion:
    """Return gap, lost motion at +-``at`` (N m) and stiffness, or why the recording does not show them.

    Parameters
    ----------
    drive : for its motor and gear ratio, which are taken as they are, and its contact law, which is tried first
    """
    if why := _no_curve(drive, recording):
        return LostMotion(valid=False, reason=why)
    curve, speed = curve_of(drive, recording)
    if why := _not_slow(curve, at):
        return LostMotion(valid=False, reason=why)
    return measure_lost_motion(drive, curve, speed, at)


def _no_curve(drive: Drive, recording: Recording) -> str:
    """Return why a recording cannot contain a curve; empty if it can."""
    time, load = recording.time, recording.load
    if why := wrong_command(drive, recording):
        return why
    if why := movement(load, recording.travel):
        return why
    if np.max(np.diff(time)) >= HOLE * np.median(np.diff(time)):
        return f"the recording has a hole of more than {HOLE} periods"
    return ""


def _not_slow(curve: Curve, at: float) -> str:
    """Return why a curve does not show the lost motion at +-``at`` (N m); empty if it may."""
    turns = np.flatnonzero(np.diff(curve.branch))
    if turns.size < _TURNS:
        return (
            f"the torque turned {turns.size} times, and must turn at least {_TURNS} times: for two cycles, and for the "
            "ways before and after them, which do not count"
        )
    if (apart := float(np.median(np.diff(curve.time[turns])))) < _SLOW:
        return (
            f"the torque turned every {apart:.2g} s, and must not turn more often than every {_SLOW:g} s: "
            "inertia would take a part of it"
        )
    between = curve.motor - curve.load
    if float((between - np.mean(between)) @ (curve.torque - np.mean(curve.torque))) <= 0.0:
        return (
            "the motor goes against its torque: check the sign of the command, and that its encoder counts in the "
            "direction of the gear"
        )
    largest = float(np.max(np.abs(curve.torque)))
    if at > _BORNE * largest:
        return f"the lost motion is wanted at +-{at:.3g} N m, but the torque reaches only {largest:.3g} N m"
    return ""


def hysteresis_findings(found: LostMotion) -> tuple[Finding, ...]:
    """Return the findings of a valid curve: gap, lost motion, stiffness of both flanks, friction."""
    borne = f" where they bear {found.gap_torque:.2g} N m" if found.gap_torque else ""
    rows = [
        Finding(
            "",
            "b at rest",
            f"the gap, by the hysteresis curve, teeth by the {found.contact} law{borne}",
            "rad",
            found.gap,
            found.gap_uncertainty,
        ),
        Finding(
            "",
            "lost motion",
            f"lost motion at +-{found.at:.3g} N m, by the hysteresis curve",
            "rad",
            found.lost_motion,
            found.lost_motion_uncertainty,
        ),
    ]
    for flank, stiffness, uncertainty in zip(
        ("negative", "positive"), found.stiffness, found.stiffness_uncertainty, strict=True
    ):
        symbol, what = f"stiffness {'-+'[flank == 'positive']}", f"torsional stiffness of the {flank} flank"
        if uncertainty < _SEEN * stiffness:
            rows.append(Finding("", symbol, what, "N m/rad", stiffness, uncertainty))
        else:
            rows.append(Finding("", symbol, what, "N m/rad", why="more than the encoders' counts show"))
    # The teeth's loss is hard to separate from friction: its part at half of the torque could be either.
    unsure = math.hypot(found.friction_uncertainty, 0.5 * found.loss * found.torque, _FRICTION * found.friction)
    friction = "friction of motor and gear, at the output"
    rows.append(Finding("", "friction", friction, "N m", found.friction, unsure))
    shown = _lost_motions(found.ramps) if found.ramps is not None else ()
    return (*rows, *(row for row in shown if row.symbol != "lost motion T, C"))  # that is the lost motion above


def _row(symbol: str, what: str, unit: str, figure: Figure, why: str) -> Finding:
    if figure.found:
        return Finding("", symbol, what, unit, figure.mean, figure.uncertainty)
    return Finding("", symbol, what, unit, why=why)


def _lost_motions(ramps: Ramps) -> list[Finding]:
    """Return what is lost between the branches of valid ramps, and the torques that end it."""
    at, few = f"+-{ramps.at:.3g} N m", "fewer than two ramps show it"
    beyond = few if ramps.at <= ramps.torque else f"the torque reaches only {ramps.torque:.3g} N m"
    rows = [
        _row("lost motion 0", "lost motion at zero torque, between the branches", "rad", ramps.at_zero, few),
        _row("lost motion T", f"lost motion at {at}, on the ways back", "rad", ramps.at_torque, beyond),
        _row("lost motion T, C", f"the same without friction, at {at}", "rad", ramps.without_friction, beyond),
        _row("width", "width of the hysteresis, the largest distance of the branches", "rad", ramps.width, few),
    ]
    for sign, figure in zip(("negative", "positive"), ramps.breakaway, strict=True):
        symbol = f"T {'-+'[sign == 'positive']}"
        rows.append(_row(symbol, f"breakaway torque in {sign} direction", "N m", figure, few))
    return rows


def ramps_findings(ramps: Ramps) -> tuple[Finding, ...]:
    """Return the findings of valid ramps."""
    rows = _lost_motions(ramps)
    ways = [(way, side) for way in ("out", "back") for side in "-+"]
    for (way, side), figure in zip(ways, ramps.stiffness, strict=True):
        flank = "positive" if side == "+" else "negative"
        what = f"stiffness of the {flank} flank on the way {way}"
        seen = figure if figure.uncertainty < _SEEN * figure.mean else Figure()
        rows.append(_row(f"k {way} {side}", what, "N m/rad", seen, "more, or less even, than the ramps show"))
    return tuple(rows)
