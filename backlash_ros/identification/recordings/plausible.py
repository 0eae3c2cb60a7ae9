"""Checks whether a recording is what it claims to be: units, directions, enough motion; before and after the fit."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.counts import count_of
from backlash_ros.identification.fitting.problem import motor_side
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.regression import guess_of

SAMPLES = 100
"""Smallest number of samples; tuned."""
LENGTH = 0.4
"""Shortest duration, s; tuned."""
COUNTS = 10
"""Smallest motion of each shaft, in counts; tuned."""
_LIMIT = 1.02
"""Multiple of the drive's largest command beyond which a unit is wrong; tuned."""
_FAST = 1.5
"""Multiple of the drive's no-load speed beyond which a unit is wrong; tuned."""
_FARTHER = 1.5
"""Times the motor's way that the load may go; tuned."""
_LOST = 0.5
"""Part of the motor's way that a gap may take from the load's, rad; tuned."""
_ALIKE = 0.9
"""Least correlation of both angles that says something of their scale; tuned."""
_BETTER = 0.3
"""Share of the misfit as told that what is suspected may leave; tuned."""
_GOOD = 0.1
"""Share of the torque that what is suspected may leave unexplained; tuned."""
_INERTIAS = (0.02, 20.0)
"""Inertias of the load over that of the motor between which what is suspected has to find it; tuned."""
_DEGREE = math.degrees(1.0)


def speed_of(time: Array, angle: Array) -> float:
    """Return the largest speed over five readings, rad/s."""
    read = np.isfinite(angle)
    time, angle = time[read], angle[read]
    return float(np.max(np.abs((angle[5:] - angle[:-5]) / (time[5:] - time[:-5])), initial=0.0))


def wrong_command(drive: Drive, recording: Recording) -> str:
    """Return why a recording contains too little, or a command that cannot be the drive's; else an empty text."""
    time, command = recording.time, recording.command
    length, largest = float(time[-1] - time[0]), float(np.nanmax(np.abs(command), initial=0.0))
    if time.size < SAMPLES or length < LENGTH:
        return (
            f"a recording must have at least {SAMPLES} samples and {LENGTH:g} s without a hole, "
            f"got {time.size} samples in {length:.3g} s"
        )
    if largest > _LIMIT * drive.command_limit:
        return (
            f"the command reaches {largest:.4g} {drive.command_unit}, but the drive obeys at most "
            f"{drive.command_limit:g} {drive.command_unit}: check the command's unit, and motor.voltage_limit or "
            "motor.current_limit of the drive"
        )
    if np.nanmax(command) == np.nanmin(command):
        return f"the command never changes: it is always {largest:g} {drive.command_unit}"
    return ""


def implausible(drive: Drive, recording: Recording) -> str:
    """Return why a recording cannot be used for a drive, in a sentence; else an empty text."""
    if why := wrong_command(drive, recording):
        return why
    time, motor, load = recording.time, recording.motor, recording.load
    for name, angle in (("motor", motor), ("load", load)):
        way, count = float(np.nanmax(angle) - np.nanmin(angle)), count_of(angle)
        if way < COUNTS * count or way == 0.0:
            return (
                f"the {name} moved by {way:.2g} rad at the output, {way / count:.0f} counts of its encoder, "
                f"and must move by at least {COUNTS}"
            )
    side = motor_side(drive)
    if side.braking > 0.0:
        fastest = _FAST * side.gain * drive.command_limit / side.braking
        for name, angle in (("motor", motor), ("load", load)):
            if (speed := speed_of(time, angle)) > fastest:
                return (
                    f"the {name} turned at {speed:.3g} rad/s at the output, but the motor reaches at most "
                    f"{fastest / _FAST:.3g} rad/s: check the unit of the angle and of the time, where the angle begins "
                    "again, and the shaft that it is counted at"
                )
    return _wrong_scale(drive, motor, load)


def _wrong_scale(drive: Drive, motor: Array, load: Array) -> str:
    both = np.isfinite(motor + load)
    x, y = motor[both] - np.mean(motor[both]), load[both] - np.mean(load[both])
    correlation = float(x @ y / math.sqrt((x @ x) * (y @ y)))
    scale = math.copysign(math.sqrt(float((y @ y) / (x @ x))), correlation)
    lost = float(np.ptp(motor[both]) - np.ptp(load[both]))
    if abs(correlation) < _ALIKE or (0.0 < scale < _FARTHER and lost < _LOST):
        return ""
    return (
        f"the load's angle grows {scale:.3g} times as fast as the motor's at the output; both must grow equally fast"
        f"{_explained(scale, drive.gear.ratio)}"
    )


def _explained(scale: float, ratio: float) -> str:
    """Return the likely cause of a scale."""
    shafts = {
        ratio: "the motor's angle seems to be counted at the motor, before the gear",
        1.0 / ratio: "the motor's angle seems to be counted at the output, behind the gear",
        ratio**-2: "motor and load seem to be swapped",
    }
    units = {
        1.0: "",
        _DEGREE: "the load's angle seems to be in degrees",
        1.0 / _DEGREE: "the motor's angle seems to be in degrees",
        2.0 * math.pi: "the motor's angle seems to be in turns",
        0.5 / math.pi: "the load's angle seems to be in turns",
    }
    said = [] if scale > 0.0 else ["the encoders count in opposite directions"]
    for factor, text in {**units, **shafts}.items():
        if text and abs(math.log(abs(scale) / factor)) < 0.1:
            said.append(text)
            break
    return f": {' and '.join(said)}" if said else ": check gear.reduction, units and counts for each turn"


def _otherwise(drive: Drive, recording: Recording) -> Iterator[tuple[str, Recording]]:
    """Yield what could be wrong, with the corrected recording."""
    _, motor, load, command, _ = recording
    per_volt = drive.motor.resistance
    yield (
        "the command seems to turn the motor backwards, or both encoders to count so",
        recording._replace(command=-command),
    )
    for text, factor in (("degrees", _DEGREE), ("turns", 0.5 / math.pi)):
        scaled = recording._replace(motor=motor / factor, load=load / factor)
        yield f"both angles seem to be in {text}", scaled
    yield "motor and load seem to be swapped", recording._replace(motor=load, load=motor)
    yield (
        "the command seems to be in amperes" if not drive.takes_current else "the command seems to be in volts",
        recording._replace(command=command / per_volt if drive.takes_current else command * per_volt),
    )


def suspicion(drive: Drive, recording: Recording, delays: Sequence[float]) -> str:
    """Return a description that fits a recording much better than the given one; empty if there is none.

    ``delays`` from a sample to when its command acts, s: those to try.
    """
    side = motor_side(drive)
    low, high = (share * side.inertia for share in _INERTIAS)

    def misfit(recording: Recording) -> float:
        guess = min((guess_of(side, recording, delay) for delay in delays), key=lambda guess: guess.misfit)
        share = guess.misfit / float(np.nanstd(side.gain * recording.command))
        return share if low < guess.inertia < high else math.inf

    told = misfit(recording)
    found = min(((misfit(other), text) for text, other in _otherwise(drive, recording)), default=(math.inf, ""))
    return found[1] if found[0] < min(_BETTER * told, _GOOD) else ""
