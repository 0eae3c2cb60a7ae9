"""A drive as SDF, for Gazebo: a model of a rotor and an output on a frame, with their joint properties."""

from xml.etree import ElementTree as ET

from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.export.notes import JOINTS, LINKS, ends_count_from, rigid, unsaid
from backlash_ros.export.sides import Body, output_of, rotor_of, speed_limits, torque_limits
from backlash_ros.export.teeth import Limit, fit_limit
from backlash_ros.export.xml_text import comment, document, element, number, text_element

VERSION = "1.11"
"""Version of the format: that of Gazebo Harmonic, which belongs to ROS 2 Jazzy, and the first with ``mimic``."""
STEP = 1e-3
"""Gazebo's step by default, s."""


def sdf(axis: Axis, torque: float | None = None) -> str:
    """Return the SDF text of a drive.

    Parameters
    ----------
    axis : the drive, the names of its joints and the ends of its travel
    torque : at which the teeth are fitted, N m at the output, for the stiffness of the ends of travel; see `fit_limit`

    Raises
    ------
    ValueError
        If the teeth cannot be fitted at that torque.
    """
    drive, teeth = axis.drive, fit_limit(axis.drive, torque)
    root = element(None, "sdf", version=VERSION)
    model = element(root, "model", name="drive")
    element(model, "link", name="base")
    fixed = element(model, "joint", name="base_to_world", type="fixed")
    text_element(fixed, "parent", "world")
    text_element(fixed, "child", "base")
    comment(model, LINKS)
    _link(model, "rotor", rotor_of(drive), -0.1)
    _link(model, "output", output_of(drive), 0.1)
    comment(model, JOINTS)
    torques, speeds = torque_limits(drive), speed_limits(drive)
    _joint(model, axis.motor_joint, "rotor", rotor_of(drive), torques[0], speeds[0])
    load = _joint(model, axis.load_joint, "output", output_of(drive), torques[1], speeds[1])
    turn = load.find("axis")
    assert turn is not None
    if axis.has_ends:
        _ends(load, turn, axis, teeth)
    comment(turn, "The gear, without its backlash.")
    mimic = element(turn, "mimic", joint=axis.motor_joint)
    text_element(mimic, "multiplier", drive.gear.ratio)
    text_element(mimic, "offset", 0.0)
    text_element(mimic, "reference", 0.0)
    return document(
        root,
        "A geared drive with backlash, exported by backlash_ros as SDF. SI units, angles in radians.",
        "What this file cannot say:",
        *rigid(drive),
        *unsaid(drive),
        "* What Gazebo Harmonic takes of it depends on the engine: DART, the default, follows no mimic (gz-physics "
        "issue 432), bullet-featherstone does but has no damping or friction (712); ODE and Simbody have soft stops.",
    )


def _link(model: ET.Element, name: str, body: Body, place: float) -> None:
    link = element(model, "link", name=name)
    text_element(link, "pose", number(0, place, 0, 0, 0, 0))
    inertial = element(link, "inertial")
    text_element(inertial, "pose", number(*body.centre, 0, 0, 0))
    text_element(inertial, "mass", body.mass)
    inertia = element(inertial, "inertia")
    for name_of in ("ixx", "iyy", "izz"):
        text_element(inertia, name_of, body.inertia)


def _joint(model: ET.Element, name: str, child: str, body: Body, effort: float, velocity: float) -> ET.Element:
    joint = element(model, "joint", name=name, type="continuous")
    text_element(joint, "parent", "base")
    text_element(joint, "child", child)
    turn = element(joint, "axis")
    text_element(turn, "xyz", "0 1 0")
    dynamics = element(turn, "dynamics")
    text_element(dynamics, "damping", body.viscous)
    text_element(dynamics, "friction", body.coulomb)
    text_element(dynamics, "spring_reference", 0.0)
    text_element(dynamics, "spring_stiffness", 0.0)
    limit = element(turn, "limit")
    text_element(limit, "effort", effort)
    text_element(limit, "velocity", velocity)
    return joint


def _ends(joint: ET.Element, turn: ET.Element, axis: Axis, teeth: Limit) -> None:
    """Add stops at the ends of travel that are as soft as the teeth through which the motor meets them."""
    joint.set("type", "revolute")
    limit = turn.find("limit")
    assert limit is not None
    comment(limit, f"Stops that give as the teeth do, at {teeth.torque:.6g} N m: N m/rad, N m s/rad.")
    if axis.zero:
        comment(limit, ends_count_from(axis.zero))
    lower, upper = axis.end_readings
    text_element(limit, "lower", lower)
    text_element(limit, "upper", upper)
    text_element(limit, "stiffness", teeth.stiffness)
    text_element(limit, "dissipation", teeth.damping)
    comment(joint, f"The same stops for ODE, with a step of {STEP!r} s.")
    stop = element(element(element(joint, "physics"), "ode"), "limit")
    whole = STEP * teeth.stiffness + teeth.damping
    text_element(stop, "cfm", 1.0 / whole)
    text_element(stop, "erp", STEP * teeth.stiffness / whole)
