"""Inputs for every command, made from a seed: files that are cut, overwritten or something else, and odd options."""

import random
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from plain_bag import PlainBag
from rosbags.rosbag2 import StoragePlugin

VALUES = (
    *(".nan", "-.inf", "1e400", "1e300", "-1", "0", "0.0", "1e-300", "9" * 400, "1e5", "250", "3.0"),
    *(
        "text",
        "''",
        "[]",
        "{}",
        "null",
        "true",
        "2026-01-31",
        "!!binary YQ==",
        "*a",
        "&a 1",
        "[1.0, [2.0]]",
        "{a: {b: 1}}",
    ),
    *(
        "[1.0, 2.0, 3.0]",
        "current",
        "elastic",
        "[theta_m]",
        "\u00e4",
        "1,5",
        "-0",
        "|",
        "\t",
        "- 1",
        "'",
        "/axis",
        "bad name",
        "~",
    ),
)
DRIVE = """/**:
  ros__parameters:
    rate: 250.0
    law: auto
    command_interface: voltage
    motor_joint: motor
    load_joint: load
    loop_delay: 0.0
    motor:
      resistance: 3.37
      inductance: 3.37e-3
      torque_constant: 0.09303
      inertia: 6.924e-5
      viscous_friction: 6.924e-5
      coulomb_friction: 0.0
      voltage_limit: 24.0
      current_limit: 12.0
    gear:
      reduction: 5.374597
      backlash_angle: 0.02
      backlash_variation: 0.1
    load:
      inertia: 0.0005
      viscous_friction: 0.001
      gravity_torque: 0.0
    contact:
      law: power
      power: {exponent: 21}
    sensors:
      measured: [theta_m, theta_l]
      motor_counts: 4096.0
      load_noise: 0.0
    delay: {command: 0.001}
    limits: {position_lower: -3.0, position_upper: 3.0}
    gain_set: nominal
    gains: {fast: {q: [300.0, 1.0]}}
"""
TABLE = "time,motor,load,command\n" + "".join(
    f"{0.004 * k:.3f},{0.05 * (k % 20):.4f},{0.009 * (k % 19):.4f},{(-1) ** (k // 10) * 2.0:.1f}\n" for k in range(160)
)
PATH = """header: {stamp: {sec: 0, nanosec: 0}}
joint_names: [load, other]
points:
- positions: [0.1, 0.0]
  velocities: [1.0, 0.0]
  accelerations: [0.0, 0.0]
  time_from_start: {sec: 0, nanosec: 100000000}
- positions: [0.2, 0.0]
  velocities: [0.0, 0.0]
  accelerations: [0.0, 0.0]
  time_from_start: {sec: 0, nanosec: 300000000}
"""
PATH_TABLE = "time,position,velocity,acceleration\n0.1,0.1,1.0,0.0\n0.2,0.15,0.3,0.0\n0.3,0.2,0.0,0.0\n"
ANSWERS = """motor: pololu 4753
motor.voltage_limit: 12
motor.inertia: 8 g cm^2
command_interface: voltage
gear.reduction: 50
gear.backlash_angle: 1.5 deg
load.body: disc
load.mass: 0.2 kg
load.size: 40 mm
encoders: both
sensors.motor_counts: 64
sensors.load_counts: 12 bit
limits.position_lower: -1.0 rad
limits.position_upper: 90 deg
limits.command: 3.0
rate: 250
"""
OPTIONS: dict[str, Sequence[str]] = {
    "simulate": ("--load-torque", "--reference", "--seconds", "--set", "--law", "--case"),
    "check": (),
    "setup": (),
    "design": ("--load-torque", "--rate", "--delay"),
    "export": ("--torque",),
    "evaluate": ("--laws", "--experiments", "--drives", "--scheduler", "--model"),
    "identify": (
        *("--from", "--to", "--motor-unit", "--load-unit", "--motor-counts", "--load-wraps", "--motor-at", "--supply"),
        *("--command-unit", "--time-unit", "--time-column", "--joint-topic", "--stamps", "--rated-torque"),
    ),
    "lost-motion": (
        *(
            "--from",
            "--to",
            "--motor-unit",
            "--load-unit",
            "--motor-at",
            "--reduction",
            "--rated-torque",
            "--time-unit",
        ),
        *("--torque-unit", "--torque-column", "--time-column", "--load-column"),
        *("--load-joint", "--command-topic", "--stamps"),
    ),
    "report": (
        *("--reference-topic", "--joint-topic", "--motor-joint", "--motor-unit", "--load-counts", "--velocity-unit"),
        *("--effort-unit", "--reference-unit", "--backlash-angle", "--command-index", "--stamps"),
    ),
    "replay": ("--set", "--controller"),
    "params": ("--unknown",),
}
"""The commands whose files are made up, with the options that take a value."""
LIKELY = (
    "counts",
    "deg",
    "A",
    "duty",
    "log",
    "ms",
    "output",
    "planned",
    "fast",
    "load.inertia=1e-3",
    "gear.backlash=x",
)
OUTPUTS = {
    "simulate": "--csv",
    "design": "--out",
    "setup": "--out",
    "export": "--out",
    "identify": "--json",
    "lost-motion": "--certificate",
    "report": "--out",
    "replay": "--json",
}


def bags(folder: Path) -> list[Path]:
    """Write small bags, one with odd messages in it, of both storages; return their folders."""
    found = []
    for odd in (False, True):
        bag = PlainBag()
        for k in range(60):
            time, angle = 0.01 * k, 0.1 * (k % 20)
            bag.sample(
                "/joint_states", time, ("motor", "load") if not odd or k % 7 else ("load",), (angle, 0.2 * angle)
            )
            values: dict[str, Any] = {"reference": float(k > 20), "holding": 1.0, "active": 1.0, "samples": float(k)}
            values |= {"elapsed": 0.01, "experiment": 0.0, "fault": 0.0}
            if odd:
                values |= {"reference": "soon", "fault": 1e9}
            bag.status("/controller/state", time, "servo", values)
            bag.numbers("/command", time, [float("nan")] if odd and k % 5 else [1.0], answers=time)
        if odd:
            bag.status("/reference", 0.0, "target", {"value": 1.0})
        name = "odd" if odd else "good"
        found += [bag.write(folder / f"{name}_{storage.name}", storage) for storage in StoragePlugin]
    return found


def _spoilt(content: bytes, chance: random.Random) -> bytes:
    """Return bytes of which something is cut, doubled, left out or overwritten."""
    at, length = chance.randrange(len(content) + 1), chance.randrange(1, 40)
    ways: list[Callable[[], bytes]] = [
        lambda: content[:at],
        lambda: content[:at] + chance.randbytes(length) + content[at + length :],
        lambda: content[:at] + content[at + length :],
        lambda: content[:at] + content[max(at - length, 0) :],
        lambda: content,
    ]
    return chance.choice(ways)()


def _other(place: Path, chance: random.Random) -> Path:
    """Make something that is no file of the kind that is wanted, or nothing."""
    kind = chance.choice(("nothing", "folder", "empty", "noise", "levels", "utf-16", "zeros", "link", "long"))
    if kind == "folder":
        place.mkdir()
    elif kind == "link":
        place.symlink_to(place)
    elif kind == "long":
        return place.with_name("x" * 300)
    elif kind != "nothing":
        contents = {"empty": b"", "noise": chance.randbytes(500), "levels": b"[" * 3000, "zeros": bytes(300)}
        place.write_bytes(contents.get(kind, DRIVE.encode("utf-16")))
    return place


def _kept(lines: Sequence[str], place: Path, chance: random.Random) -> Path:
    """Write lines, spoilt now and then."""
    content = "\n".join(lines).encode()
    place.write_bytes(_spoilt(content, chance) if chance.random() < 0.2 else content)
    return place


def _drive_file(folder: Path, chance: random.Random) -> Path:
    place = folder / "drive.yaml"
    if chance.random() < 0.15:
        return _other(place, chance)
    lines = DRIVE.splitlines()
    for _ in range(chance.randrange(3)):
        k = chance.randrange(2, len(lines))
        key, colon, _ = lines[k].partition(":")
        ways = [f"{key}{colon} {chance.choice(VALUES)}", f"{lines[k]}\n{lines[k]}", f" {lines[k]}", "", f"{key}x: 1.0"]
        ways += [f"{lines[k]}\n    load.inertia: 1.0", f"{lines[k]}\n    1: 2"]
        lines[k] = chance.choice([ways[0], *ways])
    return _kept(lines, place, chance)


def _answers(folder: Path, chance: random.Random) -> Path:
    """Return answers for `backlash setup`, whole or not."""
    place = folder / "answers.yaml"
    if chance.random() < 0.15:
        return _other(place, chance)
    lines = ANSWERS.splitlines()
    for _ in range(chance.randrange(3)):
        k = chance.randrange(len(lines))
        key = lines[k].partition(":")[0]
        lines[k] = chance.choice(
            [f"{key}: {chance.choice(VALUES)}", f"{key}: {chance.choice(VALUES)} deg", "", f"{key}x: 1"]
        )
    return _kept(lines, place, chance)


def _path(folder: Path, chance: random.Random) -> Path:
    """Return a path of the load, as YAML or a table, whole or not."""
    yaml = chance.random() < 0.5
    place = folder / ("path.yaml" if yaml else "path.csv")
    if chance.random() < 0.1:
        return _other(place, chance)
    lines = (PATH if yaml else PATH_TABLE).splitlines()
    for _ in range(chance.randrange(3)):
        k = chance.randrange(len(lines))
        begin, mark, _ = lines[k].rpartition(": " if yaml else ",")
        lines[k] = chance.choice([f"{begin}{mark}{chance.choice(VALUES)}", f"{lines[k]}\n{lines[k]}", ""])
    return _kept(lines, place, chance)


def _recording(folder: Path, originals: Sequence[Path], chance: random.Random) -> Path:
    """Return a table or a bag, whole or not."""
    way = chance.random()
    if way < 0.15:
        return _other(folder / chance.choice(("a.csv", "a", "a.mcap", "a.db3", "metadata.yaml")), chance)
    if way < 0.5:
        place = folder / chance.choice(("a.csv", "a.log", "a"))
        lines = TABLE.splitlines()
        for _ in range(chance.randrange(3)):
            cells = lines[k := chance.randrange(len(lines))].split(",")
            cells[chance.randrange(len(cells))] = chance.choice(VALUES)
            lines[k] = ",".join(cells)
        text = "\n".join(lines)
        text = chance.choice(
            (text, text.replace(",", ";"), text.replace(",", "\t"), text.replace(",", ";").replace(".", ","))
        )
        content = text.encode()
        place.write_bytes(_spoilt(content, chance) if chance.random() < 0.4 else content)
        return place
    bag = folder / "bag"
    shutil.copytree(chance.choice(originals), bag)
    if chance.random() < 0.7:
        file = chance.choice(sorted(bag.iterdir()))
        file.write_bytes(_spoilt(file.read_bytes(), chance))
    return bag if chance.random() < 0.7 else chance.choice(sorted(bag.iterdir()))


def command(seed: int, folder: Path, originals: Sequence[Path]) -> list[str]:
    """Return the words of a command whose files are in ``folder``, which is empty; the same for each seed."""
    chance = random.Random(seed)
    if chance.random() < 0.08:
        return _without_files(folder, chance)
    name = chance.choice(list(OPTIONS))
    words = [name]
    if name in {"simulate", "check", "design", "export"}:
        words += [str(_drive_file(folder, chance))] if name != "simulate" or chance.random() < 0.9 else []
    if name in {"identify", "lost-motion", "report", "replay"}:
        words += [str(_recording(folder, originals, chance))]
        words += ["--drive", str(_drive_file(folder, chance))] if name != "replay" and chance.random() < 0.4 else []
    if name == "lost-motion" and chance.random() < 0.6:
        words += ["--torque-column=command"]
    if name == "simulate" and len(words) > 1:
        follows = chance.random() < 0.5
        words += ["--trajectory", str(_path(folder, chance))] if follows else ["--seconds", "0.1"]
    if name == "setup":
        words += ["--answers", str(_answers(folder, chance))]
    if name == "export":
        words += ["--format", chance.choice(("mujoco", "urdf", "sdf"))]
    if name == "evaluate":
        words += ["--seed", "1", "--only", "0", "--drive", str(_drive_file(folder, chance))]
    for option in chance.choices(OPTIONS[name], k=chance.choice((0, 0, 1, 2))) if OPTIONS[name] else ():
        words += [f"{option}={chance.choice(VALUES + LIKELY)}"]
    if name in OUTPUTS and (name == "report" or chance.random() < 0.5):
        out = folder / chance.choice(("out", "out", "x" * 300, ".", "new/out", "drive.yaml/out"))
        words += [OUTPUTS[name], str(out)]
    return words


def _without_files(folder: Path, chance: random.Random) -> list[str]:
    """Return commands that would start something, with what keeps them from it."""
    (folder / "file").write_text("")
    file, odd = str(folder / "file"), chance.choice(VALUES)
    return chance.choice(
        [
            ["measure", f"--namespace={odd}", "--out", file],
            ["measure", f"--rated-torque={odd}", "--out", str(folder)],
            ["figures", "planned", "--out", file],
            ["figures", "--out", str(folder), "--page", str(folder)],
            ["live", "--out", file],
            ["live", "--drive", file],
            ["live", "--port", "x" + odd],
            ["demo", "--out", f"{file}/out"],
            ["params", "--out", f"{file}/out"],
            ["params", odd],
            [odd],
            [],
        ]
    )
