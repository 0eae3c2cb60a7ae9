"""The faults: stable names and numbers, and in one table what each means and what to do about it."""

from enum import IntEnum
from typing import NamedTuple


class Fault(IntEnum):
    """Faults that latch: the motor gets 0 until a reset. Names and numbers are stable: bags and pages store them."""

    NONE = 0
    # Found by the tick in a sample.
    MOTOR_JUMP = 1
    LOAD_JUMP = 2
    MOTOR_OVERSPEED = 3
    LOAD_OVERSPEED = 4
    ENCODERS_DISAGREE = 5
    UNEXPLAINED_TORQUE = 6
    LOWER_END = 7
    UPPER_END = 8
    NOT_FINITE = 9
    MOTOR_SPEED = 10
    LOAD_SPEED = 11
    MOTOR_CURRENT = 12
    RATE = 13
    TRACKING = 14
    # Found by the controller's gate between samples.
    NO_SAMPLES = 20
    SECOND_DRIVE = 21
    JOINTS_APART = 22
    # Found by the drive's gate between commands.
    NO_COMMANDS = 30
    BAD_COMMAND = 31
    SECOND_CONTROLLER = 32
    # Found by the simulator in its plant.
    CANNOT_SIMULATE = 40


class Meaning(NamedTuple):
    """What a fault means and what to do about it, in one sentence each."""

    meaning: str
    remedy: str


FAULTS = {
    Fault.MOTOR_JUMP: Meaning(
        "The motor's encoder moved further between two samples than the motor can.",
        "If its position begins again, publish it continuously or set motor_wrap; else look at its cable and counts.",
    ),
    Fault.LOAD_JUMP: Meaning(
        "The load's encoder moved further between two samples than the load can.",
        "If its position begins again, publish it continuously or set load_wrap; else look at its cable and counts.",
    ),
    Fault.MOTOR_OVERSPEED: Meaning(
        "The motor turns faster than faults.velocity allows.", "Look for what drives it, or raise faults.velocity."
    ),
    Fault.LOAD_OVERSPEED: Meaning(
        "The load turns faster than faults.velocity allows.", "Look for what drives it, or raise faults.velocity."
    ),
    Fault.ENCODERS_DISAGREE: Meaning(
        "The two shafts moved apart by more than the gear's backlash and wind-up allow.",
        "Look at both encoders and the gear; check gear.reduction and backlash_angle.",
    ),
    Fault.UNEXPLAINED_TORQUE: Meaning(
        "The drive does not move as its command should make it.",
        "Look for a blocked load and a motor without power; check the signs of encoders and command.",
    ),
    Fault.LOWER_END: Meaning("The load is too far beyond the lower end of its travel.", "Bring it back by hand."),
    Fault.UPPER_END: Meaning("The load is too far beyond the upper end of its travel.", "Bring it back by hand."),
    Fault.NOT_FINITE: Meaning("The samples give no finite command.", "Look at what the drive publishes."),
    Fault.MOTOR_SPEED: Meaning(
        "The motor's speed contradicts its encoder.", "Check unit (rad/s) and sign of the velocity, and rate."
    ),
    Fault.LOAD_SPEED: Meaning(
        "The load's speed contradicts its encoder.", "Check unit (rad/s) and sign of the velocity, and rate."
    ),
    Fault.MOTOR_CURRENT: Meaning(
        "The command cannot cause the motor's effort.",
        "Check unit (N m at the motor's shaft) and sign of the effort, and motor.torque_constant.",
    ),
    Fault.RATE: Meaning(
        "Samples do not come at the rate that the controller was given.", "Set rate to the drive's rate."
    ),
    Fault.TRACKING: Meaning(
        "The load leaves its reference: the distance grew by more than faults.tracking within a second.",
        "Look for what pushes the load; check gains, signs and units; for a law with plans learn and identify again.",
    ),
    Fault.NO_SAMPLES: Meaning(
        "No usable joint states came for state_timeout.", "Look at the drive and at the network; see messages_dropped."
    ),
    Fault.SECOND_DRIVE: Meaning(
        "Two publishers send joint states with the same joint names, or the stamps of one drive stand still.",
        "Stop one, or give it its own namespace or joint names; look at the stamps.",
    ),
    Fault.JOINTS_APART: Meaning(
        "Motor and load come in separate messages that cannot be put together.",
        "Send both in one message, or give both the stamp of one measurement.",
    ),
    Fault.NO_COMMANDS: Meaning(
        "No usable command came for command_timeout while the motor had power.", "Look at the controller."
    ),
    Fault.BAD_COMMAND: Meaning("A command was not a finite number.", "Find out who publishes commands."),
    Fault.SECOND_CONTROLLER: Meaning(
        "Two controllers, or a controller and another publisher, command the drive.", "Stop all but one."
    ),
    Fault.CANNOT_SIMULATE: Meaning(
        "The equations of the simulated drive cannot be solved for its load torque.", "Give a smaller load torque."
    ),
}
"""Every fault except NONE."""
