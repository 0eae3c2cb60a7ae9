"""A drive written as a file of another simulator, pure text: MuJoCo's MJCF, URDF, SDF; and what those cannot say."""

from backlash_ros.analysis.export.mjcf import mjcf
from backlash_ros.analysis.export.sdf import sdf
from backlash_ros.analysis.export.urdf import urdf

FORMATS = {"mujoco": mjcf, "urdf": urdf, "sdf": sdf}
"""What writes a drive, by the name of its format: functions of an axis and the torque at which its teeth are fitted."""

__all__ = ["FORMATS", "mjcf", "sdf", "urdf"]
