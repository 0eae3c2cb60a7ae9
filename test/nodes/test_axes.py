"""Six axes from one file, in one process of drives and one of controllers: each learns, moves and fails on its own."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from graph import Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from backlash_ros.control import Gains, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.ros.topics import TRANSIENT_LOCAL

Start = Callable[..., Process]
CONFIG = Path(__file__).parents[2] / "config" / "six_axes.yaml"
# What the file says of each: backlash, m; load inertia, kg m^2; law; gain set; weights or gains of the fast region.
SIX = {
    "axis1": (0.02, 5.0e-4, "auto", "nominal", [1000.0, 1.0]),
    "axis2": (0.024, 5.0e-4, "auto", "stiff", [1500.0, 1.0]),
    "axis3": (0.03, 8.0e-4, "auto", "gentle", [20.0, 0.5, 0.1]),
    "axis4": (0.04, 8.0e-4, "auto", "custom", [500.0, 1.0]),
    "axis5": (0.02, 8.0e-4, "auto", "nominal", [1000.0, 1.0]),
    "axis6": (0.012, 5.0e-4, "cascade", "nominal", [1000.0, 1.0]),
}


class Axis:
    """What the test hears of one axis."""

    def __init__(self, peer: Peer, name: str) -> None:
        self.angle, self.stamps = 0.0, set[tuple[int, int]]()
        self.in_use: dict[str, object] = {}
        node, newest = peer.node, QoSProfile(depth=1)
        node.create_subscription(JointState, f"{name}/joint_states", self._on_state, newest)
        node.create_subscription(
            ParameterEvent, f"{name}/controller/parameters_in_use", self._on_in_use, TRANSIENT_LOCAL
        )
        self.learn = node.create_client(Trigger, f"{name}/controller/learn")
        self.reference = node.create_publisher(Float64, f"{name}/reference", 1)

    def _on_state(self, message: JointState) -> None:
        self.angle = message.position[list(message.name).index("load")]
        self.stamps.add((message.header.stamp.sec, message.header.stamp.nanosec))

    def _on_in_use(self, message: ParameterEvent) -> None:
        self.in_use = {p.name: parameter_value_to_python(p.value) for p in message.new_parameters}


@pytest.fixture
def lockstep(start: Start, peer: Peer) -> Callable[..., dict[str, Axis]]:
    """Start axes of the file in lockstep, where nothing depends on how fast the machine is."""

    def begin(names: Sequence[str], factor: float = 0.0) -> dict[str, Axis]:
        axes = {name: Axis(peer, name) for name in names}
        file = ("--params-file", str(CONFIG))
        start("controller", *file, non_ros=["--axes", *names], state_timeout=10.0)
        start("plant_simulator", *file, non_ros=["--axes", *names], lockstep=True, real_time_factor=factor)
        # The second sample follows the answer to the first: the controller is there, and takes references.
        peer.wait("every axis", lambda: all(len(axis.stamps) > 1 and axis.in_use for axis in axes.values()))
        peer.wait("references", lambda: all(axis.reference.get_subscription_count() for axis in axes.values()))
        return axes

    return begin


@pytest.mark.grid
def test_axes_learn_at_once_each_its_own_backlash(lockstep: Callable[..., dict[str, Axis]], peer: Peer) -> None:
    axes = lockstep(["axis4", "axis6"], factor=0.4)  # so slow that the loops leave the cores to the fits
    for axis in axes.values():
        peer.wait("the services", axis.learn.service_is_ready)
    answers = [axis.learn.call_async(Trigger.Request()) for axis in axes.values()]
    peer.wait("all answers", lambda: all(answer.done() for answer in answers), 600.0)
    for answer in answers:
        assert answer.result().success, answer.result().message
    for name in axes:
        backlash, inertia, law, gain_set, fast = SIX[name]
        gear, load = replace(NOMINAL_DRIVE.gear, backlash_angle=backlash), replace(NOMINAL_DRIVE.load, inertia=inertia)
        drive = replace(NOMINAL_DRIVE, gear=gear, load=load)
        peer.wait("what was learned", lambda n=name: axes[n].in_use["backlash_angle"])
        in_use = axes[name].in_use
        assert in_use["backlash_angle"] == pytest.approx(gear.backlash_angle, rel=0.05), name
        assert (in_use["law"], in_use["gain_set"]) == (law, gain_set)
        gains = design_gains("fast", drive, fast) if len(fast) == 2 else Gains(*fast)
        assert in_use["gains.fast.k"] == pytest.approx(gains.as_array())


def test_a_fault_of_one_axis_leaves_the_others_running(lockstep: Callable[..., dict[str, Axis]], peer: Peer) -> None:
    axes = lockstep(["axis1", "axis2", "axis3"])
    assert Parameters(peer, "axis2/controller").set(faults__velocity=0.01) == (True, "")
    for axis in axes.values():
        axis.reference.publish(Float64(data=1.0))
    peer.wait("two at their target", lambda: all(abs(axes[n].angle - 1.0) < 0.05 for n in ("axis1", "axis3")))
    assert abs(axes["axis2"].angle) < 0.5  # where it rolled to without a voltage
    answer = peer.call(Trigger, "axis2/controller/reset_fault", Trigger.Request())
    assert "faults.velocity" in answer.message


@pytest.mark.grid
@pytest.mark.parametrize("stops", ["axis1", "axis3"])
def test_an_axis_that_is_deactivated_holds_up_neither_the_others_nor_the_clock(
    lockstep: Callable[..., dict[str, Axis]], peer: Peer, stops: str
) -> None:
    axes = lockstep(["axis1", "axis2", "axis3"])
    clock: list[float] = []
    peer.node.create_subscription(Clock, "/clock", lambda m: clock.append(m.clock.sec + 1e-9 * m.clock.nanosec), 100)
    deactivate, activate = (
        ChangeState.Request(transition=Transition(id=number))
        for number in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE)
    )
    assert peer.call(ChangeState, f"{stops}/plant_simulator/change_state", deactivate).success
    for _ in range(10):
        peer.spin(0.01)  # what was still on its way
    stopped, stopped_at = len(axes[stops].stamps), max(axes[stops].stamps)
    others = [axis for name, axis in axes.items() if name != stops]
    for axis in axes.values():
        axis.reference.publish(Float64(data=1.0))
    peer.wait("two at their target", lambda: all(abs(axis.angle - 1.0) < 0.05 for axis in others))
    assert len(axes[stops].stamps) == stopped
    seen = len(clock)
    peer.wait("the clock", lambda: len(clock) > seen + 10)
    assert peer.call(ChangeState, f"{stops}/plant_simulator/change_state", activate).success
    peer.wait("its samples", lambda: len(axes[stops].stamps) > stopped + 10)
    peer.wait("two seconds", lambda: clock[-1] > clock[seen] + 2.0)
    assert clock == sorted(clock)
    again = min(stamp for stamp in axes[stops].stamps if stamp > stopped_at)
    assert again[0] + 1e-9 * again[1] > clock[seen]  # its time has gone on with that of the others


@pytest.mark.corners(2)
@pytest.mark.parametrize(
    ("axes", "arguments", "why"),
    [
        (["a", "b", "a"], [], "--axes must be different from each other"),
        (["a", "/a"], [], "--axes must be different from each other"),
        (["a", "b"], ["-r", "__ns:=/c"], "--axes gives the namespaces"),
        (["a"], ["-r", "__ns:=/c"], "--axes gives the namespaces"),
        (["a", "not a name"], [], "not a name"),
    ],
)
@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_axes_that_cannot_be_told_apart_are_refused(
    start: Start, node: str, axes: list[str], arguments: list[str], why: str
) -> None:
    process = start(node, *arguments, non_ros=["--axes", *axes])
    assert process.wait() == 2
    assert "cannot start" in process.output()
    assert why in process.output()
