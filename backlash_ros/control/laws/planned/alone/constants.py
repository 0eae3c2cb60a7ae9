"""What the law knows with one encoder alone, beside the constants of the plans."""

from backlash_ros.control.laws.planned.constants import TABLE_SIZE, Constants
from backlash_ros.foundation.record import Array, Record, cells, part, view_of


class AloneConstants(Record):
    """The constants of the plans, and the model of both shafts in steps that are parts of a period."""

    plans: Constants = part(Constants)
    sees_load: float  # 1 if the load's encoder is there, 0 if the motor's is
    steps: float  # so many in a period
    step: float  # s, the length of each
    torque_per_command: float  # N m at standstill, for each V or A
    braking: float  # N m s/rad, by the back-EMF of a winding that the command feeds with a voltage
    decay: float  # of the winding's current in a step; 0 where the current is imposed
    teeth_dampings: Array = cells(TABLE_SIZE)  # N m s/rad, of teeth that carry the torques of the table
    first_power: float  # with which the torque grows with the distance below the table


alone_constants_at = view_of(AloneConstants)
