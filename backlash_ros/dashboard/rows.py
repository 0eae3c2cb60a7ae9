"""Messages as rows of numbers, and many rows as one frame of bytes for the page."""

import math
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from backlash_ros.control.telemetry import TELEMETRY

JOINTS, STATE = 0, 1
"""What a frame is of."""

JOINT_COLUMNS = ("time", "motor", "load", "gear_torque")
"""Of a frame of joint states: s; the motor's angle through the gear and the load's, rad; N m at the output."""

STATE_COLUMNS = ("time", *TELEMETRY)
"""Of a frame of ``~/state``."""

Row = tuple[float, ...]


def _seconds(stamp: object) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)  # type: ignore[attr-defined]


def joint_row(message: JointState, joints: tuple[str, str], reduction: float) -> Row:
    """Return the row of `JOINT_COLUMNS`; nan for what the message does not have.

    Parameters
    ----------
    joints : names of the motor's and of the load's joint
    reduction : turns of the motor for one of the load
    """

    def of(joint: str, values: Sequence[float]) -> float:
        place = message.name.index(joint) if joint in message.name else len(values)
        return float(values[place]) if place < len(values) else math.nan

    motor, load = joints
    torque = of(load, message.effort)
    return _seconds(message.header.stamp), of(motor, message.position) / reduction, of(load, message.position), torque


def state_row(message: DiagnosticArray) -> Row:
    """Return the row of `STATE_COLUMNS`; nan for what the message does not have."""
    values = {entry.key: entry.value for status in message.status for entry in status.values}
    return _seconds(message.header.stamp), *(_number(values.get(name, "")) for name in TELEMETRY)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def frame(kind: int, rows: Sequence[Row]) -> bytes:
    """Return rows as numbers of 8 bytes, little-endian: ``kind``, how many columns there are, and the rows."""
    table = np.array(rows, dtype="<f8")
    return np.concatenate([np.array([kind, table.shape[1]], dtype="<f8"), table.ravel()]).tobytes()
