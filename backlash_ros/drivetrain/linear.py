"""Linear models of the drive, continuous and discrete, for designing gains and judging loops.

Continuous models take the winding's voltage V, and the current is their last state. Under the voltage interface the
drive holds the voltage of each sample. Under the current interface the drive's own loop imposes the current, which the
controller computes for a winding without inductance, i = (V - K_m omega_m)/R, from the speed of the sample.
`discretize` gives the model from sample to sample for either interface.
"""

import numpy as np
from scipy.linalg import expm

from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.record import Array

_WHOLE = 1e-9
"""A delay this close to a whole number of periods counts as whole, in periods."""


def rigid_model(drive: Drive) -> tuple[Array, Array]:
    """Return the matrices (A, B) of eq 9, the drive without backlash.

    States: theta_l (rad), omega_l (rad/s), i (A). Inputs: voltage (V), load torque tau_l (N m). In print the
    second input is tau_m with 1/J; by eq 4 it is the load torque with 1/J_e, which is what stands here.

    Returns
    -------
    (A, B) : arrays of shape (3, 3) and (3, 2)
    """
    motor, n = drive.motor, drive.gear.ratio
    inertia, friction = drive.effective_inertia, drive.effective_friction
    a = np.array(
        [
            [0.0, 1.0, 0.0],
            [0.0, -friction / inertia, motor.torque_constant / (n * inertia)],
            [0.0, -motor.torque_constant / (n * motor.inductance), -motor.resistance / motor.inductance],
        ]
    )
    b = np.array([[0.0, 0.0], [0.0, 1.0 / inertia], [1.0 / motor.inductance, 0.0]])
    return a, b


def motor_model(drive: Drive) -> tuple[Array, Array]:
    """Return the matrices (A, B) of the motor alone, as it turns inside the gap (eqs 7, 8 with F = 0).

    States: omega_m (rad/s), i (A). Input: voltage (V).

    Returns
    -------
    (A, B) : arrays of shape (2, 2) and (2, 1)
    """
    motor = drive.motor
    a = np.array(
        [
            [-motor.viscous_friction / motor.inertia, motor.torque_constant / motor.inertia],
            [-motor.torque_constant / motor.inductance, -motor.resistance / motor.inductance],
        ]
    )
    return a, np.array([[0.0], [1.0 / motor.inductance]])


def _settled_current(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rows that give the current for L di/dt = 0, from the other states and from the voltage."""
    return a[-1:, :-1] / -a[-1, -1], b[-1:] / -a[-1, -1]


def without_inductance(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the model in the limit L -> 0, where the current is not a state.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts

    Returns
    -------
    (A, B) : shape (N - 1, N - 1) and (N - 1, 1)
    """
    from_states, from_voltage = _settled_current(a, b)
    per_ampere = a[:-1, -1:]
    return a[:-1, :-1] + per_ampere @ from_states, per_ampere @ from_voltage


def command_from_voltage(drive: Drive, a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rows (F, G) that turn the law's voltage into the drive's command, u = F x + G V.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts

    Returns
    -------
    (F, G) : shape (1, N) and (1, 1); 0 and 1 under the voltage interface
    """
    if not drive.takes_current:
        return np.zeros((1, len(a))), np.eye(1)
    from_states, from_voltage = _settled_current(a, b)
    return np.hstack([from_states, np.zeros((1, 1))]), from_voltage


def _zero_order_hold(a: Array, b: Array, seconds: float) -> tuple[Array, Array]:
    """Return the matrices of d/dt x = a x + b u over ``seconds`` in which u is constant."""
    states, inputs = b.shape
    flow = expm(seconds * np.vstack([np.hstack([a, b]), np.zeros((inputs, states + inputs))]))
    return flow[:states, :states], flow[:states, states:]


def discretize_from_command(drive: Drive, a: Array, b: Array, period: float, delay: float = 0.0) -> tuple[Array, Array]:
    """Return the model from sample to sample whose input is the drive's command u, V or A, which acts with a delay.

    The command of sample k acts from ``k period + delay`` on, until the next one does. A delay of m whole periods and a
    remainder splits each period in two: u(k - m - 1) acts first, then u(k - m). The commands in transit are states.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts
    period : of the samples, s
    delay : from the instant of a measurement to that at which its command acts, s, >= 0

    Returns
    -------
    (A, B) : shape (N + D, N + D) and (N + D, 1), D the delay in periods, rounded up. States: those of the continuous
        model at the instant of the sample, before a new command acts, then u(k - 1) to u(k - D)

    Notes
    -----
    The exact solution, no approximation of the delay (Astrom & Wittenmark, Computer-Controlled Systems, sect. 2.3).
    """
    whole = int(delay / period + _WHOLE)
    rest = delay - whole * period
    if rest <= _WHOLE * period:
        rest = 0.0
    waiting = whole + (rest > 0)
    states = len(a)
    moving = states - 1 if drive.takes_current else states
    flow, effect = (a[:-1, :-1], a[:-1, -1:]) if drive.takes_current else (a, b)
    # Row j gives u(k - j); the columns are the states, the commands in transit and the new one.
    commands = np.zeros((waiting + 1, states + waiting + 1))
    commands[0, -1] = 1.0
    commands[1:, states:-1] = np.eye(waiting)
    following = np.zeros((states + waiting, states + waiting + 1))
    after, new = _zero_order_hold(flow, effect, period - rest)
    following[:moving, :moving] = after
    following[:moving] += new @ commands[whole : whole + 1]
    if rest:
        before, old = _zero_order_hold(flow, effect, rest)
        following[:moving, :moving] = after @ before
        following[:moving] += after @ old @ commands[whole + 1 :]
    if drive.takes_current:
        following[moving] = commands[whole]
    following[states:] = commands[:-1]
    return following[:, :-1], following[:, -1:]


def discretize(drive: Drive, a: Array, b: Array, period: float, delay: float = 0.0) -> tuple[Array, Array]:
    """Return the model from sample to sample whose input is the law's voltage, under the drive's command interface.

    Parameters
    ----------
    a, b : shape (N, N) and (N, 1): d/dt x = a x + b V, the current (A) the last of x, V in volts
    period : of the samples, s
    delay : from the instant of a measurement to that at which its command acts, s, >= 0

    Returns
    -------
    (A, B) : shape (N + D, N + D) and (N + D, 1): x(k+1) = A x(k) + B V(k); states as in `discretize_from_command`

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE, rigid_model
    >>> a, b = rigid_model(NOMINAL_DRIVE)
    >>> discretize(NOMINAL_DRIVE, a, b[:, :1], period=0.004)[0].shape
    (3, 3)
    >>> discretize(NOMINAL_DRIVE, a, b[:, :1], period=0.004, delay=0.006)[0].shape
    (5, 5)
    """
    from_states, from_voltage = command_from_voltage(drive, a, b)
    following, effect = discretize_from_command(drive, a, b, period, delay)
    following[:, : len(a)] += effect @ from_states
    return following, effect @ from_voltage
