"""A dashboard in a process of its own, drive and controller beside it, and a page's connection without a browser."""

import http.client
import math
import re
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from backlash_ros.dashboard.rows import JOINT_COLUMNS, STATE_COLUMNS
from backlash_ros.drivetrain import NOMINAL_DRIVE

Start = Callable[..., Process]
B = NOMINAL_DRIVE.gear.backlash_angle
WATCHDOG = 1.0
ANEW = ("law", "backlash_angle", "gain_set", "identified", "learning.experiment")


class Served:
    """A dashboard in a process of its own, and where it serves."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder / "kept"
        words = ["-p", "port:=0", "-p", f"folder:={self.folder}", *arguments]
        self.process = Process("dashboard", words, folder / "dashboard.log")

    @property
    def address(self) -> str:
        """Empty until it has said where it serves."""
        found = re.search(r"^http://\S+$", self.process.output(), re.MULTILINE)
        return found[0] if found else ""

    @property
    def host(self) -> str:
        return self.address.removeprefix("http://").partition("/")[0]

    def ask(self, method: str, path: str, **headers: str) -> tuple[int, str]:
        connection = http.client.HTTPConnection(self.host, timeout=60)
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read().decode()


def begin(start: Start, **controller: object) -> Process:
    """Start drive and controller; time waits for the answers, so that the drive does the same on any machine."""
    drive = start("plant_simulator", lockstep=True, command_timeout=WATCHDOG)
    start("controller", **{"state_timeout": 10.0, "use_sim_time": True, **controller})
    return drive


class Reader:
    """One page's connection, without a browser: frames as they come."""

    def __init__(self, served: Served) -> None:
        self._open = ExitStack()
        host = served.host
        rest = {"max_size": None, "open_timeout": 60, "close_timeout": 1}
        rest["ping_interval"] = None  # one that stands still asks nobody
        page = connect(f"ws://{host}/samples?axis=/", origin=f"http://{host}", **rest)
        self._connection = self._open.enter_context(page)
        self.samples: list[tuple[float, ...]] = []
        self.states: list[tuple[float, ...]] = []

    def read(self) -> None:
        data = self._connection.recv(timeout=30)
        assert isinstance(data, bytes)
        split = 8 + int(struct.unpack_from("<d", data)[0])
        self.samples += struct.iter_unpack(f"<{len(JOINT_COLUMNS)}d", data[8:split])
        self.states += struct.iter_unpack(f"<{len(STATE_COLUMNS)}d", data[split:])

    @property
    def span(self) -> float:
        """Time between its first and its last sample, s."""
        return self.samples[-1][0] - self.samples[0][0] if self.samples else 0.0

    def close(self) -> None:
        self._open.close()


class Button:
    """A button that a page without a browser holds: it says so, again and again, where ``hold`` is called."""

    def __init__(self, served: Served, share: float = 0.03) -> None:
        self._address, self._rest = f"ws://{served.host}/jog?axis=/&way=1&share={share}", {"open_timeout": 60}
        self._origin = f"http://{served.host}"
        self._open, self._said = ExitStack(), 0.0
        self._connection = self._press()

    def _press(self) -> ClientConnection:
        connection = connect(self._address, origin=Origin(self._origin), close_timeout=1, **self._rest)
        return self._open.enter_context(connection)

    def hold(self) -> None:
        """Say that it is held, 20 times a second; press again if it was ended: the machine may stand still."""
        if time.monotonic() < self._said + 0.05:
            return
        self._said = time.monotonic()
        try:
            self._connection.send("held")
        except ConnectionClosed:
            self._connection = self._press()

    def close(self) -> None:
        self._open.close()


class System:
    """Drive, controller and dashboard that several tests use, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.peer = Peer()
        said = {"plant_simulator": ["lockstep:=true", f"command_timeout:={WATCHDOG}"]}
        said["controller"] = ["state_timeout:=10.0", "use_sim_time:=true", "loop_delay:=0.008"]
        self._nodes = [
            Process(name, [word for rule in rules for word in ("-p", rule)], folder / f"{name}.log")
            for name, rules in said.items()
        ]
        self.served = Served(folder)
        self.peer.wait("the dashboard", lambda: self.served.address)
        self.parameters = Parameters(self.peer, "controller")
        self._reference = self.peer.node.create_publisher(Float64, "reference", 10)
        self._faults = self.peer.node.create_client(Trigger, "controller/reset_fault")
        self.loads: list[float] = []
        self.peer.node.create_subscription(JointState, "joint_states", lambda m: self.loads.append(m.position[1]), 10)
        self._at_first = dict(zip(ANEW, self.parameters.get(*ANEW), strict=True))

    def anew(self) -> None:
        """Put back what a test may have changed, and let the load come to rest at 0."""
        self._faults.call_async(Trigger.Request())
        if Lifecycle(self.peer, "controller").state == "inactive":
            Lifecycle(self.peer, "controller").change(Transition.TRANSITION_ACTIVATE)
        assert self.parameters.set(**{name.replace(".", "__"): value for name, value in self._at_first.items()})[0]

        def there() -> bool:
            self._reference.publish(Float64(data=0.0))
            return bool(self.loads) and abs(self.loads[-1]) < B

        self.peer.wait("the load at 0", there)

    def moved(self, way: float, meanwhile: Callable[[], object] = lambda: None) -> float:
        """Wait until the load has moved by a way, rad; return where it is."""
        begin = self.loads[-1]

        def there() -> bool:
            meanwhile()
            return (self.loads[-1] - begin) * math.copysign(1.0, way) > abs(way)

        self.peer.wait(lambda: f"a motion by {way} rad, not from {begin} to {self.loads[-1]}", there)
        return self.loads[-1]

    def stands(self) -> float:
        """Wait until the load has not moved for half a second but for a rattle; return where it is."""
        seen = len(self.loads)
        self.peer.wait(
            "a load that stands", lambda: len(self.loads) > seen + 125 and np.ptp(self.loads[-125:]) < 1.5 * B
        )
        return self.loads[-1]

    def close(self) -> None:
        for process in (self.served.process, *self._nodes):
            process.kill()
            print(f"--- {process.log.stem}\n{process.output()}")
        self.peer.close()
