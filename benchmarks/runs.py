"""What `batch.py` runs by number: a drive of the population in the closed loop, and its plant alone."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np

from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.motion.integrator import DEFAULT_TOLERANCE, DONE, integration_memory, integrator_for
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, at_rest
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.studies.evaluation import draw_member
from backlash_ros.studies.evaluation.population import Member, told_model
from backlash_ros.studies.evaluation.task import first_reading, settings_for

SEED = 1


def _step(number: int, seconds: float) -> tuple[Member, Run]:
    """Run a drive with the law of two regions, a step of 1 rad; it is told its gap."""
    member = draw_member(SEED, number)
    model = told_model(member, "nominal")
    settings = replace(
        settings_for(model, member).with_law("two_region"), backlash_angle=member.drive.gear.backlash_angle
    )
    reference = np.full(round(seconds * member.rate), first_reading(member) + 1.0)
    torque = np.array(member.load_torque)
    scenario = Scenario(reference, torque, sensors=member.sensors, delay=member.delay)
    return member, run(member.drive, settings, scenario, model=model)


def closed_loop(drives: int, seconds: float, number: int) -> dict[str, Any]:
    """Run one of the first ``drives`` drives; return what the batch writes down, and this process's memory, kB."""
    _, done = _step(number % drives, seconds)
    return {"angle": float(done.load_angle[-1]), "fault": done.fault, "memory": peak_memory()}


def peak_memory() -> int:
    """Return the most memory that this process has had so far, kB."""
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])


@dataclass(frozen=True)
class Recorded:
    """The commands of a closed loop as they acted, each for ``duration`` s, and where the load was in the end, rad."""

    member: Member
    commands: Array
    duration: float
    angle: float

    def play(self) -> float:
        """Return where the load is in the end if the plant plays this alone, rad."""
        drive, state = self.member.drive, at_rest()
        status = _advance_all(
            *(integrator_for(drive), plant_constants(drive), state, integration_memory()),
            *(self.commands, self.member.load_torque, self.duration, DEFAULT_TOLERANCE),
        )
        if status != DONE:
            raise RuntimeError(f"drive {self.member.number}: not integrated")
        return float(state[THETA_L])


@numba.njit
def _advance_all(advance, plant, state, memory, commands, torque, duration, tolerance):  # type: ignore[no-untyped-def]
    status = 0
    for command in commands:
        status = max(status, advance(plant, state, memory, command, torque, duration, tolerance)[0])
    return status


def record(number: int, seconds: float) -> Recorded:
    """Run a drive and return what its plant was told; delays are whole or half periods."""
    member, done = _step(number, seconds)
    late = round(2.0 * member.delay.command * member.rate)
    commands = np.clip(done.command, -member.drive.command_limit, member.drive.command_limit)
    parts = 1 + late % 2
    acting = np.repeat(commands, parts)
    shift = late * parts // 2
    acting = np.concatenate([np.zeros(shift), acting])[: acting.size]
    return Recorded(member, acting, 1.0 / (parts * member.rate), float(done.load_angle[-1]))
