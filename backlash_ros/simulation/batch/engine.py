"""Runs that do not depend on each other, on all cores or on a Dask cluster.

What a run gives depends on its number alone: not on the number of cores, nor on its place in the batch.
"""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing
from itertools import islice
from multiprocessing.connection import wait

from backlash_ros.simulation.batch.journal import Entry, Journal
from backlash_ros.simulation.batch.worker import Job, Worker

LIMIT = 300.0
"""Longest time of a run, s, unless another is given."""


def run_batch(
    job: Job,
    numbers: Iterable[int],
    journal: Journal,
    *,
    limit: float = LIMIT,
    cores: int | None = None,
    scheduler: str = "",
    ended: Callable[[Entry], None] = lambda _entry: None,
) -> None:
    """Do the runs that are not in the journal yet, and write down how each ended.

    A run that raises, takes too long or kills its process is written down as a failure, and the rest goes on. Numbers
    are taken from ``numbers`` as they are needed: memory does not grow with the batch.

    Parameters
    ----------
    job : what is run, by its number: a function that can be imported, or a `functools.partial` of one
    limit : longest time of a run, s
    cores : processes on this machine; by default as many as there are cores to be had
    scheduler : address of a Dask scheduler, whose workers then run it in place of this machine's cores
    ended : called with each run that has ended

    Raises
    ------
    ImportError
        If a scheduler is named and Dask distributed is not installed: it is an extra, ``backlash_ros[cluster]``.
    OSError
        If the journal cannot be written or the scheduler not be reached.
    CannotRunError
        If no run can be done: workers cannot import the job.
    """
    missing = (number for number in numbers if number not in journal)
    if scheduler:
        from backlash_ros.simulation.batch.cluster import run_on_cluster  # noqa: PLC0415 - an extra

        entries = run_on_cluster(job, missing, limit, scheduler)
    else:
        entries = run_here(job, missing, limit, cores or len(os.sched_getaffinity(0)))
    with closing(entries):
        for entry in entries:
            journal.add(entry)
            ended(entry)


def run_here(job: Job, numbers: Iterator[int], limit: float, cores: int) -> Generator[Entry, None, None]:
    """Yield runs as they end, from processes on this machine; they are gone when the iterator is."""
    with ExitStack() as stack:
        busy: dict[object, Worker] = {}
        for number in islice(numbers, cores):
            worker = Worker(job, limit)
            stack.callback(worker.stop)
            worker.begin(number)
            busy[worker.connection] = worker
        while busy:
            for connection in wait(list(busy)):  # type: ignore[arg-type]
                worker = busy.pop(connection)
                entry = worker.end()
                following = next(numbers, None)
                if following is not None:
                    worker.begin(following)
                    busy[worker.connection] = worker
                yield entry
