"""Independent runs, on all cores or on a Dask cluster.

The result of a run depends only on its number, not on the number of cores or its place in the batch.
"""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing
from itertools import islice
from multiprocessing.connection import wait

from backlash_ros.simulation.batch.journal import Entry, Journal
from backlash_ros.simulation.batch.worker import Job, Worker

LIMIT = 300.0
"""Default time limit of a run, s."""


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
    """Do the runs that are not yet in the journal, and record how each ended.

    A run that raises, takes too long or kills its process is recorded as a failure, and the others go on. Numbers are
    taken from ``numbers`` as needed: memory does not grow with the batch.

    Parameters
    ----------
    job : the run, as a function of its number that can be imported, or a `functools.partial` of one
    limit : longest time of a run, s
    cores : processes on this machine; by default one per available core
    scheduler : address of a Dask scheduler, whose workers then replace this machine's cores
    ended : called with each run that has ended

    Raises
    ------
    ImportError
        If a scheduler is given and Dask distributed, the extra ``backlash_ros[cluster]``, is not installed.
    OSError
        If the journal cannot be written or the scheduler cannot be reached.
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
    """Yield runs as they end, from processes on this machine, which end with the iterator."""
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
