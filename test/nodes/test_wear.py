"""Wear over DDS: told where the gap has grown, and learned anew where that is allowed; nobody calls a service."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from rclpy.qos import QoSProfile

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
WORN = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_angle=5 * B))
COUNTED = Sensors(measured=POSITIONS, motor_counts=4096.0, load_counts=65536.0)


@pytest.mark.grid  # test_wear.py has it by unit
def test_a_gap_that_has_grown_is_told_and_learned_anew(start: Callable[..., Process], peer: Peer) -> None:
    start("controller", backlash_angle=B, learning__renew=True, state_timeout=10.0)
    told: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        told.extend(value.value for status in message.status for value in status.values if value.key == "wear")

    peer.node.create_subscription(DiagnosticArray, "/diagnostics", hear, QoSProfile(depth=10))
    drive = LockstepDrive(peer, simulated=SimulatedDrive(WORN, 0.004, sensors=COUNTED)).matched()
    assert drive.follows(0.5)
    parameters = Parameters(peer, "controller")

    def learned() -> bool:
        drive.run(25)
        return bool(parameters.get("backlash_angle")[0] != B)

    peer.wait("the backlash to be learned anew", learned)
    assert parameters.get("backlash_angle")[0] == pytest.approx(5 * B, rel=0.02)
    assert any("the gap has grown: the two flanks were" in text for text in told)
    peer.wait("no more wear to be told", lambda: drive.run(25) is not None and told[-1] == "")
    assert drive.follows(0.0)
