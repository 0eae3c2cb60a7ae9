"""A simulated drive, its controller and the page, on this machine alone: `make live`."""

import argparse
import socket
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from backlash_ros.dashboard.command import main as dashboard
from backlash_ros.drive_file.drive_file import read_start
from backlash_ros.foundation.parser import Parser
from backlash_ros.ros.client import start_node, stop_node
from backlash_ros.ros.isolation import isolated
from backlash_ros.simulation.__main__ import compile_all

_PORT = 8080
_IN_STEP = ["-p", "lockstep:=true"]
"""For the simulator: time waits for the answers, so that a busy machine does not affect the motion."""
_PATIENT = ["-p", "use_sim_time:=true", "-p", "state_timeout:=3.0"]
"""For the controller, whose watchdog goes by the wall clock: patient with a busy machine, on which no time passes
meanwhile; an encoder that is lost is a fault soon, as time passes then."""


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return probe.connect_ex(("127.0.0.1", port)) != 0


def port_number(text: str) -> int:
    """Return the number of a TCP port; 0 stands for any."""
    if not (text.isascii() and text.isdigit() and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 to 65535, got {text!r}")
    return int(text)


def main(words: Sequence[str] | None = None) -> int:
    """Run it until Ctrl-C; the address is printed. OSError and ValueError as `read_start`."""
    parser = Parser(prog="backlash live", description=__doc__, epilog="example: backlash live --port 8081")
    help_port = f"of the page; by default {_PORT}, or if that is in use, any"
    parser.add_argument("--port", type=port_number, metavar="PORT", help=help_port)
    help_drive = "drive file, as `backlash setup` writes it; by default the nominal drive"
    parser.add_argument("--drive", type=Path, metavar="FILE", help=help_drive)
    parser.add_argument("--out", type=Path, default=Path("results/live"), metavar="DIR", help="for recordings and logs")
    given = parser.parse_args(words)
    port = given.port if given.port is not None else _PORT if _free(_PORT) else 0
    if given.drive is not None and not given.drive.is_file():
        parser.error(f"argument --drive: must be a file, got '{given.drive}'")
    of_drive = []
    if given.drive is not None:
        read_start(given.drive)  # refused like the controller, whose log nobody would read
        of_drive = ["--params-file", str(given.drive)]
    try:
        given.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"argument --out: must be a folder, got '{given.out}': {error.strerror}")
    print("compiling what this version has not compiled yet: once, a minute or two", flush=True)
    compile_all()
    with isolated(), ExitStack() as running:
        for name, arguments in (("plant_simulator", _IN_STEP), ("controller", _PATIENT)):
            running.callback(stop_node, start_node(name, given.out / f"{name}.log", *of_drive, *arguments))
        return dashboard(["--ros-args", "-p", f"port:={port}", "-p", f"folder:={given.out}"])


if __name__ == "__main__":
    raise SystemExit(main())
