"""Learning where the measurement is broken, or the load not free: never valid and wrong; the table in docs/learning.md.

`python test/support/broken_measurements.py --drives 8` runs each kind on as many random drives and fills in the page;
with `--kinds` the named rows alone; with `--encoders load` or `motor` it prints those that one encoder can have, under
the relay.
"""

import argparse
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from backlash_ros.control import AUTO, BacklashEstimate, Servo
from backlash_ros.control.experiment import Deferred, Outcome
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M, Measurement
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model
from backlash_ros.studies.evaluation.task import settings_for

PAGE = Path(__file__).parents[2] / "docs" / "learning.md"
_FILLED = re.compile(r"(<!-- broken: begin -->\n)(.*)(<!-- broken: end -->)", re.DOTALL)
WRONG, COUNTS = {"both": 0.2, "load": 0.3, "motor": 0.3}, 2.0
"""By how much of the gap, by the encoders, and by how many counts of the load's encoder, an estimate is wrong."""


class Shown(NamedTuple):
    """One sample: its time (s), what is measured, what was shown before, the true state; all random comes from rng."""

    time: float
    measured: Measurement
    before: Measurement
    state: Array
    member: Member
    rng: np.random.Generator


Break = Callable[[Shown], None]
"""Changes what is measured, in place."""


def _scaled(factor: float, *signals: int) -> Break:
    def change(shown: Shown) -> None:
        for signal in signals:
            shown.measured[signal] *= factor

    return change


def _swapped(shown: Shown) -> None:
    shown.measured[[THETA_M, THETA_L]] = shown.measured[[THETA_L, THETA_M]]


def _frozen(signal: int, since: float) -> Break:
    def change(shown: Shown) -> None:
        if shown.time >= since:
            shown.measured[signal] = shown.before[signal]

    return change


def _stuck_bit(shown: Shown) -> None:
    count = shown.member.load_count
    if count > 0.0:
        shown.measured[THETA_L] = count * (round(float(shown.measured[THETA_L]) / count) | 16)


def _stale(shown: Shown) -> None:
    if shown.rng.random() < 0.05:
        shown.measured[:] = shown.before


def _slips(shown: Shown) -> None:
    if shown.time > 1.5:
        shown.measured[THETA_L] += 0.3 * shown.member.drive.gear.backlash_angle


def _offset(shown: Shown) -> None:
    shown.measured[THETA_M] += 1.3
    shown.measured[THETA_L] -= 0.7


def _in_rpm(shown: Shown) -> None:
    """Speeds, told in rpm, beside right positions."""
    shown.measured[OMEGA_M], shown.measured[OMEGA_L] = 9.55 * shown.state[1], 9.55 * shown.state[3]


def _right(_shown: Shown) -> None:
    """Show what is."""


Push = Callable[[float, Array, Member], float]
"""Torque on the load, N m, beside the drive's own: of time (s), state and drive."""


def _nothing(_time: float, _state: Array, _member: Member) -> float:
    return 0.0


def _stop(_time: float, state: Array, _member: Member) -> float:
    """A soft stop, 5 mrad from where it began, to one side."""
    return -5.0 * max(0.0, float(state[THETA_L]) - 0.005) - 0.005 * max(0.0, float(state[OMEGA_L]))


def _hand(time: float, state: Array, _member: Member) -> float:
    return -2.0 * float(state[THETA_L]) - 0.01 * float(state[OMEGA_L]) if time < 2.0 else 0.0


def _shaken(time: float, _state: Array, _member: Member) -> float:
    return 0.3 * math.sin(2.0 * math.pi * 7.0 * time)


def _changes(time: float, _state: Array, _member: Member) -> float:
    return 0.3 if time > 1.5 else 0.0


class Kind(NamedTuple):
    """What is wrong: with what is measured, with the load, with the drive that the controller is told."""

    measured: Break = _right
    load: Push = _nothing
    told: Callable[[Drive], Drive] = lambda drive: drive
    lost: float = 0.0
    late: int = 0


def _reduction(factor: float) -> Callable[[Drive], Drive]:
    def told(drive: Drive) -> Drive:
        return replace(drive, gear=replace(drive.gear, reduction=factor * drive.gear.reduction))

    return told


KINDS: Mapping[str, Kind] = {
    "motor's encoder reversed": Kind(_scaled(-1.0, THETA_M)),
    "load's encoder reversed": Kind(_scaled(-1.0, THETA_L)),
    "encoders swapped": Kind(_swapped),
    "motor's encoder frozen": Kind(_frozen(THETA_M, 0.0)),
    "load's encoder frozen": Kind(_frozen(THETA_L, 0.0)),
    "motor's encoder freezes on the way": Kind(_frozen(THETA_M, 1.7)),
    "load's encoder freezes on the way": Kind(_frozen(THETA_L, 1.7)),
    "a bit of the load's encoder is stuck": Kind(_stuck_bit),
    "reduction told 1 % wrong": Kind(told=_reduction(1.01)),
    "reduction told 3 % wrong": Kind(told=_reduction(0.97)),
    "reduction told 10 % wrong": Kind(told=_reduction(1.1)),
    "velocities in rpm": Kind(_in_rpm),
    "coupling slips by 0.3 b": Kind(_slips),
    "5 % of the samples stale": Kind(_stale),
    "5 % of the samples lost": Kind(lost=0.05),
    "samples 3 periods late": Kind(late=3),
    "zero of both encoders elsewhere": Kind(_offset),
    "load against a stop": Kind(load=_stop),
    "load held by hand and let go": Kind(load=_hand),
    "frame shaken": Kind(load=_shaken),
    "load torque changes": Kind(load=_changes),
}


_OF_ONE = ("encoder reversed", "encoder frozen", "encoder freezes on the way")
_OF_ANY = (
    *("reduction told 10 % wrong", "velocities in rpm", "5 % of the samples stale", "5 % of the samples lost"),
    *("samples 3 periods late", "load against a stop", "load held by hand and let go", "frame shaken"),
    "load torque changes",
)


def kinds_for(encoders: str) -> tuple[str, ...]:
    """Return what can be wrong with these encoders, both or one of them."""
    if encoders == "both":
        return tuple(KINDS)
    return (*(f"{encoders}'s {what}" for what in _OF_ONE), *_OF_ANY)


class Found(NamedTuple):
    """What became of a run: was there an estimate, was it wrong, and how far beyond the swing did it go, in b."""

    kind: str
    valid: bool
    wrong: bool
    beyond: float


def play(kind: str, number: int, seed: int, population: str, encoders: str = "both") -> Found:
    """Let a controller learn on one drive of the population."""
    member, how = draw_member(seed, number, population, encoders), KINDS[kind]
    model = how.told(told_model(member, "nominal"))
    try:
        servo = Servo(model, settings_for(model, member, 0.0))
    except ValueError:
        return Found(kind, valid=False, wrong=False, beyond=0.0)
    delay = replace(member.delay, sample=member.delay.sample + how.late / member.rate)
    plant = SimulatedDrive(member.drive, 1.0 / member.rate, sensors=member.sensors, delay=delay)
    rng, before, farthest = np.random.default_rng([seed, number]), np.full(5, math.nan), 0.0
    outcome: Outcome | Deferred | None = None
    elapsed = 0.0
    try:
        while outcome is None and not servo.latched:
            measured = plant.sample()
            before = measured.copy() if np.isnan(before).all() else before
            how.measured(Shown(plant.time, measured, before, plant.state, member, rng))
            before = measured.copy()
            elapsed += plant.elapsed
            if rng.random() >= how.lost:
                if servo.holding and not servo.experimenting:
                    servo.start_experiment(AUTO)
                servo.update(measured, elapsed)
                outcome, elapsed = servo.take_outcome(), 0.0
            plant.advance(servo.command, member.load_torque + how.load(plant.time, plant.state, member))
            farthest = max(farthest, abs(float(plant.state[THETA_L])))
    except IntegrationError:
        return Found(kind, valid=False, wrong=False, beyond=0.0)
    gap = member.drive.gear.backlash_at(float(plant.state[THETA_L]))
    beyond = max(0.0, farthest - 0.3) / member.drive.gear.backlash_angle
    if isinstance(outcome, Deferred):
        outcome = outcome.work()
    if not (isinstance(outcome, BacklashEstimate) and outcome.valid):
        return Found(kind, valid=False, wrong=False, beyond=beyond)
    wrong = abs(outcome.angle - gap) > max(WRONG[encoders] * gap, COUNTS * member.load_count)
    return Found(kind, valid=True, wrong=wrong, beyond=beyond)


def rows(found: Iterator[Found], drives: int, kinds: Sequence[str]) -> dict[str, str]:
    """Return the table's rows, by kind."""
    runs, text = list(found), {}
    for kind in kinds:
        own = [each for each in runs if each.kind == kind]
        counts = f"{sum(each.valid for each in own)} | {sum(each.wrong for each in own)}"
        text[kind] = f"| {kind} | {drives} | {counts} | {max(each.beyond for each in own):.2f} b |"
    return text


def table_of(text: Mapping[str, str]) -> str:
    """Return the table of these rows."""
    head = "| what is wrong | runs | valid | valid and wrong | farthest beyond the swing |\n|---|---|---|---|---|\n"
    return head + "".join(f"{row}\n" for row in text.values())


def filled(page: str, renewed: Mapping[str, str]) -> str:
    """Return the page with these rows of its table renewed; the others stay.

    Raises
    ------
    ValueError
        if the page has no such table
    """
    if not (found := _FILLED.search(page)):
        raise ValueError("the page has no part for broken measurements")
    present = {line.split("|")[1].strip(): line for line in found[2].splitlines() if line.startswith("| ")} | renewed
    table = table_of({kind: present[kind] for kind in KINDS if kind in present})
    return _FILLED.sub(lambda m: f"{m[1]}\n{table}\n{m[3]}", page)


def main() -> None:
    """Run all, or the rows that are asked for; fill in the page, or print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=16, metavar="N")
    parser.add_argument("--seed", type=int, default=20261124, metavar="S")
    parser.add_argument("--population", default="full")
    parser.add_argument("--encoders", default="both", choices=list(WRONG))
    parser.add_argument("--kinds", nargs="+", default=[], metavar="KIND")
    parser.add_argument("--page", type=Path, default=PAGE, metavar="FILE")
    given = parser.parse_args()
    kinds = given.kinds or kinds_for(given.encoders)
    if unknown := set(kinds) - set(kinds_for(given.encoders)):
        parser.error(f"--kinds: unknown {', '.join(sorted(unknown))}; known: {', '.join(kinds_for(given.encoders))}")
    if given.encoders == "both":
        filled(given.page.read_text(), {})  # before an hour of work, not after it
    run = partial(_play, seed=given.seed, population=given.population, encoders=given.encoders)
    with ProcessPoolExecutor() as pool:
        renewed = rows(pool.map(run, product(kinds, range(given.drives)), chunksize=4), given.drives, kinds)
    if given.encoders == "both":
        given.page.write_text(filled(given.page.read_text(), renewed))
    else:
        print(table_of(renewed))


def _play(job: tuple[str, int], seed: int, population: str, encoders: str) -> Found:
    return play(*job, seed, population, encoders)


if __name__ == "__main__":
    main()
