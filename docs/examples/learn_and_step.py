"""Learns the backlash and steps to 1 rad, by the topics and services of a running controller, with rclpy alone."""

import rclpy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node("learn_and_step")
reference = node.create_publisher(Float64, "/reference", 10)  # early: nodes take a moment to find each other


def call(service: str) -> None:
    """Call a service of the controller and show its answer."""
    client = node.create_client(Trigger, f"/controller/{service}")
    client.wait_for_service()
    rclpy.spin_once(node, timeout_sec=1.0)  # meanwhile the controller finds this client, too
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future)
    node.get_logger().info(f"{service}: {future.result().message}")


call("reset_fault")  # a controller that waited for its drive may have latched a fault
call("learn")  # takes some seconds; the motor moves
reference.publish(Float64(data=1.0))  # rad
reference.wait_for_all_acked()
node.get_logger().info("sent: 1 rad")
node.destroy_node()
rclpy.shutdown()
