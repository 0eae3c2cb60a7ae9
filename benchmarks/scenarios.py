"""What `plant.py` plays: drives in a loop of their own, sampled at 4 ms for 20 s, from rest in the middle of the gap.

- *nominal limit cycle*: the nominal drive, a step of 1 rad with the fast gains
- *free flight and slow motion*: the nominal drive, +-1 V, reversed every 2 s: the motor crosses the gap, then pushes
  the load slowly
- *stiff teeth*: as the limit cycle, the contact's exponent 51 in place of 21
- *elastic contact*: as the limit cycle, with the elastic contact at its defaults
- *friction*: Coulomb friction on both sides, each 1 % of the stall torque at the output, and the fast gains that follow
  a sine of 0.05 rad at 2 Hz. The motor comes to rest and breaks away again four times a second, the load six times;
  the motor rests 15 % of the time, the load 38 %
"""

from dataclasses import dataclass, replace

import numpy as np

from backlash_ros.control import design_gains
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, THETA_L

PERIOD, COUNT = 0.004, 5000


@dataclass(frozen=True, eq=False)
class Play:
    """A drive, and what commands it: ``feed`` (V) less ``gains`` times load angle, load speed and current."""

    name: str
    drive: Drive
    gains: Array
    feed: Array

    @property
    def elastic(self) -> bool:
        """Whether the contact is the elastic one, or else a power law."""
        return self.drive.gear.contact.section == "contact.elastic"

    def voltage(self, feed: float, state: Array) -> float:
        """Return the command at a sample, V."""
        limit = self.drive.motor.voltage_limit
        return min(max(float(feed - self.gains @ state[[THETA_L, OMEGA_L, CURRENT]]), -limit), limit)


def plays() -> dict[str, Play]:
    """Return the scenarios by name."""
    fast, none = design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0]).as_array(), np.zeros(3)
    gear, plant, time = NOMINAL_DRIVE.gear, plant_constants(NOMINAL_DRIVE), PERIOD * np.arange(COUNT)
    step, sine = np.full(COUNT, fast[0]), 0.05 * fast[0] * np.sin(2.0 * np.pi * 2.0 * time)
    slow = np.where(np.arange(COUNT) // 500 % 2 == 0, 1.0, -1.0)
    stall = plant.K_m * plant.current_scale
    stiff = replace(NOMINAL_DRIVE, gear=replace(gear, contact=replace(gear.contact, exponent=51)))
    elastic = replace(NOMINAL_DRIVE, gear=replace(gear, contact=CONTACTS["elastic"]()))
    rubbing = replace(
        NOMINAL_DRIVE,
        motor=replace(NOMINAL_DRIVE.motor, coulomb_friction=0.01 * stall),
        load=replace(NOMINAL_DRIVE.load, coulomb_friction=0.01 * stall / gear.ratio),
    )
    made = (
        Play("nominal limit cycle", NOMINAL_DRIVE, fast, step),
        Play("free flight and slow motion", NOMINAL_DRIVE, none, slow),
        Play("stiff teeth, exponent 51", stiff, fast, step),
        Play("elastic contact", elastic, fast, step),
        Play("with friction", rubbing, fast, sine),
    )
    return {play.name: play for play in made}
