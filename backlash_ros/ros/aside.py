"""Work beside the loop, so that no sample waits for it: computation in a separate process, the disk in a thread."""

import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

T = TypeVar("T")

KINDER = 10
"""Added to the nice value of work for which the loop must not wait."""


def give_way() -> None:
    """Yield to threads that wait for this core.

    Linux lets a thread run for some milliseconds while others wait. Called between two short pieces of work, this
    spares a loop on the same machine from waiting for both.
    """
    os.sched_yield()


class Aside(Executor):
    """Runs each job in its own process, which ends with the job, when cancelled, or with this process.

    The process gives way to the loop, unless ``kind`` is false: a loop in lockstep goes as fast as it can, and would
    leave nothing to a job that gives way.
    """

    def __init__(self, *, kind: bool = True) -> None:
        self._kind = kind

    def submit(self, work: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Start ``work``, which must be picklable, as must its result; return the future of the result."""
        future: Future[T] = Future()
        context = get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_do, args=(sender, self._kind, work, args, kwargs), daemon=True)
        # Ctrl-C is for the node: the process inherits the blocked signal.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        sender.close()
        future.add_done_callback(lambda done: process.kill() if done.cancelled() else None)
        Thread(target=_wait, args=(receiver, future, process), daemon=True).start()
        return future


def _do(
    sender: Connection, kind: bool, work: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> None:
    if kind:
        os.nice(KINDER)
    try:
        done = ForkingPickler.dumps((work(*args, **kwargs), None))
    except Exception as error:
        done = ForkingPickler.dumps((None, error))
    with suppress(BrokenPipeError):  # no one waits for it any longer
        sender.send_bytes(done)


def _wait(receiver: Connection, future: "Future[Any]", process: Any) -> None:
    try:
        result, error = receiver.recv()
    except EOFError:
        process.join()
        result, error = None, RuntimeError(f"the process that computed it ended with code {process.exitcode}")
    with suppress(InvalidStateError):  # it was cancelled
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)


class InTurn(Executor):
    """Runs one job after the other in a thread, for jobs that wait but hardly compute.

    The process ends without waiting for a job that hangs, as it may on a network disk.
    """

    def __init__(self) -> None:
        self._queue: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._thread: Thread | None = None

    def submit(self, work: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Queue ``work``; return the future of its result."""
        future: Future[T] = Future()

        def do() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(work(*args, **kwargs))
            except Exception as error:
                future.set_exception(error)

        self._queue.put(do)
        if self._thread is None:
            self._thread = Thread(target=self._work, daemon=True)
            self._thread.start()
        return future

    def _work(self) -> None:
        while True:
            self._queue.get()()
