"""A drive as URDF: a robot of a frame, a rotor and an output, with its joint properties and a ros2_control tag."""

from xml.etree import ElementTree as ET

from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain import Drive
from backlash_ros.export.notes import JOINTS, LINKS, ends_count_from, rigid, unsaid
from backlash_ros.export.sides import Body, output_of, rotor_of, speed_limits, torque_limits
from backlash_ros.export.xml_text import comment, document, element, number, text_element


def urdf(axis: Axis, torque: float | None = None) -> str:  # noqa: ARG001
    """Return the URDF text of a drive; a URDF has no teeth, so no torque to fit them at."""
    drive = axis.drive
    root = element(None, "robot", name="drive")
    element(root, "link", name="base")
    comment(root, LINKS)
    _link(root, "rotor", rotor_of(drive))
    _link(root, "output", output_of(drive))
    torques, speeds = torque_limits(drive), speed_limits(drive)
    comment(root, JOINTS)
    _joint(root, axis.motor_joint, "rotor", rotor_of(drive), torques[0], speeds[0])
    load = _joint(root, axis.load_joint, "output", output_of(drive), torques[1], speeds[1])
    if axis.has_ends:
        load.set("type", "revolute")
        limit = load.find("limit")
        assert limit is not None
        lower, upper = axis.end_readings
        limit.set("lower", number(lower))
        limit.set("upper", number(upper))
        if axis.zero:
            comment(load, ends_count_from(axis.zero))
    comment(
        load,
        "The gear, without its backlash. Take mimic out where both shafts have an encoder: robot_state_publisher would "
        "show the load where a rigid gear has it.",
    )
    element(load, "mimic", joint=axis.motor_joint, multiplier=drive.gear.ratio, offset=0.0)
    _control(root, axis)
    return document(
        root,
        "A geared drive with backlash, exported by backlash_ros as URDF. SI units, angles in radians.",
        "What this file cannot say:",
        *rigid(drive),
        *unsaid(drive),
    )


def _link(root: ET.Element, name: str, body: Body) -> None:
    inertial = element(element(root, "link", name=name), "inertial")
    element(inertial, "origin", xyz=number(*body.centre), rpy="0 0 0")
    element(inertial, "mass", value=body.mass)
    moment = body.inertia
    element(inertial, "inertia", ixx=moment, ixy=0.0, ixz=0.0, iyy=moment, iyz=0.0, izz=moment)


def _joint(root: ET.Element, name: str, child: str, body: Body, effort: float, velocity: float) -> ET.Element:
    joint = element(root, "joint", name=name, type="continuous")
    element(joint, "parent", link="base")
    element(joint, "child", link=child)
    element(joint, "origin", xyz=number(0, -0.1 if child == "rotor" else 0.1, 0), rpy="0 0 0")
    element(joint, "axis", xyz="0 1 0")
    element(joint, "dynamics", damping=body.viscous, friction=body.coulomb)
    element(joint, "limit", effort=effort, velocity=velocity)
    return joint


def _control(root: ET.Element, axis: Axis) -> None:
    """Add the hardware as in docs/real_drive.md: each position at its own shaft, so without a transmission."""
    drive: Drive = axis.drive
    comment(
        root,
        "The interfaces that the controller wants: docs/real_drive.md. Each position at the shaft that its joint is "
        "named for, so without a transmission. Put your hardware's plugin in.",
    )
    control = element(root, "ros2_control", name="drive", type="system")
    text_element(element(control, "hardware"), "plugin", "my_drive/MyDrive")
    motor = element(control, "joint", name=axis.motor_joint)
    command = element(motor, "command_interface", name=drive.command_interface)
    text_element(command, "param", -drive.command_limit, name="min")
    text_element(command, "param", drive.command_limit, name="max")
    for name in ("position", "velocity", "effort"):
        element(motor, "state_interface", name=name)
    load = element(control, "joint", name=axis.load_joint)
    element(load, "state_interface", name="position")
