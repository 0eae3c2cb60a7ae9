"""How much does each tuned number of the law of planned moves matter? Each alone is made 0.8 and 1.2 times as large.

    python benchmarks/sensitivity.py --drives 10

The controller knows each drive of `core` and of `wild`, but not its effects. It plays the steps of docs/evaluation.md,
and follows a slow sine and a fast move. Printed is how many verdicts (quiet, precise, overshoot ok) are lost and won,
how many drives take twice as long to settle, and by how much the time to settle and the errors on the paths change: the
median over the drives. Numbers of periods or readings stay whole. A run that does not read a number is not repeated.
Killed, it goes on from its journal in `results/sensitivity`. The first start compiles.
"""

import argparse
import hashlib
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tuned_copy import WHOLE, copy_package

import backlash_ros
from backlash_ros.control import ServoSettings
from backlash_ros.control.laws import design_law
from backlash_ros.control.laws.planned import PlannedParameters
from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.simulation import run
from backlash_ros.studies.evaluation import Member, draw_member, motion
from backlash_ros.studies.evaluation.population import told_model
from backlash_ros.studies.evaluation.task import STEP, judge_run, scenario_of, settings_for

OUT = Path("results/sensitivity")
LAW, FACTORS, POPULATIONS = "planned", (0.8, 1.2), ("core", "wild")
PATHS = {"sine": motion.PATHS[1], "move": motion.PATHS[3]}
KINDS = "steps", *PATHS
VERDICTS = "quiet", "precise", "overshoot_ok"
READINGS = {"load._ASTRAY_READINGS", "readings._MOVED_READINGS", "readings._LEAPT_READINGS"}
"""Counts that are kept as floats, but compared with whole ones."""
TITLES = "verdicts lost / won", "late", "settle / sine / move, %"
LATE = 2.0
"""A drive that takes so many times as long to settle is late."""
BLOCK = 8
"""Drives of each population on which all numbers are tried before the next ones."""

Found = dict[str, Any]


@dataclass(frozen=True)
class Played:
    """A drive, and what its controller knows."""

    member: Member
    settings: ServoSettings
    known: Drive

    @classmethod
    def of(cls, seed: int, population: str, number: int) -> "Played":
        """Return a drive of a population, with its gap known."""
        member = draw_member(seed, number, population)
        known, gap = told_model(member, "true"), member.drive.gear.backlash_angle
        settings = replace(settings_for(known, member), identified=True, backlash_angle=gap)
        return cls(member, settings.with_law(LAW), known)

    def play(self, kind: str, settings: ServoSettings) -> Found:
        """Return the figures of a run, and a digest of its commands."""
        member = self.member
        scenario = motion.scenario_of(member, PATHS[kind]) if kind in PATHS else scenario_of(member)
        design_law.cache_clear()
        try:
            done = run(member.drive, settings, scenario, model=self.known)
        except (ValueError, IntegrationError) as error:
            return {"failure": str(error)}
        judged = motion.judge(member, PATHS[kind], done) if kind in PATHS else judge_run(member, scenario, done)
        return asdict(judged) | {"digest": hashlib.sha256(done.command.tobytes()).hexdigest()[:16]}


class Numbers:
    """The tuned numbers of the copy, and the law's parameters."""

    def __init__(self) -> None:
        self._tuned: Any = importlib.import_module(f"backlash_ros.control.laws.{LAW}.tuned")
        self.base = {**self._tuned.BASE, **{f"parameters.{k}": v for k, v in asdict(PlannedParameters()).items()}}
        self._places = {name: place for place, name in enumerate(self._tuned.BASE)}

    def play(self, played: Played, kind: str, name: str, factor: float) -> Found:
        """Play with one number changed; return also which numbers were read."""
        cells, settings = self._tuned.VALUES_AND_READ, played.settings
        cells[:] = [*self._tuned.BASE.values(), *[0.0] * self._tuned.SIZE]
        value = factor * self.base.get(name, 0.0)
        if name in self._places:
            whole = name in READINGS or name.partition(".")[2] in WHOLE
            cells[self._places[name]] = round(value) if whole else value
        elif name:
            settings = settings.with_law(LAW, PlannedParameters(**{name.partition(".")[2]: value}))
        figures = played.play(kind, settings)
        read = [each for each, k in self._places.items() if cells[self._tuned.SIZE + k]]
        return {"figures": figures, "read": [] if name else [*read, *(self.base.keys() - self._places.keys())]}


def scan(given: argparse.Namespace, lines: list[Found]) -> Iterator[Found]:
    """Yield the runs that the journal's lines lack."""
    numbers = Numbers()
    done = {(*key_of(each), each["name"], each["factor"]) for each in lines}
    reads = {key_of(each): each["read"] for each in lines if not each["name"]}
    variants = [("", 1.0), *((name, factor) for name in given.only or numbers.base for factor in FACTORS)]
    for first in range(0, given.drives, BLOCK):
        block = [(p, k) for k in range(first, min(first + BLOCK, given.drives)) for p in POPULATIONS]
        drives = {each: Played.of(given.seed, *each) for each in block}
        for name, factor in variants:
            for (population, number), played in drives.items():
                for kind in KINDS:
                    key = population, number, kind
                    if (*key, name, factor) not in done and (not name or name in reads[key]):
                        found = numbers.play(played, kind, name, factor)
                        reads.setdefault(key, found["read"])
                        named = {"population": population, "number": number, "kind": kind}
                        yield {**named, "name": name, "factor": factor, **found}


def key_of(line: Found) -> tuple[str, int, str]:
    """Return which run a line of the journal is of."""
    return line["population"], line["number"], line["kind"]


def time_or_error(figures: Found) -> float:
    """Return the settling time of the step of 1 rad, s, or the rms error on a path, b; at least a millionth."""
    return max(figures.get("rms") or figures.get("step", {}).get("settle", STEP), 1e-6)


def compare(base: dict[Any, Found], changed: dict[Any, Found]) -> list[str]:
    """Return the cells of a row for one factor; - where no command changes."""
    if all(changed[key].get("digest") == base[key].get("digest") for key in changed):
        return ["-"] * len(TITLES)
    every, (steps, *paths) = {**base, **changed}, ([key for key in base if key[2] == kind] for kind in KINDS)
    turned = [bool(every[key].get(each)) - bool(base[key].get(each)) for key in steps for each in VERDICTS]
    ratios = [[time_or_error(every[key]) / time_or_error(base[key]) for key in keys] for keys in (steps, *paths)]
    late = sum(ratio > LATE for ratio in ratios[0])
    typical = (f"{100.0 * (float(np.median(each)) - 1.0):+.0f}" for each in ratios)
    return [f"{turned.count(-1)} / {turned.count(1)}", f"{late}", " / ".join(typical)]


def table(lines: list[Found], names: Iterable[str]) -> list[list[str]]:
    """Return the rows of the table, one for each number; the first has the titles."""
    base = {key_of(each): each["figures"] for each in lines if not each["name"]}
    rows = [["number", *(f"x{factor:g}: {title}" for factor in FACTORS for title in TITLES)]]
    for name in names:
        row = [f"`{name}`"]
        for factor in FACTORS:
            changed = {key_of(e): e["figures"] for e in lines if (e["name"], e["factor"]) == (name, factor)}
            row += compare(base, changed)
        rows.append(row)
    return rows


def main() -> None:
    """Make the copy, start again in it, scan, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=10, help="of each population")
    parser.add_argument("--seed", type=int, default=451128)
    parser.add_argument("--only", nargs="*", default=[], help="numbers such as carry._ON_FLANK; all by default")
    given = parser.parse_args()
    source, copy = Path(backlash_ros.__file__).parent, OUT.resolve()
    if source.parent != copy:
        copy_package(source, copy)
        there = {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(copy / "compiled")}
        sys.exit(subprocess.run([sys.executable, *sys.argv], env={**os.environ, **there}, check=False).returncode)
    journal = OUT / f"{given.seed}.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    with journal.open("a") as file:
        for line in scan(given, lines):
            file.write(json.dumps(line) + "\n")
            file.flush()
            lines.append(line)
    for row in table(lines, given.only or Numbers().base):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
