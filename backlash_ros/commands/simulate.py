"""`backlash simulate`: its arguments; simulates a step or a path, judges, prints, draws and writes."""

import argparse
import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from backlash_ros.commands.command import DONE, NOTHING, Command
from backlash_ros.commands.output import print_json, staged
from backlash_ros.control import AUTO, LAWS, Polynomials, Servo, ServoSettings, design_law
from backlash_ros.control.design.start import CannotStartError
from backlash_ros.control.encoders import encoders_of
from backlash_ros.control.laws import BEST, UNTIL_THEN, law_of
from backlash_ros.control.motion.profile import MotionLimits
from backlash_ros.control.motion.profile_parameters import LIMITED, OF_DRIVE, STEP
from backlash_ros.control.motion.trajectory import Trajectory, TrajectoryError
from backlash_ros.drive_file.drive_file import (
    axis_of,
    law_named,
    law_parameters_of,
    read_parameters,
    start_of,
    surroundings_of,
)
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.reading.parameter_files import in_sections, merged, named
from backlash_ros.foundation.signals import STATE_NAMES, Measurement
from backlash_ros.recordings.trajectory_file import JOINED, PathFile, read_trajectory
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.simulation.simulated_drive import largest_load_torque
from backlash_ros.studies.metrics import path_figures, step_response
from backlash_ros.studies.paper import CASES, SECONDS, judge, respond
from backlash_ros.studies.replay.what_if import Changes

DESCRIPTION = (
    "Simulates one step of the reference, its profile, or a path, and prints its figures as JSON: of the nominal drive "
    "under one of the paper's conditions, or of the drive in parameter files, with their rate, sensors, delay, law and "
    "gains. A "
    "path is a table with the columns time, position[, velocity[, acceleration]] in s and rad, or a "
    "trajectory_msgs/JointTrajectory in YAML; it is followed, or refused, as on the topic joint_trajectory, under the "
    "files' limits. The controller "
    "knows the drive and its backlash, as after `identify`: law auto is 'planned', with one encoder as with both. "
    "Before, it is 'two_region' (--law two_region). A load that does not stay within a quarter of the backlash for the "
    "last second has not settled: null."
)
EXAMPLE = (
    "examples: backlash simulate --law cascade --case 'load inertia x4'; backlash simulate config/nominal_drive.yaml "
    "--set load.inertia=0.002 --reference 0.5 --plot step.png --csv step.csv; backlash simulate axis.yaml gains.yaml; "
    "backlash simulate axis.yaml --profile auto; backlash simulate axis.yaml --profile 2,50,1000; "
    "backlash simulate axis.yaml --trajectory path.csv --plot path.png"
)
_LONGEST = 600.0
"""Longest simulation, s."""
_OF_DRIVES: dict[str, Any] = {
    "set": [],
    "plot": None,
    "csv": None,
    "reference": 1.0,
    "seconds": SECONDS,
    "load_torque": 0.0,
    "trajectory": None,
    "profile": None,
}
"""Options that need a drive file, and their defaults with one."""
_OF_STEPS = "reference", "seconds", "profile"
"""Options that have no use with a path, which has its own end and length."""
_AFTER = 1.5
"""Time for which a path's end is watched, s."""
_PAPER = "two_region"
_OURS = (
    *("motor", "gear", "load", "contact", "effects", "sensors", "delay", "rate", "loop_delay", "command_interface"),
    *("gains", "gain_set", "gain_set_names", "gain_sets", "profile", "limits"),
)
"""Parameters of a file that a simulation uses, in addition to those of its law."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    text = "ROS parameter files, such as config/nominal_drive.yaml; later ones override earlier ones"
    add("drive", type=Path, nargs="*", metavar="DRIVE", help=text)
    add("--law", choices=sorted([AUTO, *LAWS]), help=f"by default that of DRIVE, or {AUTO}; {_PAPER} without DRIVE")
    add("--case", choices=list(CASES), help="a condition of the paper, without DRIVE; by default nominal")
    text = "with DRIVE, as often as needed: a parameter of drive, effects, sensors, delay, limits, gain sets or laws"
    add("--set", action="append", default=[], metavar="NAME=VALUE", help=text)
    text = "with DRIVE: target of the load, which starts at 0; by default 1"
    add("--reference", type=float, metavar="RAD", help=text)
    add("--seconds", type=float, metavar="S", help=f"with DRIVE; by default {SECONDS:g}")
    text = "with DRIVE: constant torque on the output, N m; by default 0"
    add("--load-torque", type=float, metavar="T", help=text)
    text = "with DRIVE: follow the path in this table or YAML file, from 0, instead of a step"
    add("--trajectory", type=Path, metavar="FILE", help=text)
    text = (
        "with DRIVE: how the setpoint goes to the reference: step, auto, within what the drive can do, or within "
        "limits in rad/s, rad/s^2, rad/s^3; by default as profile.mode of DRIVE says"
    )
    add("--profile", metavar="{step,auto,V,A,J}", help=text)
    add("--plot", type=Path, metavar="FILE", help="with DRIVE: file for a picture, such as step.png")
    add("--csv", type=Path, metavar="FILE", help="with DRIVE: file for a table with one row per sample, true values")
    add("--force", action="store_true", help="overwrite existing files")


def _changes(given: Sequence[str], law: str) -> Mapping[str, Any]:
    laws = [f"laws.{name}." for name in ((BEST, UNTIL_THEN) if law == AUTO else (law,))]
    changes = Changes.parsed(given).given
    for name, value in changes.items():
        if name.partition(".")[0] not in _OURS and not name.startswith(tuple(laws)):
            known = ", ".join([*_OURS, *(f"{law}*" for law in laws)])
            raise ValueError(f"--set must be a parameter that a simulation goes by ({known}), got {name}={value!r}")
    return in_sections(changes)


def _profile(given: str | None) -> Mapping[str, Any]:
    """Return the parameters that ``--profile`` stands for, in sections; ValueError if it stands for none."""
    if given is None:
        return {}
    if given in (STEP, OF_DRIVE):
        return {"profile": {"mode": given}}
    try:
        velocity, acceleration, jerk = map(float, given.split(","))
    except ValueError:
        raise ValueError(
            f"--profile must be {STEP}, {OF_DRIVE} or V,A,J in rad/s, rad/s^2, rad/s^3, got {given!r}"
        ) from None
    return {"profile": {"mode": LIMITED, "velocity": velocity, "acceleration": acceleration, "jerk": jerk}}


def _check(name: str, value: float, least: float, most: float, unit: str) -> None:
    if not least <= value <= most:
        raise ValueError(f"{name} must be >= {least:g} and <= {most:g} {unit}, got {value!r}")


def _check_design(drive: Drive, settings: ServoSettings) -> None:
    """Raise CannotStartError if the law cannot be designed for a drive."""
    try:
        design_law(drive, settings)
    except ValueError as error:
        raise CannotStartError(str(error)) from error


def _simulated(given: argparse.Namespace) -> tuple[Run, PathFile | MotionLimits | None]:
    """Return the requested run, and the path or the limits of the profile that it followed, None for a step.

    ValueError names what is wrong.
    """
    _check("--seconds", given.seconds, 0.1, _LONGEST, "s")
    _check("--reference", abs(given.reference), 1e-6, 1e3, "rad, either way")
    try:
        parameters = read_parameters(*given.drive)
        law = given.law or law_named(parameters)
        parameters = merged(merged(parameters, _changes(given.set, law)), _profile(given.profile))
        axis = axis_of(parameters)
        path = None if given.trajectory is None else read_trajectory(given.trajectory, axis.load_joint)
        heaviest = largest_load_torque(axis.drive)
        _check(
            "--load-torque", abs(given.load_torque), 0.0, heaviest, "N m, either way, ten times what the motor holds"
        )
        around = surroundings_of(parameters)
        start = start_of(parameters, axis.drive, around)
        settings = ServoSettings(
            start.settings.gains,
            law=law,
            period=1.0 / around.rate,
            loop_delay=around.delay.mean,
            identified=True,
            encoders=encoders_of(_at_zero(around.sensors)),
            backlash_angle=axis.drive.gear.backlash_angle,
            profile=start.settings.profile,
            largest_command=start.limits.command,
        )
        law = law_of(start.drive, settings)
        settings = settings.with_law(law, law_parameters_of(parameters, law))
        _check_design(start.drive, settings)
    except TypeError as error:
        raise ValueError(str(error)) from error
    scenario = Scenario(
        np.full(max(1, round(given.seconds * around.rate)), given.reference),
        np.array(given.load_torque),
        sensors=around.sensors,
        delay=around.delay,
    )
    if path is None and settings.profile.mode == STEP:
        if refusal := start.limits.rejection_reason(given.reference, 0.0):
            raise ValueError(f"--reference: {refusal}")
        return run(axis.drive, settings, scenario, model=start.drive, limits=start.limits), None
    settings = replace(settings, thresholds=start.settings.thresholds)
    servo = Servo(start.drive, settings, start.limits)
    servo.update(_at_zero(around.sensors))  # it holds the load there
    refusal = servo.set_reference(given.reference) if path is None else _refusal(servo, path.trajectory)
    if refusal:
        raise ValueError(f"{given.trajectory or '--reference'}: {refusal}")
    if path is not None:
        length = float(path.trajectory.times[-1]) + _AFTER
        _check(f"{given.trajectory}: time to the end of the path", length - _AFTER, 0.0, _LONGEST, "s")
        scenario = replace(scenario, reference=np.zeros(math.ceil(length * around.rate)))
    scenario = replace(scenario, source=Polynomials(servo.segments))
    followed = servo.motion if path is None else path
    return run(axis.drive, settings, scenario, model=start.drive, limits=start.limits), followed


def _at_zero(sensors: Sensors) -> Measurement:
    """Return the sample of a drive at 0; nan where nothing is measured."""
    return Measurement(np.array([0.0 if name in sensors.measured else math.nan for name in STATE_NAMES]))


def _refusal(servo: Servo, path: Trajectory) -> str:
    """Return why a controller refuses a path; empty if it follows it."""
    try:
        return servo.follow(path, at_once=True)
    except TrajectoryError as error:
        return str(error)


def _figures(result: Run, reference: float) -> dict[str, Any]:
    gear = result.drive.gear
    b = gear.backlash_angle
    judged = step_response(
        result.time,
        result.load_angle,
        result.gap,
        target=reference,
        backlash=gear.backlash,
        backlash_angle=b,
    )
    return {
        "rise_time_s": judged.rise_time,
        "settling_time_s": judged.settling_time,
        "overshoot_b": max(0.0, judged.overshoot),
        "residual_b": judged.residual,
        "impacts_after_switch": judged.impacts,
        "final_error_b": float(result.load_angle[-1] - reference) / b,
        **_largest(result),
    }


def _profile_figures(result: Run, motion: MotionLimits) -> dict[str, Any]:
    error = result.load_angle[:-1] - result.setpoint
    return {
        "profile": asdict(motion),
        "largest_error_b": float(np.max(np.abs(error))) / result.drive.gear.backlash_angle,
    }


def _path_figures(result: Run, path: PathFile) -> dict[str, Any]:
    b, samples = result.drive.gear.backlash_angle, slice(0, -1, None)
    end = float(path.trajectory.times[-1])
    judged = path_figures(result.time[samples], result.load_angle[samples], result.setpoint, end)
    return {
        "points": path.trajectory.times.size,
        "joined_by": JOINED[path.trajectory.states.shape[1] - 1],
        "notes": path.notes,
        "end_s": end,
        "rms_error_b": judged.rms / b,
        "largest_error_b": judged.largest / b,
        "final_error_b": judged.final / b,
        "rms_error_rad": judged.rms,
        "largest_error_rad": judged.largest,
        "final_error_rad": judged.final,
        "lag_s": judged.lag,
        "reversals": judged.reversals,
        **_largest(result),
    }


def _largest(result: Run) -> dict[str, Any]:
    return {
        "peak_force_N": float(np.max(result.peak_force)),
        "peak_command": float(np.max(np.abs(result.command))),
        "fault": result.fault,
    }


def _write_table(result: Run, place: Path) -> None:
    table = result.table()
    with place.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*(values.tolist() for _, values in table.values()), strict=True))


def _write_picture(result: Run, title: str, place: Path, largest: float) -> None:
    """Draw the run; of a path, whose ``largest`` error, b, is given, all of it."""
    import matplotlib  # noqa: PLC0415 - takes a second
    import matplotlib.pyplot as plt  # noqa: PLC0415

    matplotlib.use("Agg")
    figure = result.plot()
    whole, near, *_ = figure.axes
    if largest:  # a path, which may be anywhere: the legend stands beside the title
        whole.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncol=3, frameon=False, fontsize="small")
        reach = max(1.1 * largest, *near.get_ylim())
        near.set_ylim(-reach, reach)
    figure.suptitle(title, fontsize="medium")
    figure.savefig(place, dpi=110)
    plt.close(figure)


def simulate(given: argparse.Namespace, console: Console) -> int:
    """Simulate and print; return 1 if the controller latched a fault, else 0. Files appear complete or not at all.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read, a parameter or an option is out of bounds, or options contradict each other.
    """
    if not given.drive:
        for name in _OF_DRIVES:
            if getattr(given, name) not in ([], None):
                raise ValueError(f"--{name.replace('_', '-')} needs DRIVE, a parameter file")
        case = given.case or "nominal"
        condition = CASES[case]
        law = _PAPER if given.law in (None, AUTO) else given.law
        figures = judge(respond(law, condition), condition)
        print_json(console, {"law": law, "case": case, **figures})
        return DONE
    for name in _OF_STEPS:
        if given.trajectory is not None and getattr(given, name) is not None:
            raise ValueError(f"--{name} has no use with --trajectory")
    for name, default in _OF_DRIVES.items():
        if getattr(given, name) is None:
            setattr(given, name, default)
    files = named(given.drive)
    if given.case is not None:
        raise ValueError(f"--case is of the nominal drive: leave it or {files} out")
    result, followed = _simulated(given)
    path = followed if isinstance(followed, PathFile) else None
    figures = _figures(result, given.reference) if path is None else _path_figures(result, path)
    if isinstance(followed, MotionLimits):
        figures |= _profile_figures(result, followed)
    with staged(given.plot, given.csv) as written:
        if given.csv is not None:
            _write_table(result, written[given.csv])
        if given.plot is not None:
            title = files if path is None else f"{files}, {given.trajectory}"
            _write_picture(result, title, written[given.plot], figures.get("largest_error_b", 0.0))
    content = {
        "law": result.law,
        "drive": files,
        "set": given.set,
        **({} if path is None else {"trajectory": str(given.trajectory)}),
        **figures,
    }
    print_json(console, content)
    return NOTHING if result.fault else DONE


COMMAND = Command(simulate, add_arguments, written=("plot", "csv"))
