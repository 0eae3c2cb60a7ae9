"""Lockstep: the closed loop of two processes over DDS equals the offline run, faster than real time."""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from graph import Parameters, Peer, Process
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.drive_file.drive_file import read_axis
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.ros.messages import answer, stamp_label, to_stamp
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.judging import judge_move
from backlash_ros.studies.metrics import step_response

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
Start = Callable[..., Process]
DEEP = QoSProfile(depth=100_000)
TARGETS = (1.0, -0.5, 0.25, 2.0)
SIMULATED = 5.0
PERIOD = 0.004


def settings(**changes: object) -> ServoSettings:
    return ServoSettings(GainSet.of(NOMINAL_DRIVE), backlash_angle=0.02, identified=True, **changes)


def kept(*axes: str) -> dict[str, int]:
    """Let the nodes keep what this process, on a loaded machine, takes seconds to fetch: nothing is missing then."""
    topics = [f"{axis}/{topic}" for axis in axes or [""] for topic in ("joint_states", "command")]
    return {f"qos_overrides./{topic.lstrip('/')}.publisher.depth": 10_000 for topic in topics}


class Recorded:
    """What went over the topics of one axis: positions of both joints and answers, by the stamp of the sample."""

    def __init__(self, peer: Peer, axis: str = "") -> None:
        self.positions: dict[int, tuple[float, float]] = {}
        self.answers: dict[int | None, float] = {}
        node, prefix = peer.node, f"{axis}/" if axis else ""
        node.create_subscription(JointState, f"{prefix}joint_states", self._on_state, DEEP)
        node.create_subscription(Float64MultiArray, f"{prefix}command", self._on_command, DEEP)
        self.reference = node.create_publisher(Float64, f"{prefix}reference", 10)

    def _on_state(self, message: JointState) -> None:
        motor, load = (message.position[message.name.index(joint)] for joint in ("motor", "load"))
        self.positions[stamp_ns(message.header.stamp)] = motor, load

    def _on_command(self, message: Float64MultiArray) -> None:
        self.answers[answered_sample(message)] = message.data[0]

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return PERIOD * len(self.positions)

    def equals_offline(
        self, offline_settings: ServoSettings, targets: Sequence[float], **of_drive: Sensors | Delay
    ) -> np.ndarray:
        """Assert that every sample and every answer is the offline run's; return the references.

        A reference acts from the first answer on that the offline run with the old one does not give.
        """
        stamps = sorted(self.positions)
        beats = 1e-9 * np.array(stamps) / PERIOD
        np.testing.assert_allclose(np.diff(beats), 1, atol=1e-3)  # no sample is missing or there twice
        missed = math.ceil(beats[0] - 1e-3) - 1  # before this peer was found
        answers = np.array([math.nan] * missed + [self.answers.get(stamp, math.nan) for stamp in stamps])
        references = np.zeros(len(answers))
        for target in (*targets, None):
            offline = run(NOMINAL_DRIVE, offline_settings, Scenario(references, **of_drive))
            if target is not None:
                other = np.flatnonzero(np.abs(answers - offline.command) > 1e-6)  # nan is not
                references[other[0] :] = target
        heard = ~np.isnan(answers)
        found = np.flatnonzero(heard)[0]  # nodes find this peer one after the other
        assert found < np.flatnonzero(references)[0]
        assert np.count_nonzero(heard) > 0.99 * (len(answers) - found)
        np.testing.assert_allclose(answers[heard], offline.command[heard], rtol=0, atol=1e-6)
        if not of_drive:
            np.testing.assert_allclose(
                [self.positions[stamp][1] for stamp in stamps], offline.load_angle[missed:-1], rtol=0, atol=1e-9
            )
        return references


def test_the_closed_loop_equals_the_offline_run(start: Start, peer: Peer) -> None:
    """Both start from rest; the simulator waits for its first answer, so that nothing is missed."""
    recorded = Recorded(peer)
    clocks: list[float] = []
    peer.node.create_subscription(Clock, "/clock", lambda m: clocks.append(m.clock.sec + 1e-9 * m.clock.nanosec), 10)
    start("controller", backlash_angle=0.02, identified=True, state_timeout=10.0, use_sim_time=True, **kept())
    peer.wait("the controller", lambda: recorded.reference.get_subscription_count() > 0)
    start("plant_simulator", lockstep=True, real_time_factor=0.0, **kept())
    peer.wait("samples and answers", lambda: recorded.time > 0.5 and recorded.answers)
    began, first = time.monotonic(), recorded.time
    for k, target in enumerate(TARGETS):
        recorded.reference.publish(Float64(data=target))
        peer.wait("simulated time", lambda k=k: recorded.time > SIMULATED * (k + 1) / len(TARGETS), 250)
    speed = (recorded.time - first) / (time.monotonic() - began)
    print(f"lockstep: {recorded.time:.1f} s simulated, {speed:.1f} times real time")
    references = recorded.equals_offline(settings(), TARGETS)
    assert set(references) == {0.0, *TARGETS}
    assert np.all(np.diff(clocks) > 0)
    assert Parameters(peer, "controller").get("use_sim_time") == [True]


def test_sensors_and_delay_of_the_simulator_are_those_of_the_offline_run(start: Start, peer: Peer) -> None:
    """A 12-bit encoder at the motor, a 14-bit one at the load, speeds from their counts, behind a ros2_control loop."""
    sensors = Sensors(
        measured=("theta_m", "omega_m", "theta_l", "omega_l"),
        speeds_from_positions=True,
        motor_counts=2**12,
        load_counts=2**14,
        motor_offset=0.7,
        motor_noise=1e-3,
    )
    recorded = Recorded(peer)
    start("controller", backlash_angle=0.02, identified=True, state_timeout=10.0, use_sim_time=True, **kept())
    peer.wait("the controller", lambda: recorded.reference.get_subscription_count() > 0)
    start(
        "plant_simulator",
        lockstep=True,
        real_time_factor=0.0,
        sensors__measured="[theta_m, omega_m, theta_l, omega_l]",
        sensors__speeds_from_positions=True,
        sensors__motor_counts=2**12,
        sensors__load_counts=2**14,
        sensors__motor_offset=0.7,
        sensors__motor_noise=1e-3,
        delay__sample=0.001,
        delay__command=PERIOD,
        **kept(),
    )
    peer.wait("samples and answers", lambda: recorded.time > 0.5 and recorded.answers)
    recorded.reference.publish(Float64(data=0.8))
    peer.wait("simulated time", lambda: recorded.time > 3.0)
    references = recorded.equals_offline(settings(), [0.8], sensors=sensors, delay=Delay(sample=0.001, command=PERIOD))
    assert references[-1] == 0.8


def run_axes(
    start: Start, peer: Peer, folder: Path, axes: Mapping[str, tuple[str, float]], seconds: float
) -> dict[str, tuple[Recorded, np.ndarray]]:
    """Send each axis, with its law, to its target; return what it did and its references: those of the offline run."""
    recorded = {axis: Recorded(peer, axis) for axis in axes}
    file = folder / "axes.yaml"
    common = {"backlash_angle": 0.02, "state_timeout": 10.0}
    file.write_text(
        json.dumps(
            {f"/{axis}/controller": {"ros__parameters": {"law": law, **common}} for axis, (law, _) in axes.items()}
        )
    )
    start("controller", "--params-file", str(file), non_ros=["--axes", *axes], **kept(*axes))
    for axis in axes:
        peer.wait("the controllers", lambda a=axis: recorded[a].reference.get_subscription_count() > 0)
    start("plant_simulator", non_ros=["--axes", *axes], lockstep=True, real_time_factor=0.0, **kept(*axes))
    peer.wait("samples and answers", lambda: all(axis.time > 0.5 and axis.answers for axis in recorded.values()))
    for axis, (_, target) in axes.items():
        recorded[axis].reference.publish(Float64(data=target))
    peer.wait("simulated time", lambda: all(axis.time > seconds for axis in recorded.values()))
    return {
        axis: (recorded[axis], recorded[axis].equals_offline(settings(law=law), [target]))
        for axis, (law, target) in axes.items()
    }


def test_axes_of_one_process_step_together_each_as_if_alone(start: Start, peer: Peer, tmp_path: Path) -> None:
    axes = {"shoulder": ("two_region", 1.0), "elbow": ("fast", -0.5), "wrist": ("overdamped", 0.5)}
    for axis, (_, references) in run_axes(start, peer, tmp_path, axes, 2.5).items():
        assert references[-1] == axes[axis][1]


@pytest.mark.grid  # the demo shows it, too
def test_two_region_law_is_as_fast_as_the_fast_gains_which_rattle(start: Start, peer: Peer, tmp_path: Path) -> None:
    """What the demo shows, on a machine that may be busy."""
    gear, responses = NOMINAL_DRIVE.gear, {}
    laws = ("fast", "overdamped", "two_region")
    for law, (axis, references) in run_axes(start, peer, tmp_path, {law: (law, 1.0) for law in laws}, 5.0).items():
        rows = np.array([axis.positions[stamp] for stamp in sorted(axis.positions)])
        began = np.flatnonzero(references[-len(rows) :])[0]
        motor, load = rows[began:].T
        responses[law] = step_response(
            PERIOD * np.arange(len(load)),
            load,
            gear.motor_radius * motor - gear.load_radius * load,
            target=1.0,
            backlash=gear.backlash,
            backlash_angle=gear.backlash_angle,
        )
    fast, slow, both = (responses[law] for law in laws)
    assert both.rise_time <= 1.05 * fast.rise_time
    assert slow.rise_time > 5 * fast.rise_time
    assert both.overshoot <= 0.1
    assert both.impacts <= 2
    assert max(both.residual, slow.residual) <= 0.02
    assert 0.7 <= fast.residual <= 1.0


AXES = {"low": ("low_resistance_actuator", 0.5, 2.5), "harmonic": ("harmonic_drive", 0.05, 4.5)}
"""Drive file, step in rad, and how long it is watched, s."""


def begun(axis: Recorded, first: int, step: float) -> int:
    """Return the number of the sample, from the first one on, from which the load has begun a step, rad; 0 before."""
    angles = [axis.positions[stamp][1] for stamp in sorted(axis.positions)]
    return next((k for k in range(first, len(angles)) if abs(angles[k] - angles[first]) > 0.01 * step), 0)


@pytest.mark.parametrize("rate", [250.0, pytest.param(1000.0, marks=pytest.mark.grid)])
def test_an_actuator_of_low_resistance_and_a_harmonic_drive_step_and_hold_quietly(
    rate: float, start: Start, peer: Peer, tmp_path: Path
) -> None:
    """With the values of their data sheets, the gains that the controller chooses, and nothing learned."""
    recorded, nodes, counts = {axis: Recorded(peer, axis) for axis in AXES}, {}, 2**21
    for axis, (name, _, _) in AXES.items():
        told = yaml.safe_load((EXAMPLES / f"{name}.yaml").read_text())["/**"]["ros__parameters"] | {"rate": rate}
        seen = {"measured": ["theta_m", "theta_l"], "motor_counts": 16384.0, "load_counts": float(counts)}
        nodes[f"/{axis}/controller"] = {"ros__parameters": told | {"state_timeout": 10.0}}
        nodes[f"/{axis}/plant_simulator"] = {"ros__parameters": told | {"sensors": seen}}
    file = tmp_path / "axes.yaml"
    file.write_text(json.dumps(nodes))
    controller = start("controller", "--params-file", str(file), non_ros=["--axes", *AXES], **kept(*AXES))
    for axis in AXES:
        peer.wait("the controllers", lambda a=axis: recorded[a].reference.get_subscription_count() > 0)
    drives = ("plant_simulator", "--params-file", str(file))
    start(*drives, non_ros=["--axes", *AXES], lockstep=True, real_time_factor=0.0, **kept(*AXES))
    peer.wait(
        "samples and answers", lambda: all(len(axis.positions) > 50 and axis.answers for axis in recorded.values())
    )
    before = {axis: len(recorded[axis].positions) for axis in AXES}
    for axis, (_, step, _) in AXES.items():
        recorded[axis].reference.publish(Float64(data=step))
    # On a busy machine the reference comes late, and simulated time goes on meanwhile.
    peer.wait("motion", lambda: all(begun(recorded[axis], before[axis], AXES[axis][1]) for axis in AXES), 400)
    before = {axis: begun(recorded[axis], before[axis], AXES[axis][1]) for axis in AXES}
    ends = {axis: before[axis] + round(seconds * rate) for axis, (_, _, seconds) in AXES.items()}
    peer.wait("simulated time", lambda: all(len(recorded[axis].positions) > end for axis, end in ends.items()), 400)
    for axis, (name, step, seconds) in AXES.items():
        b = read_axis(EXAMPLES / f"{name}.yaml").drive.gear.backlash_angle
        load = np.array([recorded[axis].positions[stamp][1] for stamp in sorted(recorded[axis].positions)])
        load = load[before[axis] : ends[axis]]
        count = 2.0 * math.pi / counts
        move = judge_move(np.arange(len(load)) / rate, load, step, b, count)
        assert move.swing <= max(0.05, count / b), axis
        assert move.error <= 0.25, axis
        assert move.settle < seconds, axis
    assert ("a winding of 1.7 ohm is emulated" in controller.output()) == (rate < 1000.0)
    assert "until reset_fault" not in controller.output()


def test_two_controllers_are_found_out_in_lockstep(start: Start, peer: Peer) -> None:
    start("controller", state_timeout=10.0)
    start("controller", "-r", "__node:=second", state_timeout=10.0)
    simulator = start("plant_simulator", lockstep=True, real_time_factor=0.0)
    peer.wait("the fault", lambda: "two controllers publish command" in simulator.output())


def test_a_sample_without_an_answer_comes_again_before_a_watchdog_acts(start: Start, peer: Peer) -> None:
    arrived: list[tuple[float, int]] = []
    peer.node.create_subscription(
        JointState, "joint_states", lambda m: arrived.append((time.monotonic(), stamp_ns(m.header.stamp))), DEEP
    )
    simulator = start("plant_simulator", lockstep=True, real_time_factor=0.0)
    peer.wait("repeats", lambda: len(arrived) > 20)
    assert len({sample for _, sample in arrived}) == 1
    assert np.median(np.diff([at for at, _ in arrived])) < 0.1  # the controller's watchdog, by default
    assert "until reset_fault" not in simulator.output()


def test_answer_may_take_longer_than_the_watchdog(start: Start, peer: Peer) -> None:
    """In lockstep time waits for the answer, however long that takes."""
    speeds: dict[int, float] = {}
    peer.node.create_subscription(
        JointState, "joint_states", lambda m: speeds.setdefault(stamp_ns(m.header.stamp), m.velocity[0]), DEEP
    )
    publisher = peer.node.create_publisher(Float64MultiArray, "command", 10)
    start("plant_simulator", lockstep=True, real_time_factor=0.0, command_timeout=0.1)
    peer.wait("the simulator", lambda: speeds and publisher.get_subscription_count())
    end = time.monotonic() + 0.5
    peer.wait("a while", lambda: time.monotonic() > end)
    (sample,) = speeds

    def next_sample() -> bool:
        publisher.publish(answer(6.0, stamp_label(to_stamp(sample))))
        return len(speeds) > 1

    peer.wait("the next sample", next_sample)
    assert min(speeds.values()) == 0.0
    assert max(speeds.values()) > 1.0


def test_simulated_time_runs_as_fast_as_asked(start: Start, peer: Peer) -> None:
    clocks: list[float] = []
    peer.node.create_subscription(Clock, "/clock", lambda m: clocks.append(m.clock.sec + 1e-9 * m.clock.nanosec), DEEP)
    start("plant_simulator", rate=50.0, real_time_factor=4.0)  # so slow that a busy machine is late for few beats
    peer.wait("the clock", lambda: len(clocks) > 500)
    steps = np.round(np.diff(clocks) * 50.0)
    assert np.median(steps) == 1
    assert np.all(steps >= 1)  # a late beat is skipped, not made up


def test_lockstep_goes_no_faster_than_asked(start: Start, peer: Peer) -> None:
    clocks: list[float] = []
    peer.node.create_subscription(Clock, "/clock", lambda _: clocks.append(time.monotonic()), DEEP)
    start("controller", state_timeout=10.0, use_sim_time=True)
    simulator = start("plant_simulator", lockstep=True, real_time_factor=2.0)
    peer.wait("the clock", lambda: len(clocks) > 500)
    assert clocks[-1] - clocks[0] >= 0.98 * (len(clocks) - 1) * PERIOD / 2.0
    assert "in lockstep, 2 times real time at most" in simulator.output()
