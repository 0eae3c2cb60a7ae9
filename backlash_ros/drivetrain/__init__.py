"""The plant: parameters, contact, equations of motion, integrator and linear models."""

from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts import CONTACTS
from backlash_ros.drivetrain.effects.parameters import Effects
from backlash_ros.drivetrain.linear import (
    command_from_voltage,
    discretize,
    discretize_from_command,
    motor_model,
    rigid_model,
    without_inductance,
)
from backlash_ros.drivetrain.motion.integrator import IntegrationError
from backlash_ros.drivetrain.motion.plant import Plant
from backlash_ros.drivetrain.parameters import (
    COMMAND_INTERFACES,
    NOMINAL_DRIVE,
    Drive,
    Gear,
    Load,
    Motor,
)

__all__ = [
    "COMMAND_INTERFACES",
    "CONTACTS",
    "NOMINAL_DRIVE",
    "Contact",
    "Drive",
    "Effects",
    "Gear",
    "IntegrationError",
    "Load",
    "Motor",
    "Plant",
    "command_from_voltage",
    "discretize",
    "discretize_from_command",
    "motor_model",
    "rigid_model",
    "without_inductance",
]
