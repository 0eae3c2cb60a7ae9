"""One axis of a bag: its samples in SI units, its controller's messages and its drive, on one clock."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.recordings.bag import Series

_NO_TIME = np.empty(0)


@dataclass(frozen=True)
class Axis:
    """One drive and its controller in a bag; times in s from the bag's start, or as ``clock`` says.

    Attributes
    ----------
    name : namespace of its topics, ``/`` without one
    joint_topic, motor_joint, load_joint : source of its samples, empty if the bag has none
    time, received, stamps : of the used samples, shape (N,): on the axis's clock; of recording and stamp, s since the
        epoch
    motor, load : angles, rad, from the axis' zero, the motor's before the gear; all nan if there are none
    load_speed : rad/s
    torque : of the motor, N m before the gear
    repeated : number of samples without a later stamp, which are left out
    reference, load_torque, estimates, command : as the bag has them, rad, N m, rad, and V, A or what the topic has
    answered, commands_received : the stamps of the samples that the commands name, nan if none, and when the commands
        were recorded, s since the epoch
    state : the values of ``~/state`` by name
    versions : parameters in use by their time
    drive : motor, gear and load from ``drive_source``; None if unknown
    notes : how the samples were treated, in words
    missing : what the recording lacks, in words
    """

    name: str
    clock: str = ""
    joint_topic: str = ""
    motor_joint: str = ""
    load_joint: str = ""
    time: Array = field(default_factory=lambda: _NO_TIME)
    received: Array = field(default_factory=lambda: _NO_TIME)
    stamps: Array = field(default_factory=lambda: _NO_TIME)
    motor: Array = field(default_factory=lambda: _NO_TIME)
    load: Array = field(default_factory=lambda: _NO_TIME)
    load_speed: Array = field(default_factory=lambda: _NO_TIME)
    torque: Array = field(default_factory=lambda: _NO_TIME)
    repeated: int = 0
    reference: Series | None = None
    reference_source: str = ""
    command: Series | None = None
    command_unit: str = ""
    command_topic: str = ""
    answered: Array = field(default_factory=lambda: _NO_TIME)
    commands_received: Array = field(default_factory=lambda: _NO_TIME)
    load_torque: Series | None = None
    estimates: Series | None = None
    state: Mapping[str, Series] = field(default_factory=dict)
    versions: Sequence[tuple[float, int, Mapping[str, Any]]] = ()
    drive: Drive | None = None
    drive_source: str = ""
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    @property
    def ratio(self) -> float:
        """Output angle per rad of the motor; nan if unknown."""
        return self.drive.gear.ratio if self.drive is not None else math.nan

    @property
    def position(self) -> Array:
        """The angle that the axis is judged by, rad at the output: the load's, else the motor's through the gear."""
        return self.load if np.any(np.isfinite(self.load)) or self.drive is None else self.motor * self.ratio

    @property
    def twist(self) -> Array:
        """The motor's angle through the gear less the load's, rad at the output, shape (N,)."""
        return self.motor * self.ratio - self.load


def backlash_in_use(axis: Axis) -> tuple[float, str]:
    """Return the last backlash that the controller used, rad, and its source; 0 if unknown."""
    if axis.versions and (angle := float(axis.versions[-1][2].get("backlash_angle", 0.0))) > 0.0:
        return angle, "the parameters in use at the end"
    if (series := axis.state.get("backlash_angle")) is not None:
        known = series.values[np.isfinite(series.values) & (series.values > 0.0)]
        if known.size:
            return float(known[-1]), "~/state"
    if axis.estimates is not None and axis.estimates.values.size and axis.estimates.values[-1] > 0.0:
        return float(axis.estimates.values[-1]), "~/backlash_estimate"
    return 0.0, ""
