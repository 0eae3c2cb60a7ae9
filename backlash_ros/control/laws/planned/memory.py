"""The law's memory by name: one part for each thing that it estimates, plans or does.

All values are at the output: p = n theta_m is the motor's angle there, w its speed. g = p - theta_l - middle says where
in the gap the motor is. A torque is positive if it turns the load forward. A flank is 1 if the motor's teeth drive the
load forward, and -1 if they hold it back. Each s in a unit is the law's unit of time: see `unit`.
"""

from collections.abc import Sequence

from backlash_ros.control.law import FAST_REGION
from backlash_ros.foundation.record import Array, Record, cells, part, parts, view_of

FLIGHT, HOLD, FOLLOW = 1.0, 2.0, 3.0
"""Phases: a planned move; near the target; with a reference that moves."""
PHASES = {1: "flight", 2: "hold", 3: "follow"}
NO_MOVE = 0.0
"""Next move: none."""
TO_FLY = 1.0
"""Next move: a flight to the target."""
TO_SHIFT = 2.0
"""Next move: a shift of a held load."""
TO_PRESS = 3.0
"""Next move: a press of a stuck load."""
REMEMBERED = 12
"""Number of commands that are remembered: the longest delay has two less."""
DRAG_SIZE = 5
"""Number of quantities that the drag's filter estimates."""
MOST_SEGMENTS = 6
"""Most segments of a plan: approach, push, cruise, crossing, brake, and back or leave."""


class Doubt(Record):
    """The readings of an encoder that cannot be."""

    readings: float = 0.0  # so many in a row
    first_error: float = 0.0  # rad, of the first of them


class MotorState(Record):
    """What the motor's observer estimates."""

    angle: float = 0.0  # p, rad
    speed: float = 0.0  # w, rad/s
    current_torque: float = 0.0  # N m, of the current
    disturbance: float = 0.0  # N m, constant, against the motor: what the model leaves out


class Count(Record):
    """The count of an encoder, as its readings show it."""

    reading: float = 0.0  # rad, the last one that was believed
    width: float = 0.0  # rad, of which all changes so far are multiples; 0 before the first
    agreeing: float = 0.0  # so many changes in a row


class Motor(Record):
    """The motor."""

    estimated: MotorState = part(MotorState)  # at the sample
    predicted: MotorState = part(MotorState)  # when the next command begins to act
    compensation: float = 0.0  # N m, of the disturbance
    last_reading: float = 0.0  # rad
    count: Count = part(Count)
    gain: float = 0.0  # index of the observer's gain in `Constants.gains`
    doubt: Doubt = part(Doubt)


class Load(Record):
    """The load and its readings."""

    angle: float = 0.0  # rad, estimated
    speed: float = 0.0  # rad/s, estimated
    last_reading: float = 0.0  # rad
    last_change: float = 0.0  # rad, of the last two readings
    smallest_step: float = 0.0  # rad, of the readings; 0 until one is seen
    roughness: float = 0.0  # rad, mean second difference of the readings
    count: float = 0.0  # rad, of the encoder, as steps and noise show it; with one encoder, the model's doubt, too
    readings_astray: float = 0.0  # so many in a row beyond where it rests, with the sign of the side
    doubt: Doubt = part(Doubt)


class LoadTorque(Record):
    """The load torque, and what it is estimated from."""

    estimated: float = 0.0  # N m
    smoothed: float = 0.0  # N m, as the momentum shows it
    constant: float = 0.0  # N m, in plans: the constant part
    sine: float = 0.0  # N m, in plans: the part with the sine of the load's angle
    cosine: float = 0.0  # N m, in plans: the part with the cosine of the load's angle
    expected_sine: float = 0.0  # N m, that was expected when `sine` was taken
    expected_cosine: float = 0.0  # N m, that was expected when `cosine` was taken
    momentum: float = 0.0  # N m s, of both shafts
    unexplained_momentum: float = 0.0  # N m s, that a flight shows beyond the load torque of its plan
    slope_momentum: float = 0.0  # N m s, that the growth with the load's angle gave in the flight
    observed_time: float = 0.0  # s, for which the flight shows the load torque
    recent_peak_speed: float = 0.0  # rad/s, of the load


class Sent(Record):
    """What was sent to the drive, the newest first."""

    commands: Array = cells(REMEMBERED)  # V or A
    teeth_torques: Array = cells(REMEMBERED)  # N m, that the teeth were to carry meanwhile


class Segment(Record):
    """A part of a plan, in the move's own direction: the motor is in contact on a flank, or crosses the gap."""

    duration: float = 0.0  # s
    direction: float = 0.0  # of the move
    angle: float = 0.0  # rad, of the load at its start
    speed: float = 0.0  # rad/s, of the load at its start
    first_acceleration: float = 0.0  # rad/s^2, of the straight line at its start
    last_acceleration: float = 0.0  # rad/s^2, of the straight line at its end
    bump: float = 0.0  # rad/s^2, mean acceleration of the bump on that line
    ends_softly: float = 0.0  # 1 if the bump does
    flank: float = 0.0  # of a contact; 0 if the motor crosses
    crosses_from: float = 0.0  # rad, g
    crosses_to: float = 0.0  # rad, g
    closing_speed: float = 0.0  # rad/s, of g at the start of a crossing


class Move(Record):
    """The move that is planned, in its own direction. A resistance is the torque that brakes the load at any speed."""

    direction: float = 0.0  # 1 or -1
    target: float = 0.0  # rad
    angle: float = 0.0  # rad, of the load
    speed: float = 0.0  # rad/s, of the load
    deceleration: float = 0.0  # rad/s^2, of the load before it is touched
    gap_position: float = 0.0  # g, rad
    closing_speed: float = 0.0  # rad/s, of g
    holding_torque: float = 0.0  # N m, the load torque if it holds the load at the start, else 0
    first_resistance: float = 0.0  # N m, at the start
    crossing_resistance: float = 0.0  # N m, where the motor crosses
    last_resistance: float = 0.0  # N m, at the target


class Throw(Record):
    """How the load is thrown, from where it is touched."""

    angle: float = 0.0  # rad, of the load where it is touched
    touch_speed: float = 0.0  # rad/s, of the load there
    moves: float = 0.0  # 1 if the load moves as the plan begins
    adapts: float = 0.0  # 1 if the resistance while the motor crosses is taken where it does
    speed: float = 0.0  # rad/s, after the push
    approach_time: float = 0.0  # s
    push_time: float = 0.0  # s
    cruise_time: float = 0.0  # s
    brake_time: float = 0.0  # s
    back_time: float = 0.0  # s, in which the motor crosses again; 0 if it does not


class Plan(Record):
    """The plan that is flown."""

    time: float = 0.0  # s, since its start
    rest_torque: float = 0.0  # N m, of the teeth at its end; positive forward, whatever the direction of the move
    segment_count: float = 0.0
    segments: Sequence[Segment] = parts(Segment, MOST_SEGMENTS)
    move: Move = part(Move)
    throw: Throw = part(Throw)


class Hold(Record):
    """How the load is held at its target."""

    time_since_landing: float = 0.0  # s, in hold
    waiting_time: float = 0.0  # s, since hold or its kind began; of a load that is not held, since parking ended, too
    attempts: float = 0.0  # to move the load
    error_share: float = 0.0  # of the error that a shift or a press takes
    last_error: float = 0.0  # rad, of a shift or a press
    leading_flank: float = 0.0  # that leads a free load in; 0 if none does
    leading_time: float = 0.0  # s, since that flank was chosen
    parking_time: float = -1.0  # s, since the load was parked; -1 if it is not
    parked_from: float = 0.0  # rad, where the motor was then


class Crossing(Record):
    """The motor's way through the gap while it follows a reference in motion."""

    starts: float = 0.0  # periods from the sample on; negative once it has begun
    duration: float = 0.0  # s
    flank: float = 0.0  # to which it goes; 0: to the middle of the gap
    begin: float = 0.0  # rad, g
    speed: float = 0.0  # rad/s, of g at its begin
    end: float = 0.0  # rad, g


class Learned(Record):
    """What following has shown of a flank."""

    seat: float = 0.0  # rad, error of g on the flank
    seat_time: float = 0.0  # s, for which that was learned


class Drag(Record):
    """What motion costs beyond the model, positive against forward motion; learned from the momentum of both shafts."""

    load: float = 0.0  # N m, in both directions: a load torque
    friction: float = 0.0  # N m, against each direction
    sine: float = 0.0  # N m, in both directions: a weight's, times the sine of the way from the origin
    cosine: float = 0.0  # N m, likewise, times 1 less the cosine
    origin: float = 0.0  # rad, angle of the load where it began
    runs: float = 0.0  # 1 while it is learned
    effort: float = 0.0  # N m, the largest that an acceleration took lately
    momentum: float = 0.0  # N m s, estimated
    covariance: Array = cells(DRAG_SIZE, DRAG_SIZE)  # of momentum, load, friction, sine and cosine


class Follow(Record):
    """How a reference in motion is followed."""

    flank: float = 0.0  # on which the teeth are; 0 if they are apart
    crosses: float = 0.0  # 1 while the motor crosses the gap
    crossing: Crossing = part(Crossing)
    time_on_flank: float = 0.0  # s
    time_fallen: float = 0.0  # s, for which the load has been on the other one
    doubt: float = 0.0  # N m, below which a change of the needed torque's sign is not believed
    side: float = 0.0  # of the gap, on which the motor was last
    beats: float = 0.0  # how often it went to the other one lately, though it was not to cross
    direction: float = 0.0  # of the motion, the last one there was
    drag: Drag = part(Drag)
    forward: Learned = part(Learned)
    backward: Learned = part(Learned)


class Memory(Record):
    """All that the law remembers."""

    region: float = float(FAST_REGION)  # the law has one only
    phase: float = 0.0
    flank: float = 0.0
    started: float = 0.0  # 1 from the first step on
    target: float = 0.0  # rad
    next_move: float = NO_MOVE  # that is to be planned now
    next_target: float = 0.0  # rad, of a shift or a press
    motor_target: float = 0.0  # rad, where the motor is to be
    middle: float = 0.0  # rad, p - theta_l in the middle of the gap
    held: float = 0.0  # 1 if a load torque holds the load on a flank
    motor: Motor = part(Motor)
    load: Load = part(Load)
    load_torque: LoadTorque = part(LoadTorque)
    sent: Sent = part(Sent)
    plan: Plan = part(Plan)
    hold: Hold = part(Hold)
    follow: Follow = part(Follow)


memory_at = view_of(Memory)
