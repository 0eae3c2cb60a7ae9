"""What a fit varies: the parameters of the filter by name, as one row of numbers in a fixed order."""

from typing import get_type_hints

from backlash_ros.foundation.record import Array, Record, row_of, size_of, view_of


class Parameters(Record):
    """The parameters, all as seen at the output; logarithms are natural ones.

    The stiffness of a told law is a factor on its force; that law has no damping, rebound and exponent to vary.
    """

    ln_half_gap: float = 0.0  # of half the gap, rad, at the load's start
    offset: float = 0.0  # motor angle less load angle in the middle of the gap, rad
    gap_slope: float = 0.0  # relative growth of the gap with the load's angle, 1/rad
    ln_stiffness: float = 0.0  # of the teeth, N m/rad
    ln_damping: float = 0.0  # of the teeth, N m s/rad
    ln_rebound: float = 0.0  # of the teeth, s/rad
    ln_exponent: float = 0.0  # of the teeth
    ln_load_inertia: float = 0.0  # kg m^2
    ln_load_viscous: float = 0.0  # viscous friction of the load, N m s/rad
    load_coulomb: float = 0.0  # dry friction of the load, N m
    load_torque: float = 0.0  # at the load's start, N m
    load_torque_slope: float = 0.0  # its growth with the load's angle, as by a weight, N m/rad
    motor_coulomb: float = 0.0  # dry friction of the motor, N m
    gear_loss: float = 0.0  # share of the teeth's torque that the gear loses
    load_scale_error: float = 0.0  # relative scale error of the load's encoder, as by an eccentric disk
    delay: float = 0.0  # from a sample to when its command acts, s
    ln_motor_gain: float = 0.0  # relative to the motor's data sheet
    ln_motor_braking: float = 0.0  # relative to the motor's data sheet
    dead_band: float = 0.0  # what the amplifier takes from the size of every command, V or A


NAMES = tuple(get_type_hints(Parameters))
"""The parameters in their order."""
PARAMETERS = size_of(Parameters)
parameters_at = view_of(Parameters)


def place_of(name: str) -> int:
    """Return the place of a parameter in the row."""
    return NAMES.index(name)


def places_of(*names: str) -> list[int]:
    """Return the places of parameters in the row."""
    return [place_of(name) for name in names]


def parameters_of(others: float = 0.0, **values: float) -> Array:
    """Return a row with ``values`` by name, and the same number for all ``others``."""
    return row_of(Parameters, **{**dict.fromkeys(NAMES, others), **values})
