"""`backlash export`: every number is the drive's, what is wrong is refused, and the commands of the page run."""

import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from backlash_ros.cli import main
from backlash_ros.drive_file.drive_file import Axis, read_axis
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact, PowerNoPullContact
from backlash_ros.drivetrain.contacts.restitution import RestitutionContact
from backlash_ros.export import FORMATS, mjcf, sdf, urdf
from backlash_ros.export.sides import STANDARD_GRAVITY, output_of
from backlash_ros.export.teeth import fit_limit, give, teeth_of
from backlash_ros.studies.evaluation.population import draw_member

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "simulators.md"
AWKWARD = """a<b>&"c" 'd' -- é"""
"""A name with all that XML escapes."""
DRIVES = [draw_member(20090, number, population).drive for population in ("core", "full") for number in range(10)]


def contacts(drive: Drive, *teeth: object) -> list[Drive]:
    return [replace(drive, gear=replace(drive.gear, contact=each)) for each in teeth]


def parsed(text: str) -> ET.Element:
    """The root of a text; comments are read, too, which must be well-formed."""
    return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))


def found(root: ET.Element, path: str) -> ET.Element:
    element = root.find(path)
    assert element is not None, path
    return element


def numbers(text: str | None) -> list[float]:
    assert text is not None
    return [float(word) for word in text.split()]


@pytest.mark.corners(12)
@pytest.mark.parametrize("interface", ["voltage", "current"])
@pytest.mark.parametrize("drive", DRIVES, ids=range(len(DRIVES)))
def test_every_number_of_the_mjcf_is_the_drives(drive: Drive, interface: str) -> None:
    drive = replace(drive, command_interface=interface)
    motor, load, limit = drive.motor, drive.load, fit_limit(drive)
    root = parsed(mjcf(Axis(drive)))
    rotor, output = found(root, ".//body[@name='rotor']"), found(root, ".//body[@name='output']")
    for body, inertia, viscous, coulomb in (
        (rotor, motor.inertia, motor.viscous_friction, motor.coulomb_friction),
        (output, load.inertia, load.viscous_friction, load.coulomb_friction),
    ):
        joint, inertial = found(body, "joint"), found(body, "inertial")
        arm = math.hypot(*numbers(inertial.get("pos")))
        about_axis = numbers(inertial.get("diaginertia"))[1] + float(inertial.get("mass", "")) * arm**2
        assert about_axis == pytest.approx(inertia, rel=1e-12)
        assert float(joint.get("damping", "")) == viscous
        assert float(joint.get("frictionloss", 0.0)) == coulomb
    tendon = found(root, "tendon/fixed")
    assert [float(joint.get("coef", "")) for joint in tendon.iter("joint")] == [drive.gear.ratio, -1.0]
    assert numbers(tendon.get("range")) == [-limit.edge, limit.edge]
    actuator = found(root, f"actuator/*[@name='{interface}']")
    assert numbers(actuator.get("ctrlrange")) == [-drive.command_limit, drive.command_limit]
    if interface == "voltage":
        assert float(actuator.get("motorconst", "")) == motor.torque_constant
        assert float(actuator.get("resistance", "")) == motor.resistance
        assert numbers(actuator.get("inductance")) == [motor.inductance, 0.0]
    else:
        assert float(actuator.get("gear", "")) == motor.torque_constant


@pytest.mark.parametrize("drive", [drive for drive in DRIVES if drive.load.gravity_torque])
@pytest.mark.parametrize("angle", [0.0, 1.0, -2.5])
def test_the_weight_is_the_drives(drive: Drive, angle: float) -> None:
    body, load = output_of(drive), drive.load
    x, _, z = body.centre
    # Turned by the angle about y, the weight m g pulls down at the centre's x.
    torque = body.mass * STANDARD_GRAVITY * (x * math.cos(angle) + z * math.sin(angle))
    assert torque == pytest.approx(-load.gravity_torque * math.sin(angle + load.gravity_offset), abs=1e-12)
    assert 0.5 * load.inertia <= body.inertia * (1.0 + 1e-12) <= load.inertia * (1.0 + 1e-12)


@pytest.mark.parametrize("make", FORMATS.values(), ids=FORMATS)
def test_names_are_escaped(make: object) -> None:
    assert callable(make)
    text = make(Axis(NOMINAL_DRIVE, AWKWARD, f"{AWKWARD}2"))
    names = {element.get(key) for element in parsed(text).iter() for key in ("name", "joint")}
    assert {AWKWARD, f"{AWKWARD}2"} <= names


@pytest.mark.parametrize("make", FORMATS.values(), ids=FORMATS)
@pytest.mark.parametrize("drive", DRIVES[::3], ids=range(len(DRIVES[::3])))
def test_the_text_is_the_same_every_time(make: object, drive: Drive) -> None:
    assert callable(make)
    assert make(Axis(drive)) == make(Axis(replace(drive)))


def test_what_a_file_cannot_say_is_said() -> None:
    gear = replace(NOMINAL_DRIVE.gear, backlash_variation=0.25, backlash_cycles=3, efficiency_backward=0.5)
    for make in FORMATS.values():
        text = " ".join(make(Axis(replace(NOMINAL_DRIVE, gear=gear))).split())
        assert "The backlash varies by 0.25 of its mean, 3 times a turn" in text
        assert "0.5 backward" in text
        assert "eccentricity" in text
        plain = make(Axis(NOMINAL_DRIVE))
        assert "varies" not in plain
        assert "backward" not in plain
    for make in (urdf, sdf):
        text = " ".join(make(Axis(NOMINAL_DRIVE)).split())
        assert "Backlash: 0.02 rad" in text
        assert "2.0 ohm, 0.002 H" in text


def test_a_spring_is_itself() -> None:
    """Teeth with a straight spring are no fit: edge, stiffness and, where the law lets go at no force, damping."""
    spring = ElasticContact(wind_up=2e-3, damping=30.0), RestitutionContact(wind_up=2e-3, restitution=0.4)
    for drive in contacts(NOMINAL_DRIVE, *spring):
        limit = fit_limit(drive)
        assert limit.edge == 0.5 * drive.gear.backlash_angle
        assert limit.power == 0
        assert limit.stiffness == pytest.approx(500.0, rel=1e-9)
        assert limit.restitution_left == pytest.approx(limit.restitution, rel=1e-6)
    gear = drive.gear
    c = gear.contact.constants(gear.load_radius, drive.contact_mass)[1] * gear.load_radius**2
    assert limit.damping == pytest.approx(c, rel=1e-4)
    assert limit.restitution == pytest.approx(0.4, rel=1e-4)


@pytest.mark.parametrize(
    "teeth",
    [
        PowerContact(),
        PowerNoPullContact(exponent=7),
        PowerContact(stiffness=1e4, damping=1e6),
        PowerContact(exponent=1),
    ],
    ids=["power", "no pull", "stiff", "spring"],
)
@pytest.mark.parametrize("torque", [None, 0.1, 4.0])
def test_a_rising_force_is_met_at_the_torque_of_the_fit(teeth: PowerContact, torque: float | None) -> None:
    (drive,) = contacts(NOMINAL_DRIVE, teeth)
    limit, law = fit_limit(drive, torque), teeth_of(drive)
    at, by = limit.edge + limit.depth, 1e-6 * limit.depth
    assert limit.torque == pytest.approx(torque or 3.0)
    assert law(at, 0.0) == pytest.approx(limit.torque, rel=1e-9)
    assert limit.torque_at(at, 0.0) == pytest.approx(limit.torque, rel=1e-9)
    slopes = [(each(at + by, 0.0) - each(at - by, 0.0)) / (2.0 * by) for each in (law, limit.torque_at)]
    assert slopes[1] == pytest.approx(slopes[0], rel=1e-4)
    assert limit.torque_at(-at, 0.0) == pytest.approx(-limit.torque, rel=1e-9)
    assert limit.restitution_left >= limit.restitution - 1e-6
    # Even teeth that give no speed back are met by no more than critical damping.
    assert limit.damping**2 * give(drive) <= 4.0 * limit.stiffness * (1.0 + 1e-9)


@pytest.mark.parametrize("torque", [0.0, -1.0, math.inf, math.nan])
def test_a_fit_needs_a_torque(torque: float) -> None:
    with pytest.raises(ValueError, match="torque must be > 0 N m and finite"):
        fit_limit(NOMINAL_DRIVE, torque)


def test_urdf_has_the_interfaces_that_the_page_on_real_drives_asks_for() -> None:
    page = (ROOT / "docs" / "real_drive.md").read_text()
    block = re.search(r"```xml\n(<ros2_control.*?)```", page, re.DOTALL)
    assert block

    def interfaces(tag: ET.Element) -> dict[str | None, list[tuple[str, str | None]]]:
        return {joint.get("name"): [(each.tag, each.get("name")) for each in joint] for joint in tag.iter("joint")}

    wanted, made = ET.fromstring(block[1]), found(parsed(urdf(Axis(NOMINAL_DRIVE))), "ros2_control")
    assert interfaces(made) == interfaces(wanted)
    assert made.get("type") == wanted.get("type")
    assert made.findtext("hardware/plugin") == wanted.findtext("hardware/plugin")
    current = parsed(urdf(Axis(replace(NOMINAL_DRIVE, command_interface="current"))))
    command = found(current, ".//command_interface")
    assert command.get("name") == "current"
    assert [float(each.text or "") for each in command] == [-12.0, 12.0]


@pytest.mark.parametrize("drive", DRIVES, ids=range(len(DRIVES)))
def test_joints_of_urdf_and_sdf_are_the_drives(drive: Drive) -> None:
    axis = Axis(drive, position_lower=-1.5, position_upper=2.0)
    robot, model = parsed(urdf(axis)), parsed(sdf(axis))
    n, stall = drive.gear.ratio, drive.standstill_torque()
    for name, part, ratio in (("motor", drive.motor, n), ("load", drive.load, 1.0)):
        joint, turn = found(robot, f"joint[@name='{name}']"), found(model, f".//joint[@name='{name}']/axis")
        limit, dynamics = found(joint, "limit"), found(joint, "dynamics")
        assert (
            float(dynamics.get("damping", "")) == float(turn.findtext("dynamics/damping", "")) == part.viscous_friction
        )
        assert float(dynamics.get("friction", "")) == part.coulomb_friction
        assert float(turn.findtext("dynamics/friction", "")) == part.coulomb_friction
        assert float(limit.get("effort", "")) == pytest.approx(stall * ratio)
        assert float(turn.findtext("limit/effort", "")) == pytest.approx(stall * ratio)
        # At this speed the whole voltage goes into the back-EMF and the motor's own friction.
        speed = float(limit.get("velocity", "")) if name == "motor" else float(limit.get("velocity", "")) / n
        motor = drive.motor
        current = motor.viscous_friction * speed / motor.torque_constant
        assert motor.torque_constant * speed + motor.resistance * current == pytest.approx(motor.voltage_limit)
        assert float(turn.findtext("limit/velocity", "")) == float(limit.get("velocity", ""))
    load = found(robot, "joint[@name='load']")
    assert load.get("type") == "revolute"
    assert (found(load, "limit").get("lower"), found(load, "limit").get("upper")) == ("-1.5", "2.0")
    assert float(found(load, "mimic").get("multiplier", "")) == n
    stop, fit = found(model, ".//joint[@name='load']"), fit_limit(drive)
    assert float(stop.findtext("axis/limit/lower", "")) == -1.5
    assert float(stop.findtext("axis/limit/stiffness", "")) == fit.stiffness
    assert float(stop.findtext("axis/mimic/multiplier", "")) == n
    erp, cfm = (float(stop.findtext(f"physics/ode/limit/{name}", "")) for name in ("erp", "cfm"))
    # A step h of a spring k and damper c in ODE: erp = h k/(h k + c), cfm = 1/(h k + c).
    assert erp / cfm == pytest.approx(1e-3 * fit.stiffness)
    assert (1.0 - erp) / cfm == pytest.approx(fit.damping, rel=1e-6)


def test_joints_without_ends_are_continuous() -> None:
    for make, path in ((urdf, "joint"), (sdf, "model/joint")):
        types = {joint.get("name"): joint.get("type") for joint in parsed(make(Axis(NOMINAL_DRIVE))).findall(path)}
        assert (types["motor"], types["load"]) == ("continuous", "continuous")


def test_ends_are_readings_of_the_encoder_whatever_zero_they_count_from() -> None:
    """As a robot model compares them with joint_states."""
    axis = Axis(NOMINAL_DRIVE, position_lower=-1.5, position_upper=2.0, zero=3.0)
    robot, model = parsed(urdf(axis)), parsed(sdf(axis))
    limit, stop = found(robot, "joint[@name='load']/limit"), found(model, ".//joint[@name='load']/axis/limit")
    assert (limit.get("lower"), limit.get("upper")) == ("1.5", "5.0")
    assert (stop.findtext("lower"), stop.findtext("upper")) == ("1.5", "5.0")
    for make in (urdf, sdf):
        assert "count from zero = 3.0 rad" in make(axis)
        assert "count from zero" not in make(replace(axis, zero=0.0))
    assert mjcf(axis) == mjcf(Axis(NOMINAL_DRIVE))  # without ends


# The command


def test_what_the_file_says_is_what_is_exported(tmp_path: Path) -> None:
    file = tmp_path / "drive.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    motor_joint: m\n    load_joint: l\n    gear: {reduction: 50.0}\n"
        "    limits: {position_lower: -1.0, position_upper: 2}\n    zero: 0.5\n"
    )
    axis = read_axis(file)
    assert (axis.motor_joint, axis.load_joint, axis.position_lower, axis.position_upper) == ("m", "l", -1.0, 2)
    assert (axis.zero, axis.end_readings) == (0.5, (-0.5, 2.5))
    assert axis.has_ends
    nominal = read_axis(ROOT / "config" / "nominal_drive.yaml")
    assert nominal == Axis(NOMINAL_DRIVE)
    assert not nominal.has_ends


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["export", *arguments])
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    return printed.err


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("gear: {reduction: 0.0}", "gear.reduction must be >= 0.001 and <= 100000, got 0.0"),
        ("motor: {mass: 1.0}", "motor.mass"),
        ("a: 1", "must have ROS parameters of motor, gear or load"),
        ("gear: {}\nmotor_joint: 5", "motor_joint must be a name in printable letters, got 5"),
        ('gear: {}\nload_joint: "a\\u0001b"', "load_joint must be a name in printable letters"),
        ("gear: {}\nload_joint: motor", "motor_joint and load_joint must differ, got 'motor' for both"),
        ("gear: {}\nlimits: {position_lower: 1.0, position_upper: 0.5}", "limits.position_lower must be <"),
        ("gear: {}\nlimits: {position_lower: wide}", "limits.position_lower must be a number, in rad, got 'wide'"),
        ("gear: {}\nzero: .nan", "zero must be a finite number, >= -1e+06 rad and <= 1e+06 rad, got nan"),
        ("gear: {}\nzero: here", "zero must be a finite number"),
        ("gear: [", "line 1: while parsing"),
    ],
)
def test_a_bad_file_is_refused_with_its_reason(
    content: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "drive.yaml", tmp_path / "out.xml"
    file.write_text(content)
    said = refusal(capsys, str(file), "--format", "mujoco", "--out", str(out))
    assert reason in said
    assert str(file) in said
    assert not out.exists()


def test_a_file_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, out = str(ROOT / "config" / "nominal_drive.yaml"), tmp_path / "new" / "drive.xml"
    arguments = [drive, "--format", "urdf", "--out", str(out)]
    assert main(["export", *arguments]) == 0
    assert out.read_text() == urdf(Axis(NOMINAL_DRIVE))
    out.write_text("mine")
    assert "exists; --force overwrites it" in refusal(capsys, *arguments)
    assert out.read_text() == "mine"
    assert main(["export", *arguments, "--force"]) == 0
    assert out.read_text() == urdf(Axis(NOMINAL_DRIVE))
    assert [path.name for path in out.parent.iterdir()] == ["drive.xml"]
    assert "must be writable" in refusal(capsys, *arguments[:-1], str(tmp_path), "--force")
    assert "a URDF has no teeth" in refusal(capsys, *arguments[:3], "--torque", "1")
    assert str(tmp_path / "no.yaml") in refusal(capsys, str(tmp_path / "no.yaml"), "--format", "sdf")
    assert "torque must be > 0 N m" in refusal(capsys, drive, "--format", "mujoco", "--torque", "0")
    assert "--format" in refusal(capsys, drive, "--format", "bvh")


def test_without_a_file_the_text_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(ROOT / "config" / "nominal_drive.yaml"), "--format", "sdf"]) == 0
    assert capsys.readouterr().out == sdf(Axis(NOMINAL_DRIVE))


def test_help_has_an_example_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    example = re.search(r"example:\s+backlash\s+(.*)", " ".join(capsys.readouterr().out.split()))
    assert example
    shutil.copytree(ROOT / "config", tmp_path / "config")
    monkeypatch.chdir(tmp_path)
    assert main(example[1].split()) == 0
    assert Path("drive.xml").exists()


def test_commands_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In their order, in a folder with nothing but config."""
    shutil.copytree(ROOT / "config", tmp_path / "config")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(sh|python)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    commands = [line for kind, block in blocks if kind == "sh" for line in block.splitlines()]
    assert len(commands) >= 3
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    for command in commands:
        assert command.startswith("backlash export ")
        assert main(command.split()[1:]) == 0
    if find_spec("mujoco") is not None and tuple(map(int, version("mujoco").split(".")[:2])) >= (3, 7):  # dcmotor
        for code in (block for kind, block in blocks if kind == "python"):
            run = [sys.executable, "-c", code]
            done = subprocess.run(run, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120, check=False)
            assert done.returncode == 0, done.stderr
            assert float(done.stdout.split()[0]) == pytest.approx(0.145, abs=0.01)
