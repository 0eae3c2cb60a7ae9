"""A controller that was told a drive's data sheet, and that drive, in lockstep: what it finds is for tests to judge."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from graph import Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from rclpy.task import Future
from std_srvs.srv import Trigger

from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.ros.parameters import Declarations, declare_drive
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, told_model
from backlash_ros.studies.evaluation.task import first_reading, true_reading

Start = Callable[..., Process]
FAULTS = tuple(f"faults.{name}" for name in ("velocity", "load_torque", "gap"))
GAINS = "gain_set", "gains.fast.k", "gains.overdamped.k"
EXPECTED = tuple(f"expected_load_torque{part}" for part in ("", "_angle", "_slope"))
UNEXPLAINED = "unexplained_motor_torque", "unexplained_load_torque"
OTHERS = "backlash_angle", *EXPECTED, *UNEXPLAINED, "identified", "loop_delay", *FAULTS, *GAINS
_NODE: Any = Declarations()
NAMES = [*declare_drive(_NODE), *OTHERS]
"""Parameters of the drive, and what follows from them or is found beside."""


class Rig:
    """A controller that was told a drive's data sheet, and that drive: our simulator's, or another ``plant``."""

    def __init__(
        self,
        start: Start,
        peer: Peer,
        folder: Path,
        member: Member,
        plant: SimulatedDrive | None = None,
        **parameters: Any,
    ) -> None:
        self.member, self.peer = member, peer
        model = told_model(member, "identified")
        file = folder / "data_sheet.yaml"
        told = {**values_of(model), "rate": member.rate, "state_timeout": 10.0}
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": told}}))
        self.process = start("controller", "--params-file", str(file), **parameters)
        self.parameters = Parameters(peer, "controller")
        self.start = first_reading(member)
        own = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)
        self.drive = LockstepDrive(peer, member.rate, simulated=plant or own)
        self.drive.load_torque = member.load_torque
        self.drive.matched()

    def in_use(self) -> dict[str, Any]:
        return dict(zip(NAMES, self.parameters.get(*NAMES), strict=True))

    def answer(self, asked: Future) -> Trigger.Response:
        """Go on, sample by sample, until there is an answer."""
        self.drive.until(asked.done)
        return asked.result()

    @property
    def reading(self) -> float:
        """What a perfect encoder reads of the load, rad."""
        return float(true_reading(self.member, np.array([self.drive.load_angle]))[0])

    def begin(self, service: str) -> Future:
        """Ask, and go on until the experiment has begun."""
        began, output = ("identifying the drive", "learning the backlash"), self.process.output
        before = sum(output().count(text) for text in began)
        asked = self.peer.request(service)
        self.drive.until(lambda: sum(output().count(text) for text in began) > before)
        return asked

    def step(self, way: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Give a reference so far from where it began; return time and what a perfect encoder reads."""
        before = self.reading
        self.drive.set_reference(self.start + way)
        angles = self.drive.run(round(seconds * self.member.rate))
        position = np.array([before, *true_reading(self.member, angles)])
        return np.arange(position.size) / self.member.rate, position
