"""Does a listener that is stopped hold up who publishes? Fast DDS by shared memory and by UDP, at the same time.

One process publishes to another, which is stopped (SIGSTOP, as by Ctrl-Z or a debugger) for 20 ms again and again while
others keep its core busy. Counted is after how many stops a call of publish() took longer than half a second: by shared
memory the listener may be stopped while it holds the lock of its queue, for which the publisher waits 1 s. On fewer
cores that is likelier:

    taskset -c 0,1 python benchmarks/stopped_listener.py --seconds 60
"""

import argparse
import os
import random
import signal
import sys
import time
from multiprocessing import get_context
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from backlash_ros.ros.isolation import isolated
from backlash_ros.ros.transport import PROFILES

STOPPED = 0.02
HELD_UP = 0.5
BUSY = 3
PATIENCE = 60.0
CONTEXT = get_context("spawn")


def keep_busy(core: int) -> None:
    """Leave little of a core to others, as long as the parent lives."""
    os.sched_setaffinity(0, {core})
    parent = os.getppid()
    while os.getppid() == parent:
        pass


def listen(core: int) -> None:
    """Listen as long as the parent lives."""
    os.sched_setaffinity(0, {core})
    parent = os.getppid()
    rclpy.init()
    node = rclpy.create_node("listener")
    quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Float64, "x", lambda _message: None, quality)
    while os.getppid() == parent:
        rclpy.spin_once(node, timeout_sec=1.0)


def count(listener: int, seconds: float) -> str:
    """Publish while the listener is stopped and goes on; say how often publish() was held up."""
    rclpy.init()
    publisher = rclpy.create_node("publisher").create_publisher(Float64, "x", 10)
    end = time.monotonic() + PATIENCE
    while not publisher.get_subscription_count():
        if time.monotonic() > end:
            raise RuntimeError(f"waited {PATIENCE:g} s for the listener")
        time.sleep(0.1)
    stops, held_up, longest = 0, 0, 0.0
    end = time.monotonic() + seconds
    while (now := time.monotonic()) < end:
        stop_at = now + random.uniform(0.5 * STOPPED, 1.5 * STOPPED)
        stopped = False
        while time.monotonic() < stop_at + STOPPED:
            if not stopped and time.monotonic() > stop_at:
                os.kill(listener, signal.SIGSTOP)
                stopped, stops = True, stops + 1
            began = time.monotonic()
            publisher.publish(Float64(data=1.0))
            took = time.monotonic() - began
            held_up, longest = held_up + (took > HELD_UP), max(longest, took)
            time.sleep(0.0002)
        os.kill(listener, signal.SIGCONT)
    return f"{stops} stops, held up {held_up} times; longest publish() {1e3 * longest:.1f} ms"


def measure(shared: bool, core: int, seconds: float) -> None:
    """Count for one transport, on a domain of its own, and print it."""
    with isolated():
        if shared:
            for name in PROFILES:
                os.environ.pop(name, None)
            os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # for which rmw_fastrtps takes shared memory
        listener = CONTEXT.Process(target=listen, args=(core,), daemon=True)
        others = [CONTEXT.Process(target=keep_busy, args=(core,), daemon=True) for _ in range(BUSY)]
        for process in (listener, *others):
            process.start()
        try:
            assert listener.pid is not None
            said = count(listener.pid, seconds)
            if ("shm/fast" in Path("/proc/self/maps").read_text()) != shared:
                raise RuntimeError("this RMW, or its configuration, has other transports")
            print(f"{'shared memory' if shared else 'UDP':14s}{said}", flush=True)
        finally:
            for process in (listener, *others):
                process.kill()


def main() -> int:
    """Measure both, each with a core for its listener."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    cores = sorted(os.sched_getaffinity(0))
    each = (True, cores[-1]), (False, cores[0])
    runs = [CONTEXT.Process(target=measure, args=(shared, core, seconds)) for shared, core in each]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
    return int(any(run.exitcode for run in runs))


if __name__ == "__main__":
    sys.exit(main())
