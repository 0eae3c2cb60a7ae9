"""The law of planned moves: it plans the position of the teeth, so that they neither strike nor rattle.

The motor is controlled on its own encoder alone, so no gap makes the loop unstable. The load's angle only serves the
plans. With one encoder alone, a model of both shafts gives what the other would read. While the gap is unknown or the
drive not identified, the over-damped gains act: slower, and quiet with any load. The files:

    step                  one step; start: the first step, and a take-over from another law
    motor, load           their observers; readings: which readings are believed
    middle, load_torque   what else is estimated
    phases                flight, hold or follow; take_off: start the move that was chosen
    flight                which move takes the load to its target
    throw, press, carry   the moves; moves: what they share
    plan                  the segments of a move, what they say of a time, and the motor's motion along them
    hold, parking         a load at its target
    follow                with a reference that moves; reference: where it goes and what torque that needs;
                          crossing: when the motor changes flanks, and where it is meanwhile;
                          drag: what motion costs beyond the model
    command               from the wanted motion of the motor to the voltage
    constants, memory     all numbers by name; teeth: where they carry a torque
    design, parameters    from a drive and the user's choice to the constants; unit: in which the law counts times
    alone                 all that differs with one encoder
"""

from backlash_ros.control.law import NamedLaw
from backlash_ros.control.laws.planned.design import planned
from backlash_ros.control.laws.planned.parameters import PlannedParameters

__all__ = ["LAWS", "PlannedParameters"]

LAWS = {
    "planned": NamedLaw(
        "planned moves",
        planned,
        PlannedParameters(),
        both_encoders=True,
        one_encoder=True,
        identified=True,
    )
}
