"""Work beside the loop: what a process or a thread returns, what it raises, and that it may die or hang."""

import os
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from functools import partial
from multiprocessing import active_children
from multiprocessing.connection import wait
from pickle import PicklingError
from threading import Event

import pytest

from backlash_ros.ros.aside import KINDER, Aside, InTurn

PATIENCE = 60.0


def test_a_result_comes_from_another_process() -> None:
    assert Aside().submit(os.getpid).result(PATIENCE) not in (os.getpid(), 0)


@pytest.mark.parametrize("kind", [True, False])
def test_a_job_gives_way_to_a_loop_in_real_time(kind: bool) -> None:
    assert Aside(kind=kind).submit(os.nice, 0).result(PATIENCE) == min(os.nice(0) + KINDER * kind, 19)


def test_an_error_comes_back() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        Aside().submit(partial(int, "x")).result(PATIENCE)


def test_a_process_that_dies_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="the process that computed it ended with code 7"):
        Aside().submit(partial(os._exit, 7)).result(PATIENCE)


def test_what_is_cancelled_ends_at_once() -> None:
    before = set(active_children())
    computed = Aside().submit(partial(time.sleep, 3600.0))
    (process,) = set(active_children()) - before
    assert computed.cancel()
    assert wait([process.sentinel], PATIENCE)
    with pytest.raises(CancelledError):
        computed.result(PATIENCE)


def test_a_result_that_cannot_be_sent_is_an_error() -> None:
    with pytest.raises((AttributeError, TypeError, PicklingError), match="pickle"):
        Aside().submit(partial(eval, "lambda: 0")).result(PATIENCE)


def test_it_is_kinder_than_the_loop() -> None:
    assert Aside().submit(partial(os.nice, 0)).result(PATIENCE) > os.nice(0)


def test_one_piece_of_work_after_the_other() -> None:
    workers, gate, done = InTurn(), Event(), []
    first = workers.submit(gate.wait, PATIENCE)
    second = workers.submit(done.append, 1)
    assert not done
    gate.set()
    assert first.result(PATIENCE)
    assert second.result(PATIENCE) is None
    assert done == [1]


def test_work_that_fails_or_is_cancelled_does_not_hinder_the_next() -> None:
    workers = InTurn()
    with pytest.raises(ValueError, match="invalid literal"):
        workers.submit(int, "x").result(PATIENCE)
    gate = Event()
    workers.submit(gate.wait, PATIENCE)
    assert workers.submit(int, "2").cancel()
    gate.set()
    assert workers.submit(int, "1").result(PATIENCE) == 1


def test_work_that_hangs_does_not_keep_the_process() -> None:
    code = "from threading import Event; from backlash_ros.ros.aside import InTurn; InTurn().submit(Event().wait)"
    assert subprocess.run([sys.executable, "-c", code], timeout=PATIENCE, check=False).returncode == 0
