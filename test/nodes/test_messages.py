"""Answers that are written as bytes say what the message says."""

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from backlash_ros.foundation.messages import answered_sample, stamp_ns
from backlash_ros.ros.messages import Answer, answer, stamp_label

stamps = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 10**9 - 1))


@given(st.lists(st.tuples(stamps, st.floats(allow_nan=False)), min_size=1, max_size=10))
def test_answer_reads_as_the_message_whatever_was_written_before(answers: list[tuple[Time, float]]) -> None:
    written = Answer()
    for stamp, value in answers:
        read = deserialize_message(written.to(stamp, value), Float64MultiArray)
        assert read == answer(value, stamp_label(stamp))
        assert answered_sample(read) == stamp_ns(stamp)
