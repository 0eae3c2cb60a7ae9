"""Computing in a process of its own: what it returns, what it raises, and that it may die."""

import os
from functools import partial

import pytest

from backlash_ros.ros.aside import Aside

PATIENCE = 60.0


def test_a_result_comes_from_another_process() -> None:
    assert Aside().submit(os.getpid).result(PATIENCE) not in (os.getpid(), 0)


def test_an_error_comes_back() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        Aside().submit(partial(int, "x")).result(PATIENCE)


def test_a_process_that_dies_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="the process that computed it ended with code 7"):
        Aside().submit(partial(os._exit, 7)).result(PATIENCE)


def test_it_is_kinder_than_the_loop() -> None:
    assert Aside().submit(partial(os.nice, 0)).result(PATIENCE) > os.nice(0)
