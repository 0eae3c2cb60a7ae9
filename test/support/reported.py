"""Bags to make reports of: one of somebody else's drive, whose figures are known, and one of several axes of ours."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from plain_bag import PlainBag

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.simulation import Scenario, run

# Somebody else's drive: degrees, rpm and mN m, names of its own; two steps of 30 degrees whose shapes are formulas.

PERIOD, HEIGHT, B = 0.004, 30.0, 1.0
"""Of the samples, s; of a step and of the backlash, degrees at the output."""
DAMPING, NATURAL = 0.5, 20.0
"""Of the first step: damping ratio and natural frequency, rad/s."""
CYCLE, FREQUENCY = 0.8, 8.0
"""Of the limit cycle after the second step: peak to peak, degrees, and Hz."""
MEETING = 4.5
"""From when on the teeth meet on both flanks in turn, s."""
REDUCTION = 10.0
FIRST, SECOND, END = 1.0, 4.0, 7.0
"""When the steps begin and the bag ends, s."""
JITTER, AGES, LOST = 2e-4, (1e-3, 3e-3), tuple(range(1500, 1600, 10))
"""By which stamps are early and late in turn, and how old samples are in turn, s; samples that are not in the bag."""
PEAK, SPEED = 250.0, 3.0
"""Torque of the motor, mN m, at the start of each step, and speed that is said of the load, rpm."""
FOREIGN = ["--joint-topic", "/plc/feedback", "--motor-joint", "drive_shaft", "--load-joint", "table"]
FOREIGN += ["--motor-unit", "deg", "--load-unit", "deg", "--velocity-unit", "rpm", "--effort-unit", "mNm"]
FOREIGN += ["--reference-topic", "/plc/target", "--command-topic", "/plc/volts", "--command-index", "1"]
"""The options that read it."""


def second_order(time: np.ndarray) -> np.ndarray:
    """Return the step response of a second-order system, 0 to 1."""
    root = math.sqrt(1.0 - DAMPING**2)
    late = np.maximum(time, 0.0)
    swing = np.sin(NATURAL * root * late + math.acos(DAMPING)) / root
    return np.where(time > 0.0, 1.0 - np.exp(-DAMPING * NATURAL * late) * swing, 0.0)


def settled(time: np.ndarray) -> np.ndarray:
    """Return a first-order rise to 1 within some tens of milliseconds."""
    return np.where(time > 0.0, 1.0 - np.exp(-np.maximum(time, 0.0) / 0.02), 0.0)


def foreign_load(time: np.ndarray) -> np.ndarray:
    """Return the load's angle, degrees."""
    cycling = np.clip((time - SECOND - 0.3) / 0.2, 0.0, 1.0)
    cycle = 0.5 * CYCLE * cycling * np.sin(2.0 * math.pi * FREQUENCY * time)
    return HEIGHT * (second_order(time - FIRST) - settled(time - SECOND)) + cycle


def foreign_twist(time: np.ndarray) -> np.ndarray:
    """Return the motor's angle through the gear less the load's, degrees: from flank to flank during the cycle."""
    return 0.5 * B * np.where(time > MEETING, np.sin(2.0 * math.pi * FREQUENCY * time), 1.0)


def foreign_bag() -> PlainBag:
    """Return the bag of that drive: another joint beside, a command in the second place, and no state."""
    bag, names = PlainBag(), ("other", "table", "drive_shaft")
    count = round(END / PERIOD)
    for k in range(count):
        stamp = k * PERIOD + (JITTER if k % 2 else -JITTER) * (k > 0)
        at = np.array([stamp])
        load = float(foreign_load(at)[0])
        motor = REDUCTION * (load + float(foreign_twist(at)[0]))
        torque = PEAK if min(abs(stamp - FIRST), abs(stamp - SECOND)) < 0.05 else 10.0
        if k not in LOST:
            received = stamp + AGES[k % 2]
            bag.sample(
                "/plc/feedback", stamp, names, (7.0, load, motor), (0, SPEED, 2), (0, 0, torque), received=received
            )
            bag.numbers("/plc/volts", received + 5e-4, (99.0, 1.5))
    bag.number("/plc/target", 0.0, 0.0)
    bag.number("/plc/target", FIRST, HEIGHT)
    bag.number("/plc/target", SECOND, 0.0)
    return bag


FOREIGN_DRIVE = f"motor:\n  torque_constant: 0.05\ngear:\n  reduction: {REDUCTION}\n"
"""The drive file that belongs to it."""


# Axes of ours: the simulated drive, with state and parameters as the controller publishes them.

LAWS = ("fast", "overdamped", "two_region")
AXIS_STEP, AXIS_END = 0.5, 3.0
"""When the reference goes to 1 rad, and when the recording ends, s."""


def in_use(law: str, backlash_angle: float) -> dict[str, object]:
    """Return parameters in use of a controller of the nominal drive."""
    drive = NOMINAL_DRIVE
    names = ("resistance", "inductance", "torque_constant", "inertia", "viscous_friction", "voltage_limit")
    return {
        **{f"motor.{name}": float(getattr(drive.motor, name)) for name in names},
        "gear.reduction": float(drive.gear.reduction),
        "gear.load_radius": float(drive.gear.load_radius),
        "load.inertia": float(drive.load.inertia),
        "command_interface": "voltage",
        "law": law,
        "gain_set": "nominal",
        "gains.fast.k": [31.6, 0.87, 0.167],
        "backlash_angle": backlash_angle,
    }


def add_axis(bag: PlainBag, namespace: str, law: str, *, fault: bool = False) -> None:
    """Add a step of 1 rad of a simulated axis, a change of gains after it, and, where asked for, a fault at 2.5 s."""
    b = NOMINAL_DRIVE.gear.backlash_angle
    settings = ServoSettings(GainSet.of(NOMINAL_DRIVE), law=law, backlash_angle=b)
    steps, first = round(AXIS_END / settings.period), round(AXIS_STEP / settings.period)
    reference = np.where(np.arange(steps) < first, 0.0, 1.0)
    seen = run(NOMINAL_DRIVE, settings, Scenario(reference))
    node = f"{namespace}/controller"
    bag.in_use(f"{node}/parameters_in_use", 0.0, 1, in_use(law, b))
    bag.in_use(f"{node}/parameters_in_use", 2.8, 2, in_use("cascade", b))
    for k in range(steps):
        stamp = k * settings.period
        motor, load = float(seen.state[k, 0]), float(seen.state[k, 2])
        torque = NOMINAL_DRIVE.motor.torque_constant * float(seen.state[k, 4])
        bag.sample(f"{namespace}/joint_states", stamp, ("motor", "load"), (motor, load), (), (torque, 0.0))
        bag.numbers(f"{namespace}/command", stamp + 3e-4, (float(seen.command[k]),), answers=stamp)
        if k % 5 == 0 or k == first:
            latched = 2 if fault and 2.5 <= stamp < 2.6 else 0
            values = {"fault": latched, "reference": reference[k], "experiment": int(stamp < 0.2)}
            bag.status(f"{node}/state", stamp, "servo", values | {"backlash_angle": b if stamp > 0.25 else 0.0})


def axes_bag(namespaces: Sequence[str]) -> PlainBag:
    """Return a bag of several axes, each with another law; the second one has a fault."""
    bag = PlainBag()
    for k, namespace in enumerate(namespaces):
        add_axis(bag, namespace, LAWS[k % len(LAWS)], fault=k == 1)
    bag.status("/diagnostics", 1.0, "/axis2/controller: timing", level=1, text="3 samples late within 1.0 s")
    bag.status("/diagnostics", 2.0, "/axis2/controller: timing", level=1, text="8 samples late within 1.0 s")
    return bag


def write_drive(folder: Path) -> Path:
    """Write the drive file of somebody else's drive."""
    path = folder / "their_drive.yaml"
    path.write_text(FOREIGN_DRIVE)
    return path
