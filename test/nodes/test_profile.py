"""Profiles over DDS, in lockstep: a reference that comes in flight is the same motion as offline, within its limits."""

import math
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from graph import Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from backlash_ros.control.motion.profile import MotionLimits, Profile
from backlash_ros.control.motion.setpoint import evaluate
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.foundation.signals import Setpoint

B = NOMINAL_DRIVE.gear.backlash_angle
LIMITS = MotionLimits(1.0, 10.0, 200.0)
NAMES = "setpoint", "setpoint_velocity", "setpoint_acceleration"


def test_a_reference_in_flight_goes_on_within_the_limits(start: Callable[..., Process], peer: Peer) -> None:
    drive, told = LockstepDrive(peer), list[dict[str, float]]()
    sent = peer.node.create_publisher(Float64, "reference", 10)

    def hear(message: DiagnosticArray) -> None:
        told.append({each.key: float(each.value) for each in message.status[0].values})

    peer.node.create_subscription(DiagnosticArray, "controller/state", hear, QoSProfile(depth=10_000))
    start(
        "controller",
        use_sim_time=True,
        state_timeout=10.0,
        telemetry_rate=250.0,
        backlash_angle=B,
        identified=True,
        profile__mode="limited",
        profile__velocity=LIMITS.velocity,
        profile__acceleration=LIMITS.acceleration,
        profile__jerk=LIMITS.jerk,
    )
    drive.matched()
    parameters = Parameters(peer, "controller")
    assert parameters.set(profile__jerk=0.0) == (
        False,
        "profile.jerk must be >= 1e-06 rad/s^3 with profile.mode = 'limited', got 0.0",
    )
    peer.wait("the topic", lambda: sent.get_subscription_count() > 0)
    drive.run(50)

    def refer(reference: float, count: int) -> None:
        """Send a reference until it is taken, and make so many periods."""

        def taken() -> bool:
            drive.step()
            return told[-1]["reference"] == reference

        sent.publish(Float64(data=reference))
        peer.wait("the reference to be taken", taken)
        drive.run(count)

    refer(0.6, 80)
    refer(-0.2, 400)
    samples = {int(each["samples"]): each for each in told if not math.isnan(each["elapsed"])}
    turns = [next(k for k, each in samples.items() if each["reference"] == target) for target in (0.6, -0.2)]
    first, second = turns
    seen = {k: np.array([each[name] for name in NAMES]) for k, each in samples.items()}
    plan, begins, out = Profile(Setpoint(seen[first - 1]), 0.6, LIMITS), first - 1, Setpoint(np.zeros(3))
    for k in range(first, max(seen)):
        if k == second:
            time = drive.period * (k - 1 - begins)
            plan, begins = plan.onward(Setpoint(seen[k - 1]), -0.2, time), k - 1
        evaluate(plan.rows, drive.period * (k - begins), out)
        np.testing.assert_allclose(seen[k], out, atol=1e-9)
        assert abs(samples[k]["error"]) < 0.25 * B
        assert abs(seen[k][1]) <= 1.0 + 1e-9
    assert seen[second][1] > 0.9  # it was in flight
    assert abs(drive.load_angle + 0.2) < 0.1 * B
    assert parameters.set(profile__mode="step")[0]
    refer(-0.1, 2)
    assert [told[-1][name] for name in NAMES] == [-0.1, 0.0, 0.0]
