"""A process that runs one job after another, and whose death does not affect its parent.

The time limit is an alarm of the operating system, which ends the process even in compiled code or without a parent.
"""

import json
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from backlash_ros.simulation.batch.journal import Entry

Job = Callable[[int], Any]
"""A run by its number; returns a JSON value that depends only on the number. Must be picklable."""

_CANNOT_BEGIN = 70
"""Exit code of a process that could not import its job."""


class CannotRunError(RuntimeError):
    """No run is possible: workers cannot import the job, or a cluster lacks the package."""


class Worker:
    """One process for one job function; it is restarted after a run that killed it.

    Parameters
    ----------
    job : the function that is run
    limit : longest time of a run, s
    """

    def __init__(self, job: Job, limit: float) -> None:
        self._job, self._limit = job, limit
        self._process: subprocess.Popen[bytes] | None = None
        self.connection: Connection[Any, Any]
        self.number: int | None = None
        self._start()

    def _start(self) -> None:
        self.connection, theirs = Pipe()
        # Threads of the linear algebra would slow each other down. A process in its own session gets no Ctrl-C.
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import main; main({theirs.fileno()})"],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
        )
        theirs.close()
        self.connection.send((self._job, self._limit))

    def begin(self, number: int) -> None:
        """Start a run; ``connection`` becomes readable when it has ended."""
        if self._process is None:
            self._start()
        self.number = number
        self.connection.send(number)

    def end(self) -> Entry:
        """Wait for the end of the run and return it."""
        number, self.number = self.number, None
        assert number is not None
        try:
            value, failure = self.connection.recv()
        except (EOFError, ConnectionError):
            return Entry(number, None, self._died())
        return Entry(number, value, failure)

    def _died(self) -> str:
        assert self._process is not None
        code = self._process.wait()
        self.connection.close()
        self._process = None
        if code == _CANNOT_BEGIN:
            raise CannotRunError(f"a worker cannot import {self._job!r}")
        if code == -signal.SIGALRM:
            return f"it took longer than {self._limit:g} s"
        return f"its process ended with exit code {code}"

    def stop(self) -> None:
        """End the process and its current run."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self.connection.close()
            self._process = None


def work(connection: "Connection[Any, Any]") -> None:
    """Run incoming requests; EOFError when the other end closes."""
    try:
        job, limit = connection.recv()
    except (ImportError, AttributeError):
        traceback.print_exc()
        raise SystemExit(_CANNOT_BEGIN) from None
    while True:
        number = connection.recv()
        signal.setitimer(signal.ITIMER_REAL, limit)
        answer: tuple[Any, str]
        try:
            answer = (job(number), "")
            json.dumps(answer)
        except Exception as error:
            answer = (None, f"{type(error).__name__}: {error}")
        signal.setitimer(signal.ITIMER_REAL, 0)
        connection.send(answer)


def main(handle: int) -> None:
    """Serve the other end of a pipe."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    with suppress(EOFError, ConnectionError):
        work(Connection(handle))
