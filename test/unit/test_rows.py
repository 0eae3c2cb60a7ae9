"""Joint states read by the dozen: the same as one by one, whatever their names, lengths, byte order and gaps."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from backlash_ros.dashboard.rows import JOINT_COLUMNS, JointReader, frame

MOTOR, LOAD, REDUCTION = "motor", "load", 5.0
NAMES = ([MOTOR, LOAD], [LOAD, MOTOR], ["a", MOTOR, "bcd", LOAD, "\u00e4", "f"], [LOAD], [MOTOR], [], ["motor", "lode"])
"""The last as long as the first."""


def message(
    rng: np.random.Generator, names: Sequence[str], counts: tuple[int, int, int] | None = None, frame_id: str = ""
) -> JointState:
    """Return one with random numbers, as many as there are names unless said otherwise."""
    stamp = Time(sec=int(rng.integers(2**31)), nanosec=int(rng.integers(10**9)))
    numbers = [rng.normal(size=count).tolist() for count in counts or (len(names),) * 3]
    return JointState(
        header=Header(stamp=stamp, frame_id=frame_id),
        name=list(names),
        **dict(zip(("position", "velocity", "effort"), numbers, strict=True)),
    )


def one_by_one(sent: Sequence[bytes]) -> npt.NDArray[np.float64]:
    """Return what the messages say, each read by ROS."""
    rows = []
    for each in sent:
        said = deserialize_message(each, JointState)

        def of(joint: str, values: Sequence[float], names: Sequence[str] = tuple(said.name)) -> float:
            place = names.index(joint) if joint in names else len(values)
            return values[place] if place < len(values) else math.nan

        stamp = said.header.stamp
        time, motor = stamp.sec + 1e-9 * stamp.nanosec, of(MOTOR, said.position) / REDUCTION
        rows.append((time, motor, of(LOAD, said.position), of(LOAD, said.effort)))
    return np.array(rows).reshape(-1, len(JOINT_COLUMNS))


def check(sent: Sequence[bytes], reader: JointReader) -> None:
    np.testing.assert_array_equal(reader.rows(sent, MOTOR, LOAD, REDUCTION), one_by_one(sent))


def test_those_that_are_alike() -> None:
    rng, reader = np.random.default_rng(1), JointReader()
    for count in (50, 0, 1, 500):
        check([serialize_message(message(rng, NAMES[0])) for _ in range(count)], reader)


def test_any_mixture() -> None:
    rng, reader = np.random.default_rng(2), JointReader()
    for _ in range(50):
        sent = []
        for _ in range(rng.integers(20)):
            names = NAMES[rng.integers(len(NAMES))]
            counts = (*(int(n) for n in rng.integers(len(names) + 2, size=3)),) if rng.integers(2) else None
            frame_id = "base"[: rng.integers(5)]
            sent += [serialize_message(message(rng, names, counts, frame_id))] * int(rng.integers(1, 4))
        check(sent, reader)


def test_numbers_that_move_from_speed_to_torque_in_a_message_as_long() -> None:
    rng, reader = np.random.default_rng(3), JointReader()
    sent = [serialize_message(message(rng, NAMES[0], counts)) for counts in ((2, 2, 0), (2, 0, 2), (0, 2, 2))]
    assert len({len(each) for each in sent}) == 1
    check(sent * 2, reader)


def test_what_fills_gaps_may_be_anything() -> None:
    rng, reader = np.random.default_rng(4), JointReader()
    sent = bytearray(serialize_message(message(rng, ["load"], frame_id="")))
    gap = 4 + 8 + 4 + 1  # behind an empty text, up to the next multiple of four
    assert sent[gap + 3 : gap + 7] == b"\x01\0\0\0"  # one name
    filled = [bytes(sent)]
    for byte in (0, 1, 255):
        sent[gap : gap + 3] = bytes([byte] * 3)
        filled.append(bytes(sent))
    check(filled, reader)
    assert len(np.unique(reader.rows(filled, MOTOR, LOAD, REDUCTION)[:, 2])) == 1


def test_the_other_byte_order() -> None:
    head = b"\x00\x00\x00\x00" + (7).to_bytes(4, "big") + (500_000_000).to_bytes(4, "big")
    text = (1).to_bytes(4, "big") + b"\0\0\0\0" + (1).to_bytes(4, "big") + (5).to_bytes(4, "big") + b"load\0\0\0\0"
    count, none = (1).to_bytes(4, "big"), (0).to_bytes(4, "big")
    body = head + text + count
    body += bytes(-(len(body) - 4) % 8) + np.array([2.5], ">f8").tobytes() + none + none
    rows = JointReader().rows([body, body], MOTOR, LOAD, REDUCTION)
    np.testing.assert_array_equal(rows, [[7.5, math.nan, 2.5, math.nan]] * 2)


def test_a_frame_says_where_the_states_begin() -> None:
    samples, states = np.arange(8.0).reshape(2, 4), np.arange(3.0).reshape(1, 3)
    numbers = np.frombuffer(frame(samples, states))
    np.testing.assert_array_equal(numbers, [samples.nbytes, *samples.ravel(), *states.ravel()])
