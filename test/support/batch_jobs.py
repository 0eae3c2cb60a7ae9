"""Jobs for the tests of the batch engine: they are imported by its processes."""

import os
import signal
import time
from pathlib import Path


def square(number: int) -> int:
    return number * number


def troubled(number: int) -> int:
    """Raise, hang or die for some numbers."""
    if number == 3:
        raise ValueError("three is not liked")
    if number == 5:
        while True:
            pass
    if number == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def slow(folder: Path, seconds: float, number: int) -> int:
    """Take a while and leave a line for each time that it was done to its end."""
    time.sleep(seconds)
    with (folder / f"{number}").open("a") as file:
        file.write("done\n")
    return number * number
