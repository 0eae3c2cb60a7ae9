"""The law's constants: the drive, the design of the loops and the settings, by name.

All values are at the output, unless said otherwise. There p = n theta_m is the motor's angle and w its speed. Each s in
a unit is the law's unit of time, a second for usual drives: see `unit`.
"""

from collections.abc import Sequence

from backlash_ros.foundation.record import Array, Record, cells, part, parts, view_of

TABLE_SIZE = 16
"""Number of torques in the table of the teeth."""
GAINS = 8
"""Number of gains of the motor's observer, each for readings that err by twice as much as for the one before."""
FINEST_ERROR = 4.5e-5
"""Error of the readings at the output, rad, for the first of them: about a count of 14 bit before a gear of 10:1."""


class MotorModel(Record):
    """The motor over a part of a period: one row for each state that changes.

    A row has the factors of angle, speed, torque of the current, disturbance, command and torque of the teeth.
    """

    angle: Array = cells(6)
    speed: Array = cells(6)
    current_torque: Array = cells(6)


class ObserverGain(Record):
    """By how much each state of the motor's observer follows an unexpected angle: per rad."""

    angle: float = 0.0
    speed: float = 0.0
    current_torque: float = 0.0
    disturbance: float = 0.0


class Constants(Record):
    """What the law knows of the drive, and its parameters."""

    unit: float  # of time, true s
    period: float  # s
    delay: float  # s, from measuring to acting
    whole_periods: float  # in the delay
    rest_of_delay: float  # s, beyond the whole periods; 0 if there is none
    ratio: float  # n

    motor_inertia: float  # J_m/n^2, kg m^2
    motor_friction: float  # B_m/n^2, N m s/rad
    motor_dry_friction: float  # N m
    friction_rate: float  # 1/s: friction counts as at the wanted speed plus this times the error
    load_inertia: float  # J_l, kg m^2
    load_friction: float  # B_l, N m s/rad
    load_dry_friction: float  # tau_c, N m
    gap: float  # b, rad

    stall_torque: float  # N m, of the motor at standstill
    available_torque: float  # N m, the same with the largest command that the controller sends
    no_load_speed: float  # rad/s, of the motor with that command; by the largest voltage where it is a current
    volts_per_torque: float  # V/(N m)
    volts_per_speed: float  # V s/rad
    back_emf: float  # V s/rad at the motor, true s; 0 where the command is the voltage
    resistance: float  # ohm; 1 where the command is the voltage
    electrical_time: float  # L/R, s

    stiffness: float  # K of the motor's loop, N m/rad
    damping: float  # D of the motor's loop, N m s/rad
    compensation_share: float  # by which the compensated torque follows the disturbance, each period
    crossing_time: float  # s
    push_time: float  # s
    brake_time: float  # s

    expected_load_torque: float  # N m, its constant part
    expected_sine: float  # N m, its part with the sine of the load's angle
    expected_cosine: float  # N m, its part with the cosine of the load's angle
    unexplained_motor_torque: float  # N m
    unexplained_load_torque: float  # N m
    holding_excess: float  # N m, beyond the friction, from which on a load torque holds the load

    clear_distance: float  # rad, abs(g) within which the teeth do not push a load that is free
    teeth_torques: Array = cells(TABLE_SIZE)  # N m, the table of the teeth
    teeth_distances: Array = cells(TABLE_SIZE)  # rad, abs(g) at which they carry these torques
    gains: Sequence[ObserverGain] = parts(ObserverGain, GAINS)
    after: MotorModel = part(MotorModel)  # over the part of a period after a command begins to act
    before: MotorModel = part(MotorModel)  # over the part of a period before that


constants_at = view_of(Constants)
