"""The parameters of each node, declared by functions, so that each node knows all names without creating the others."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.node import Node

from backlash_ros.drivetrain import Drive, Effects
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.parameters import FOUND, drive_of
from backlash_ros.foundation.quantity import Quantity, take
from backlash_ros.foundation.reading.misspelled import check_known
from backlash_ros.foundation.reading.parameter_files import by_name
from backlash_ros.ros.overrides import values_given
from backlash_ros.ros.parameters import (
    NONE,
    Declarations,
    declare,
    declare_autostart,
    declare_drive,
    declare_joints,
    declare_number,
    declare_quantities,
    declare_rate,
    declare_sensors,
    declare_timeout,
)
from backlash_ros.ros.topics import TOPICS


@dataclass(frozen=True)
class SimulatorParameters:
    """The plant simulator's parameters; times in s, rates in Hz. ``sensors`` are values by name, and dynamic."""

    drive: Drive
    joints: tuple[str, str]
    rate: float
    real_time_factor: float
    lockstep: bool
    command_timeout: float
    sensors: dict[str, Any]
    delay: Delay
    seed: int


def declare_simulator(node: Node) -> SimulatorParameters:
    """Declare the plant simulator's parameters and return them; ValueError names a refused one."""
    values = declare_drive(node) | declare_quantities(node, Effects(), dynamic=NONE)
    drive, joints, rate = drive_of(values), declare_joints(node), declare_rate(node)
    text = "simulated time divided by real time; with lockstep an upper limit, and 0: as fast as possible"
    factor = declare_number(node, "real_time_factor", 1.0, Quantity(text, "", 0.0, 100.0))
    text = "wait for the answer to each sample; the simulated time is then published on /clock"
    lockstep = declare(node, "lockstep", False, text, read_only=True)
    if not (factor or lockstep):
        raise ValueError("real_time_factor must be > 0 without lockstep, got 0")
    text = "time without a valid command after which the motor gets 0 V; a command is as old as the sample it answers"
    timeout = declare_timeout(node, "command_timeout", text, 1.0 / rate / (factor or 1.0))
    sensors, delay = declare_sensors(node), take(Delay, declare_quantities(node, Delay(), dynamic=NONE))
    seed = declare_number(node, "seed", 0, Quantity("seed of noise and jitter", "", 0, 2**31 - 1, whole=True))
    return SimulatorParameters(drive, joints, rate, factor, lockstep, timeout, sensors, delay, seed)


@dataclass(frozen=True)
class ControllerParameters:
    """The controller's fixed parameters; those that can change while it runs are in `Tunables`.

    Times in s, rates in Hz; ``drive`` are values by name, some of them dynamic.
    """

    drive: dict[str, Any]
    joints: tuple[str, str]
    wraps: tuple[float, float]
    rate: float
    state_timeout: float
    setpoint_timeout: float
    group: str
    telemetry_rate: float
    estimate_file: str
    use_estimate_file: bool


def _declare_estimate_file(node: Node) -> tuple[str, bool]:
    text = "file that stores every valid estimate; empty: none"
    bound = "a file of this controller, or a new file in an existing folder"
    file = declare(node, "learning.estimate_file", "", text, constraint=bound, read_only=True)
    text = "when configured, restore the newest applied value of each parameter from that file"
    use = declare(node, "learning.use_estimate_file", False, text, read_only=True)
    if use and not file:
        raise ValueError("learning.use_estimate_file must be false if learning.estimate_file is empty, got true")
    return file, use


def _declare_wrap(node: Node, side: str) -> float:
    text = f"range after which the {side}'s position in joint_states begins again, 2 pi for a turn; 0: it goes on"
    return float(declare_number(node, f"{side}_wrap", 0.0, Quantity(text, "rad", 0.0, 1e9)))


def declare_controller(node: Node) -> ControllerParameters:
    """Declare the controller's parameters except the tunable ones; ValueError names a refused one."""
    drive, joints, rate = declare_drive(node, FOUND), declare_joints(node), declare_rate(node)
    wraps = _declare_wrap(node, "motor"), _declare_wrap(node, "load")
    text = "time without joint_states after which the command is 0 V and a fault is latched"
    timeout = declare_timeout(node, "state_timeout", text, 1.0 / rate)
    text = "time without a setpoint after which their stream has ended; a fifth of it may lie between two of them"
    setpoint_timeout = float(declare_number(node, "setpoint_timeout", 0.1, Quantity(text, "s", 0.0, 10.0, True)))
    text = "axes with the same one move together: while one of them cannot, the others come to rest; empty: alone"
    name = "a letter, then letters, digits or underscores"
    group = declare(node, "group", "", text, constraint=name, read_only=True)
    if not re.fullmatch(r"([A-Za-z][A-Za-z0-9_]*)?", group):
        raise ValueError(f"group must be {name}, or be empty, got {group!r}")
    described = Quantity(
        "rate of ~/state, at most the sample rate; changes are also sent at once", "Hz", 0.0, rate, True
    )
    telemetry_rate = declare_number(node, "telemetry_rate", min(50.0, rate), described)
    return ControllerParameters(
        drive, joints, wraps, rate, timeout, setpoint_timeout, group, telemetry_rate, *_declare_estimate_file(node)
    )


@dataclass(frozen=True)
class RecorderParameters:
    """The recorder's parameters."""

    output: str
    topics: Sequence[str]


def declare_recorder(node: Node, output: str) -> RecorderParameters:
    """Declare the recorder's parameters and return them; ``output`` is the default folder."""
    text = "folder to create; must not exist yet"
    output = declare(node, "output", output, text, read_only=True)
    return RecorderParameters(output, declare(node, "topics", list(TOPICS), "topics to record", read_only=True))


@dataclass(frozen=True)
class DashboardParameters:
    """The dashboard's parameters; ``port`` 0 stands for any free port."""

    host: str
    port: int
    token: str
    read_only: bool
    folder: str


def declare_dashboard(node: Node) -> DashboardParameters:
    """Declare the dashboard's parameters and return them."""
    fixed = partial(declare, node, read_only=True)
    text = "address at which the page is served; any but this machine's loopback address needs a token"
    host = fixed("host", "127.0.0.1", text)
    port = declare_number(
        node, "port", 8080, Quantity("TCP port of the page; 0: any free port", "", 0, 65535, whole=True)
    )
    text = "secret needed to see the page; if empty and the address needs one, a new one is made"
    token = fixed("token", "", text)
    read_only = fixed("read_only", False, "show everything, allow no change")
    text = "folder for recordings and measurements, each in a new subfolder"
    return DashboardParameters(host, port, token, read_only, fixed("folder", "dashboard", text))


def all_names(given: Mapping[str, Any]) -> set[str]:
    """Return the parameter names of all nodes with the overrides ``given``, which may name gain sets."""
    # Imported only when needed: the simulator needs no control law.
    from backlash_ros.nodes.tunables import tunable_names  # noqa: PLC0415

    names: Any = Declarations()
    declare_autostart(names)
    declare_simulator(names)
    declare_controller(names)
    declare_recorder(names, "")
    declare_dashboard(names)
    return {*names.declared, *tunable_names(given)}


def refuse_misspelled(parameters: Mapping[str, Any]) -> None:
    """Refuse misspelled parameters in sections, as files have them; ValueError as `check_known`."""
    given = by_name(parameters)
    check_known(given, [], lambda: all_names(given))


def refuse_unknown(node: Node) -> None:
    """Refuse misspelled overrides of ``node``, after all of its parameters have been declared."""
    given = values_given(node)
    check_known(given, list(node._parameters), lambda: all_names(given))
