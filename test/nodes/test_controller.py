"""The controller on real DDS, against a drive that the test plays in lockstep."""

import math
import signal
from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from graph import Lifecycle, Parameters, Peer, Process
from lifecycle_msgs.msg import Transition
from lockstep_drive import LockstepDrive
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header
from std_srvs.srv import Trigger

from backlash_ros.control import Gains, GainSet, Limits, ServoSettings, design_gains
from backlash_ros.control.laws.two_region import TwoRegionParameters
from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.drivetrain import NOMINAL_DRIVE, Plant
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.messages import stamp_ns
from backlash_ros.gates import Fault
from backlash_ros.simulation import Scenario, SimulatedDrive, run

Start = Callable[..., Process]
PATIENT = {"state_timeout": 10.0}
"""The test may be slow: silence is tested where it is meant."""
BY_LIMIT_CYCLE = {**PATIENT, "learning__experiment": "limit_cycle"}


@pytest.fixture
def gains() -> GainSet:
    return GainSet.of(NOMINAL_DRIVE)


def test_closed_loop_over_dds_equals_the_offline_run(start: Start, peer: Peer, gains: GainSet) -> None:
    names = {"law": "two_region", "laws__two_region__min_dwell": 0.0}
    start("controller", backlash_angle=0.02, identified=True, **names, **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    first = drive.plant.load_angle
    angles = np.concatenate([[0.0, first], drive.run(400)])
    settings = ServoSettings(gains, backlash_angle=0.02, identified=True)
    settings = settings.with_law("two_region", TwoRegionParameters(min_dwell=0.0))
    offline = run(NOMINAL_DRIVE, settings, Scenario(np.ones(401)))
    np.testing.assert_allclose(angles, offline.load_angle, rtol=0, atol=1e-9)


REAL = Sensors(
    measured=("theta_m", "omega_m", "theta_l", "omega_l"),
    speeds_from_positions=True,
    motor_counts=2**12,
    load_counts=2**14,
    motor_offset=-0.7,
    load_offset=0.3,
    load_eccentricity=0.001,
)
LATE = Delay(sample=0.4 * 0.004, command=0.9 * 0.004, sample_jitter=0.2 * 0.004, command_jitter=0.2 * 0.004)
ENDS = {"position_upper": 1.0, "soft_zone": 0.3, "command": 15.0}
LARGEST = {"overdamped": (0.0, 2.0), "elastic_lqg": (8.0, ENDS["command"]), "planned": (8.0, ENDS["command"])}
"""Between which the largest command is, V, of a law without memory, one with states and one with a plan."""


@pytest.mark.corners(1)
@pytest.mark.parametrize("law", LARGEST)  # tests by unit have each law the same in the node and offline
def test_closed_loop_over_dds_with_counts_offsets_delay_and_limits_equals_the_offline_run(
    start: Start, peer: Peer, gains: GainSet, law: str
) -> None:
    """The test plays the drive, through the model of sensors and delay; the reference is in the soft zone."""
    limits = {f"limits__{name}": value for name, value in ENDS.items()}
    start(
        "controller",
        law=law,
        backlash_angle=0.02,
        identified=True,
        laws__two_region__min_dwell=0.0,
        **limits,
        **PATIENT,
    )
    simulated = SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=REAL, delay=LATE, seed=11)
    drive = LockstepDrive(peer, simulated=simulated).matched()
    drive.load_torque = -0.1
    drive.set_reference(0.9)
    angles = np.concatenate([[0.0, drive.load_angle], drive.run(400)])
    settings = ServoSettings(gains, backlash_angle=0.02, identified=True)
    settings = settings.with_law("two_region", TwoRegionParameters(min_dwell=0.0)).with_law(law)
    scenario = Scenario(np.full(401, 0.9), np.array(-0.1), sensors=REAL, delay=LATE, seed=11)
    offline = run(NOMINAL_DRIVE, settings, scenario, limits=replace(Limits.of(NOMINAL_DRIVE), **ENDS))
    assert offline.fault == ""
    largest = np.max(np.abs(offline.command))
    least, most = LARGEST[law]
    assert least < largest <= most
    np.testing.assert_allclose(angles, offline.load_angle, rtol=0, atol=1e-9)


def test_learning_over_the_service(start: Start, peer: Peer) -> None:
    start("controller", **BY_LIMIT_CYCLE)
    estimates: list[float] = []
    transient_local = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(
        Float64, "controller/backlash_estimate", lambda m: estimates.append(m.data), transient_local
    )
    drive = LockstepDrive(peer).matched()
    response = drive.call("learn")
    assert response.success, response.message
    assert "by gap_travel" in response.message
    (learned,) = Parameters(peer, "controller").get("backlash_angle")
    assert learned == pytest.approx(0.02, rel=0.05)
    peer.wait("the estimate", lambda: estimates)
    assert estimates[-1] == learned
    assert Parameters(peer, "controller").set(backlash_angle=0.0) == (True, "")
    peer.wait("the estimate that is taken back", lambda: estimates[-1] == 0.0)


@pytest.mark.grid  # by one encoder; test_relay.py has the experiment
@pytest.mark.parametrize("measured", ["theta_l", "theta_m"])
def test_learning_where_the_other_joint_is_absent(start: Start, peer: Peer, measured: str) -> None:
    process = start("controller", **PATIENT)
    sensors = Sensors(measured=(measured,), motor_counts=2**12, load_counts=2**14)
    drive = LockstepDrive(peer, simulated=SimulatedDrive(NOMINAL_DRIVE, 0.004, sensors=sensors)).matched()
    response = drive.call("learn")
    assert response.success, response.message
    assert "by relay" in response.message
    side = {"theta_m": "motor", "theta_l": "load"}[measured]
    assert process.output().count(f"drive found: the {side}'s encoder alone") == 1
    (learned,) = Parameters(peer, "controller").get("backlash_angle")
    assert learned == pytest.approx(0.02, rel=0.05)


@pytest.mark.grid  # test_learning.py has it by unit
def test_learning_under_a_load_torque_keeps_the_old_estimate(start: Start, peer: Peer) -> None:
    start("controller", backlash_angle=0.015, learning__limit_cycle__attempts=1, **BY_LIMIT_CYCLE)
    drive = LockstepDrive(peer).matched()
    drive.load_torque = 0.1
    answer = drive.call("learn")
    assert drive.tick < 5000
    assert not answer.success
    assert "no valid cycle" in answer.message
    assert Parameters(peer, "controller").get("backlash_angle") == [0.015]


def test_learning_beyond_the_limits_is_refused(start: Start, peer: Peer) -> None:
    start("controller", limits__position_upper=0.05, **PATIENT)
    drive = LockstepDrive(peer).matched()
    other = {"limits__position_upper": 1e3, "limits__step": 0.02}
    for why, then in (("limits.position_upper = 0.05 rad", other), ("limits.step = 0.02 rad", {"limits__step": 1.0})):
        answer = drive.call("learn")
        assert drive.tick < 5000
        assert max(map(abs, drive.answers.values())) < 1.0
        assert not answer.success
        assert answer.message.startswith("cannot learn: it swings by learning.gap_probe.swing = 0.3 rad")
        assert why in answer.message
        assert Parameters(peer, "controller").set(**then) == (True, "")


def test_learning_under_a_fault_is_refused_each_time(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.run(10)
    assert drive.exchange(drive.sample(position=[0.0, 5.0])) == 0.0
    for _ in range(2):
        answer = drive.call("learn")
        assert drive.tick < 10_000
        assert not answer.success
        assert answer.message.startswith("cannot learn while this fault is latched: load encoder moved 5 rad")


def test_silence_ends_learning(start: Start, peer: Peer) -> None:
    process = start("controller", state_timeout=3.0)
    drive = LockstepDrive(peer).matched()
    answer = peer.request("learn")
    drive.until(lambda: "learning the backlash" in process.output())
    assert drive.tick < 5000
    peer.wait("an answer", answer.done)
    assert not answer.result().success
    assert answer.result().message == "no gap measured: no joint_states for 3 s"


def test_deactivation_ends_learning(start: Start, peer: Peer) -> None:
    process = start("controller", **PATIENT)
    lifecycle = Lifecycle(peer, "controller")
    drive = LockstepDrive(peer).matched()
    answer = peer.request("learn")
    drive.until(lambda: "learning the backlash" in process.output())
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    peer.wait("an answer", answer.done)
    assert not answer.result().success
    assert answer.result().message == "no gap measured: the controller is no longer active"


def test_reference_is_not_taken_while_learning(start: Start, peer: Peer) -> None:
    process = start("controller", **BY_LIMIT_CYCLE)
    drive = LockstepDrive(peer).matched()
    answer = peer.request("learn")
    drive.until(lambda: "learning the backlash" in process.output())
    drive._reference.publish(Float64(data=0.5))
    drive.until(answer.done)
    assert answer.result().success, answer.result().message
    assert "came while learning" in process.output()
    assert abs(drive.run(300)[-1]) < 0.02  # back at the reference from before


def test_shutdown_answers_who_waits_for_learning(start: Start, peer: Peer) -> None:
    process = start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    answer = peer.request("learn")
    drive.until(lambda: "learning the backlash" in process.output())
    peer.request("learn")  # and another one behind it
    process.signal(signal.SIGINT)
    peer.wait("an answer", answer.done)
    assert not answer.result().success
    assert process.wait() == 0


@pytest.mark.grid
def test_learning_without_joint_states_is_refused(start: Start, peer: Peer) -> None:
    start("controller")
    response = peer.call(Trigger, "controller/learn", Trigger.Request())
    assert not response.success
    assert response.message == "cannot learn: no joint_states for 5 s"


def test_holding_begins_where_the_load_is_when_somebody_listens_to_the_command(start: Start, peer: Peer) -> None:
    """A drive whose command interface comes up after its joint states: until then the load may move."""
    process = start("controller", **PATIENT)
    told: list[str] = []
    peer.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: told.extend(s.message for s in m.status if "servo" in s.name), 10
    )
    states = peer.node.create_publisher(JointState, "joint_states", 1)
    clock = count(1)
    peer.wait("the controller", states.get_subscription_count)

    def warned() -> bool:
        header = Header(stamp=Time(sec=next(clock)))
        states.publish(JointState(header=header, name=["motor", "load"], position=[0.0, 0.0]))
        return bool(told) and told[-1] == "command has no subscriber"

    peer.wait("a warning", warned)
    answer = peer.request("learn")
    peer.wait("an answer", lambda: warned() and answer.done())
    assert answer.result().message == "cannot learn: command has no subscriber for 5 s"
    reference = peer.node.create_publisher(Float64, "reference", 1)
    refusal = "reference 1 rad came while no position is held"
    peer.wait("a refusal", lambda: reference.publish(Float64(data=1.0)) or refusal in process.output())
    seen = len(told)
    peer.wait("what was on its way", lambda: len(told) > seen + 1)
    drive = LockstepDrive(peer)
    drive.plant = Plant(NOMINAL_DRIVE, [5.0, 0.0, 0.5, 0.0, 0.0])
    drive.matched()
    np.testing.assert_allclose(drive.run(50), 0.5, atol=1e-3)
    assert drive.follows(0.6)
    assert "until reset_fault" not in process.output()
    assert process.output().count("drive found: both encoders") == 1


def test_joints_are_found_by_name_in_any_order_and_others_ignored(start: Start, peer: Peer) -> None:
    start("controller", law="fast", torque_bandwidth=0.0, **PATIENT)
    drive = LockstepDrive(peer).stand_at(1.0, 0.09).matched()
    drive.set_reference(0.3, move=False)
    expected = drive.exchange(drive.sample())
    assert expected == pytest.approx(31.6227766 * (0.3 - 0.09))
    for order in ([1, 0], [2, 1, 0], [1, 2, 0], [0, 2, 1]):
        fields = {
            name: [[*getattr(drive.sample(), name), extra][k] for k in order]
            for name, extra in (("name", "gripper"), ("position", 99.0), ("velocity", -99.0), ("effort", 9.0))
        }
        assert drive.exchange(drive.sample(**fields)) == expected


def test_drives_that_measure_less_are_controlled_too(start: Start, peer: Peer) -> None:
    """Positions alone, and the load encoder alone: the loop closes, by the observer."""
    start("controller", law="overdamped", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    plant = drive.plant
    for k in range(1500):
        fields = {"velocity": [], "effort": []}
        if k % 2:
            fields = {"velocity": [math.nan, math.nan], "effort": [math.nan, math.nan]}
        if k >= 750:
            fields |= {"name": ["load"], "position": [plant.load_angle]}
        plant.advance(drive.exchange(drive.sample(**fields)), 0.0, drive.period)
    assert plant.load_angle == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    "missing", ["both", *(pytest.param(m, marks=pytest.mark.grid) for m in ("velocity", "effort"))]
)
def test_signal_that_turns_nan_does_not_shake_the_loop(start: Start, peer: Peer, missing: str) -> None:
    """A drive stops measuring speed or torque on the way, and later says them every second time only."""
    process = start("controller", backlash_angle=0.02, **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    nothing = [math.nan, math.nan]
    fields = {name: nothing for name in ("velocity", "effort") if missing in (name, "both")}
    angles, commands = [], []
    for k in range(400):
        unmeasured = 15 <= k < 150 or (k >= 150 and k % 2)
        commands.append(drive.exchange(drive.sample(**fields) if unmeasured else drive.sample()))
        drive.plant.advance(commands[-1], 0.0, drive.period)
        angles.append(drive.plant.load_angle)
    assert max(angles) < 1.0 + 0.1 * 0.02
    assert np.all(np.abs(np.array(angles[-200:]) - 1.0) < 0.5 * 0.02)
    assert np.all(np.abs(np.diff(commands[-200:])) < 0.02)
    assert "unusable" not in process.output()


def test_gain_swap_is_seen_in_the_next_command(start: Start, peer: Peer) -> None:
    start("controller", law="fast", torque_bandwidth=0.0, **PATIENT)
    drive = LockstepDrive(peer).stand_at(1.0, 0.09).matched()
    parameters = Parameters(peer, "controller")
    drive.set_reference(0.2, move=False)
    plant = drive.plant

    def expected(gains: Gains) -> float:
        state = np.array([plant.load_angle - 0.2, plant.load_speed, plant.motor_torque / 0.05])
        return float(-gains.as_array() @ state)

    old = design_gains("q", NOMINAL_DRIVE, [1000.0, 1.0])
    assert drive.exchange(drive.sample()) == pytest.approx(expected(old), rel=1e-9)
    accepted, reason = parameters.set(gains__fast__k=[20.0, 0.6, 0.1])
    assert accepted, reason
    assert drive.exchange(drive.sample()) == pytest.approx(expected(Gains(20.0, 0.6, 0.1)), rel=1e-9)
    assert parameters.get("gain_set", "gains.fast.q") == ["custom", [0.0, 0.0]]
    accepted, reason = parameters.set(gains__fast__q=[400.0, 0.5])
    assert accepted, reason
    designed = design_gains("q", NOMINAL_DRIVE, [400.0, 0.5])
    assert drive.exchange(drive.sample()) == pytest.approx(expected(designed), rel=1e-9)
    assert parameters.get("gains.fast.k") == [list(designed.as_array())]
    accepted, reason = parameters.set(gain_set="nominal")
    assert accepted, reason
    assert drive.exchange(drive.sample()) == pytest.approx(expected(old), rel=1e-9)


HYSTERESIS = "laws.two_region.hysteresis"
WATCHED = ("law", "gain_set", "gains.fast.k", "gains.fast.q", "gains.overdamped.k", "backlash_angle", HYSTERESIS)


REFUSED: list[tuple[dict[str, object], str]] = [
    ({"backlash_angle": -0.1}, "backlash_angle must be >= 0 rad and <= 3.2 rad, got -0.1"),
    ({"backlash_angle": math.nan}, "backlash_angle must be >= 0 rad and <= 3.2 rad, got nan"),
    ({"backlash_angle": 0.03, HYSTERESIS: 1e9}, f"{HYSTERESIS} must be"),
    ({"backlash_angle": 0.03, "gains__fast__k": [1e5, 0.0, 0.0]}, "gains.fast.k = [100000, 0, 0] is unstable"),
    ({"gains__fast__k": [30.0, 0.8, 0.1], "gains__overdamped__k": [1.0, math.inf, 0.0]}, "gains.overdamped.k: k2"),
    ({"gains__fast__q": [-1.0, 0.0], "backlash_angle": 0.03}, "gains.fast.q: Q11 must be > 0"),
    ({"gain_set": "nosuch", "law": "fast"}, "gain_set must be one of ['nominal', 'custom'], got 'nosuch'"),
    ({"law": "bang_bang", "backlash_angle": 0.03}, "law must be one of"),
    ({"gear__reduction": 12.0, "backlash_angle": 0.03}, "gear.reduction is read-only"),
    ({"backlash_angle": "wide"}, "backlash_angle must be a number, >= 0 rad and <= 3.2 rad, got 'wide'"),
]


def test_refused_set_changes_nothing_and_says_why(start: Start, peer: Peer) -> None:
    start("controller", law="fast", torque_bandwidth=0.0, faults__load_torque=1e9, **PATIENT)
    drive = LockstepDrive(peer).matched()  # stands still, whatever the command
    parameters = Parameters(peer, "controller")
    drive.set_reference(0.2, move=False)
    before, command = parameters.get(*WATCHED), drive.exchange(drive.sample())
    for changes, culprit in REFUSED:
        accepted, reason = parameters.set(**changes)
        assert not accepted
        assert culprit in reason
        assert parameters.get(*WATCHED) == before
        assert drive.exchange(drive.sample()) == command


def test_named_gain_sets_come_from_parameters(start: Start, peer: Peer) -> None:
    start(
        "controller",
        gain_set_names="[nominal, gentle]",
        gain_sets__gentle__fast__q="[100.0, 1.0]",
        gain_sets__gentle__overdamped__k="[1.5, 0.03, 0.0]",
        gain_set="gentle",
        **PATIENT,
    )
    parameters = Parameters(peer, "controller")
    designed = list(design_gains("q", NOMINAL_DRIVE, [100.0, 1.0]).as_array())
    assert parameters.get("gain_set", "gains.fast.k", "gains.overdamped.k") == ["gentle", designed, [1.5, 0.03, 0.0]]


def test_gains_given_at_the_start_are_in_use(start: Start, peer: Peer) -> None:
    start("controller", gains__fast__k="[20.0, 0.6, 0.1]", **PATIENT)
    values = Parameters(peer, "controller").get("gain_set", "gains.fast.k", "gains.fast.q", "gains.overdamped.q")
    assert values == ["custom", [20.0, 0.6, 0.1], [0.0, 0.0], [4.0, 0.0]]


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"gains__fast__k": "[1.0e+5, 0.0, 0.0]"}, "gains.fast.k = [100000, 0, 0] is unstable at 250 Hz"),
        ({"gains__fast__k": "[30.0, 1, 0]"}, "gains.fast.k:=[30.0, 1, 0]"),
    ],
)
def test_unusable_start_parameter_ends_the_node_with_a_line_that_names_it(
    start: Start, parameters: dict[str, object], says: str
) -> None:
    """More of them in test/unit/test_tunables.py."""
    process = start("controller", **parameters)
    assert process.wait() == 2
    assert "cannot start: " in process.output()
    assert says in process.output()
    assert "Traceback" not in process.output()


def test_whole_numbers_stand_for_floats(start: Start, peer: Peer) -> None:
    start("controller", rate=500, gear__backlash_angle="0.04", learning__limit_cycle__swing=1, **PATIENT)
    parameters = Parameters(peer, "controller")
    accepted, reason = parameters.set(backlash_angle=1)
    assert accepted, reason
    assert parameters.get("backlash_angle", "rate") == [1.0, 500]


def test_zero_volts_while_nothing_is_measured(start: Start, peer: Peer) -> None:
    start("controller")
    drive = LockstepDrive(peer)
    peer.wait("three commands", lambda: len(drive.commands) >= 3)
    assert set(drive.commands) == {0.0}


def test_zero_volts_on_silence_and_hold_where_it_comes_back(start: Start, peer: Peer) -> None:
    start("controller", state_timeout=1.0)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    assert drive.step() > 1.0
    drive.commands.clear()
    peer.wait("0 V after silence", lambda: 0.0 in drive.commands)
    drive.commands.clear()
    peer.wait("0 V again and again", lambda: len(drive.commands) >= 3)
    assert set(drive.commands) == {0.0}
    # Back with the load elsewhere: 0 V still, until somebody has looked; then it is held there, not driven away.
    drive.plant = Plant(NOMINAL_DRIVE, [5.0, 0.0, 0.5, 0.0, 0.0])
    assert drive.exchange(drive.sample()) == 0.0
    assert (
        peer.call(Trigger, "controller/reset_fault", Trigger.Request()).message
        == "reset NO_SAMPLES: no joint_states for 1 s"
    )
    angles = drive.run(100)
    assert np.all(np.abs(angles - 0.5) < 0.02)
    assert drive.follows(0.2)


def test_silence_while_not_active_is_no_fault(start: Start, peer: Peer) -> None:
    process = start("controller", state_timeout=3.0)
    lifecycle = Lifecycle(peer, "controller")
    drive = LockstepDrive(peer).matched()
    drive.run(10)
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    peer.wait("the last command", lambda: drive.commands[-1:] == [0.0])
    assert lifecycle.change(Transition.TRANSITION_ACTIVATE)
    drive.commands.clear()
    peer.wait("0 V by the watchdog", lambda: drive.commands)
    assert set(drive.commands) == {0.0}
    assert "until reset_fault" not in process.output()
    drive.run(10)
    assert drive.follows(0.3)


UNUSABLE: list[dict[str, list[object]]] = [
    {"position": [0.0, math.nan]},
    {"position": [math.inf, 0.0]},
    {"velocity": [0.0, math.inf]},
    {"effort": [-math.inf, 0.0]},
    {"effort": [1.7e308, 0.0]},
    {"velocity": [0.0, -1e306]},
    {"position": [0.0]},
    {"velocity": [0.0]},
    {"effort": [0.0]},
    {"name": ["load", "load"]},
]


def test_zero_volts_on_a_sample_that_cannot_be_used(start: Start, peer: Peer) -> None:
    process = start("controller", law="fast", faults__load_torque=1e9, **PATIENT)
    drive = LockstepDrive(peer).matched()  # stands still, whatever the command
    drive.set_reference(1.0, move=False)
    for bad in UNUSABLE:
        good = drive.sample()
        assert drive.exchange(good) > 1.0
        assert drive.exchange(drive.sample(**bad)) == 0.0, bad
        assert drive.exchange(good) == 0.0  # a repeat is answered with what is on the motor
        assert drive.exchange(drive.sample()) > 1.0  # it goes on with the next good one
    peer.wait("the warning", lambda: "unusable joint_states" in process.output())


def test_sample_out_of_order_is_not_answered(start: Start, peer: Peer) -> None:
    process = start("controller", law="fast", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    expected = drive.exchange(drive.sample())
    drive.tick -= 3
    old = drive.sample(position=[0.0, -5.0])
    drive.tick += 3
    drive.answers.clear()
    drive._states.publish(old)
    peer.wait("the warning", lambda: "out of order" in process.output())
    assert drive.exchange(drive.sample()) == pytest.approx(expected, rel=0.1)
    assert not {None, stamp_ns(old.header.stamp)} & set(drive.answers)


def test_stamp_before_the_epoch_is_survived(start: Start, peer: Peer) -> None:
    process = start("controller", law="fast", torque_bandwidth=0.0, **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    message = drive.sample()
    message.header.stamp.sec = -1
    drive._states.publish(message)
    peer.wait("the warning", lambda: "out of order" in process.output())
    assert drive.exchange(drive.sample()) > 1.0
    assert process.running


def test_zero_volts_on_shutdown(start: Start, peer: Peer) -> None:
    process = start("controller", law="fast", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    assert drive.exchange(drive.sample()) > 1.0
    process.signal(signal.SIGTERM)  # others in test_faults.py
    peer.wait("the last command", lambda: drive.commands[-1] == 0.0)
    assert process.wait() == 0
    assert "Traceback" not in process.output()


def test_reference_that_is_not_finite_is_dropped(start: Start, peer: Peer) -> None:
    process = start("controller", law="fast", torque_bandwidth=0.0, **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(0.3)
    before = drive.exchange(drive.sample())
    drive._reference.publish(Float64(data=math.nan))
    peer.wait("the warning", lambda: "reference must be finite" in process.output())
    assert drive.exchange(drive.sample()) == before


class States:
    """What ``~/state`` said: stamps (ns) and values by name."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.heard: list[tuple[int, dict[str, float]]] = []
        peer.node.create_subscription(DiagnosticArray, "controller/state", self._on, QoSProfile(depth=2000))

    def _on(self, message: DiagnosticArray) -> None:
        assert [status.name for status in message.status] == ["servo"]
        values = {entry.key: float(entry.value) for entry in message.status[0].values}
        self.heard.append((stamp_ns(message.header.stamp), values))

    def series(self, name: str) -> list[float]:
        return [values[name] for _, values in self.heard]

    def first(self, what: str, condition: Callable[[dict[str, float]], bool]) -> int:
        """Wait for a message that meets ``condition`` and return the stamp of the first."""
        found = self.peer.wait(
            what, lambda: next(((stamp,) for stamp, values in self.heard if condition(values)), None)
        )
        return int(found[0])


def test_state_says_everything_worth_plotting_by_name(start: Start, peer: Peer) -> None:
    start("controller", backlash_angle=0.02, telemetry_rate=250.0, **PATIENT)
    states = States(peer)
    drive = LockstepDrive(peer).matched()
    peer.wait("telemetry", lambda: states.heard)
    drive.load_torque = 0.05
    drive.set_reference(0.5)
    drive.run(500)
    newest = stamp_ns(drive.sample().header.stamp) - 4_000_000
    peer.wait("the last telemetry", lambda: states.heard[-1][0] == newest)
    last = states.heard[-1][1]
    assert list(last) == list(TELEMETRY)
    assert max(states.series("error")) == pytest.approx(0.5, abs=0.01)
    assert set(states.series("region")) - {0} == {1, 2}  # 0 before the first sample
    assert (last["region"], last["active"], last["holding"], last["fault"]) == (2, 1, 1, 0)
    assert last["load_torque"] == pytest.approx(0.05, rel=0.02)
    assert (last["reference"], last["setpoint"], last["setpoint_velocity"]) == (0.5, 0.5, 0.0)
    assert last["load_angle"] == pytest.approx(drive.plant.load_angle, abs=1e-3)
    assert last["motor_angle"] == pytest.approx(drive.plant.motor_angle, abs=1e-2)
    assert last["error"] == pytest.approx(0.5 - last["load_angle"])
    assert last["command"] == drive.commands[-1]
    assert (last["range_low"], last["range_high"]) == (-24.0, 24.0)
    assert (last["experiment"], last["offset"], last["torque"], last["backlash_angle"]) == (0, 0.0, 0.0, 0.02)


def test_each_change_is_told_with_the_stamp_of_the_first_sample_that_it_acted_on(start: Start, peer: Peer) -> None:
    start("controller", law="fast", telemetry_rate=0.01, **PATIENT)
    states = States(peer)
    drive = LockstepDrive(peer).matched()
    parameters, answers = Parameters(peer, "controller"), []
    versions = states.first("the start", lambda values: values["holding"] == 1)
    states.heard.clear()

    def acted(what: str, condition: Callable[[dict[str, float]], bool]) -> None:
        """The next sample is the first one after the change; many more follow without a message."""
        stamp = stamp_ns(drive.sample().header.stamp)
        answers.append(drive.exchange(drive.sample()))
        assert states.first(what, condition) == stamp
        drive.run(50)
        assert len(states.heard) <= 2

    assert versions
    drive.set_reference(0.3, move=False)
    states.first("the reference", lambda values: values["reference"] == 0.3)
    drive.run(600)
    states.heard.clear()
    assert parameters.set(law="overdamped")[0]
    acted("the law", lambda values: values["parameters_version"] == 2)
    states.heard.clear()
    assert parameters.set(gains__fast__k=[20.0, 0.6, 0.1])[0]
    acted("the gains", lambda values: values["parameters_version"] == 3)
    states.heard.clear()
    stamp = stamp_ns(drive.sample().header.stamp)
    assert drive.exchange(drive.sample(position=[0.0, 5.0])) == 0.0
    assert states.first("the fault", lambda values: values["fault"] == Fault.LOAD_JUMP) == stamp
    states.heard.clear()
    assert Lifecycle(peer, "controller").change(Transition.TRANSITION_DEACTIVATE)
    states.first("the state", lambda values: values["active"] == 0)


def test_cancel_ends_an_experiment_and_says_so(start: Start, peer: Peer) -> None:
    process = start("controller", telemetry_rate=250.0, **PATIENT)
    states = States(peer)
    drive = LockstepDrive(peer).matched()
    nothing = peer.call(Trigger, "controller/cancel", Trigger.Request())
    assert (nothing.success, nothing.message) == (False, "there is no experiment to cancel")
    answer = peer.request("learn")
    drive.until(lambda: "progress" in (states.heard or [(0, {})])[-1][1] and states.series("progress")[-1] >= 0.01)
    assert drive.tick < 5000
    refusal = peer.call(Trigger, "controller/learn", Trigger.Request()).message
    assert refusal == "cannot learn: a run is already in progress"
    cancelled = peer.call(Trigger, "controller/cancel", Trigger.Request())
    assert (cancelled.success, cancelled.message) == (True, "cancelled")
    peer.wait("an answer", answer.done)
    assert not answer.result().success
    assert answer.result().message == "no gap measured: cancelled on request"
    assert "until reset_fault" not in process.output()
    drive.run(10)
    peer.wait("the end", lambda: states.series("experiment")[-1] == 0)
    assert drive.follows(0.2)


def test_learn_is_refused_at_once_while_not_configured(start: Start, peer: Peer) -> None:
    start("controller", autostart=False)
    for _ in range(2):
        response = peer.call(Trigger, "controller/learn", Trigger.Request())
        assert not response.success
        assert response.message == "cannot learn: the controller must be active, but is unconfigured"


def test_messages_of_another_machine_are_passed_over(start: Start, peer: Peer) -> None:
    """Several drives may share a topic, each with joints of its own."""
    process = start("controller", law="fast", **PATIENT)
    drive = LockstepDrive(peer).matched()
    drive.set_reference(1.0)
    before = drive.exchange(drive.sample())
    for other in (
        {"name": ["a", "b"]},
        {"name": [], "position": [], "velocity": [], "effort": []},
        {"name": ["a"], "position": [math.nan], "velocity": [], "effort": []},
    ):
        message = drive.sample(**other)
        drive.answers.clear()
        drive._states.publish(message)
        assert drive.exchange(drive.sample()) == pytest.approx(before, rel=0.5)
        assert stamp_ns(message.header.stamp) not in list(drive.answers)[:-1]
    assert "unusable" not in process.output()
    assert "until reset_fault" not in process.output()


def test_topics_are_relative(start: Start, peer: Peer) -> None:
    start("controller", "-r", "__ns:=/axis1", "-r", "command:=voltage")
    expected = {
        ("/axis1/joint_states", "sensor_msgs/msg/JointState"),
        ("/axis1/reference", "std_msgs/msg/Float64"),
        ("/axis1/voltage", "std_msgs/msg/Float64MultiArray"),
        ("/axis1/controller/state", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/axis1/controller/backlash_estimate", "std_msgs/msg/Float64"),
    }

    def all_there() -> bool:
        topics = {(name, kind) for name, kinds in peer.node.get_topic_names_and_types() for kind in kinds}
        return expected <= topics

    peer.wait("the topics", all_there)
    learn = ("/axis1/controller/learn", ["std_srvs/srv/Trigger"])
    peer.wait("the service", lambda: learn in peer.node.get_service_names_and_types())
