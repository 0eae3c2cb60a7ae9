"""One drive of a population, with its surroundings."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import Validated

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Member:
    """One drive of a population, with its surroundings.

    ``rate`` in Hz. ``load_torque``, N m, always acts on the output shaft; ``torque_change``, N m, is added from the
    middle of the hold on. ``delay`` acts on the command. ``effects``: names of what it has of `effects.EFFECTS`.
    """

    number: int
    drive: Drive
    sensors: Sensors
    delay: Delay
    rate: float
    load_torque: float
    torque_change: float
    effects: tuple[str, ...] = ()

    @property
    def load_count(self) -> float:
        """One count of the load's encoder, rad at the output; of the motor's if the load has none."""
        sensors = self.sensors
        if "theta_l" in sensors.measured:
            return _TURN / sensors.load_counts
        return _TURN / sensors.motor_counts * self.drive.gear.ratio

    @property
    def standing_torque(self) -> float:
        """The torque on the load at an angle of 0, N m: load torque and weight."""
        load = self.drive.load
        return self.load_torque - load.gravity_torque * math.sin(load.gravity_offset)

    @property
    def can_outrun(self) -> bool:
        """Whether the motor can outrun the load, so that the teeth part: 1.2 J_r a + 0.5 N m within the stall torque.

        a is the acceleration of the load alone under the `standing_torque`, without friction.
        """
        drive = self.drive.as_built
        needed = 1.2 * drive.reflected_inertia * abs(self.standing_torque) / drive.load.inertia + 0.5
        return needed <= drive.standstill_torque()

    @property
    def free(self) -> bool:
        """Whether only viscous friction acts on the load: no load torque, no weight, no dry friction."""
        load, motor = self.drive.load, self.drive.motor
        return not (self.load_torque or load.gravity_torque or load.coulomb_friction or motor.coulomb_friction)

    def gap_at(self, theta_l: float, age: float) -> float:
        """Return the gap where the load stands at ``theta_l`` (rad), ``age`` seconds after the start, rad."""
        effects = self.drive.effects
        grown = 1.0 + effects.gap_growth * min(age / effects.drift_time, 1.0)
        return self.drive.gear.backlash_at(theta_l) * grown

    def parameters(self) -> dict[str, Any]:
        """Return everything that was drawn, as columns: each parameter of the drive, its sensors and its delay."""
        drive = self.drive
        columns: dict[str, Any] = {"number": self.number, "rate": self.rate}
        columns |= {"load_torque": self.load_torque, "torque_change": self.torque_change}
        columns |= {"can_outrun": self.can_outrun, "free": self.free, "contact": drive.gear.contact.section}
        columns["effects"] = " ".join(self.effects)
        for part in (drive.motor, drive.gear, drive.load, drive.effects, self.sensors, self.delay):
            columns |= dict(_columns(part))
        return columns


def _columns(part: Validated) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a value as columns, each named after its section."""
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, tuple):
            yield f"{part.section}_{field.name}", " ".join(value)
        elif not isinstance(value, Validated):
            yield f"{part.section}_{field.name}", value
