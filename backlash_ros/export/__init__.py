"""Writes a drive as text for other simulators: MuJoCo's MJCF, URDF, SDF; and notes what these leave out."""

from backlash_ros.export.mjcf import mjcf
from backlash_ros.export.sdf import sdf
from backlash_ros.export.urdf import urdf

FORMATS = {"mujoco": mjcf, "urdf": urdf, "sdf": sdf}
"""The writers by format: functions of an axis and of the torque at which its teeth are fitted."""

__all__ = ["FORMATS", "mjcf", "sdf", "urdf"]
