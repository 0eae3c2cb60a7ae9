"""A dashboard in a process of its own, drive and controller beside it, and a page's connection without a browser."""

import http.client
import re
import struct
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from websockets.sync.client import connect

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
        self._load: list[float] = []
        self.peer.node.create_subscription(JointState, "joint_states", lambda m: self._load.append(m.position[1]), 10)
        self._at_first = dict(zip(ANEW, self.parameters.get(*ANEW), strict=True))

    def anew(self) -> None:
        """Put back what a test may have changed, and let the load come to rest at 0."""
        self._faults.call_async(Trigger.Request())
        if Lifecycle(self.peer, "controller").state == "inactive":
            Lifecycle(self.peer, "controller").change(Transition.TRANSITION_ACTIVATE)
        assert self.parameters.set(**{name.replace(".", "__"): value for name, value in self._at_first.items()})[0]

        def there() -> bool:
            self._reference.publish(Float64(data=0.0))
            return bool(self._load) and abs(self._load[-1]) < B

        self.peer.wait("the load at 0", there)

    def close(self) -> None:
        for process in (self.served.process, *self._nodes):
            process.kill()
            print(f"--- {process.log.stem}\n{process.output()}")
        self.peer.close()
