"""Zero and homing on the live controller: the load does not move, positions count anew, and a restart knows them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from graph import Parameters, Peer, Process
from lockstep_drive import LockstepDrive
from std_msgs.msg import Bool, Float64

from backlash_ros.drivetrain import NOMINAL_DRIVE, Effects
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.simulation import SimulatedDrive

Start = Callable[..., Process]
B = NOMINAL_DRIVE.gear.backlash_angle
KNOWN = {"state_timeout": 10.0, "backlash_angle": B, "identified": True}
HOME = {
    "limits__position_lower": 0.0,
    "limits__position_upper": 1.0,
    "homing__speed": -0.5,
    "homing__back_off": 0.05,
}
SLOW = {
    "profile__mode": "limited",
    "profile__velocity": 0.25,
    "profile__acceleration": 5.0,
    "profile__jerk": 100.0,
}
STOP = -0.3


def answered(drive: LockstepDrive, service: str) -> tuple[bool, str]:
    answer = drive.call(service)
    return answer.success, answer.message


def goes(drive: LockstepDrive, reference: float, reading: float) -> bool:
    """Send a reference; return whether the load comes to rest where its encoder reads ``reading``, rad."""
    drive._reference.publish(Float64(data=reference))
    return any(max(abs(drive.run(50) - reading)) < 0.5 * B for _ in range(60))


def with_stop(peer: Peer) -> LockstepDrive:
    real = replace(NOMINAL_DRIVE, effects=Effects(stop_lower=STOP))
    simulated = SimulatedDrive(real, 0.004, sensors=Sensors(measured=POSITIONS))
    return LockstepDrive(peer, simulated=simulated).matched()


def test_set_zero_moves_nothing_and_a_restart_knows_it(start: Start, peer: Peer, tmp_path: Path) -> None:
    file = tmp_path / "estimates.yaml"
    kept = {"learning__estimate_file": file, "learning__use_estimate_file": True, **KNOWN}
    process = start("controller", limits__position_lower=-1.0, limits__position_upper=1.0, **SLOW, **kept)
    drive, parameters = LockstepDrive(peer).matched(), Parameters(peer, "controller")
    drive._reference.publish(Float64(data=0.5))
    drive.until(lambda: drive.load_angle > 0.01)
    assert answered(drive, "set_zero")[1].startswith("cannot set the zero: the zero must not change while the load")
    drive.run(800)
    before = drive.load_angle
    assert parameters.set(zero=-2.0)[1].startswith("with zero = -2 rad the load is at 2.")
    success, told = answered(drive, "set_zero")
    assert success, told
    (zero,) = parameters.get("zero")
    assert abs(zero - before) < 1e-4
    assert told == f"zero = {zero:.6g} rad, by set_zero, from where the load is"
    assert max(abs(drive.run(200) - before)) < 1e-4
    assert goes(drive, 0.9, zero + 0.9)
    assert process.stop() == 0

    start("controller", **kept)
    again = LockstepDrive(peer)
    again.plant = drive.plant
    again.matched()
    assert Parameters(peer, "controller").get("zero") == [zero]
    assert goes(again, 0.0, zero)


def test_home_finds_the_stop_and_positions_count_from_it(start: Start, peer: Peer) -> None:
    """With ends of the travel that it is outside of before, as it counts then."""
    process = start("controller", **HOME, **KNOWN)
    drive, parameters = with_stop(peer), Parameters(peer, "controller")
    drive.run(50)
    assert answered(drive, "home") == (
        False,
        "cannot home: homing.way must be > homing.back_off = 0.05 rad, got 0",
    )
    assert parameters.set(homing__way=1.0)[0]
    success, told = answered(drive, "home")
    assert success, told
    assert told.endswith("the next start does not know it, since learning.use_estimate_file is false")
    assert "homing" in process.output()
    (zero,) = parameters.get("zero")
    assert abs(zero - STOP) < 0.002
    assert goes(drive, 0.8, STOP + 0.8)


def test_home_goes_on_until_the_switch_closes(start: Start, peer: Peer) -> None:
    start("controller", homing__switch=True, homing__way=1.0, homing__position=0.1, **HOME, **KNOWN)
    drive, parameters = with_stop(peer), Parameters(peer, "controller")
    switch = peer.node.create_publisher(Bool, "home_switch", 10)
    peer.wait("the topic", lambda: switch.get_subscription_count() > 0)
    drive.run(50)
    assert answered(drive, "home") == (False, "cannot home: home_switch has not said anything")

    def says(closed: bool) -> None:
        switch.publish(Bool(data=closed))
        drive.run(20)

    says(True)
    assert answered(drive, "home") == (False, "cannot home: home_switch is closed: move the load off it")
    says(False)
    answer = peer.request("home")
    drive.until(lambda: drive.load_angle < -0.15)
    drive.run(3)  # the median of the last three readings is beyond it, too
    says(True)
    closed_after = drive.load_angle
    drive.until(answer.done)
    assert answer.result().success, answer.result().message
    (zero,) = parameters.get("zero")
    assert closed_after < zero + 0.1 <= -0.15


def test_a_switch_that_closes_between_the_request_and_the_next_sample_ends_home(start: Start, peer: Peer) -> None:
    start("controller", homing__switch=True, homing__way=1.0, **HOME, **KNOWN)
    drive, parameters = with_stop(peer), Parameters(peer, "controller")
    switch = peer.node.create_publisher(Bool, "home_switch", 10)
    peer.wait("the topic", lambda: switch.get_subscription_count() > 0)
    drive.run(50)
    switch.publish(Bool(data=False))
    drive.run(20)
    answers = [peer.request("home"), peer.request("home")]
    peer.wait("a refusal: the other one waits for a sample", lambda: any(answer.done() for answer in answers))
    (answer,) = [answer for answer in answers if not answer.done()]
    switch.publish(Bool(data=True))
    parameters.get("zero")  # gives the message its time; one that comes later ends the homing just as well
    drive.until(answer.done)
    assert answer.result().success, answer.result().message
    assert drive.load_angle > -0.05
