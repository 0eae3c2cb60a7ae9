"""The exports in MuJoCo: they load, stand as the teeth do, and move as our simulator does.

The figures of docs/simulators.md come from the same functions: `mujoco_export`.
"""

import math
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("mujoco") is None:
    pytest.skip("MuJoCo is not installed here; the locks in requirements have it", allow_module_level=True)

import mujoco
from mujoco_export import (
    Recording,
    errors,
    members,
    play_here,
    play_there,
    random_commands,
    record_probe,
    record_steps,
    with_mean_gap,
)

from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.drivetrain.contacts.restitution import RestitutionContact
from backlash_ros.export import mjcf, urdf
from backlash_ros.export.teeth import fit_limit, give
from backlash_ros.studies.evaluation.population import draw_member

pytestmark = pytest.mark.population

WITHIN = 0.1
"""Of the rms of the motion."""
HAS_DC_MOTOR = tuple(int(part) for part in mujoco.__version__.split(".")[:2]) >= (3, 7)
INTERFACES = [
    pytest.param("voltage", marks=pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")),
    "current",
]
CURRENT = replace(NOMINAL_DRIVE, command_interface="current")
TEETH = [PowerContact(), PowerContact(stiffness=1e3, exponent=7), ElasticContact(), RestitutionContact()]


def with_teeth(drive: Drive, teeth: PowerContact | ElasticContact | RestitutionContact) -> Drive:
    return replace(drive, gear=replace(drive.gear, contact=teeth))


def drive_of(number: int, interface: str, population: str = "core") -> tuple[Drive, float]:
    drive, period = list(members(number + 1, interface, population))[number]
    return with_mean_gap(drive), period


@pytest.mark.parametrize("interface", INTERFACES)
def test_steps_are_followed(interface: str) -> None:
    """Two seconds of steps under the default law, gap crossings and both flanks; only the commands are played.

    All but one of six: after an impact a difference in the last digit may grow, as between two versions of a library.
    """
    missed = []
    for number in range(6):
        drive, period = drive_of(number, interface)
        here = record_steps(drive, period, number)
        missed.append(max(errors(here, play_there(drive, here))))
    assert sum(miss < WITHIN for miss in missed) >= 5
    assert np.median(missed) < 0.5 * WITHIN


@pytest.mark.corners(3)
@pytest.mark.population
@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("population", ["core", "full"])
@pytest.mark.parametrize("number", range(5))
def test_random_commands_are_followed(number: int, population: str, interface: str) -> None:
    """With a weight and every friction, too."""
    drive, period = drive_of(number, interface, population)
    here = play_here(drive, random_commands(drive, period, 2.0, number), period)
    assert max(errors(here, play_there(drive, here))) < 0.01


@pytest.mark.corners(1)
@pytest.mark.population
@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
@pytest.mark.parametrize("friction", [0.02, 0.05, 0.1, 0.2])
def test_the_drive_that_was_identified_from_a_recording_follows_it(friction: float) -> None:
    drive = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, coulomb_friction=friction, inertia=8e-4))
    here, found = record_probe(drive, NOMINAL_DRIVE, 0.004)
    assert found is not None
    assert found.load.inertia == pytest.approx(8e-4, rel=0.05)
    assert max(errors(here, play_there(found, here))) < WITHIN


@pytest.mark.corners(4)
@pytest.mark.parametrize("teeth", TEETH, ids=["power", "steep", "elastic", "restitution"])
@pytest.mark.parametrize("share", [0.5, 1.0, 2.0])
def test_the_limit_stands_as_it_was_fitted(teeth: PowerContact, share: float) -> None:
    """The motor pushes against a load torque: the gap and what the teeth carry, on both flanks."""
    drive = with_teeth(CURRENT, teeth)
    limit = fit_limit(drive)
    torque, depth = share * limit.torque, limit.depth * share ** (1.0 / (2 * limit.power + 1))
    model = mujoco.MjModel.from_xml_string(mjcf(Axis(drive)))
    for side in (1.0, -1.0):
        data = mujoco.MjData(model)
        data.qpos[0] = side * (limit.edge + depth) / drive.gear.ratio
        data.ctrl[:] = side * torque * drive.gear.ratio / drive.motor.torque_constant, -side * torque
        mujoco.mj_step(model, data, round(0.3 / model.opt.timestep))
        # The impedance takes its share of the torque: 2 % at most where the limit rises, 1e-4 where it is straight.
        assert side * data.sensor("gap").data[0] - limit.edge == pytest.approx(depth, rel=0.02)
        assert abs(data.sensor("tooth_torque").data[0]) == pytest.approx(torque, rel=2e-3)


@pytest.mark.parametrize("teeth", TEETH, ids=["power", "steep", "elastic", "restitution"])
def test_an_impact_leaves_the_speed_that_the_fit_says(teeth: PowerContact) -> None:
    drive = with_teeth(CURRENT, teeth)
    drive = replace(
        drive, motor=replace(drive.motor, viscous_friction=0.0), load=replace(drive.load, viscous_friction=0.0)
    )
    limit = fit_limit(drive)
    model = mujoco.MjModel.from_xml_string(mjcf(Axis(drive)))
    assert model.tendon_invweight0[0] == pytest.approx(give(drive), rel=1e-9)
    data = mujoco.MjData(model)
    n, share = drive.gear.ratio, drive.motor_share
    data.qvel[:] = (1.0 - share) * limit.speed / n, -share * limit.speed
    mujoco.mj_step(model, data, round(2.0 * limit.edge / limit.speed / model.opt.timestep))
    rate = 0.0
    while rate >= 0.0 or abs(data.sensor("gap").data[0]) > limit.edge:
        mujoco.mj_step(model, data)
        rate = n * data.qvel[0] - data.qvel[1]
        assert data.time < 1.0
    assert -rate / limit.speed == pytest.approx(limit.restitution_left, abs=0.03)


@pytest.mark.parametrize("interface", INTERFACES)
def test_what_is_mirrored_moves_mirrored(interface: str) -> None:
    drive, period = drive_of(2, interface, "full")
    here = play_here(drive, random_commands(drive, period, 1.0, 5), period)
    load = replace(drive.load, gravity_offset=-drive.load.gravity_offset)
    one = play_there(drive, here)
    other = play_there(replace(drive, load=load), replace(here, command=-here.command))
    np.testing.assert_allclose(other.load, -one.load, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.motor, -one.motor, rtol=0, atol=1e-6)


@pytest.mark.parametrize("backlash", [1e-5, 1e-9])
def test_no_backlash_is_the_rigid_drive(backlash: float) -> None:
    """A constant current: J_e dw/dt = T - B_e w."""
    drive = with_teeth(replace(CURRENT, gear=replace(CURRENT.gear, backlash_angle=backlash)), ElasticContact())
    current, period = 0.5, 0.004
    there = play_there(drive, Recording(period, np.full(125, current), np.zeros(0), np.zeros(0), np.zeros(5)))
    torque = drive.motor.torque_constant * current / drive.gear.ratio
    time, slowing = 0.004 * np.arange(126), drive.effective_inertia / drive.effective_friction
    speed = torque / drive.effective_friction
    angle = speed * (time - slowing * (1.0 - np.exp(-time / slowing)))
    wound = backlash + 2.0 * torque * 1e-3
    np.testing.assert_allclose(there.load, angle, rtol=1e-3, atol=wound)
    np.testing.assert_allclose(there.motor, angle, rtol=1e-3, atol=wound)


@pytest.mark.skipif(not HAS_DC_MOTOR, reason="needs MuJoCo 3.7: dcmotor")
def test_the_winding_is_the_drives() -> None:
    """Locked, the current rises to V/R with L/R; free, the speed is that of a motor with its back-EMF."""
    motor = NOMINAL_DRIVE.motor
    model = mujoco.MjModel.from_xml_string(mjcf(Axis(NOMINAL_DRIVE)))
    data = mujoco.MjData(model)
    model.dof_damping[:] = 1e6
    data.ctrl[0] = 4.0
    lag = motor.inductance / motor.resistance
    mujoco.mj_step(model, data, round(lag / model.opt.timestep))
    assert data.act[0] == pytest.approx(4.0 / motor.resistance * (1.0 - math.exp(-1.0)), rel=1e-3)
    data.ctrl[0] = 100.0
    mujoco.mj_step(model, data, round(20 * lag / model.opt.timestep))
    assert data.act[0] == pytest.approx(motor.voltage_limit / motor.resistance, rel=1e-3)


@pytest.mark.corners(3)
@pytest.mark.parametrize("number", range(5))
def test_every_drive_loads(number: int) -> None:
    axis = Axis(draw_member(20090, number, "full").drive, 'a<b>&"c"', "é d", -1.0, 2.0)
    if HAS_DC_MOTOR:
        model = mujoco.MjModel.from_xml_string(mjcf(axis))
        assert (model.joint(axis.motor_joint).id, model.joint(axis.load_joint).id) == (0, 1)
        assert model.nu == 2
    robot = mujoco.MjModel.from_xml_string(urdf(axis))
    drive, motor, load = axis.drive, robot.joint(axis.motor_joint), robot.joint(axis.load_joint)
    data = mujoco.MjData(robot)
    mujoco.mj_forward(robot, data)
    for joint, part in ((motor, drive.motor), (load, drive.load)):
        dof = joint.dofadr[0]
        assert robot.dof_M0[dof] == pytest.approx(part.inertia, rel=1e-9)
        assert float(np.ravel(joint.damping)[0]) == part.viscous_friction
        assert joint.frictionloss[0] == part.coulomb_friction
    np.testing.assert_array_equal(load.range, [-1.0, 2.0])
    assert not robot.jnt_limited[motor.id]
    # MuJoCo's own gravity makes the weight of the drive.
    gravity = data.qfrc_bias[load.dofadr[0]]
    assert gravity == pytest.approx(drive.load.gravity_torque * math.sin(drive.load.gravity_offset), abs=1e-9)
