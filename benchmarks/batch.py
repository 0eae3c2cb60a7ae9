"""How fast are batches, and does their memory grow? Drives of the population, by `run_batch` as `backlash evaluate`.

Run with `make bench`; `runs.py` has what is run. A run is a drive of seed 1, the law of two regions with its observer,
told the gap, and a step of 1 rad; everything from drawing the drive to the line in the journal counts. The processes'
start does not: counting begins after the first 20 runs.

- *one core*: runs of 6 s, a second, against the plants alone under the commands that these runs recorded, in turn on
  the same core; the ratio is how many times as long as its plant a run takes. The error is the largest difference of
  where the load is in the end, rad
- *two cores*: the same in a batch on two cores, against two processes, each with a batch of its own on one core
- *memory*: the peak of resident memory, MB, of the process that hands out the runs and of its largest worker, at
  10,000 runs of 0.1 s against at 100, each another drive
"""

import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import rows
from rows import Row
from runs import Recorded, closed_loop, peak_memory, record

from backlash_ros.simulation.batch import Entry, Journal, run_batch

SECONDS, DRIVES, WARM = 6.0, 200, 20
PASSES = 3
FEW, MANY, BRIEF = 100, 10_000, 0.1
CONTEXT = get_context("spawn")


def batch(drives: int, seconds: float, runs: int, cores: int) -> tuple[float, int]:
    """Do runs in a batch; return how many were done a second, and the memory of the largest worker, kB."""
    times, largest = [], 0

    def ended(entry: Entry) -> None:
        nonlocal largest
        if entry.failure:
            raise RuntimeError(f"run {entry.number}: {entry.failure}")
        largest = max(largest, entry.value["memory"])
        times.append(time.perf_counter())

    with tempfile.TemporaryDirectory() as folder, Journal(Path(folder) / "journal") as journal:
        run_batch(partial(closed_loop, drives, seconds), range(runs), journal, cores=cores, ended=ended)
    return (runs - WARM) / (times[-1] - times[WARM - 1]), largest


def rate(cores: int) -> float:
    """Return how many runs a second a batch does."""
    return batch(DRIVES, SECONDS, cores * DRIVES + WARM, cores)[0]


@contextmanager
def one_core() -> Iterator[None]:
    """Stay on one core, with the processes that are started meanwhile."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def alone(recorded: list[Recorded]) -> tuple[float, float]:
    """Return how many runs a second the plants do alone, and the largest error, rad."""
    began = time.perf_counter()
    angles = [each.play() for each in recorded]
    passed = time.perf_counter() - began
    return len(recorded) / passed, max(abs(angle - each.angle) for angle, each in zip(angles, recorded, strict=True))


def against_plant() -> Row:
    """Measure a batch on one core against the plants alone."""
    with one_core():
        recorded = [record(number, SECONDS) for number in range(DRIVES)]
        _, error = alone(recorded)
        pairs = [(rate(1), alone(recorded)[0]) for _ in range(PASSES)]
    mine, theirs = (max(each) for each in zip(*pairs, strict=True))
    ratios = [theirs / mine, *(plant / ours for ours, plant in pairs)]
    what, against = f"batch on one core, runs of {SECONDS:g} s each second", "their plants alone, same commands"
    return Row(what, mine, against, theirs, theirs / mine, (min(ratios), max(ratios)), error, "<= 3")


def on_two_cores() -> Row:
    """Measure a batch on two cores against two batches on one core each."""
    what, against, goal = (
        f"batch on two cores, runs of {SECONDS:g} s each second",
        "two batches on one core each",
        ">= 0.95",
    )
    if len(os.sched_getaffinity(0)) < 2:
        return Row(what, None, against, None, None, None, None, goal, "this machine has one core")
    with ProcessPoolExecutor(2, mp_context=CONTEXT) as pool:
        pairs = [(rate(2), sum(pool.map(rate, (1, 1)))) for _ in range(PASSES)]
    mine, theirs = (max(each) for each in zip(*pairs, strict=True))
    ratios = [mine / theirs, *(both / apart for both, apart in pairs)]
    return Row(what, mine, against, theirs, mine / theirs, (min(ratios), max(ratios)), None, goal)


def memory(runs: int) -> tuple[int, int]:
    """Do runs in a batch; return the peak of memory of this process and of the largest worker, kB."""
    largest = batch(runs, BRIEF, runs, len(os.sched_getaffinity(0)))[1]
    return peak_memory(), largest


def of_memory() -> list[Row]:
    """Measure memory, each time in a process of its own."""
    measured = []
    for runs in (MANY, FEW):
        with ProcessPoolExecutor(1, mp_context=CONTEXT) as pool:
            measured.append(pool.submit(memory, runs).result())
    many, few = measured
    return [
        Row(f"batch, memory of {who}, {MANY} runs, MB", a / 1e3, f"{FEW} runs", b / 1e3, a / b, None, None, "<= 1.2")
        for who, a, b in zip(("the main process", "the largest worker"), many, few, strict=True)
    ]


def main() -> None:
    """Measure, print and write."""
    rows.record([against_plant(), on_two_cores(), *of_memory()])


if __name__ == "__main__":
    main()
