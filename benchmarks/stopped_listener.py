"""Does a listener that is stopped hold up who publishes? Fast DDS with shared memory beside UDP alone, in one run.

One process publishes to another, which is stopped (SIGSTOP, as by Ctrl-Z or a debugger) for 20 ms again and again while
others keep its core busy. Counted is how often one call of publish() took longer than half a second: with shared memory
the listener may be stopped while it holds a lock, for which the publisher waits 1 s. `taskset -c 0,1` before it makes
the machine busier, and that likelier.

    stopped_listener.py [--seconds 60]
"""

import argparse
import os
import random
import signal
import time
from multiprocessing import get_context

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from backlash_ros.nodes.domain import own_domain

STOPPED = 0.02
HELD_UP = 0.5
BUSY = 3


def keep_busy(core: int) -> None:
    """Leave little of a core to others, until killed."""
    os.sched_setaffinity(0, {core})
    while True:
        pass


def listen(domain: int, core: int) -> None:
    """Listen until killed."""
    os.sched_setaffinity(0, {core})
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("listener")
    quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Float64, "x", lambda _message: None, quality)
    rclpy.spin(node)


def publish(transports: str, domain: int, core: int, seconds: float) -> None:
    """Publish while the listener is stopped and goes on; print how often publish() was held up."""
    # Not LOCALHOST, for which rmw_fastrtps takes shared memory whatever the variable says.
    os.environ |= {"FASTDDS_BUILTIN_TRANSPORTS": transports, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    context = get_context("spawn")
    listener = context.Process(target=listen, args=(domain, core), daemon=True)
    others = [context.Process(target=keep_busy, args=(core,), daemon=True) for _ in range(BUSY)]
    for process in (listener, *others):
        process.start()
    assert listener.pid is not None
    try:
        rclpy.init(domain_id=domain)
        publisher = rclpy.create_node("publisher").create_publisher(Float64, "x", 10)
        while not publisher.get_subscription_count():
            time.sleep(0.1)
        stops, held_up, longest = 0, 0, 0.0
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            stop_at = now + random.uniform(0.5 * STOPPED, 1.5 * STOPPED)
            stopped = False
            while time.monotonic() < stop_at + STOPPED:
                if not stopped and time.monotonic() > stop_at:
                    os.kill(listener.pid, signal.SIGSTOP)
                    stopped, stops = True, stops + 1
                began = time.monotonic()
                publisher.publish(Float64(data=1.0))
                took = time.monotonic() - began
                held_up, longest = held_up + (took > HELD_UP), max(longest, took)
                time.sleep(0.0002)
            os.kill(listener.pid, signal.SIGCONT)
        print(
            f"{transports:8s} {stops} stops, held up {held_up} times; longest publish() {1e3 * longest:.1f} ms",
            flush=True,
        )
    finally:
        for process in (listener, *others):
            process.kill()


def main() -> None:
    """Measure both at the same time, each with a listener's core of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    cores = sorted(os.sched_getaffinity(0))
    context = get_context("spawn")
    with own_domain() as first, own_domain() as second:
        runs = [
            context.Process(target=publish, args=(transports, domain, core, seconds))
            for transports, domain, core in (("DEFAULT", first, cores[-1]), ("UDPv4", second, cores[-2]))
        ]
        for run in runs:
            run.start()
        for run in runs:
            run.join()


if __name__ == "__main__":
    main()
