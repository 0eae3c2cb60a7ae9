"""What the filter is given, what it remembers from sample to sample, and what it leaves for each sample."""

import math
from typing import NamedTuple

from backlash_ros.drivetrain.contact import Constants
from backlash_ros.foundation.record import Array, Record, cells, part, size_of, view_of
from backlash_ros.identification.fitting.parameters import PARAMETERS, Parameters


class Steps(NamedTuple):
    """Steps between two samples: the ``longest`` and the ``shortest`` on stiff teeth, s.

    ``swing`` is the largest phase of the swing on the teeth in one step, rad, and change of their torque, a share.
    """

    longest: float
    shortest: float
    swing: float


FINE = Steps(longest=5e-4, shortest=2e-5, swing=0.25)
"""Steps to trust."""
COARSE = Steps(longest=2e-3, shortest=1e-4, swing=1.0)
"""Steps to look around with much noise: they take a third of the time."""


class MotorSide(NamedTuple):
    """The motor as seen at the output, by its data sheet.

    ``rate`` is R/L (1/s; infinite where a current is commanded); ``gain`` N m at standstill for each V or A, and
    ``braking`` N m s/rad by the back-EMF.
    """

    inertia: float
    viscous: float
    rate: float
    gain: float
    braking: float


class Noise(NamedTuple):
    """Variances: of the readings, rad^2; of both speeds for each second, rad^2/s^3; of the share of the teeth's torque.

    The last is for 1 ms. ``timing``: of the time of both readings of a sample, s^2.
    """

    motor_reading: float
    load_reading: float
    motor_speed: float
    load_speed: float
    teeth: float
    timing: float


class Teeth(NamedTuple):
    """A contact law's constants, and its ``depth``: see `Candidate`."""

    constants: Constants
    depth: float


class Model(Record):
    """The drive by the parameters, at the output: see `Parameters` and the equations of `filter`."""

    half_gap: float = 0.0  # rad, at the load's start
    offset: float = 0.0  # rad
    gap_slope: float = 0.0  # 1/rad
    stiffness: float = 0.0  # of the teeth: see `Shape`
    damping: float = 0.0
    rebound: float = 0.0
    exponent: float = 0.0
    depth: float = 0.0
    inertia: float = 0.0  # of the load, kg m^2
    viscous: float = 0.0  # of the load, N m s/rad
    load_coulomb: float = 0.0  # N m
    load_torque: float = 0.0  # N m
    load_torque_slope: float = 0.0  # N m/rad
    motor_coulomb: float = 0.0  # N m
    gear_loss: float = 0.0
    scale: float = 0.0  # of the load's encoder
    delay: float = 0.0  # s
    gain: float = 0.0  # of the motor, N m for each V or A
    braking: float = 0.0  # N m s/rad
    dead_band: float = 0.0  # of the amplifier, V or A
    per_inertia: float = 0.0  # of both shafts against each other, 1/(kg m^2)


class Given(NamedTuple):
    """What else stays the same in one pass of the filter."""

    side: MotorSide
    constants: Constants
    noise: Noise
    steps: Steps


class State(Record):
    """The motion at the output."""

    motor_angle: float = 0.0  # rad
    motor_speed: float = 0.0  # rad/s
    drive_torque: float = 0.0  # N m
    load_angle: float = 0.0  # rad
    load_speed: float = 0.0  # rad/s


COUNT = size_of(State)
"""Number of states."""
WIDE = 4 * math.ceil((COUNT + PARAMETERS) / 4)
"""Columns of a row of `Rows`: they are processed four at a time."""


class Columns(Record):
    """What one row of `Rows` consists of: a covariance with each state, then a derivative by each parameter."""

    state: State = part(State)
    parameter: Parameters = part(Parameters)


class Rows(Record):
    """A row for each state, each of the `Columns`.

    They follow each other at distances known to the compiler, so that it sees that the columns are independent.
    """

    motor_angle: Array = cells(WIDE)
    motor_speed: Array = cells(WIDE)
    drive_torque: Array = cells(WIDE)
    load_angle: Array = cells(WIDE)
    load_speed: Array = cells(WIDE)


class Forcing(Record):
    """What else acts in a step, by the `Columns`: the torque on both shafts, and on the drive torque's end, N m."""

    on_motor: Array = cells(WIDE)
    on_load: Array = cells(WIDE)
    on_drive: Array = cells(WIDE)


class Memory(Record):
    """What one pass of the filter works with."""

    model: Model = part(Model)
    state: State = part(State)
    rows: Rows = part(Rows)
    forcing: Forcing = part(Forcing)
    no_forcing: Forcing = part(Forcing)
    first: Array = cells(WIDE)  # the motor angle's row before its reading corrected it
    second: Array = cells(WIDE)  # the reading of the load by the `Columns`
    gain: State = part(State)  # of the motor's reading
    load_gain: State = part(State)  # of the load's reading
    start: float = 0.0  # first reading of the load, rad
    command: float = 0.0  # number of the command that acts
    half_gap: float = 0.0  # at the newest step, rad
    twist: float = 0.0  # from the middle of the gap at the newest step, rad
    least_torque: float = 0.0  # of the teeth since the previous sample, N m
    largest_torque: float = 0.0


class Trace(Record):
    """The state after a sample, and the torques of the teeth since the previous one, N m."""

    state: State = part(State)
    least_torque: float = 0.0
    largest_torque: float = 0.0


STATES = size_of(Trace)
MEMORY = size_of(Memory)
columns_at, memory_at, trace_at = view_of(Columns), view_of(Memory), view_of(Trace)


class Motion(NamedTuple):
    """The motion in a recording, shapes (N,): see `State`."""

    motor_angle: Array
    motor_speed: Array
    drive_torque: Array
    load_angle: Array
    load_speed: Array


def motion_of(states: Array) -> Motion:
    """Return the motion by name from states, shape (N, `STATES`)."""
    return Motion(*states[:, :COUNT].T)


class Results(NamedTuple):
    """What a pass fills in, for each of N samples; what has no reading stays as it is.

    ``innovations`` divided by their standard deviation, shape (N, 2); their ``derivatives``, shape (N, 2,
    `PARAMETERS`); ``logs`` of their variances, shape (N, 2); ``states``, shape (N, `STATES`), each a `Trace`: speeds
    and torque of the first one are those to start from.
    """

    innovations: Array
    derivatives: Array
    logs: Array
    states: Array
