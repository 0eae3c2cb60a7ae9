"""A law for drives with both encoders: it plans the position of the teeth, so that they neither strike nor rattle.

The motor is controlled on its own encoder alone, so no gap makes the loop unstable. The load's angle only serves the
plans. While the gap is unknown, the drive not identified or an encoder missing, the over-damped gains act: slower, and
quiet with any load. The files:

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
"""

from backlash_ros.control.law import NamedLaw
from backlash_ros.control.laws.two_encoder.design import two_encoder
from backlash_ros.control.laws.two_encoder.parameters import TwoEncoderParameters

__all__ = ["LAWS", "TwoEncoderParameters"]

LAWS = {
    "two_encoder": NamedLaw(
        "planned for two encoders",
        two_encoder,
        TwoEncoderParameters(),
        both_encoders=True,
        one_encoder=True,
        identified=True,
    )
}
