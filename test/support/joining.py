"""Participants that come, publish one reference and leave, as `ros2 topic pub --once` does, four at a time.

Each is a process of its own; a line is written when it was heard and has left.

    python test/support/joining.py <how many>
"""

import os
import sys
import time

import rclpy
from std_msgs.msg import Float64

AT_ONCE = 4
POLL = KEEP_ALIVE = 0.1  # s, of `ros2 topic pub --once`
PATIENCE = 30.0


def publish_once(value: float) -> bool:
    rclpy.init()
    node = rclpy.create_node("joining")
    publisher = node.create_publisher(Float64, "reference", 10)
    end = time.monotonic() + PATIENCE
    while not (heard := publisher.get_subscription_count() > 0) and time.monotonic() < end:
        time.sleep(POLL)
    publisher.publish(Float64(data=value))
    time.sleep(KEEP_ALIVE)
    node.destroy_node()
    rclpy.shutdown()
    return heard


def main(count: int) -> None:
    for k in range(count + AT_ONCE - 1):
        if k < count and not os.fork():  # quicker than a new interpreter; DDS begins in the child
            os._exit(0 if publish_once(0.1 * (k % 5)) else 1)
        if k >= AT_ONCE - 1:
            _, status = os.wait()
            if status:
                sys.exit(f"nobody listened within {PATIENCE:g} s")
            print("heard", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
