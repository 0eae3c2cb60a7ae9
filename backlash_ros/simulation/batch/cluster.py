"""Runs on a Dask cluster: each of its threads has its own process, for the same limits."""

import pickle
import threading
from collections.abc import Generator, Iterator
from itertools import islice
from typing import Any

from distributed import Client, KilledWorker, as_completed

from backlash_ros.simulation.batch.code import code_digest
from backlash_ros.simulation.batch.journal import Entry
from backlash_ros.simulation.batch.worker import CannotRunError, Job, Worker

_AHEAD = 2000
"""Runs submitted at a time: enough for a thousand threads, for a batch of any length."""

_here = threading.local()


def _run(code: str, job: bytes, limit: float, number: int) -> Entry:
    """Do one run, on a worker of the cluster, in this thread's process."""
    if code != code_digest():
        raise CannotRunError("this worker has another version of backlash_ros, or other plugins")
    if getattr(_here, "asked", None) != (job, limit):
        if hasattr(_here, "worker"):
            _here.worker.stop()
        _here.worker, _here.asked = Worker(pickle.loads(job), limit), (job, limit)  # noqa: S301 - from the client
    _here.worker.begin(number)
    entry: Entry = _here.worker.end()
    return entry


def run_on_cluster(job: Job, numbers: Iterator[int], limit: float, scheduler: str) -> Generator[Entry, None, None]:
    """Yield runs as they end; another worker repeats those of a lost worker.

    Raises
    ------
    OSError
        If the scheduler cannot be reached.
    CannotRunError
        If the cluster cannot do a run: its workers lack the package or have another version.
    """
    packed, code = pickle.dumps(job), code_digest()
    try:
        connected = Client(scheduler)
    except ValueError as error:  # not an address
        raise OSError(f"no scheduler at {scheduler!r}: {error}") from error
    with connected as client:
        number_of: dict[Any, int] = {}

        def submit(number: int) -> Any:
            future = client.submit(_run, code, packed, limit, number, pure=False)
            number_of[future] = number
            return future

        ending = as_completed([submit(number) for number in islice(numbers, _AHEAD)])
        for future in ending:
            number, raised = number_of.pop(future), future.exception()
            if raised is not None and not isinstance(raised, KilledWorker):
                raise CannotRunError(f"the cluster at {scheduler} cannot do run {number}: {raised!r}") from raised
            yield future.result() if raised is None else Entry(number, None, f"its workers were lost: {raised}")
            following = next(numbers, None)
            if following is not None:
                ending.add(submit(following))
