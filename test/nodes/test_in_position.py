"""What the controller says over DDS of the load's position, in lockstep."""

from collections.abc import Callable

from graph import Lifecycle, Peer, Process
from lifecycle_msgs.msg import Transition
from lockstep_drive import LockstepDrive
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from backlash_ros.drivetrain import NOMINAL_DRIVE

Start = Callable[..., Process]
B = NOMINAL_DRIVE.gear.backlash_angle
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def words(peer: Peer) -> list[str]:
    """Return what is said, from the last word on that was said before."""
    said: list[str] = []
    peer.node.create_subscription(String, "controller/in_position", lambda m: said.append(m.data), LATCHED)
    return said


def test_a_program_can_wait_until_the_load_is_there(start: Start, peer: Peer) -> None:
    start("controller", backlash_angle=B, identified=True, state_timeout=10.0)
    said, drive = words(peer), LockstepDrive(peer).matched()
    drive.until(lambda: said[-1:] == ["holding"])
    drive.set_reference(1.0)
    drive.until(lambda: said[-1:] == ["settled"])
    assert abs(drive.load_angle - 1.0) <= 0.25 * B
    assert said[-3:] == ["holding", "moving", "settled"]
    late = words(peer)
    peer.wait("the last word", lambda: late)
    assert late == ["settled"]
    drive._reference.publish(Float64(data=4.0))
    drive.until(lambda: said[-1] == "moving")
    assert drive.call("hold").success
    drive.until(lambda: said[-1] == "holding")


def test_it_ends_with_a_fault_and_with_the_active_state(start: Start, peer: Peer) -> None:
    start("controller", state_timeout=0.5)
    said, lifecycle = words(peer), Lifecycle(peer, "controller")
    peer.wait("the first word", lambda: said == ["released"])
    drive = LockstepDrive(peer).matched()
    peer.wait("the fault", lambda: said[-1] == "released")  # the drive is silent now
    peer.call(Trigger, "controller/reset_fault", Trigger.Request())
    drive.until(lambda: said[-1] == "holding")
    assert lifecycle.change(Transition.TRANSITION_DEACTIVATE)
    peer.wait("the last word", lambda: said[-1] == "released")
