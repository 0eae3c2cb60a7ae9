"""What the state of any drive says, with effects or without: the force of its teeth, its energy, and its gap."""

from collections.abc import Callable

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.effects.equations import real_equations
from backlash_ros.drivetrain.motion.dynamics import equations_of
from backlash_ros.drivetrain.motion.integrator import whole_state
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.record import Array

View = Callable[[PlantConstants, Array, Array], float]
"""Takes the drive's constants, its state, shape (7,), and the integrator's memory."""


def force_view(drive: Drive) -> View:
    """Return what tells the force of the teeth on the load, N."""
    if not drive.effects.acts:
        contact_of = equations_of(drive).contact_of
        return lambda plant, state, _memory: float(contact_of(plant, state)[0])
    real_contact = real_equations(type(drive.gear.contact)).contact_of  # type: ignore[arg-type]
    return lambda plant, state, memory: float(real_contact(plant, whole_state(plant, state, memory))[0])


def energy_view(drive: Drive) -> View:
    """Return what tells the energy stored, J: kinetic, magnetic, elastic and potential."""
    if not drive.effects.acts:
        energy_of = equations_of(drive).stored_energy
        return lambda plant, state, _memory: float(energy_of(plant, state))
    real_energy = real_equations(type(drive.gear.contact)).stored_energy  # type: ignore[arg-type]
    return lambda plant, state, memory: float(real_energy(plant, whole_state(plant, state, memory)))
