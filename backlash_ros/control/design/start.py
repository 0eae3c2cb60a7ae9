"""What a controller chooses so that it can start, emulated winding and default weights, and the remedy if it cannot.

Where the drive imposes the current, the controller turns its volts into amperes by a winding of its own,
i = (V - K_m omega_m)/R, so that the braking by the back-EMF comes once a period. Inside the gap, where the motor turns
alone, that is stable above a rate of K_m^2/(2 R J_m) only, or a higher one with a delay. The drive does not depend on
R, so the controller may emulate a larger one: a motor with a resistor in series.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache

import numpy as np

from backlash_ros.control.design.gains import DEFAULT_WEIGHTS, Gains, design_gains
from backlash_ros.control.design.stability import LONGEST_DELAY, UnstableError, is_stable
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.quantity import Quantity

RATE = Quantity("sample rate, the same for drive and controller", "Hz", 0.0, 2000.0, True)

_RESERVE = 3.0
"""Emulated winding over the least one, where the motor's own is less than that."""
_WEAKEST = 0.05
"""Least share of the largest current that an emulated winding lets through."""
_QUARTERS = 20
"""How often default weights are divided by four, at most."""
_TRIES, _ROUNDS = 30, 6
"""Values that a remedy is looked for at, and halvings between two of them."""


class CannotStartError(ValueError):
    """A controller does not start: ``why``, and a ``remedy`` that works, if there is one."""

    def __init__(self, why: str, remedy: str = "") -> None:
        super().__init__(f"{why}; {remedy}" if remedy else why)
        self.why, self.remedy = why, remedy


def with_winding(drive: Drive, resistance: float) -> Drive:
    """Return the drive with another ``motor.resistance``, ohm."""
    return replace(drive, motor=replace(drive.motor, resistance=resistance))


def least_winding(drive: Drive, period: float, delay: float) -> float:
    """Return the least resistance with which the motor is stable alone, and with one more period of delay, ohm.

    Without friction the speed of the motor follows w(k+1) = w(k) - a w(k-D), a = K_m^2 T/(R J_m), with a delay of D
    periods T: stable for a < 2 sin(pi/(4 D + 2)).
    """
    motor = drive.motor
    late = math.ceil(delay / period - 1e-9) + 1
    return motor.torque_constant**2 * period / (motor.inertia * 2.0 * math.sin(math.pi / (4 * late + 2)))


def emulated(drive: Drive, period: float, delay: float = 0.0) -> Drive:
    """Return the drive with the winding that its controller emulates; the drive itself where it takes a voltage.

    It is the motor's own, or if that is less than the `least_winding`, three times that. One period of delay more than
    the drive has is what speeds that are derived from positions cause; with three times the least a load behind a gap
    of a few counts stays quiet, with twice it does not always.

    Parameters
    ----------
    period, delay : of the samples, and from a measurement to when its command acts, s

    Raises
    ------
    CannotStartError
        If that winding lets less than a twentieth of ``motor.current_limit`` through.

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> motor = replace(NOMINAL_DRIVE.motor, inertia=1e-6)
    >>> light = replace(NOMINAL_DRIVE, motor=motor, command_interface="current")
    >>> [emulated(light, period).motor.resistance for period in (0.004, 0.002, 0.0005)]
    [30.0, 15.0, 2.0]
    """
    least = least_winding(drive, period, delay)
    if not drive.takes_current or drive.motor.resistance >= least:
        return drive
    through = _through(drive, period, delay)
    if through < _WEAKEST * drive.motor.current_limit:

        def strong(rate: float) -> bool:
            return _through(drive, 1.0 / rate, delay) >= _WEAKEST * drive.motor.current_limit

        rate = _least(strong, 1.0 / period, RATE.upper)
        raise CannotStartError(
            f"rate = {1.0 / period:g} Hz is too low for the motor inside the gap: it needs an emulated winding of "
            f"{_RESERVE * least:.2g} ohm, which lets {through:.2g} A of {drive.motor.current_limit:g} A through",
            f"it starts with a rate of {math.ceil(rate):g} Hz" if rate else "",
        )
    return with_winding(drive, float(f"{_RESERVE * least:.2g}"))


def _through(drive: Drive, period: float, delay: float) -> float:
    """Return the current that `motor.voltage_limit` drives through a winding with the reserve, A."""
    return drive.motor.voltage_limit / (_RESERVE * least_winding(drive, period, delay))


@lru_cache(maxsize=64)
def default_weights(drive: Drive, period: float, delay: float) -> Mapping[str, list[float]]:
    """Return the default weights by region, for a drive as `emulated`.

    Weights with which the loop is unstable are divided by four, which halves k1, until it is stable with one more
    period of delay.
    """
    return {region: _lowered(drive, weights, period, delay) for region, weights in DEFAULT_WEIGHTS.items()}


def _lowered(drive: Drive, weights: list[float], period: float, delay: float) -> list[float]:
    if is_stable(drive, design_gains("q", drive, weights), period, delay):
        return weights
    for quarters in range(1, _QUARTERS + 1):
        lower = [weight / 4.0**quarters for weight in weights]
        gains = design_gains("q", drive, lower)
        if all(is_stable(drive, gains, period, late) for late in (delay, delay + period)):
            return lower
    return weights


@contextmanager
def explained(drive: Drive, period: float, delay: float) -> Iterator[None]:
    """Turn an `UnstableError` into a `CannotStartError` with a remedy; ``drive`` as described. Takes half a second."""
    try:
        yield
    except UnstableError as error:
        raise CannotStartError(str(error), remedy_for(error, drive, period, delay)) from error


def remedy_for(error: UnstableError, drive: Drive, period: float, delay: float) -> str:
    """Return what makes gains stable that were refused for a ``drive`` as described: each of the values alone does."""
    weights = error.weights

    def stable(period: float, delay: float, drive: Drive = drive, share: float = 1.0) -> bool:
        if delay > LONGEST_DELAY * period:
            return False
        drive = emulated(drive, period, delay)
        gains = Gains(*(share * error.gains.as_array()))
        if weights is not None:
            gains = design_gains("q", drive, [share * weight for weight in weights])
        return is_stable(drive, gains, period, delay)

    found = []
    if rate := _least(lambda rate: stable(1.0 / rate, delay), 1.0 / period, RATE.upper):
        found.append(f"a rate of {math.ceil(rate):g} Hz")
    if part := _least(lambda part: stable(period, delay, share=1.0 / part), 1.0, 1e6):
        what = error.name if weights is None else f"{error.name.removesuffix('.k')}.q"
        lower = error.gains.as_array() if weights is None else weights
        found.append(f"{what} of [{', '.join(f'{value / part:.3g}' for value in lower)}]")
    own = drive.motor.resistance
    ohm = _least(lambda ohm: stable(period, delay, with_winding(drive, ohm)), own, 1e3 * own)
    if drive.takes_current and ohm:
        found.append(f"a motor.resistance of {ohm:.3g} ohm, which the controller then emulates")
    if delay and (less := _least(lambda less: stable(period, delay / less), 1.0, 1e3)):
        found.append(f"a delay of {1e3 * delay / less:.3g} ms")
    return f"stable with {', or '.join(found)}" if found else ""


def _least(holds: Callable[[float], bool], refused: float, most: float) -> float:
    """Return a value between ``refused`` and ``most`` that holds, 5 % beyond the least; 0 if there is none."""
    values = np.geomspace(refused, most, _TRIES)[1:].tolist()
    high = next((value for value in values if holds(value)), 0.0)
    if not high:
        return 0.0
    low = max([refused, *(value for value in values if value < high)])
    for _ in range(_ROUNDS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    beyond = min(1.05 * high, most)
    return beyond if holds(beyond) else high
