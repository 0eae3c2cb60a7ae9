"""The checks of the drive contract: each is one claim about a drive, and fails by its name.

One recording of small moves serves every check that only reads. A check that may leave a drive with a fault, or ends
it, has its own fresh drive.
"""

import itertools
import math
import signal
from collections.abc import Iterator

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from backlash_ros.contract.bench import ATTEMPTS, END_LIMIT, FEWEST, REACH, REST, Bench, Expected, Recording, running
from backlash_ros.contract.plugin import expected_of
from backlash_ros.gates.positions import Position

SIDES = ("motor", "load")
STAMP_AGE = 0.1
"""Largest median age of a sample when it arrives, s."""


@pytest.fixture(scope="module")
def expected(pytestconfig: pytest.Config) -> Expected:
    """Return the description from the options."""
    described: Expected = expected_of(pytestconfig)
    return described


@pytest.fixture(scope="module")
def recording(expected: Expected, pytestconfig: pytest.Config) -> Recording:
    """Return the drive's samples before, during and between four small moves, and a whole turn where it is allowed."""
    value = expected.value
    with running(expected) as bench:
        bench.hold("silence", None, REST)
        bench.hold("zero", [0.0], REST)
        bench.move("forward", [value], expected.move)
        bench.rest("forward rest")
        bench.move("back", [-value], expected.move)
        bench.rest("back rest")
        bench.move("double", [2 * value], expected.double_move)
        bench.rest("double rest")
        bench.move("stamped", [-value, 3.0, 7.0], expected.move, stamped=True)
        bench.rest("stamped rest")
        if pytestconfig.getoption("--whole-turn"):
            bench.turn("turn")
            bench.rest("turn rest")
        return bench.recording


@pytest.fixture
def fresh(expected: Expected, recording: Recording) -> Iterator[Bench]:  # noqa: ARG001
    """Yield a drive that has just started; a drive that made no recording is not started again."""
    with running(expected) as bench:
        yield bench


@pytest.fixture(params=SIDES)
def joint(request: pytest.FixtureRequest, expected: Expected) -> str:
    """Each joint in turn."""
    name = expected.motor_joint if request.param == "motor" else expected.load_joint
    if not name:
        pytest.skip(f"the drive has no {request.param} joint")
    return name


def test_joint_states_are_published_reliably(recording: Recording) -> None:
    """A reliable subscriber, such as a recorder, receives the drive's samples."""
    assert recording.reliable, "joint_states is offered best effort: a reliable subscriber receives nothing"


def test_samples_name_the_joints(recording: Recording, expected: Expected) -> None:
    """Each joint is in every sample once, in any place."""
    for message in recording.messages:
        for name in expected.joints:
            count = list(message.name).count(name)
            assert count == 1, f"joint {name!r} appears {count} times, not once, in a sample of {list(message.name)}"


def test_arrays_fit_the_names(recording: Recording) -> None:
    """As many positions as names; velocity and effort likewise, or empty."""
    for message in recording.messages:
        count = len(message.name)
        for field, allowed in (("position", (count,)), ("velocity", (0, count)), ("effort", (0, count))):
            length = len(getattr(message, field))
            assert length in allowed, f"{field} has {length} values in a sample of {count} names"


def not_finite(recording: Recording) -> str:
    """Return which value is not finite, and how often; empty if none, or if a velocity or effort is always NaN."""
    signals: dict[tuple[str, str], list[float]] = {}
    for message in recording.messages:
        for field in ("position", "velocity", "effort"):
            for name, value in zip(message.name, getattr(message, field), strict=False):
                signals.setdefault((field, name), []).append(value)
    for (field, name), values in signals.items():
        wrong = [value for value in values if not math.isfinite(value)]
        not_measured = field != "position" and all(math.isnan(value) for value in values)
        if wrong and not not_measured:
            return f"{field} of joint {name!r} is {wrong[0]} in {len(wrong)} of {len(values)} samples"
    return ""


def test_values_are_finite(recording: Recording) -> None:
    """No NaN and no infinity, except an unmeasured velocity or effort, which is NaN in every sample."""
    assert not not_finite(recording), not_finite(recording)


def test_rate(recording: Recording, expected: Expected) -> None:
    """Samples come at the rate: median period within 5 %, at most 10 % of the samples missing."""
    time = recording.time
    count = round(expected.rate / 2)
    single = 1 / float(np.median(np.diff(time)))
    many = count / float(np.median(time[count:] - time[:-count]))
    rate = expected.rate
    assert 0.95 * rate <= single <= 1.05 * rate, f"rate is {single:.4g} Hz by the median period, not {rate:g} Hz +-5 %"
    assert 0.9 * rate <= many <= 1.05 * rate, (
        f"{many:.4g} samples come per second, by the median time of {count}, not {rate:g} Hz -10 % +5 %"
    )


def same(a: JointState, b: JointState) -> bool:
    """Return whether both are the same, including NaN."""
    return bool(serialize_message(a) == serialize_message(b))


def test_each_sample_is_published_once(recording: Recording) -> None:
    """No sample is repeated with the same stamp and the same values."""
    moving = recording.messages[recording.stretches["forward"]]
    # Samples at rest are all the same if the stamp stands still, which has its own check.
    change = next((k for k, message in enumerate(moving) if not same(message, moving[0])), 0)
    if change and moving[change].header.stamp == moving[0].header.stamp:
        moving = moving[change:]
    twice = sum(same(a, b) for a, b in itertools.pairwise(moving))
    assert twice == 0, f"{twice} of {len(moving)} samples of a move repeat the previous one"


def test_stamps_increase(recording: Recording) -> None:
    """Each sample is stamped later than the previous one."""
    messages, stamps = recording.messages, recording.stamps
    steps = np.array([stamps[k + 1] - stamps[k] for k in range(stamps.size - 1) if not same(*messages[k : k + 2])])
    wrong = steps[steps <= 0]
    assert not wrong.size, f"{wrong.size} of {steps.size} stamps do not increase; the first steps by {wrong[0]} ns"


def test_stamps_are_of_now(recording: Recording) -> None:
    """The stamp is the time of measurement on the ROS clock: a sample is young when it arrives."""
    age = float(np.median(np.array(recording.received) - recording.stamps)) * 1e-9
    assert abs(age) <= STAMP_AGE, f"samples arrive {age:.4g} s after their stamp, at most +-{STAMP_AGE:g} s is allowed"


def test_rests_without_command_and_at_zero(recording: Recording, expected: Expected, joint: str) -> None:
    """Before the first command, and while it is 0, nothing moves."""
    motion = recording.motion(joint, "silence", "zero")
    drift = float(np.ptp(motion.position))
    bound = 0.02 * expected.ideal_travel(joint)
    assert drift <= bound, (
        f"joint {joint!r} moved by {drift:.3g} rad without {expected.interface}, at most {bound:.3g} rad is rest"
    )


def test_positive_command_turns_forward(recording: Recording, expected: Expected, joint: str) -> None:
    """A positive command turns motor and load to larger angles."""
    travel = recording.motion(joint, "forward").travel
    least = 0.1 * expected.ideal_travel(joint)
    assert travel >= least, (
        f"joint {joint!r} travelled {travel:.3g} rad in {expected.move:g} s at +{expected.value:g} {expected.unit},"
        f" at least +{least:.3g} rad is expected"
    )


def test_negative_command_turns_back(recording: Recording, expected: Expected, joint: str) -> None:
    """A negative command turns motor and load to smaller angles."""
    travel = recording.motion(joint, "back").travel
    most = -0.1 * expected.ideal_travel(joint)
    assert travel <= most, (
        f"joint {joint!r} travelled {travel:.3g} rad in {expected.move:g} s at -{expected.value:g} {expected.unit},"
        f" at most {most:.3g} rad is expected"
    )


def test_load_travels_gear_ratio_times_the_motor(recording: Recording, expected: Expected) -> None:
    """Each joint is measured at its own shaft, in the same unit."""
    if len(expected.joints) < 2:
        pytest.skip("the drive has one joint")
    # The second half of the move, with the teeth in contact.
    motor, load = (recording.motion(joint, "forward").end_speed(expected.move / 2) for joint in expected.joints)
    ratio = load / motor if motor else math.nan
    gear = expected.gear_ratio
    assert abs(ratio - gear) <= 0.2 * gear, (
        f"load travel/motor travel is {ratio:.4g}, the gear ratio is {gear:g} +-20 %"
    )


def test_position_is_in_radians(recording: Recording, expected: Expected, joint: str) -> None:
    """The speed is that of a motor: voltage/torque constant, or torque x time/inertia, reduced by friction."""
    top = recording.motion(joint, "forward", "forward rest").top_speed()
    ideal = expected.ideal_speed(joint)
    most = (4 if expected.takes_current else 2) * ideal
    assert ideal / 4 <= top <= most, (
        f"joint {joint!r} reached {top:.4g} rad/s by its positions at {expected.value:g} {expected.unit},"
        f" between {ideal / 4:.4g} and {most:.4g} rad/s is expected of it"
    )


def test_position_goes_on_beyond_a_turn(recording: Recording, expected: Expected, joint: str) -> None:
    """It does not begin again at a turn, nor where a counter overflows."""
    motion = recording.motion(joint, *recording.stretches)
    position, side = Position(), "motor" if joint == expected.motor_joint else "load"
    for angle, elapsed in zip(motion.position.tolist(), np.diff(motion.time, prepend=motion.time[0]), strict=True):
        position.take(angle, round(1e9 * elapsed), 4.0 * expected.ideal_speed(joint))
        assert not position.jump, f"joint {joint!r} {position.jump}: publish it continuously, or set {side}_wrap"
    travel = float(np.ptp(motion.position))
    if travel < 2 * math.pi:
        pytest.skip(
            f"joint {joint!r} moved by {travel:.3g} rad, less than a turn, and so may begin again unseen; if the load"
            " may turn freely, --whole-turn moves it far enough"
        )


def test_velocity_is_the_rate_of_the_position(recording: Recording, expected: Expected, joint: str) -> None:
    """Summed over a move, velocity gives the travel, in each direction."""
    for move in ("forward", "back"):
        motion = recording.motion(joint, move, f"{move} rest")
        if np.all(np.isnan(motion.velocity)):
            pytest.skip("the drive does not publish velocity")
        steps = np.diff(motion.time)
        whole = steps < 5 / expected.rate  # not with missing samples
        summed = float(np.nansum((0.5 * (motion.velocity[1:] + motion.velocity[:-1]) * steps)[whole]))
        travel = float(np.sum(np.diff(motion.position)[whole]))
        assert abs(summed - travel) <= 0.2 * abs(travel), (
            f"velocity of joint {joint!r} adds up to {summed:.4g} rad, the move ({move}) was {travel:.4g} rad +-20 %"
        )


def test_motor_effort_is_its_torque(recording: Recording, expected: Expected) -> None:
    """The motor's torque has the sign of the command and the size of the standstill torque; a voltage's soon drops."""
    if not expected.motor_joint:
        pytest.skip("the drive has no motor joint")
    torque = expected.starting_torque
    least, most = torque / (2 if expected.takes_current else 20), 2 * torque
    for move, sign in (("forward", 1), ("back", -1)):
        effort = recording.motion(expected.motor_joint, move).effort
        if np.all(np.isnan(effort)):
            pytest.skip("the drive does not publish effort")
        peak = float(np.nanmax(sign * effort))
        assert least <= peak <= most, (
            f"effort of joint {expected.motor_joint!r} peaks at {peak:.4g} N m the way of the command ({move}),"
            f" between {least:.3g} and {most:.3g} N m is expected at {expected.value:g} {expected.unit}"
        )


def test_double_command_is_faster(recording: Recording, expected: Expected) -> None:
    """The command is proportional, not a switch."""
    joint = expected.joints[0]
    single, double = (abs(recording.motion(joint, move).end_speed(0.05)) for move in ("forward", "double"))
    assert double >= 1.3 * single > 0, (
        f"joint {joint!r} turns with {single:.4g} rad/s at {expected.value:g} {expected.unit} and {double:.4g} rad/s at"
        " twice that, at least 1.3 times as much is expected"
    )


def left_of_speed(recording: Recording, expected: Expected, move: str, after: str) -> float:
    """Return the share of the speed at the end of ``move`` that is left at the end of ``after``.

    Under a current the motor accelerates until a watchdog acts, and then coasts: in that case it is the share of the
    speed a rest before the end of ``after``.
    """
    joint = expected.joints[0]
    rest = recording.motion(joint, after)
    before = rest.end_speed(before=REST - 0.1) if expected.takes_current else recording.motion(joint, move).end_speed()
    return abs(rest.end_speed() / before) if before else math.inf


def test_zero_command_slows_down(recording: Recording, expected: Expected) -> None:
    """0 stops the drive or lets it coast; the checks of stopping compare with this."""
    left = left_of_speed(recording, expected, "forward", "forward rest")
    most = 0.7
    if expected.takes_current:
        # Friction that limits the speed towards the end of the move stops the drive afterwards. With hardly any, the
        # speed about doubles in the second half, and then stays.
        move = recording.motion(expected.joints[0], "forward")
        late, early = move.end_speed(0.05), move.end_speed(0.05, before=expected.move / 2)
        most = max(most, late / early - 0.7 if early else 0.0)
    assert left <= most, (
        f"{REST:g} s after 0 {expected.unit} {left:.0%} of the speed is left, at most {most:.0%} is expected"
    )


def test_stamp_and_further_elements_are_no_obstacle(recording: Recording, expected: Expected) -> None:
    """data[0] counts; further data, and a layout with the stamp of the answered sample, change nothing."""
    joint = expected.joints[0]
    plain, stamped = (recording.motion(joint, move).end_speed() for move in ("back", "stamped"))
    value, unit = expected.value, expected.unit
    assert abs(stamped - plain) <= 0.3 * abs(plain), (
        f"joint {joint!r} turns with {stamped:.4g} rad/s at [{-value:g}, 3, 7] {unit} with a stamp in the layout,"
        f" {plain:.4g} rad/s +-30 % at [{-value:g}] {unit} alone"
    )


def stops(command: list[float] | None, recording: Recording, expected: Expected) -> Recording:
    """Assert that the moving drive slows down on ``command`` as it does at 0, within the command timeout.

    Each attempt has a drive that has just started: the command may have been a fault to the previous one.
    """
    what = "silence" if command is None else f"command {command}"
    joint = expected.joints[0]
    allowed = 0.2 + left_of_speed(recording, expected, "forward", "forward rest")
    for _ in range(ATTEMPTS):
        with running(expected) as bench:
            bench.move("forward", [expected.value], expected.move)
            travel = abs(bench.recording.motion(joint, "forward").travel)
            bench.hold("after", command, expected.command_timeout + REST, reach=REACH[expected.interface] * travel)
            bench.brake()
            code = bench.exit_code
        # If samples were missing, the watchdog may have stopped the motor, not the command.
        if command is None or bench.runaway or code is not None or not bench.stalled("after"):
            break
    else:
        pytest.fail(f"samples were missing in each of {ATTEMPTS} attempts: the drive or this machine stood still")
    heard = bench.recording.stretches["after"]
    assert heard.stop - heard.start >= FEWEST, (
        f"the drive fell silent on {what}: {heard.stop - heard.start} samples in {expected.command_timeout + REST:g} s"
    )
    assert code is None, f"the drive ended with code {code} on {what}"
    assert not bench.runaway, (
        f"on {what} joint {joint!r} travelled {bench.runaway:.3g} rad before the kit commanded 0 {expected.unit},"
        f" after a move of {travel:.3g} rad"
    )
    left = left_of_speed(bench.recording, expected, "forward", "after")
    assert left <= allowed, (
        f"{expected.command_timeout + REST:g} s of {what} leave {left:.0%} of the speed of joint {joint!r},"
        f" {REST:g} s of 0 {expected.unit} with 20 % to spare leave {allowed:.0%}"
    )
    return bench.recording


def test_stops_when_commands_stop(recording: Recording, expected: Expected) -> None:
    """The drive has its own watchdog: a crashed controller cannot stop it."""
    stops(None, recording, expected)


@pytest.mark.parametrize("bad", [[math.nan], [math.inf], []], ids=["nan", "inf", "empty"])
def test_stops_on_a_bad_command(recording: Recording, expected: Expected, bad: list[float]) -> None:
    """A command that is not a number counts as 0, not as the old command, and the drive goes on publishing."""
    heard = stops(bad, recording, expected)
    assert not not_finite(heard), f"after command {bad} {not_finite(heard)}"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_ends_on_a_signal(fresh: Bench, number: signal.Signals) -> None:
    """The drive ends when it is told to, and leaves no process."""
    assert fresh.end(number), f"the drive still runs {END_LIMIT:g} s after {number.name}"
    fresh.hold("on its way", None, 0.1)
    fresh.hold("ended", None, REST)
    late = fresh.recording.stretches["ended"]
    assert late.stop == late.start, f"{late.stop - late.start} samples came after the drive had ended on {number.name}"
