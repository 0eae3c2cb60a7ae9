"""The motion suite: paths that an axis follows on a drive of a population, and how far off its load is."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from backlash_ros.control import Polynomials, ServoSettings
from backlash_ros.control.motion.setpoint import DURATION, joined, positions_at
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.foundation.record import Array
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.studies.evaluation.member import Member
from backlash_ros.studies.evaluation.task import NotReadyError, Task, first_reading, prepare, true_reading
from backlash_ros.studies.judging import threshold
from backlash_ros.studies.metrics import SETTLED

LEAD = 1.0
"""Time for which the load is held before a path begins, s."""
AFTER = 1.5
"""Time for which a move is judged after its end, s."""
_NODES = 50
"""Quintics for one period of a sine, or for a move."""
_SUBSTEPS = 1e-3
"""Largest time between the states that are judged, s."""


@dataclass(frozen=True)
class Path:
    """A motion of the load.

    ``states``: position, rad, velocity and acceleration at times from its start, s, shape (times, 3); ``nodes``: times
    between which quintics join these; ``judged``: the time from which its error counts; ``ends`` at rest, s, or inf.
    """

    name: str
    states: Callable[[Array], Array]
    nodes: Array
    judged: float = 0.0
    ends: float = math.inf

    @property
    def length(self) -> float:
        """Time for which it is watched, s."""
        return float(self.nodes[-1]) + (AFTER if math.isfinite(self.ends) else 0.0)

    def rows(self, start: float) -> Array:
        """Return the plan: held at ``start``, rad, for `LEAD` seconds, then the path from there on."""
        states = self.states(self.nodes) + np.array([start, 0.0, 0.0])
        durations = np.diff(self.nodes)
        path = np.zeros((durations.size, DURATION + 1))
        path[:, :DURATION], path[:, DURATION] = joined(states[:-1], states[1:], durations), durations
        held = np.array([[start, 0.0, 0.0, 0.0, 0.0, 0.0, LEAD]])
        return np.vstack([held, path])


def _eased(u: Array, size: float, length: float) -> Array:
    """Return a quintic from 0 to ``size`` in ``length`` seconds, at shares ``u`` of it: shape (times, 3)."""
    u = np.clip(u, 0.0, 1.0)
    position = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    velocity = 30.0 * u * u * (1.0 - u) ** 2 / length
    acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / length**2
    return size * np.stack([position, velocity, acceleration], axis=-1)


def ramp(speed: float, begins: float = 0.1, seconds: float = 3.0) -> Path:
    """Return a path at an even speed, rad/s, that is reached smoothly within ``begins`` seconds."""

    def states(time: Array) -> Array:
        u = np.clip(time / begins, 0.0, 1.0)
        position = speed * begins * (u**3 - 0.5 * u**4) + speed * np.maximum(time - begins, 0.0)
        return np.stack([position, speed * u * u * (3.0 - 2.0 * u), speed * 6.0 * u * (1.0 - u) / begins], axis=-1)

    return Path(f"ramp {speed:g} rad/s", states, np.array([0.0, begins, begins + seconds]), judged=3.0 * begins)


def sine(amplitude: float, frequency: float, periods: int = 3) -> Path:
    """Return a sine, rad and Hz, whose amplitude grows from 0 in the first half period."""
    omega, growth = 2.0 * math.pi * frequency, 0.5 / frequency

    def states(time: Array) -> Array:
        e, de, dde = _eased(time / growth, 1.0, growth).T
        s, c = np.sin(omega * time), np.cos(omega * time)
        velocity = de * s + e * omega * c
        acceleration = dde * s + 2.0 * de * omega * c - e * omega * omega * s
        return amplitude * np.stack([e * s, velocity, acceleration], axis=-1)

    nodes = np.arange(_NODES * periods + 1) / (_NODES * frequency)
    return Path(f"sine {amplitude:g} rad {frequency:g} Hz", states, nodes, judged=1.0 / frequency)


def move(distance: float, seconds: float) -> Path:
    """Return a quintic from rest to rest."""
    nodes = np.linspace(0.0, seconds, _NODES + 1)

    def states(time: Array) -> Array:
        return _eased(time / seconds, distance, seconds)

    return Path(f"{distance:g} rad in {seconds:g} s", states, nodes, ends=seconds)


PATHS = (ramp(1.0), sine(0.5, 0.5), sine(0.05, 8.0, periods=16), move(1.0, 0.2))


@dataclass(frozen=True)
class Followed:
    """How a law followed a path; by default that of a failed run.

    In b: ``rms`` and ``largest`` error of the load. ``settle``: time from the end of a move until the load stays within
    b/4, or a count, s. ``peak_force`` between the teeth, N.
    """

    rms: float = math.inf
    largest: float = math.inf
    settle: float = math.nan
    peak_force: float = math.nan
    fault: str = ""
    failure: str = ""


def scenario_of(member: Member, path: Path) -> Scenario:
    """Return a path as a scenario for a drive."""
    start, count = first_reading(member), round((LEAD + path.length) * member.rate)
    substeps = max(1, round(1.0 / (_SUBSTEPS * member.rate)))
    source = Polynomials(path.rows(start))
    told = {"sensors": member.sensors, "delay": member.delay, "substeps": substeps}
    return Scenario(np.full(count, start), np.full(count, member.load_torque), source=source, **told)  # type: ignore[arg-type]


def judge(member: Member, path: Path, done: Run) -> Followed:
    """Judge one run of a path."""
    b, time = member.drive.gear.backlash_angle, done.time
    wanted = positions_at(path.rows(first_reading(member)), time)
    error = np.abs(wanted - true_reading(member, done.load_angle)) / b
    counts = error[time >= LEAD + path.judged]
    settle = math.nan
    if math.isfinite(path.ends):
        end = LEAD + path.ends
        off = np.flatnonzero((error > threshold(SETTLED, b, member.load_count)) & (time >= end))
        settle = float(time[off[-1]] - end) if off.size else 0.0
    return Followed(
        rms=float(np.sqrt(np.mean(counts**2))),
        largest=float(np.max(counts)),
        settle=settle,
        peak_force=float(np.max(done.peak_force[round(LEAD * member.rate) :])),
        fault=done.fault,
    )


def follow(member: Member, path: Path, settings: ServoSettings, known: Drive) -> Followed:
    """Let a law follow a path, and judge it."""
    try:
        return judge(member, path, run(member.drive, settings, scenario_of(member, path), model=known))
    except (ValueError, IntegrationError) as error:
        return Followed(failure=str(error))


def evaluate_motion(task: Task, number: int) -> dict[str, Any]:
    """Return the results of one drive as the journal keeps them: ``learned``, and ``laws`` by name, then by path."""
    member = task.member(number)
    try:
        ready = prepare(task, member)
    except NotReadyError as error:
        failed = {path.name: asdict(Followed(failure=str(error))) for path in PATHS}
        return {"learned": asdict(error.learned), "laws": dict.fromkeys(task.laws, failed)}
    laws = {
        law: {path.name: asdict(follow(member, path, ready.settings.with_law(law), ready.known)) for path in PATHS}
        for law in task.laws
    }
    return {"learned": asdict(ready.learned), "laws": laws}


def motion_table(results: list[dict[str, Any]], laws: tuple[str, ...]) -> list[list[str]]:
    """Return the table of a suite: a row for each path and law, the first with the titles; shares of the drives.

    Parameters
    ----------
    results : of `evaluate_motion`
    """

    def spread(values: list[float], digits: int = 2) -> str:
        shares = np.percentile(np.array(values, dtype=float), (50, 90, 100), method="higher")
        return " / ".join(f"{value:.{digits}g}" for value in shares)

    rows = [
        ["path", "law", "rms, b: median / 90 % / worst", "largest, b", "settled after its end, s", "teeth, N", "faults"]
    ]
    for path in PATHS:
        for law in laws:
            got = [result["laws"][law][path.name] for result in results]
            ended = [each["settle"] for each in got if not math.isnan(each["settle"])]
            forces = [each["peak_force"] for each in got if not math.isnan(each["peak_force"])]
            rows.append(
                [
                    *(path.name, law, spread([each["rms"] for each in got]), spread([each["largest"] for each in got])),
                    spread(ended) if ended else "-",
                    spread(forces) if forces else "-",
                    str(sum(bool(each["fault"] or each["failure"]) for each in got)),
                ]
            )
    return rows
