"""The checks of the drive contract: each is one claim about a drive, and fails by its name.

One recording of small moves serves every check that only looks. What may leave a drive with a fault, or ends it, has a
fresh drive of its own.
"""

import itertools
import math
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from backlash_ros.contract.bench import END_LIMIT, FEWEST, MOVE, REST, Bench, Expected, Recording, running

SIDES = ("motor", "load")
STAMP_AGE = 0.1
"""Largest median age of a sample when it arrives, s."""

REACH = 3.0
"""Travel after a bad command at which the kit gives up and commands 0 V, in travels of the move before."""


@pytest.fixture(scope="module")
def expected(pytestconfig: pytest.Config) -> Expected:
    """Return what the options say."""
    option = pytestconfig.getoption
    return Expected(
        command=option("--drive-command"),
        rate=option("--drive-rate"),
        value=option("--drive-value"),
        motor_joint=option("--motor-joint"),
        load_joint=option("--load-joint"),
        gear_ratio=option("--gear-ratio"),
        torque_constant=option("--torque-constant"),
        resistance=option("--resistance"),
        command_timeout=option("--command-timeout"),
    )


@pytest.fixture(scope="module")
def recording(expected: Expected) -> Recording:
    """Return what the drive says before, during and between four small moves."""
    value = expected.value
    with running(expected) as bench:
        bench.hold("silence", None, REST)
        bench.hold("zero", [0.0], REST)
        bench.move("forward", [value])
        bench.hold("forward rest", [0.0], REST)
        bench.move("back", [-value])
        bench.hold("back rest", [0.0], REST)
        bench.move("double", [2 * value], MOVE / 2)
        bench.hold("double rest", [0.0], REST)
        bench.move("stamped", [-value, 3.0, 7.0], stamped=True)
        bench.hold("stamped rest", [0.0], REST)
        return bench.recording


@pytest.fixture
def fresh(expected: Expected, recording: Recording) -> Iterator[Bench]:  # noqa: ARG001
    """Give a drive that has just started; one that made no recording is not started again."""
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
    """A reliable subscriber, a recorder say, hears the drive."""
    assert recording.reliable, "joint_states is offered best effort: a reliable subscriber hears nothing"


def test_samples_name_the_joints(recording: Recording, expected: Expected) -> None:
    """Each joint stands once in every sample, in any place."""
    for message in recording.messages:
        for name in expected.joints:
            count = list(message.name).count(name)
            assert count == 1, f"joint {name!r} stands {count} times, not once, in a sample of {list(message.name)}"


def test_arrays_fit_the_names(recording: Recording) -> None:
    """As many positions as names; velocity and effort likewise, or empty."""
    for message in recording.messages:
        count = len(message.name)
        for field, allowed in (("position", (count,)), ("velocity", (0, count)), ("effort", (0, count))):
            length = len(getattr(message, field))
            assert length in allowed, f"{field} has {length} values in a sample of {count} names"


def not_finite(recording: Recording) -> str:
    """Say what is not finite, and how often; nothing if all is."""
    wrong = [
        f"{field} of joint {name!r} is {value}"
        for message in recording.messages
        for field in ("position", "velocity", "effort")
        for name, value in zip(message.name, getattr(message, field), strict=False)
        if not math.isfinite(value)
    ]
    return f"{wrong[0]}, and {len(wrong)} such values in {len(recording.messages)} samples" if wrong else ""


def test_values_are_finite(recording: Recording) -> None:
    """No NaN and no infinity: what is not known is left out."""
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


def test_each_sample_is_published_once(recording: Recording) -> None:
    """No sample comes a second time, with the same stamp and the same values."""
    moving = recording.messages[recording.stretches["forward"]]
    twice = sum(a == b for a, b in itertools.pairwise(moving))
    assert twice == 0, f"{twice} of {len(moving)} samples of a move repeat the one before"


def test_stamps_increase(recording: Recording) -> None:
    """Each sample is stamped later than the one before."""
    messages, stamps = recording.messages, recording.stamps
    steps = np.array([stamps[k + 1] - stamps[k] for k in range(stamps.size - 1) if messages[k] != messages[k + 1]])
    wrong = steps[steps <= 0]
    assert not wrong.size, f"{wrong.size} of {steps.size} stamps do not increase; the first steps by {wrong[0]} ns"


def test_stamps_are_of_now(recording: Recording) -> None:
    """The stamp is the time of measurement on the ROS clock: a sample is young when it arrives."""
    age = float(np.median(np.array(recording.received) - recording.stamps)) * 1e-9
    assert abs(age) <= STAMP_AGE, f"samples arrive {age:.4g} s after their stamp, at most +-{STAMP_AGE:g} s is allowed"


def test_rests_without_command_and_at_zero(recording: Recording, expected: Expected, joint: str) -> None:
    """Before the first command, and while it is 0 V, nothing moves."""
    motion = recording.motion(joint, "silence", "zero")
    drift = float(np.ptp(motion.position))
    bound = 0.02 * MOVE * expected.ideal_speed(joint)
    assert drift <= bound, f"joint {joint!r} moved by {drift:.3g} rad without voltage, at most {bound:.3g} rad is rest"


def test_positive_command_turns_forward(recording: Recording, expected: Expected, joint: str) -> None:
    """A positive voltage turns motor and load to larger angles."""
    travel = recording.motion(joint, "forward").travel
    least = 0.1 * MOVE * expected.ideal_speed(joint)
    assert travel >= least, (
        f"joint {joint!r} travelled {travel:.3g} rad in {MOVE:g} s at +{expected.value:g} V,"
        f" at least +{least:.3g} rad is expected"
    )


def test_negative_command_turns_back(recording: Recording, expected: Expected, joint: str) -> None:
    """A negative voltage turns motor and load to smaller angles."""
    travel = recording.motion(joint, "back").travel
    most = -0.1 * MOVE * expected.ideal_speed(joint)
    assert travel <= most, (
        f"joint {joint!r} travelled {travel:.3g} rad in {MOVE:g} s at -{expected.value:g} V,"
        f" at most {most:.3g} rad is expected"
    )


def test_load_travels_gear_ratio_times_the_motor(recording: Recording, expected: Expected) -> None:
    """Each joint is measured at its own shaft, in the same unit."""
    if len(expected.joints) < 2:
        pytest.skip("the drive has one joint")
    # The second half of the move: the backlash is taken up.
    motor, load = (recording.motion(joint, "forward").end_speed(MOVE / 2) for joint in expected.joints)
    ratio = load / motor if motor else math.nan
    gear = expected.gear_ratio
    assert abs(ratio - gear) <= 0.2 * gear, (
        f"load travel/motor travel is {ratio:.4g}, the gear ratio is {gear:g} +-20 %"
    )


def test_position_is_in_radians(recording: Recording, expected: Expected, joint: str) -> None:
    """The speed is that of a motor at this voltage: voltage/torque constant, less what friction takes."""
    top = recording.motion(joint, "forward", "forward rest").top_speed()
    ideal = expected.ideal_speed(joint)
    assert ideal / 4 <= top <= 2 * ideal, (
        f"joint {joint!r} reached {top:.4g} rad/s by its positions at {expected.value:g} V,"
        f" between {ideal / 4:.4g} and {2 * ideal:.4g} rad/s is expected of it"
    )


def test_velocity_is_the_rate_of_the_position(recording: Recording, expected: Expected, joint: str) -> None:
    """Summed over a move, velocity gives the travel, in each direction."""
    for move in ("forward", "back"):
        motion = recording.motion(joint, move, f"{move} rest")
        if np.all(np.isnan(motion.velocity)):
            pytest.skip("the drive does not publish velocity")
        steps = np.diff(motion.time)
        whole = steps < 5 / expected.rate  # not where samples are missing
        summed = float(np.nansum((0.5 * (motion.velocity[1:] + motion.velocity[:-1]) * steps)[whole]))
        travel = float(np.sum(np.diff(motion.position)[whole]))
        assert abs(summed - travel) <= 0.2 * abs(travel), (
            f"velocity of joint {joint!r} adds up to {summed:.4g} rad, the move ({move}) was {travel:.4g} rad +-20 %"
        )


def test_motor_effort_is_its_torque(recording: Recording, expected: Expected) -> None:
    """At the start of a move the motor's torque has the sign of the voltage and about the stall torque's size."""
    if not expected.motor_joint:
        pytest.skip("the drive has no motor joint")
    stall = expected.torque_constant * expected.value / expected.resistance
    for move, sign in (("forward", 1), ("back", -1)):
        effort = recording.motion(expected.motor_joint, move).effort
        if np.all(np.isnan(effort)):
            pytest.skip("the drive does not publish effort")
        peak = sign * float(effort[np.nanargmax(np.abs(effort))])
        assert stall / 20 <= peak <= 2 * stall, (
            f"effort of joint {expected.motor_joint!r} peaks at {peak:.4g} N m the way of the voltage ({move}),"
            f" between {stall / 20:.3g} and {2 * stall:.3g} N m is expected at {expected.value:g} V"
        )


def test_double_command_is_faster(recording: Recording, expected: Expected) -> None:
    """The command is a size, not a switch."""
    joint = expected.joints[0]
    single, double = (abs(recording.motion(joint, move).end_speed(0.05)) for move in ("forward", "double"))
    assert double >= 1.3 * single > 0, (
        f"joint {joint!r} turns with {single:.4g} rad/s at {expected.value:g} V and {double:.4g} rad/s at twice that,"
        " at least 1.3 times as much is expected"
    )


def left_of_speed(recording: Recording, joint: str, move: str, after: str) -> float:
    """Share of the speed at the end of ``move`` that is left at the end of ``after``."""
    before = recording.motion(joint, move).end_speed()
    return abs(recording.motion(joint, after).end_speed() / before) if before else math.inf


def test_zero_command_slows_down(recording: Recording, expected: Expected) -> None:
    """0 V takes the drive out of its motion; the checks of stopping compare with this."""
    left = left_of_speed(recording, expected.joints[0], "forward", "forward rest")
    assert left <= 0.7, f"{REST:g} s after 0 V {left:.0%} of the speed is left, at most 70 % is expected"


def test_stamp_and_further_elements_are_no_obstacle(recording: Recording, expected: Expected) -> None:
    """data[0] counts; data behind it, and a layout with the stamp of the sample that is answered, change nothing."""
    joint = expected.joints[0]
    plain, stamped = (recording.motion(joint, move).end_speed() for move in ("back", "stamped"))
    assert abs(stamped - plain) <= 0.3 * abs(plain), (
        f"joint {joint!r} turns with {stamped:.4g} rad/s at [{-expected.value:g}, 3, 7] V with a stamp in the layout,"
        f" {plain:.4g} rad/s +-30 % at [{-expected.value:g}] V alone"
    )


def stops(bench: Bench, command: list[float] | None, recording: Recording, expected: Expected) -> None:
    """Assert that the drive, moving, slows down on ``command`` as it does at 0 V, within the command timeout."""
    what = "silence" if command is None else f"command {command}"
    joint = expected.joints[0]
    allowed = 0.2 + left_of_speed(recording, joint, "forward", "forward rest")
    bench.move("forward", [expected.value])
    travel = abs(bench.recording.motion(joint, "forward").travel)
    bench.hold("after", command, expected.command_timeout + REST, reach=REACH * travel)
    heard = bench.recording.stretches["after"]
    assert heard.stop - heard.start >= FEWEST, (
        f"the drive fell silent on {what}: {heard.stop - heard.start} samples in {expected.command_timeout + REST:g} s"
    )
    assert bench.exit_code is None, f"the drive ended with code {bench.exit_code} on {what}"
    assert not bench.runaway, (
        f"on {what} joint {joint!r} travelled {bench.runaway:.3g} rad before the kit commanded 0 V,"
        f" after a move of {travel:.3g} rad"
    )
    left = left_of_speed(bench.recording, joint, "forward", "after")
    assert left <= allowed, (
        f"{expected.command_timeout + REST:g} s of {what} leave {left:.0%} of the speed of joint {joint!r},"
        f" {REST:g} s of 0 V with 20 % to spare leave {allowed:.0%}"
    )


def test_stops_when_commands_stop(fresh: Bench, recording: Recording, expected: Expected) -> None:
    """The drive has a watchdog of its own: a controller that died cannot stop it."""
    stops(fresh, None, recording, expected)


@pytest.mark.parametrize("bad", [[math.nan], [math.inf], []], ids=["nan", "inf", "empty"])
def test_stops_on_a_bad_command(fresh: Bench, recording: Recording, expected: Expected, bad: list[float]) -> None:
    """What is no voltage is 0 V, not the old voltage, and the drive goes on publishing."""
    stops(fresh, bad, recording, expected)
    assert not not_finite(fresh.recording), f"after command {bad} {not_finite(fresh.recording)}"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_ends_on_a_signal(fresh: Bench, number: signal.Signals) -> None:
    """The drive ends when it is told to, and nothing of it goes on."""
    assert fresh.end(number), f"the drive still runs {END_LIMIT:g} s after {number.name}"
    fresh.hold("on its way", None, 0.1)
    fresh.hold("ended", None, REST)
    late = fresh.recording.stretches["ended"]
    assert late.stop == late.start, f"{late.stop - late.start} samples came after the drive had ended on {number.name}"
