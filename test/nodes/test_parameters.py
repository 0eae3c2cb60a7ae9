"""Parameters on the live controller: described, in use, published, and refused by name."""

import math
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import parameter_table
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import PATIENCE, Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from parameter_table import FROM_ROS
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile

from backlash_ros.control import Gains
from backlash_ros.recordings import read_bag

Start = Callable[..., Process]
PATIENT = {"state_timeout": 10.0}
HYSTERESIS = "laws.two_region.hysteresis"
TRANSIENT_LOCAL = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class InUse:
    """What a node says it uses: versions and values, as they came."""

    def __init__(self, peer: Peer, node: str = "controller") -> None:
        self.heard: list[tuple[int, dict[str, Any]]] = []
        self._peer = peer
        peer.node.create_subscription(ParameterEvent, f"{node}/parameters_in_use", self._on, TRANSIENT_LOCAL)
        peer.wait("what is in use", lambda: self.heard)

    def _on(self, message: ParameterEvent) -> None:
        values = {p.name: parameter_value_to_python(p.value) for p in message.new_parameters}
        self.heard.append((values.pop("version"), values))

    def version(self, number: int) -> dict[str, Any]:
        self._peer.wait(f"version {number}", lambda: self.heard[-1][0] >= number)
        return dict(self.heard)[number]


def descriptors(peer: Peer, node: str) -> dict[str, ParameterDescriptor]:
    names = peer.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
    names = [name for name in names if not name.startswith(FROM_ROS)]
    answer = peer.call(DescribeParameters, f"/{node}/describe_parameters", DescribeParameters.Request(names=names))
    return dict(zip(names, answer.descriptors, strict=True))


def test_the_documented_table_is_what_the_code_makes(tmp_path: Path) -> None:
    made, committed = tmp_path / "parameters.md", Path(__file__).parents[2] / "docs" / "parameters.md"
    parameter_table.main(["--out", str(made)])
    assert made.read_text() == committed.read_text(), "renew it: make docs"


@pytest.mark.parametrize("node", ["controller", "plant_simulator"])
def test_every_parameter_is_described_and_every_number_bounded(start: Start, peer: Peer, node: str) -> None:
    start(node)
    described = descriptors(peer, node)
    described = {
        name: d for name, d in described.items() if d.type != ParameterType.PARAMETER_BOOL or not d.description
    }
    without_unit = {"real_time_factor", "learning.limit_cycle.cycles", "contact.restitution.restitution"}
    without_unit |= {"contact.power.exponent", "contact.power_no_pull.exponent", "gear.reduction"}
    without_unit |= {"gear.backlash_variation", "gear.backlash_cycles"}
    without_unit |= {"gear.efficiency_forward", "gear.efficiency_backward"}
    without_unit |= {
        "learning.limit_cycle.attempts",
        "learning.limit_cycle.spread",
        "learning.gap_probe.torque",
        "learning.relay.torque",
        "homing.torque",
        "learning.gap_map.places",
        "learning.gap_map.torque",
        "learning.hysteresis.torque",
        "learning.hysteresis.cycles",
        "learning.hysteresis.lost_motion_share",
        "laws.two_region.hysteresis",
        "laws.two_region.width",
        "laws.cascade.dead_band",
    }
    without_unit |= {"laws.switched_linear.reduction", "laws.elastic_lqg.lead", "laws.dual_loop.least_torque"}
    without_unit |= {"sensors.motor_counts", "sensors.load_counts", "seed"}
    shares = {"torque_ripple", "friction_asymmetry", "dead_band", "supply_sag", "outer_share", "gap_growth"}
    shares |= {"first_gap", "wheel_inertia", "friction_fall", "static_friction", "outer_damping"}
    shares |= {f"{value}_error" for value in ("resistance", "inductance", "torque_constant", "inertia")}
    without_unit |= {f"effects.{name}" for name in (*shares, "cogging_cycles", "torque_ripple_cycles")}
    without_unit |= {"contact.hunt_crossley.exponent"}
    for name, descriptor in described.items():
        assert descriptor.description, name
        assert descriptor.additional_constraints, name
        if descriptor.type in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER):
            assert [*descriptor.floating_point_range, *descriptor.integer_range], name
            assert descriptor.description.endswith("]") != (name in without_unit), name
        assert not descriptor.dynamic_typing, name


def test_all_parameters_are_published_as_in_use_the_fixed_ones_too(start: Start, peer: Peer) -> None:
    start("controller", gear__reduction=12.0)
    in_use = InUse(peer).version(1)
    assert set(descriptors(peer, "controller")) <= set(in_use)
    assert (in_use["gear.reduction"], in_use["rate"], in_use["law"]) == (12.0, 250.0, "auto")


def test_in_use_has_a_new_version_for_each_request_that_is_taken(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    in_use, parameters = InUse(peer), Parameters(peer, "controller")
    for number, changes in enumerate(({"gains__fast__k": [20.0, 0.6, 0.1]}, {"law": "fast", HYSTERESIS: 0.2}), 2):
        assert parameters.set(**changes) == (True, "")
        assert not parameters.set(**{HYSTERESIS: -1.0})[0]
        assert not parameters.set(law="fast", nosuch=1.0)[0]
        values = in_use.version(number)
        assert list(values.values()) == parameters.get(*values)
        assert values["gain_set"] == "custom"
    assert [version for version, _ in in_use.heard] == [1, 2, 3]
    assert (values["law"], values[HYSTERESIS], values["gains.fast.k"]) == ("fast", 0.2, [20.0, 0.6, 0.1])
    late = InUse(peer)
    peer.wait("all versions, late", lambda: late.heard == in_use.heard)


def test_the_next_command_follows_what_is_published(start: Start, peer: Peer) -> None:
    """Also where two requests come between two samples: the last one counts."""
    start("controller", law="fast", torque_bandwidth=0.0, **PATIENT)
    drive = LockstepDrive(peer).matched()
    in_use, parameters = InUse(peer), Parameters(peer, "controller")
    drive.set_reference(0.2)
    drive.run(3)
    for version in (3, 5, 7):
        for k1 in (10.0 + version, 20.0 + version):
            assert parameters.set(gains__fast__k=[k1, 0.6, 0.1]) == (True, "")
        gains = Gains.from_sequence("k", in_use.version(version)["gains.fast.k"])
        assert gains.position == 20.0 + version
        assert drive.exchange(drive.sample()) == pytest.approx(fast_command(gains, drive, 0.2), rel=1e-9)


def fast_command(gains: Gains, drive: LockstepDrive, reference: float) -> float:
    """Eq 15 without load torque, where every state is measured."""
    plant = drive.plant
    state = np.array([plant.load_angle - reference, plant.load_speed, plant.motor_torque / 0.05])
    return float(-gains.as_array() @ state)


@pytest.mark.grid
def test_what_was_learned_is_a_new_version_in_use(start: Start, peer: Peer) -> None:
    start("controller", learning__experiment="limit_cycle", **PATIENT)
    in_use = InUse(peer)
    drive = LockstepDrive(peer).matched()
    answer = drive.call("learn")
    assert answer.success, answer.message
    assert in_use.version(2)["backlash_angle"] == pytest.approx(0.02, rel=0.05)


def value(kind: int, **fields: Any) -> ParameterValue:
    return ParameterValue(type=kind, **fields)


FLOATS, TEXT = ParameterType.PARAMETER_DOUBLE_ARRAY, ParameterType.PARAMETER_STRING


def atomically(peer: Peer, node: str, **values: ParameterValue) -> tuple[bool, str]:
    request = [Parameter(name=name.replace("__", "."), value=given) for name, given in values.items()]
    service = f"/{node}/set_parameters_atomically"
    result = peer.call(SetParametersAtomically, service, SetParametersAtomically.Request(parameters=request)).result
    return result.successful, result.reason


def test_whatever_is_sent_is_refused_by_name(start: Start, peer: Peer) -> None:
    """A value of an unknown type ended the node; a wrong type, a deletion and an unknown name were not named."""
    process = start("controller", **PATIENT)
    in_use = InUse(peer)
    good = {HYSTERESIS: value(ParameterType.PARAMETER_DOUBLE, double_value=0.3)}
    for name, given, says in (
        ("backlash_angle", value(42), "backlash_angle: unexpected parameter type 42"),
        ("backlash_angle", value(0), "backlash_angle must be a number"),
        ("backlash_angle", value(ParameterType.PARAMETER_BOOL, bool_value=True), "backlash_angle must be a number"),
        (
            "learning__limit_cycle__cycles",
            value(ParameterType.PARAMETER_DOUBLE, double_value=5.5),
            "learning.limit_cycle.cycles must be a whole",
        ),
        (
            "learning__limit_cycle__cycles",
            value(ParameterType.PARAMETER_BOOL, bool_value=True),
            "learning.limit_cycle.cycles must be a ",
        ),
        ("law", value(ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[b"f"]), "law must be a text, one of"),
        ("gain_set", value(0), "gain_set must be a text, one of ['nominal', 'custom'], got None"),
        ("gains__fast__k", value(0), "gains.fast.k must be a list of numbers"),
        ("gains__fast__k", value(TEXT, string_value="[1, 2, 3]"), "gains.fast.k must be a list of numbers"),
        ("gains__fast__k", value(FLOATS, double_array_value=[20.0, 0.6]), "gains.fast.k must be three gains"),
        ("gains__fast__q", value(FLOATS, double_array_value=[]), "gains.fast.q must be two weights"),
        ("gains__fast__q", value(FLOATS, double_array_value=[math.nan, 0.0]), "gains.fast.q: Q11 must be > 0"),
        ("limits__position_upper", value(ParameterType.PARAMETER_DOUBLE, double_value=-2e9), "limits.position_upper"),
        ("rate", value(ParameterType.PARAMETER_DOUBLE, double_value=500.0), "rate is read-only: it stays 250.0"),
        ("use_sim_time", value(TEXT, string_value="yes"), "use_sim_time must be true or false"),
        ("nosuch", value(ParameterType.PARAMETER_DOUBLE, double_value=1.0), "there is no parameter 'nosuch'"),
    ):
        accepted, reason = atomically(peer, "controller", **good, **{name: given})
        assert (accepted, reason[: len(says)]) == (False, says)
    twice = [Parameter(name=HYSTERESIS, value=good[HYSTERESIS])] * 2
    answer = peer.call(
        SetParametersAtomically,
        "/controller/set_parameters_atomically",
        SetParametersAtomically.Request(parameters=twice),
    )
    assert answer.result.reason == f"{HYSTERESIS} is in the request 2 times"
    assert process.running
    assert atomically(peer, "controller", **good) == (True, "")
    assert in_use.version(2)[HYSTERESIS] == 0.3
    assert in_use.heard[-1][0] == 2
    assert {**in_use.version(2), HYSTERESIS: 0.1} == in_use.version(1)


PLUGIN = '''
"""A law of somebody else's: the position error times a gain of its own."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from backlash_ros.control.law import LAW_SIGNATURE, ControlLaw, NamedLaw
from backlash_ros.foundation.quantity import quantity
from backlash_ros.foundation.quantity import Validated
from backlash_ros.foundation.compiled import compiled_as


@dataclass(frozen=True)
class Parameters(Validated):
    section: ClassVar[str] = "laws.proportional"

    gain: float = quantity("volts for an error of 1 rad", "V/rad", above=0, at_most=50, default=5.0)


@compiled_as(LAW_SIGNATURE)
def step(law, state, estimate, path, low, high):
    return min(max(law[0] * (path[0, 0] - estimate[2]), low), high)


def design(drive, settings, parameters):
    return ControlLaw(step, np.array([parameters.gain]), np.array([1.0]))


LAWS = {"proportional": NamedLaw("proportional", design, Parameters())}
'''


@pytest.mark.grid  # test_plugins.py adds laws, too
def test_a_law_that_is_added_brings_its_parameters(
    start: Start, peer: Peer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "proportional.py").write_text(PLUGIN)
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", str(tmp_path / "proportional.py"))
    start("controller", law="proportional", laws__proportional__gain=4.0, fresh=True, **PATIENT)
    drive = LockstepDrive(peer).matched()
    in_use, parameters = InUse(peer), Parameters(peer, "controller")
    drive.set_reference(0.2)
    assert in_use.version(1)["laws.proportional.gain"] == 4.0
    for number, gain in enumerate((10.0, 20.0), 2):
        assert parameters.set(laws__proportional__gain=gain) == (True, "")
        assert in_use.version(number)["laws.proportional.gain"] == gain
        error = 0.2 - drive.plant.load_angle
        assert drive.step() == pytest.approx(gain * error, rel=1e-9)
    accepted, reason = parameters.set(laws__proportional__gain=0.0, law="fast")
    assert not accepted
    assert reason == "laws.proportional.gain must be > 0 V/rad and <= 50 V/rad, got 0.0"
    (described,) = peer.call(
        DescribeParameters,
        "/controller/describe_parameters",
        DescribeParameters.Request(names=["laws.proportional.gain"]),
    ).descriptors
    assert described.description == "volts for an error of 1 rad [V/rad]"
    assert described.additional_constraints == "> 0 V/rad and <= 50 V/rad"
    table = tmp_path / "parameters.md"
    words = [sys.executable, str(Path(parameter_table.__file__)), "--out", str(table)]
    subprocess.run(words, check=True, timeout=PATIENCE)
    row = "| `laws.proportional.gain` | double | 5 | V/rad | > 0 and <= 50 | dynamic | volts for an error of 1 rad |"
    assert row in table.read_text()


def test_one_by_one_each_parameter_is_a_request_of_its_own(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    in_use = InUse(peer)
    number = ParameterType.PARAMETER_DOUBLE
    changes = (
        ("limits.position_lower", value(number, double_value=2.0)),
        ("limits.position_upper", value(number, double_value=1.0)),  # not above the lower one, by now
        ("limits.position_lower", value(42)),
        ("limits.position_lower", value(number, double_value=0.5)),
        ("limits.position_upper", value(number, double_value=1.0)),
    )
    request = SetParameters.Request(parameters=[Parameter(name=name, value=given) for name, given in changes])
    results = peer.call(SetParameters, "/controller/set_parameters", request).results
    assert [result.successful for result in results] == [True, False, False, True, True]
    assert "limits.position_lower must be < limits.position_upper = 1 rad, got 2.0" in results[1].reason
    assert (in_use.version(4)["limits.position_lower"], in_use.version(4)["limits.position_upper"]) == (0.5, 1.0)


def test_whole_numbers_stand_for_floats_in_lists_too(start: Start, peer: Peer) -> None:
    start("controller", gain_sets__nominal__overdamped__q="[4, 0]", **PATIENT)
    parameters = Parameters(peer, "controller")
    assert parameters.set(gains__fast__k=[30, 1, 0]) == (True, "")
    assert parameters.get("gains.fast.k", "gains.overdamped.q") == [[30.0, 1.0, 0.0], [4.0, 0.0]]


def test_custom_alone_keeps_the_gains(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    in_use, parameters = InUse(peer), Parameters(peer, "controller")
    assert parameters.set(gain_set="custom") == (True, "")
    assert in_use.version(2) == {**in_use.version(1), "gain_set": "custom"}


def test_ends_of_the_travel_that_leave_the_reference_outside_are_refused(start: Start, peer: Peer) -> None:
    start("controller", **PATIENT)
    drive = LockstepDrive(peer).matched()
    parameters = Parameters(peer, "controller")
    drive.set_reference(0.3)
    command = drive.exchange(drive.sample())
    accepted, reason = parameters.set(limits__position_upper=0.2)
    assert not accepted
    assert "limits.position_upper = 0.2 rad, got 0.3" in reason
    assert parameters.set(limits__position_upper=0.4) == (True, "")
    assert drive.exchange(drive.sample()) == pytest.approx(command, rel=0.2)
    assert parameters.get("limits.position_upper") == [0.4]


def test_every_version_in_use_is_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    start("controller", **PATIENT)
    recorder = start("recorder", output=tmp_path / "bag")
    in_use, parameters = InUse(peer), Parameters(peer, "controller")
    for topic in ("controller/parameters_in_use", "diagnostics"):
        peer.wait(f"the recorder on {topic}", lambda said=f"recording /{topic}": said in recorder.output())
    for k1 in (20.0, 25.0):
        assert parameters.set(gains__fast__k=[k1, 0.6, 0.1]) == (True, "")
    in_use.version(3)
    heard: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, QoSProfile(depth=10))
    peer.wait("diagnostics", lambda: len(heard) > 1)
    assert recorder.stop() == 0
    recording = read_bag(tmp_path / "bag")
    assert [(version, values) for _, version, values in recording.in_use][-2:] == in_use.heard[-2:]
    assert recording.messages["/diagnostics"] > 0


def test_what_the_simulator_plays_is_in_the_bag(start: Start, peer: Peer, tmp_path: Path) -> None:
    start("plant_simulator", gear__backlash_angle=0.03)
    in_use, parameters = InUse(peer, "plant_simulator"), Parameters(peer, "plant_simulator")
    assert in_use.version(1)["sensors.motor_noise"] == 0.0
    assert parameters.set(sensors__motor_noise=1e-3) == (True, "")
    in_use.version(2)
    attempts = count()

    def recorded() -> list[tuple[float, int, dict[str, Any]]]:
        """What a recorder that comes late has in its bag; one that is stopped at once may have missed it."""
        bag = tmp_path / f"bag{next(attempts)}"
        recorder = start("recorder", output=bag)
        peer.wait("it", lambda: "recording /plant_simulator/parameters_in_use" in recorder.output())
        assert recorder.stop() == 0
        return read_bag(bag).simulated[-1:]

    ((_, version, values),) = peer.wait("a bag with it", recorded)
    assert (version, values["sensors.motor_noise"], values["gear.backlash_angle"]) == (2, 1e-3, 0.03)
