"""Learns the backlash, identifies the drive and steps to 1 rad, or to the angle that is given, with rclpy alone.

It uses the topics and services of a running controller: learn_and_step.py 0.5
"""

import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

TARGET = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0  # rad
TRIES = 10  # no more: a controller that refuses it must not be moved by it later

rclpy.init()
node = rclpy.create_node("learn_and_step")
reference = node.create_publisher(Float64, "/reference", 10)
state: dict[str, float] = {}


def hear(message: DiagnosticArray) -> None:
    """Keep what the controller says of itself."""
    state.update((entry.key, float(entry.value)) for entry in message.status[0].values)


node.create_subscription(DiagnosticArray, "/controller/state", hear, 1)


def followed() -> bool:
    """Return whether the controller has taken the reference."""
    return state.get("reference") == TARGET


def call(service: str, patience: float | None = None) -> bool:
    """Call a service, show its answer, and return whether it succeeded; wait for it for ``patience`` s, or for ever."""
    client = node.create_client(Trigger, service)
    if not client.wait_for_service(patience):
        return False
    rclpy.spin_once(node, timeout_sec=1.0)  # meanwhile the controller finds this client, too
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future)
    node.get_logger().info(f"{service}: {future.result().message}")
    return bool(future.result().success)


call("/plant_simulator/reset_fault", 5.0)  # each may have latched a fault while it waited for the other
call("/controller/reset_fault")
if not call("/controller/learn"):  # takes some seconds; the motor moves
    raise SystemExit("nothing was learned: without the backlash the load would rattle, so there is no step")
if not call("/controller/identify"):  # takes as long; its answer ends with the law that acts
    node.get_logger().warning("the drive was not identified: law two_region goes on, which is slower")
for _ in range(TRIES):  # a message may be lost
    reference.publish(Float64(data=TARGET))
    again = time.monotonic() + 1.0
    while not followed() and time.monotonic() < again:
        rclpy.spin_once(node, timeout_sec=0.1)
    if followed():
        break
end = f"the controller follows {TARGET:g} rad" if followed() else "not followed: see the log of the controller"
node.get_logger().info(end)
node.destroy_node()
rclpy.shutdown()
raise SystemExit(0 if followed() else 1)
