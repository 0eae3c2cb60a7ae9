"""The plant: parameters, contact, equations of motion, integrator and the rigid linear model."""

from backlash_ros.drivetrain.compiled import compiled
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.contacts import CONTACTS
from backlash_ros.drivetrain.integrator import IntegrationError
from backlash_ros.drivetrain.parameters import (
    COMMAND_INTERFACES,
    NOMINAL_DRIVE,
    Drive,
    Gear,
    Load,
    Motor,
)
from backlash_ros.drivetrain.plant import Plant
from backlash_ros.drivetrain.quantity import Quantity, Validated, quantities, quantity
from backlash_ros.drivetrain.rigid import motor_model, rigid_model
from backlash_ros.drivetrain.winding import sampled, without_inductance

__all__ = [
    "COMMAND_INTERFACES",
    "CONTACTS",
    "NOMINAL_DRIVE",
    "Contact",
    "Drive",
    "Gear",
    "IntegrationError",
    "Load",
    "Motor",
    "Plant",
    "Quantity",
    "Validated",
    "compiled",
    "motor_model",
    "quantities",
    "quantity",
    "rigid_model",
    "sampled",
    "without_inductance",
]
