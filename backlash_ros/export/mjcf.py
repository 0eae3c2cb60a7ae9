"""A drive for MuJoCo: two hinges, a limited tendon between them for the backlash, and the motor as an actuator."""

import math
from xml.etree import ElementTree as ET

from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain import Drive
from backlash_ros.export.notes import unsaid
from backlash_ros.export.sides import STANDARD_GRAVITY, Body, output_of, rotor_of
from backlash_ros.export.teeth import Limit, fit_limit, give
from backlash_ros.export.xml_text import comment, document, element, number

LONGEST_STEP = 1e-3
"""s"""
STEPS = 30
"""Least number of steps in a period of the swing on the stiffest teeth."""
LEAST_IMPEDANCE, LARGEST_IMPEDANCE = 1e-4, 0.9999
"""MuJoCo's own bounds."""
RISING_IMPEDANCE = 0.02
"""Share by which the rising limit, at its full width, makes the shafts seem heavier."""
WIDEST = 4.0
"""Multiple of the torque of the fit up to which a rising limit rises; beyond it, it is a linear spring."""


def mjcf(axis: Axis, torque: float | None = None) -> str:
    """Return the MJCF text of a drive.

    Parameters
    ----------
    axis : the drive and the names of its joints
    torque : at which the limit is fitted to the teeth, N m at the output; see `fit_limit`

    Raises
    ------
    ValueError
        If the limit cannot be fitted at that torque.
    """
    drive, limit = axis.drive, fit_limit(axis.drive, torque)
    solref, solimp = solver_numbers(drive, limit)
    step = time_step(drive, limit)
    root = element(None, "mujoco", model="geared drive with backlash")
    element(root, "compiler", angle="radian")
    comment(
        root,
        f"The step resolves the teeth: at least {STEPS} in one swing on their spring. It turns unstable with "
        "a step ten times as long. In a larger model keep the step, or fit the limit at a lower torque.",
    )
    element(root, "option", timestep=step, integrator="implicitfast", gravity=number(0, 0, -STANDARD_GRAVITY))
    world = element(root, "worldbody")
    comment(
        world,
        "The rotor at its own speed, before the gear: inertia J_m (kg m^2), viscous (N m s/rad) and Coulomb friction "
        "(N m) as they are there. Its mass (kg) stands for nothing.",
    )
    _side(world, "rotor", axis.motor_joint, rotor_of(drive), -0.1, step)
    comment(
        world,
        "The load about the output shaft, its angle and friction as they are there; J_l = inertia + mass arm^2. Put "
        "your own mechanism in its place.",
        "Its weight pulls by gravity_torque sin(angle + gravity_offset)."
        if drive.load.gravity_torque
        else "It is balanced, and its mass (kg) stands for nothing.",
    )
    _side(world, "output", axis.load_joint, output_of(drive), 0.1, step)
    comment(root, *_limit_words(drive, limit))
    tendon = element(
        element(root, "tendon"),
        "fixed",
        name="gap",
        limited="true",
        range=number(-limit.edge, limit.edge),
        solreflimit=number(*solref),
        solimplimit=number(*solimp),
    )
    element(tendon, "joint", joint=axis.motor_joint, coef=drive.gear.ratio)
    element(tendon, "joint", joint=axis.load_joint, coef=-1.0)
    _actuators(root, axis)
    _sensors(root, axis)
    return document(root, *_head(axis))


def solver_numbers(drive: Drive, limit: Limit) -> tuple[tuple[float, float], tuple[float, float, float, float, float]]:
    """Return MuJoCo's solref and solimp of the tendon's limit.

    MuJoCo's force at a depth r that grows with v is d(r)/A (b v + k d(r) r - a0), with A of `give`, the impedance d(r),
    the acceleration a0 that the gap would have without it, and by a negative solref (-S, -D) b = D/w and k = S/w^2,
    where w is d at full width: with d small it is the spring and damper of `Limit`, and a0 has next to no part.
    """
    per_torque = give(drive)
    if limit.power == 0:
        impedance = (LEAST_IMPEDANCE, LEAST_IMPEDANCE, limit.depth, 0.5, 1.0)
        return (-limit.stiffness * per_torque, -limit.damping * per_torque), impedance
    width = WIDEST ** (1.0 / (2 * limit.power + 1))
    impedance = (LEAST_IMPEDANCE, RISING_IMPEDANCE, width * limit.depth, LARGEST_IMPEDANCE, float(limit.power))
    rise = width**limit.power
    return (-limit.stiffness * per_torque * rise**2, -limit.damping * per_torque * rise), impedance


def time_step(drive: Drive, limit: Limit) -> float:
    """Return a step that resolves the stiffest teeth, s: 1, 2 or 5 times a power of ten, so that periods are whole."""
    order = 2 * limit.power + 1
    steepest = limit.stiffness * order * (WIDEST ** ((order - 1) / order) if limit.power else 1.0)
    longest = min(LONGEST_STEP, 2.0 * math.pi / math.sqrt(steepest * give(drive)) / STEPS)
    decade = math.floor(math.log10(longest) + 1e-9)
    return max(float(f"{digit}e{decade}") for digit in (1, 2, 5) if float(f"{digit}e{decade}") <= longest * (1 + 1e-9))


def _side(world: ET.Element, name: str, joint: str, body: Body, place: float, step: float) -> None:
    """Add one side as a body on a hinge; dry friction holds it as firmly as MuJoCo allows."""
    made = element(world, "body", name=name, pos=number(0, place, 0))
    hinge = element(made, "joint", name=joint, type="hinge", axis="0 1 0", damping=body.viscous)
    if body.coulomb:
        hinge.set("frictionloss", number(body.coulomb))
        hinge.set("solreffriction", number(2 * step, 1))
        hinge.set("solimpfriction", number(LARGEST_IMPEDANCE, LARGEST_IMPEDANCE, 1e-3, 0.5, 2))
    element(made, "inertial", pos=number(*body.centre), mass=body.mass, diaginertia=number(*[body.inertia] * 3))
    for size, ends in (("0.02", "0 -0.05 0 0 0.05 0"), ("0.005", "0 0.05 0 0 0.05 -0.03")):
        element(made, "geom", type="cylinder", size=size, fromto=ends, contype="0", conaffinity="0")


def _limit_words(drive: Drive, limit: Limit) -> tuple[str, ...]:
    gear = drive.gear
    spring = (
        f"a spring that rises with power {2 * limit.power + 1} of the depth" if limit.power else "a straight spring"
    )
    return (
        "The backlash: the length of this tendon is the gap, theta_motor/reduction - theta_load (rad at the output), "
        "and its limit the teeth.",
        f"Drive: backlash_angle b = {gear.backlash_angle!r} rad (b/2 = {0.5 * gear.backlash_angle!r}), "
        f"{gear.contact.section}.",
        f"Fitted to these teeth at {limit.torque:.6g} N m on the output shaft: {spring}, from {limit.edge:.6g} rad on, "
        f"which carries that torque {limit.depth:.6g} rad deeper, with the stiffness of the drive's teeth there.",
        f"An impact at {limit.speed:.4g} rad/s, which presses them as far, leaves {limit.restitution_left:.3g} of that "
        f"speed; the drive's teeth leave {limit.restitution:.3g}.",
        "solreflimit = -stiffness -damping, over the inertia of both shafts in the gap: with another load's inertia "
        "the limit is another one, so export anew. A low solimplimit makes it a true spring and damper.",
    )


def _actuators(root: ET.Element, axis: Axis) -> None:
    drive, motor = axis.drive, axis.drive.motor
    place = element(root, "actuator")
    bounds: dict[str, str | float] = {
        "joint": axis.motor_joint,
        "ctrllimited": "true",
        "ctrlrange": number(-drive.command_limit, drive.command_limit),
    }
    if drive.takes_current:
        comment(place, "ctrl[0]: the motor's current, A; the drive's own loop keeps it. gear: torque constant, N m/A.")
        element(place, "motor", name="current", gear=motor.torque_constant, **bounds)
    else:
        comment(
            place,
            "ctrl[0]: the motor's voltage, V. Torque constant (also the back-EMF's, N m/A), winding (ohm, H). For "
            "MuJoCo 3.7 or later; before, a general actuator with gainprm K/R, biasprm 0 0 -K^2/R has no inductance.",
        )
        element(
            place,
            "dcmotor",
            name="voltage",
            **bounds,
            motorconst=motor.torque_constant,
            resistance=motor.resistance,
            inductance=number(motor.inductance, 0),
        )
    comment(place, "ctrl[1]: load torque on the output shaft, N m, positive turns the load forward.")
    element(place, "motor", name="load_torque", joint=axis.load_joint, gear=1.0, ctrllimited="false")


def _sensors(root: ET.Element, axis: Axis) -> None:
    place = element(root, "sensor")
    comment(
        place, "Angles (rad) and speeds (rad/s), each at its own shaft; the gap (rad) and what the teeth carry (N m)."
    )
    for side, joint in (("motor", axis.motor_joint), ("load", axis.load_joint)):
        element(place, "jointpos", name=f"{side}_position", joint=joint)
        element(place, "jointvel", name=f"{side}_velocity", joint=joint)
    element(place, "tendonpos", name="gap", tendon="gap")
    element(place, "tendonlimitfrc", name="tooth_torque", tendon="gap")


def _head(axis: Axis) -> tuple[str, ...]:
    return (
        "A geared drive with backlash, exported by backlash_ros for MuJoCo. SI units, angles in radians.",
        "Commands: ctrl[0] is what the drive takes, ctrl[1] a load torque. Hold each command over the drive's period.",
        "What this file cannot say:",
        "* The teeth are fitted at one torque, and their damping at one speed: see the tendon.",
        "* Dry friction holds a shaft to within a creep, torque x step x 1e-4/inertia (rad/s).",
        *unsaid(axis.drive),
    )
