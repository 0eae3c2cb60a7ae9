"""What bad samples do to the load: one signal shows some finite value for a while, beside the run in which it does not.

Run as a program it tries a grid of values and rewrites the section of docs/faults.md that says how far the load moved.
"""

import itertools
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from faults_page import SECTION

from backlash_ros.control import LAWS, GainSet, LimitCycleSettings, Servo, ServoSettings
from backlash_ros.control.monitoring.plausibility import speed_lag
from backlash_ros.control.monitoring.side import LATELY, PATIENCE
from backlash_ros.control.monitoring.thresholds import mechanical_time_constant
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.signals import OMEGA_L, STATE_NAMES, THETA_L
from backlash_ros.simulation import SimulatedDrive

B = NOMINAL_DRIVE.gear.backlash_angle
GAINS = GainSet.of(NOMINAL_DRIVE)
BAD_FROM, WATCHED_FOR = 0.4, 0.35
LARGE_KICK = LimitCycleSettings(swing=1.0, kick=0.1)
"""When the first bad sample comes, and how long the load is watched from there, s."""
SENSORS = {"all signals": Sensors(), "positions alone": Sensors(measured=POSITIONS)}


class Situation(NamedTuple):
    """What goes on when the bad sample comes: a reference (rad) since a time (s), learning, a load torque (N m)."""

    reference: float = 0.0
    since: float = 0.0
    learning: bool = False
    load_torque: float = 0.0


SITUATIONS = {
    "at rest": Situation(),
    "in the limit cycle": Situation(reference=0.5, since=0.05),
    "learning": Situation(learning=True, since=0.05),
    "arriving": Situation(reference=1.0, since=BAD_FROM - 0.08),
    "at full speed": Situation(reference=1.0, since=BAD_FROM - 0.02),
}

Bad = Callable[[float, int], float]
"""From the true value and the number of bad samples before to the value that is shown."""


@dataclass(frozen=True)
class Played:
    """Load angles by sample; the sample at which a fault was latched, counted from the first bad one, or -1; why."""

    angle: np.ndarray
    speed: np.ndarray
    latched: int
    fault: str


def play(
    law: str,
    situation: Situation,
    sensors: Sensors,
    period: float,
    bad: Bad | None = None,
    signal: int = 0,
    samples: int = 0,
    backlash_angle: float = B,
    wrong_from: float = BAD_FROM,
) -> Played:
    """Play one run, with so many bad ``samples`` of one ``signal``, by default from `BAD_FROM` on."""
    servo = Servo(
        NOMINAL_DRIVE, ServoSettings(GAINS, law=law, backlash_angle=backlash_angle, period=period, identified=True)
    )
    drive = SimulatedDrive(NOMINAL_DRIVE, period, sensors=sensors)
    count, first = round((BAD_FROM + WATCHED_FOR) / period), round(wrong_from / period)
    angle, speed, latched = np.zeros(count), np.zeros(count), -1
    for k in range(count):
        measured = drive.sample()
        if bad is not None and first <= k < first + samples:
            measured[signal] = bad(float(measured[signal]), k - first)
        if k == max(1, round(situation.since / period)):
            assert situation.learning or servo.set_reference(situation.reference) == ""
            if situation.learning:
                servo.start_experiment("limit_cycle", LARGE_KICK)
        command = servo.update(measured, drive.elapsed)
        servo.take_outcome()
        if servo.fault and latched < 0:
            latched = k - first
        angle[k], speed[k] = drive.state[THETA_L], drive.state[OMEGA_L]
        drive.advance(command, situation.load_torque)
    return Played(angle, speed, latched, servo.fault)


@cache
def undisturbed(law: str, situation: Situation, sensors: Sensors, period: float) -> Played:
    """Return the run without bad samples."""
    played = play(law, situation, sensors, period)
    assert played.fault == ""
    return played


class Harm(NamedTuple):
    """How far the load was from where it would be until a fault, how far it went on, and after how many samples.

    ``samples`` counts from the first bad one, that included; 0 where no fault was latched. rad.
    """

    strayed: float
    went_on: float
    samples: int


def harm(law: str, situation: Situation, sensors: Sensors, period: float, bad: Bad, signal: int, samples: int) -> Harm:
    """Return what bad samples do."""
    true = undisturbed(law, situation, sensors, period)
    played = play(law, situation, sensors, period, bad, signal, samples)
    off = np.abs(played.angle - true.angle)
    if played.latched < 0:
        return Harm(float(np.max(off)), 0.0, 0)
    at = round(BAD_FROM / period) + played.latched
    went_on = float(np.max(np.abs(played.angle[at:] - played.angle[at])))
    return Harm(float(np.max(off[: at + 1])), went_on, played.latched + 1)


def allowed(situation: Situation, law: str, sensors: Sensors, period: float) -> tuple[float, float]:
    """Return how far the load may stray, and how far it may go on after a fault: physics beside 2 b and 0.2 rad.

    A speed that a drive reports late cannot be told from a wrong one that is off by no more: after a speed of v that
    hides v times the lag. A load that moves when its motor goes to 0 V runs on by v times the mechanical time constant.
    """
    speed = undisturbed(law, situation, sensors, period).speed[round((BAD_FROM - LATELY) / period) :]
    fastest = float(np.max(np.abs(speed)))
    moving = fastest > 3.0  # rad/s; a limit cycle has no more
    lag, coast = speed_lag(period), mechanical_time_constant(NOMINAL_DRIVE)
    return 2 * B + (lag * fastest if moving else 0.0), 0.2 + (coast * fastest if moving else 0.0)


def holds(found: Harm, bound: tuple[float, float]) -> bool:
    """Whether the property holds: strayed by no more than the bound, or a fault at once, and little way after it."""
    strayed, went_on = bound
    return found.went_on <= went_on and (found.strayed <= strayed or 0 < found.samples <= PATIENCE)


# The grid.

_SIZES: Mapping[str, tuple[float, ...]] = {
    "theta_m": (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0, 5.0),
    "omega_m": (1.0, 3.0, 10.0, 30.0, 100.0, 400.0, 1e9),
    "theta_l": (0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1, 0.5),
    "omega_l": (0.1, 0.3, 1.0, 3.0, 10.0, 40.0, 1e9),
    "current": (0.1, 0.3, 0.6, 1.0, 3.0, 12.0, 200.0, 2e10),
}
_Try = tuple[str, str, str, float]


def _tries() -> Iterator[_Try]:
    yield from itertools.product(SENSORS, SITUATIONS, sorted(LAWS), (0.004, 0.001))


def _search(tried: _Try) -> dict[tuple[str, str], Harm]:
    """Return the largest harm by situation and signal, over values, signs and numbers of samples."""
    kind, name, law, period = tried
    sensors, situation = SENSORS[kind], SITUATIONS[name]
    bound = allowed(situation, law, sensors, period)
    worst: dict[tuple[str, str], Harm] = {}
    for signal in sensors.measured:
        for size, sign, samples in itertools.product(_SIZES[signal], (1, -1), (1, 3, 10)):
            found = harm(
                law,
                situation,
                sensors,
                period,
                lambda true, _, by=sign * size: true + by,
                STATE_NAMES.index(signal),
                samples,
            )
            assert holds(found, bound), (tried, signal, sign * size, samples, found, bound)
            key = (name, f"{signal}, {kind}")
            before = worst.get(key, Harm(0.0, 0.0, 0))
            # What comes before a fault at once is the fault's; a fault later than that is judged by both.
            strayed = 0.0 if 0 < found.samples <= PATIENCE else found.strayed
            worst[key] = Harm(max(before.strayed, strayed), max(before.went_on, found.went_on), 0)
    return worst


_TEXT = """
One signal shows a wrong value for 1, 3 or 10 samples: off by {least} to {most} in its unit, with either sign, with each
law, at 250 Hz and 1 kHz, offline (`make bad-samples`; nominal drive, b = 0.02 rad). Before the slash: the load's
largest deviation from its undisturbed motion if no fault was latched within three samples. After it: how far the load
went on after a fault. Both in rad.

Currents are compared with what the commands can drive through the winding, and speeds with the encoder's motion;
implausible values are not used (`backlash_ros/control/monitoring/plausibility.py`). A jump of an encoder by less than
1.5 times the learned gap looks like a motion of the teeth. A speed error no larger than the allowed delay of a drive's
speed counts as delay: at full speed this gives the largest figure in the table. A load that moves when the motor goes
to 0 V runs on, by its speed times the mechanical time constant (0.02 s here): these are the 0.4 rad. A wrong unit or
sign is the same error without an end, and a fault within the first few degrees of the first move.

"""


def section(worst: Mapping[tuple[str, str], Harm]) -> str:
    """Return the section of the page."""
    signals = list(dict.fromkeys(signal for _, signal in worst))
    sizes = [size for each in _SIZES.values() for size in each]
    lines = [SECTION, _TEXT.format(least=f"{min(sizes):g}", most=f"{max(sizes):.0e}".replace("+", ""))]
    lines[1] += f"| wrong signal | {' | '.join(SITUATIONS)} |\n|---|{'---|' * len(SITUATIONS)}\n"
    for signal in signals:
        cells = [f"{worst[name, signal].strayed:.3f} / {worst[name, signal].went_on:.2f}" for name in SITUATIONS]
        lines[1] += f"| {signal} | {' | '.join(cells)} |\n"
    return "\n".join(lines)


def without_section(page: str) -> str:
    """Return the page as it is before the section."""
    return page.partition(SECTION)[0].rstrip() + "\n"


def main(page: Path) -> int:
    """Search, and write the section at the end of ``page``."""
    worst: dict[tuple[str, str], Harm] = {}
    with ProcessPoolExecutor() as pool:
        for found in pool.map(_search, _tries()):
            for key, value in found.items():
                before = worst.get(key, Harm(0.0, 0.0, 0))
                worst[key] = Harm(*(max(pair) for pair in zip(before, value, strict=True)))
    page.write_text(f"{without_section(page.read_text())}\n{section(worst)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
