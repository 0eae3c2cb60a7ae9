"""Options for reading a bag: topics, joints, units, and the drive."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from backlash_ros.recordings.bag_topics import Topics
from backlash_ros.recordings.encoder import Encoder
from backlash_ros.recordings.samples import Reading

VELOCITY_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0}
EFFORT_UNITS = {"Nm": 1.0, "mNm": 1e-3, "A": math.nan}
"""Units of velocity and effort in rad/s and N m; an ampere is multiplied by the motor's torque constant."""


@dataclass(frozen=True)
class Options:
    """How a bag is read; empty options are determined from the bag, if possible.

    ``backlash_angle``: rad at the output, 0 if not given. ``drive``: the file of motor and gear.
    """

    reading: Reading = field(default_factory=Reading)
    topics: Topics = field(default_factory=lambda: Topics(motor_joint="", load_joint=""))
    reference_topic: str = ""
    reference_encoder: Encoder = field(default_factory=Encoder)
    velocity_unit: str = "rad/s"
    effort_unit: str = "Nm"
    backlash_angle: float = 0.0
    drive: Path | None = None
