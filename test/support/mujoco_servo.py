"""A drive whose plant is its MuJoCo export, behind the same encoders and the same delay as the simulated drive.

Imported only where MuJoCo is installed; it needs 3.7 or later, which has the winding.
"""

import math
from collections import deque
from dataclasses import replace

import mujoco
import numpy as np

from backlash_ros.control import ServoSettings
from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.delay import LINE, Delay
from backlash_ros.export import mjcf
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member
from backlash_ros.studies.evaluation.task import settings_for

SEED = 20261124
HAS_DC_MOTOR = tuple(int(part) for part in mujoco.__version__.split(".")[:2]) >= (3, 7)
PARTS = 2
"""Of a period: the population's delays are whole and half periods of the command."""


class MujocoServoDrive(SimulatedDrive):
    """A member of a population, moved by MuJoCo."""

    def __init__(self, member: Member) -> None:
        super().__init__(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=member.delay)
        assert member.delay == Delay(command=member.delay.command)
        late = member.delay.command * member.rate * PARTS
        assert late == round(late)
        self._acting = deque([0.0] * round(late))
        self._model = mujoco.MjModel.from_xml_string(mjcf(Axis(member.drive)))
        part = 1.0 / (PARTS * member.rate)
        self._steps = math.ceil(part / self._model.opt.timestep - 1e-9)
        self._model.opt.timestep = part / self._steps
        self._data = mujoco.MjData(self._model)

    def advance(self, command: float, load_torque: float = 0.0) -> None:
        """Send a command, and advance to the next sample."""
        limit, data = self.drive.command_limit, self._data
        self._acting.extend([min(max(command, -limit), limit)] * PARTS)
        for _ in range(PARTS):
            data.ctrl[:] = self._acting.popleft(), load_torque
            mujoco.mj_step(self._model, data, self._steps)
        assert np.all(np.isfinite(data.qpos))
        self.state[[THETA_M, THETA_L]], self.state[[OMEGA_M, OMEGA_L]] = data.qpos, data.qvel
        self._sample += 1
        self._line.taken[self._sample % LINE] = self.state


def of_steel(number: int, encoders: str = "both") -> Member:
    """Return a drive of `core` with teeth that T_s/4 winds up by 0.02 to 0.1 b and that are damped by 0.05 to 1.

    T_s is the stall torque. MuJoCo has them as a spring and a damper that also pulls.
    """
    member, rng = draw_member(SEED, number, "core", encoders), np.random.default_rng([SEED, number])
    drive, (share, damping) = member.drive, rng.random(2)
    wind_up = 0.02 * 5.0**share * drive.gear.backlash_angle / (0.25 * drive.standstill_torque())
    both = drive.load.inertia * drive.reflected_inertia / drive.effective_inertia
    damper = 2.0 * (0.05 + 0.95 * damping) * math.sqrt(both / wind_up) / drive.gear.load_radius**2
    contact = ElasticContact(wind_up=wind_up, damping=damper)
    return replace(member, drive=replace(drive, gear=replace(drive.gear, contact=contact)))


def known(member: Member) -> ServoSettings:
    """Return the settings of a controller that knows a drive and its gap, with the law of planned moves."""
    settings = settings_for(member.drive, member).with_law("planned")
    return replace(settings, backlash_angle=member.drive.gear.backlash_angle, identified=True)
