"""Learns the backlash and steps to 1 rad, by the topics and services of a running controller, with rclpy alone."""

import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

TARGET = 1.0  # rad
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


def call(service: str) -> bool:
    """Call a service of the controller, show its answer, and return whether it succeeded."""
    client = node.create_client(Trigger, f"/controller/{service}")
    client.wait_for_service()
    rclpy.spin_once(node, timeout_sec=1.0)  # meanwhile the controller finds this client, too
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future)
    node.get_logger().info(f"{service}: {future.result().message}")
    return bool(future.result().success)


call("reset_fault")  # a controller that waited for its drive may have latched a fault
if not call("learn"):  # takes some seconds; the motor moves
    raise SystemExit(1)  # without the backlash the load would rattle
call("identify")  # takes as long; the law for two encoders acts if it finds inertia and friction
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
