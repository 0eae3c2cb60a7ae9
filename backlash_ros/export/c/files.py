"""All files of a controller in C by name: header, constants, object file, self-test, recording, example, README."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import backlash_ros
from backlash_ros.control import LAWS, Servo, design_law
from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.design.choice import Choice
from backlash_ros.control.laws import lacks, law_of
from backlash_ros.control.monitoring.fault_texts import FaultDetails
from backlash_ros.control.motion.moving_reference import MotionMemory
from backlash_ros.control.motion.profile_parameters import STEP
from backlash_ros.control.motion.setpoint import ORDER, Cursor
from backlash_ros.control.observer import ObserverMemory
from backlash_ros.control.tick import NOT_BEGUN, Inputs, Results, TickMemory
from backlash_ros.drive_file.drive_file import Surroundings
from backlash_ros.drivetrain import Drive
from backlash_ros.export.c.object_file import TARGETS, ObjectFile, object_file
from backlash_ros.export.c.recording import PLAN_ROWS, Recording, record, way_of
from backlash_ros.export.c.stand_in import stand_in
from backlash_ros.export.c.templates import number, render
from backlash_ros.foundation.record import Array, cell_of, row_of, size_of
from backlash_ros.foundation.signals import LOAD_TORQUE, OMEGA_L, STATE_NAMES, THETA_L
from backlash_ros.gates.faults import FAULTS, Fault

RECORDED = 3000
"""Samples of the self-test."""
ROWS = 128
"""Of the longest plan, as the header has it."""

_SHOWN = 4.0
"""Length of the example, s, at least."""
_PARTS = 16
"""Lines that the example prints."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
_TAKEN = {"example", "selftest"}
"""Names that files have, whatever the axis is called."""
_READINGS = "motor_angle", "motor_velocity", "load_angle", "load_velocity", "current"
"""A sample's numbers as the header calls them, in the order of the signals."""


@dataclass(frozen=True)
class Controller:
    """A controller to export.

    Parameters
    ----------
    choice : what it starts with
    drive, around : the drive as its file describes it, which the self-test simulates, and its sensors and delay
    source : the name of that file, for texts
    name : with which everything in C begins
    target : one of `TARGETS`

    Raises
    ------
    ValueError
        If the name is none for C, or the law lacks something: an encoder, or that drive or backlash were identified.
    """

    choice: Choice
    drive: Drive
    around: Surroundings
    source: str
    name: str = "axis"
    target: str = next(iter(TARGETS))

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.name in _TAKEN:
            raise ValueError(
                "name must begin with a small letter and have up to 31 small letters, digits and _, and must not be "
                f"example or selftest, got {self.name!r}"
            )
        settings = self.choice.settings
        if settings.law in LAWS and (missing := lacks(settings)):
            raise ValueError(
                f"law = {settings.law!r} acts once {missing}, which {self.source} does not say: set backlash_angle and "
                "identified, as `backlash identify` and ~/identify do, or take another law"
            )
        if settings.profile.mode != STEP:
            raise ValueError(
                f"profile.mode must be {STEP!r}: in C a reference is a step, got {settings.profile.mode!r}; let your "
                "program plan the motion, and follow it as a plan"
            )
        if (zero := self.choice.values["zero"]) != 0.0:
            raise ValueError(f"zero must be 0 rad: in C positions count as the encoders do, got {zero:g}")
        measured = self.around.sensors.measured
        if LAWS[self.law].both_encoders and not {"theta_m", "theta_l"} <= set(measured):
            raise ValueError(f"law = {self.law!r} needs both encoders, got sensors.measured = {list(measured)}")

    @property
    def law(self) -> str:
        """The name of the law that acts."""
        return law_of(self.choice.drive, self.choice.settings)


def files_of(controller: Controller, steps: int = RECORDED) -> dict[str, bytes]:
    """Return the content of each file by its name, with a recording of so many steps.

    Raises
    ------
    ValueError
        If the law cannot be exported: see `object_file`.
    IntegrationError
        If the drive cannot be simulated.
    """
    choice, name = controller.choice, controller.name
    servo = Servo(choice.drive, choice.settings, choice.limits)
    laws = {
        f"{name}_tick": ActingLaw(design_law(choice.drive, choice.settings)),
        f"{name}_slow_tick": ActingLaw(design_law(choice.drive, choice.settings.with_law("overdamped"))),
    }
    compiled = object_file(laws, controller.target)
    recording = record(choice, controller.drive, controller.around, steps)
    values = _values(controller, servo, *laws.values()) | _about(controller, compiled, steps)
    texts = {
        f"{name}.h": "axis.h.j2",
        f"{name}.c": "axis.c.j2",
        f"{name}_drive.h": "drive.h.j2",
        "selftest.c": "selftest.c.j2",
        "example.c": "example.c.j2",
        "README.md": "README.md.j2",
    }
    made = {file: render(template, **values) for file, template in texts.items()}
    made[f"{name}_recording.h"] = render("recording.h.j2", **values, **_recorded(recording))
    return {**{file: text.encode() for file, text in made.items()}, f"{name}_tick.o": compiled.content}


def _values(controller: Controller, servo: Servo, law: ActingLaw, slow: ActingLaw) -> dict[str, Any]:
    """Return what the templates of C name."""
    name, settings = controller.name, controller.choice.settings
    measured, (start, way) = controller.around.sensors.measured, way_of(controller.choice)
    arrays = {
        "constants": (servo.constants, "Monitor, observer, range, setpoint."),
        "law": (law.law.constants, "The law."),
        "slow_law": (slow.law.constants, "The over-damped gains, which act while an encoder is missing."),
        "first_memory": (row_of(TickMemory), "What is remembered before the first sample."),
        "first_state": (law.law.state, "The law's state then."),
        "first_slow_state": (slow.law.state, "That of the over-damped gains."),
        "no_inputs": (row_of(Inputs), "What comes with a sample, beside it."),
    }
    cells = size_of(TickMemory), law.law.state.size, slow.law.state.size
    shown = stand_in(controller.drive, settings.period, start, way)
    return {
        "name": name,
        "N": name.upper(),
        "version": backlash_ros.__version__,
        "source": controller.source,
        "law": controller.law,
        **_bounds(controller.choice),
        "faults": list(_faults()),
        "both_encoders": LAWS[controller.law].both_encoders,
        "memory": cells[0],
        "state": cells[1],
        "slow_state": cells[2],
        "bytes": 8 * (sum(cells) + 7 * ROWS + 3) + 8,
        "rows_at_most": ROWS,
        "cells": _cells(),
        "inputs": size_of(Inputs),
        "not_begun": number(NOT_BEGUN),
        "bernstein": [
            [number(math.comb(j, k) / math.comb(ORDER, k)) for k in range(ORDER + 1)] for j in range(ORDER + 1)
        ],
        "arrays": [
            {"name": each, "size": row.size, "meaning": meaning, "lines": list(_lines(row))}
            for each, (row, meaning) in arrays.items()
        ],
        "samples": _PARTS * max(round(_SHOWN / settings.period / _PARTS), 64),
        "readings": [
            f"drive.{each}" if signal in measured else "NAN"
            for signal, each in zip(STATE_NAMES, _READINGS, strict=True)
        ],
        "stand_in": {
            constant: (number(value) if isinstance(value, float) else value, meaning)
            for constant, (value, meaning) in shown.items()
        },
    }


def _bounds(choice: Choice) -> dict[str, str]:
    """Return the period, and what bounds commands and references."""
    limits, settings, drive = choice.limits, choice.settings, choice.drive
    return {
        "period": number(settings.period),
        "unit": drive.command_unit,
        "command_limit": number(min(drive.command_limit, limits.command)),
        "lower": number(limits.position_lower),
        "upper": number(limits.position_upper),
        "step": number(limits.step),
        "fastest": number(settings.thresholds_of(drive).velocity),
    }


def _about(controller: Controller, compiled: ObjectFile, steps: int) -> dict[str, Any]:
    """Return what the README names beside that."""
    choice = controller.choice
    return {
        "functions": ", ".join(f"`{function}`" for function in compiled.maths),
        "target": controller.target,
        "cpu": TARGETS[controller.target],
        "cross": controller.target != next(iter(TARGETS)),
        "steps": steps,
        "way": f"{way_of(choice)[1]:g}",
        "delay": f"{choice.settings.loop_delay:g}",
        "reduction": f"{controller.drive.gear.reduction:g}",
    }


def _faults() -> Iterator[Mapping[str, Any]]:
    """Yield the faults that the tick finds, and that of a loop without samples."""
    for fault in Fault:
        if fault <= Fault.NO_SAMPLES:
            yield {
                "name": fault.name,
                "value": fault.value,
                "meaning": FAULTS[fault].meaning if fault else "",
            }


def _cells() -> dict[str, int]:
    """Return where the numbers are that C reads or sets, by the names that it has for them."""

    def at(name: str) -> int:
        return cell_of(TickMemory, name)

    estimate = at("observer") + cell_of(ObserverMemory, "estimate")
    details = at("results") + cell_of(Results, "details")
    return {
        "SAMPLE": at("used"),
        "SETPOINT": at("setpoint"),
        "REFERENCE": at("motion") + cell_of(MotionMemory, "reference"),
        "PLAN_TIME": at("results") + cell_of(Results, "plan_time"),
        "COMMAND": at("results") + cell_of(Results, "command"),
        "FAULT": at("results") + cell_of(Results, "fault"),
        "FAULT_VALUE": details + cell_of(FaultDetails, "value"),
        "FAULT_BOUND": details + cell_of(FaultDetails, "bound"),
        "CURSOR_ROW": at("cursor") + cell_of(Cursor, "row"),
        "CURSOR_BEGINS": at("cursor") + cell_of(Cursor, "begins"),
        "LOAD_ANGLE": estimate + THETA_L,
        "LOAD_VELOCITY": estimate + OMEGA_L,
        "LOAD_TORQUE": estimate + LOAD_TORQUE,
        "ELAPSED": cell_of(Inputs, "elapsed"),
    }


def _lines(row: Array) -> Iterator[str]:
    """Yield the numbers of a row, some on each line."""
    for part in np.array_split(row, max(1, row.size // 6)):
        yield ", ".join(map(number, part)) + ","


def _recorded(recording: Recording) -> dict[str, Any]:
    """Return what the template of the recording names."""
    plans = recording.plans or [np.zeros(7)]
    return {
        "plan_rows": PLAN_ROWS,
        "plans": [", ".join(map(number, row)) for row in plans],
        "rows": [
            f"{step.event}, {number(step.value)}, {number(step.elapsed)}, "
            f"{{{', '.join(map(number, step.sample))}}}, {number(step.command)}, {step.fault}"
            for step in recording.steps
        ],
    }
