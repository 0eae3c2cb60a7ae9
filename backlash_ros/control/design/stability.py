"""Stability and margins of the sampled loop: linear, with the loop's delay, for both interfaces.

The delay is the time from the instant of a measurement to the instant at which its command acts on the motor, ideally
0: transport both ways, computation, a drive that waits for its own next cycle. All signals are taken as measured at
that instant, the current just before a new command acts. The lag of speeds derived from positions is not included.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from backlash_ros.control.design.gains import Gains
from backlash_ros.drivetrain import Drive, command_from_voltage, discretize_from_command, motor_model, rigid_model
from backlash_ros.foundation.record import Array

LONGEST_DELAY = 10
"""In periods."""

_POINTS_PER_DECADE = 100
_STEPS_PER_PERIOD = 16
_LONG = 100
"""In periods: beyond it the poles of the delayed loop take long to compute, and fractions of a period matter little."""

_LEAST_PHASE = math.radians(30)


@dataclass(frozen=True)
class Margins:
    """How far a stable loop is from instability. Infinite if no change of this kind makes it unstable.

    Parameters
    ----------
    phase : smallest lag at a crossover frequency that makes it unstable, rad
    delay : smallest additional delay of the loop that makes it unstable, s
    gain : smallest factor above 1 on the command that makes it unstable
    crossover : frequency at which the loop's gain is 1, that of ``phase``, rad/s; infinite where it stays above 1
    """

    phase: float
    delay: float
    gain: float
    crossover: float

    def tight(self, period: float) -> bool:
        """Return whether the loop tolerates less than 30 deg of lag, or less than one more ``period`` (s) of delay."""
        return self.phase < _LEAST_PHASE or self.delay < period

    def in_words(self) -> str:
        """Return the margins of phase and delay as text."""
        phase = f"{math.degrees(self.phase):.0f} deg of phase" if math.isfinite(self.phase) else "any phase"
        delay = f"{1e3 * self.delay:.3g} ms of delay" if math.isfinite(self.delay) else "any delay"
        return f"{phase}, {delay}"


def _check_delay(name: str, period: float, delay: float) -> None:
    longest = LONGEST_DELAY * period
    if not 0 <= delay <= longest * (1 + 1e-9):
        raise ValueError(
            f"{name}: delay must be >= 0 s and at most {LONGEST_DELAY} periods, {longest:g} s, got {delay!r}"
        )


def _open_loop(
    drive: Drive, model: tuple[Array, Array], feedback: Array, period: float, delay: float
) -> tuple[Array, Array, Array]:
    """Return (A, B, C) from the drive's command to minus the command that the law answers with.

    The law's voltage is -``feedback`` x, with the states x of the continuous ``model``.
    """
    a, b = model
    from_states, from_voltage = command_from_voltage(drive, a, b)
    following, effect = discretize_from_command(drive, a, b, period, delay)
    answer = np.zeros((1, len(following)))
    answer[:, : len(a)] = from_voltage @ feedback - from_states
    return following, effect, answer


def _rigid_loop(drive: Drive, gains: Gains, period: float, delay: float) -> tuple[Array, Array, Array]:
    a, b = rigid_model(drive)
    return _open_loop(drive, (a, b[:, :1]), gains.as_array()[None, :], period, delay)


def _motor_loop(drive: Drive, gains: Gains, period: float, delay: float) -> tuple[Array, Array, Array]:
    return _open_loop(drive, motor_model(drive), np.array([[0.0, gains.current]]), period, delay)


def _closed_poles(loop: tuple[Array, Array, Array]) -> NDArray[np.complex128]:
    """Return the poles of the closed loop; nan where its model overflows."""
    a, b, c = loop
    closed = a - b @ c
    if not np.all(np.isfinite(closed)):
        return np.full(len(a), complex(math.nan))
    return np.linalg.eigvals(closed).astype(complex)


def _spectral_radius(loop: tuple[Array, Array, Array]) -> float:
    return float(np.max(np.abs(_closed_poles(loop))))


def _label(gains: Gains, period: float, delay: float) -> str:
    late = f" with a delay of {delay:g} s" if delay else ""
    return f"[{gains.position:g}, {gains.velocity:g}, {gains.current:g}] is unstable at {1 / period:g} Hz{late}"


class UnstableError(ValueError):
    """``gains``, called ``name``, make the sampled loop unstable; ``weights`` are those they were designed from."""

    def __init__(self, name: str, gains: Gains, why: str, weights: Sequence[float] | None = None) -> None:
        super().__init__(f"{name} = {why}")
        self.name, self.gains, self.weights = name, gains, weights


def check_stable(
    name: str,
    drive: Drive,
    gains: Gains,
    period: float,
    delay: float = 0.0,
    weights: Sequence[float] | None = None,
) -> None:
    """Raise `UnstableError` unless the sampled loop is stable in contact and inside the gap.

    In contact the drive is the rigid model (eq 9); inside the gap the motor turns alone, and only the current gain acts
    on it. The loop is that of the drive's command interface: if the current is imposed, the current gain sees the
    previous one.

    Parameters
    ----------
    name : how errors name the gains
    period : of the samples, s
    delay : from the instant of a measurement to that at which its command acts on the motor, s, >= 0 and at most 10
        periods; whole periods and parts of one are exact
    weights : from which the gains were designed, for whoever catches the error

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> check_stable("fast", NOMINAL_DRIVE, Gains(31.6, 0.872, 0.167), period=0.004, delay=0.016)
    >>> check_stable("fast", NOMINAL_DRIVE, Gains(31.6, 0.872, 0.167), period=0.004, delay=0.022)
    Traceback (most recent call last):
    backlash_ros.control.design.stability.UnstableError: fast = [31.6, ...] is unstable at 250 Hz with a delay of ...
    """
    _check_delay(name, period, delay)
    for where, worst in _slowest_poles(drive, gains, period, delay).items():
        if not worst < 1.0:
            why = f"{_label(gains, period, delay)} {where}: pole magnitude must be < 1, got {worst:.4g}"
            raise UnstableError(name, gains, why, weights)


@lru_cache(maxsize=64)
def _slowest_poles(drive: Drive, gains: Gains, period: float, delay: float) -> dict[str, float]:
    """Return the largest magnitude of a pole in each of the two sampled loops."""
    return {
        "even without backlash": _spectral_radius(_rigid_loop(drive, gains, period, delay)),
        "inside the gap, where the motor turns alone": _spectral_radius(_motor_loop(drive, gains, period, delay)),
    }


def is_stable(drive: Drive, gains: Gains, period: float, delay: float) -> bool:
    """Return whether `check_stable` accepts the gains, for a delay of any length."""
    return max(_slowest_poles(drive, gains, period, delay).values()) < 1.0


@lru_cache(maxsize=64)
def stability_margins(drive: Drive, gains: Gains, period: float, delay: float = 0.0) -> Margins:
    """Return the margins of the sampled loop in contact (rigid model, eq 9).

    The loop is opened in one place: at the drive's command, between the controller and the motor. Its transfer function
    L(z) leads from the command on the motor, held and delayed by ``delay``, through motor and load, the samples of all
    states and the law, to minus the law's next command; L(z) = -1 is the limit of stability.
    Under the voltage interface the winding and its back-EMF belong to the drive, and L(z) = K (zI - A)^-1 B. Under the
    current interface the controller computes the back-EMF and the winding, i = (V - K_m omega_m)/R: that part of the
    feedback is in L(z) too, so that its gain and delay are changed with the rest.

    Parameters
    ----------
    period : of the samples, s
    delay : present delay of the loop, as for `check_stable`, s

    Raises
    ------
    ValueError
        If ``delay`` is out of its bounds or the loop is unstable.

    Notes
    -----
    Crossings are looked for in the frequency response up to half the sample rate. A fraction of a period does not delay
    exactly like exp(-jwd), since the hold is split. Up to 100 periods the margin is therefore found from the poles of
    the loop with that delay; beyond, from the lag at each crossover: within 1 %, and more exact the longer the delay. A
    slowly sampled loop may become unstable around a whole period, where no hold is split, and stable again a little
    later: such a range of delays is found if it begins at a whole period or is wider than a sixteenth of one.

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> margins = stability_margins(NOMINAL_DRIVE, Gains(31.6, 0.872, 0.167), period=0.004)
    >>> print(f"{margins.phase:.2f} rad at {margins.crossover:.0f} rad/s, {1e3 * margins.delay:.1f} ms")
    1.57 rad at 81 rad/s, 19.5 ms
    """
    _check_delay("stability_margins", period, delay)
    matrices = _rigid_loop(drive, gains, period, delay)
    poles = _closed_poles(matrices)
    if not np.max(np.abs(poles)) < 1.0:
        raise ValueError(f"no margins: {_label(gains, period, delay)} even without backlash")
    response = partial(_response, matrices, period)
    omega = _frequencies(response, poles, period)
    at_180 = response(_crossings(omega, lambda at: response(at).imag)).real
    at_half_rate = response(omega[-1:]).real  # real there; it crosses at the end of the range
    factors = -1.0 / np.array([at for at in (*at_180, *at_half_rate) if at < 0.0])
    crossovers = _crossings(omega, lambda at: np.abs(response(at)) - 1.0)
    lags = np.remainder(np.angle(-response(crossovers)), 2.0 * math.pi)
    nearest = int(np.argmin(lags)) if lags.size else None
    return Margins(
        phase=math.inf if nearest is None else float(lags[nearest]),
        delay=_delay_margin(drive, gains, period, delay, float(np.min(lags / crossovers, initial=math.inf))),
        gain=float(np.min(factors[factors > 1.0], initial=math.inf)),
        crossover=math.inf if nearest is None else float(crossovers[nearest]),
    )


def _response(loop: tuple[Array, Array, Array], period: float, omega: Array) -> NDArray[np.complex128]:
    """Return L(z) at frequencies, rad/s, shape (n,)."""
    a, b, c = loop
    z = np.exp(1j * period * omega)[:, None, None]
    states = np.linalg.solve(z * np.eye(len(a)) - a, np.broadcast_to(b, (len(z), *b.shape)))
    return np.asarray((c @ states)[:, 0, 0])


def _crossings(omega: Array, function: Callable[[Array], Array]) -> Array:
    """Return where a function of the frequency is 0, between those of ``omega`` where its sign changes."""
    ends = np.flatnonzero(np.diff(np.sign(function(omega))))
    return np.array([brentq(lambda at: function(np.array([at]))[0], omega[k], omega[k + 1]) for k in ends])


def _frequencies(
    response: Callable[[Array], NDArray[np.complex128]], poles: NDArray[np.complex128], period: float
) -> Array:
    """Return frequencies from one at which the integrator makes the loop's gain large up to half the sample rate."""
    lowest = min(1.0, *np.abs(np.log(poles[poles != 0]))) / period
    while abs(response(np.array([lowest]))[0]) < 10.0:
        lowest /= 10.0
    highest = math.pi / period
    return np.geomspace(lowest, highest, math.ceil(_POINTS_PER_DECADE * math.log10(highest / lowest)) + 1)


def _delay_margin(drive: Drive, gains: Gains, period: float, delay: float, estimate: float) -> float:
    """Return the smallest additional delay at which a pole leaves the unit circle; ``estimate`` if that is long."""
    if math.isfinite(estimate) and estimate > _LONG * period:
        return estimate

    def excess(total: float) -> float:
        return _spectral_radius(_rigid_loop(drive, gains, period, total)) - 1.0

    low, step = delay, period / _STEPS_PER_PERIOD
    longest = delay + LONGEST_DELAY * period
    if math.isfinite(estimate) and estimate > LONGEST_DELAY * period:
        longest, step = delay + 1.5 * estimate, 0.05 * estimate
        if excess(delay + 0.5 * estimate) < 0:
            low = delay + 0.5 * estimate
    whole = period * np.arange(math.ceil(low / period), math.floor(longest / period) + 1)
    # After a whole period a sample may see another current: a jump, and the worst case is at its start.
    for high in np.unique(np.concatenate([np.arange(low, longest + step, step), whole - 1e-6 * period, whole])):
        if high > low and not excess(high) < 0:
            return float(brentq(excess, low, high, xtol=1e-9 * period)) - delay
        low = max(low, high)
    return estimate
