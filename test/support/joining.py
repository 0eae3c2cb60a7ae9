"""Participants that come, publish one reference and leave, as `ros2 topic pub --once` does, four at a time.

Each is a process of its own; a line is written when it was heard and has left. The references are 0.01, 0.02 and so on.
One that Fast DDS does not let go (2.14 may lock itself up in `destroy_participant` while others leave) leaves by force.

    python test/support/joining.py --count 50 -w 1 --keep-alive 0.1
"""

import argparse
import os
import signal
import sys
import time

import rclpy
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Float64

AT_ONCE = 4
POLL = 0.1  # s, of `ros2 topic pub --once`
PATIENCE = 30.0
LEAVING = 10
"""Seconds after which it leaves by force: SIGALRM."""


def publish_once(value: float, subscriptions: int, keep_alive: float) -> None:
    """Publish, and leave; exit code 1 where it was not heard."""
    rclpy.init()
    node = rclpy.create_node("joining")
    publisher = node.create_publisher(Float64, "reference", 10)
    end = time.monotonic() + PATIENCE
    while publisher.get_subscription_count() < subscriptions:
        if time.monotonic() > end:
            os._exit(1)
        time.sleep(POLL)
    publisher.publish(Float64(data=value))
    time.sleep(keep_alive)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LEAVING)
    node.destroy_node()
    rclpy.shutdown()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("-w", type=int, default=1)
    parser.add_argument("--keep-alive", type=float, default=0.1)
    given = parser.parse_args(remove_ros_args(sys.argv)[1:])
    for k in range(given.count + AT_ONCE - 1):
        if k < given.count and not os.fork():  # quicker than a new interpreter; DDS begins in the child
            publish_once(0.01 * (k + 1), given.w, given.keep_alive)
            os._exit(0)
        if k >= AT_ONCE - 1:
            _, status = os.wait()
            if status and os.waitstatus_to_exitcode(status) != -signal.SIGALRM:
                sys.exit(f"not {given.w} listened within {PATIENCE:g} s")
            print("heard", flush=True)


if __name__ == "__main__":
    main()
