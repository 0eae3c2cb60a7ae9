"""The layout of the law's two arrays, its constants and its state.

All values are at the output: p = n theta_m is the motor's angle there, w its speed, g = p - theta_l minus the middle of
the gap. A torque is positive if it turns the load forward. A flank is 1 if the motor's teeth drive the load forward and
-1 if they hold it back.
"""

# fmt: off
(
    PERIOD,  # s
    DELAY, WHOLE,  # from measuring to acting, s; whole periods of it
    RATIO,  # n
    MOTOR_INERTIA, MOTOR_FRICTION, MOTOR_COULOMB,  # J_m/n^2, B_m/n^2, and its dry friction: kg m^2, N m s/rad, N m
    INERTIA, FRICTION, COULOMB,  # of the load: J_l, B_l, tau_c
    GAP,  # b, rad
    STALL, NO_LOAD,  # torque at standstill, N m, and speed without load, rad/s, of the motor
    VOLTS_PER_TORQUE, VOLTS_PER_SPEED, BACK_EMF, RESISTANCE,  # the last two: 0 and 1 where the command is the voltage
    ELECTRICAL,  # L/R, s
    STIFFNESS, DAMPING,  # of the motor's loop, N m/rad and N m s/rad
    TRUST,  # how far the disturbance that acts follows the one that is seen, each period
    CROSSING, PUSH, BRAKE,  # s
    EXPECTED, EXPECTED_SINE, EXPECTED_COSINE,  # the load torque as expected: constant, and with the load's angle, N m
    MOTOR_UNEXPLAINED, LOAD_UNEXPLAINED,  # torques, N m
    CLEAR,  # abs(g) within which the teeth do not push a load that is free, rad
) = range(30)

GAIN = 30
"""Four gains of the motor's observer."""
AFTER, BEFORE = 34, 58
"""Two models of the motor, 4 x 6, over the part of a period after a command begins to act, and over the part before:
p, w, torque of the current and disturbance, from these, the command and the torque of the teeth."""
TEETH, POINTS = 82, 16
"""Torques that the teeth carry, N m, then where they do, as g, rad."""
CONSTANTS = TEETH + 2 * POINTS

(
    REGION, PHASE, FLANK, STARTED,
    TARGET,  # rad
    MIDDLE,  # of the gap: p - theta_l there, rad
    MOTOR, SPEED, CURRENT_TORQUE, DISTURBANCE,  # as observed at the sample
    ACTING,  # disturbance that is compensated, N m
    LOAD, LOAD_SPEED, LAST_LOAD, LAST_WAY,  # as observed; its last reading and that less the one before
    STEP, ROUGH, COUNT,  # least step of the readings, their mean second difference, the count that both come to, rad
    PULL, PULL_SLOW,  # load torque, N m; a slow look at it
    CONSTANT, SINE, COSINE,  # it in plans: constant, and with the load's angle, N m
    TOLD_SINE, TOLD_COSINE,  # what was expected when these were taken, N m
    SEEN, WEIGHED, SEEN_TIME,  # of what a flight shows beyond that, and of the other part, N m s; the time, s
    TIME, SEGMENTS, REST_TORQUE,  # of the plan: s, how many, N m
    WAITED, TRIES, SIDE, SIDE_TIME, SHARE, LAST_ERROR, HELD,  # of holding
    PLACE, FROM, PARKED,  # where the motor is to be, and where and for how long it goes to the middle
    STEPPED,  # g that follows a setpoint in motion
    LAST_MOTOR,  # the motor's last reading, rad
    DOUBTED, _, LOAD_DOUBTED, _,  # how many readings in a row cannot be, and what the first of them missed, rad
    MOMENTUM,  # of both shafts, N m s
    ASTRAY,  # how many readings in a row the load was beyond where it is at rest, with the sign of the side
    LANDED,  # time in hold, s
    SHAKEN,  # speed of the load, the largest lately, rad/s
) = range(51)

COMMANDS, CARRIED, KEPT = 51, 63, 12
"""Commands, the newest first, and what the teeth were to carry meanwhile, N m."""
PLAN, ROWS, COLUMNS = 75, 6, 12
"""Segments of the plan: see `plan`."""
MEMORY = PLAN + ROWS * COLUMNS

FLIGHT, HOLD, FOLLOW = 1.0, 2.0, 3.0
"""Phases: a planned move; near the target; behind a setpoint that moves."""
PHASES = {1: "flight", 2: "hold", 3: "follow"}
# fmt: on
