"""What the pure tests share: the nominal gains, rooms that no test leaves its files in, how examples are searched."""

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

from backlash_ros.control import EXPERIMENTS, LAWS, GainSet
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE

# The same examples in each run, so that a change is judged and not luck, nor how busy the machine is;
# HYPOTHESIS_PROFILE=default searches on.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(autouse=True)
def _rooms_as_they_were() -> Iterator[None]:
    """Take out what a test has added to the rooms of laws, contacts and experiments."""
    before = [(room, dict(room)) for room in (LAWS, CONTACTS, EXPERIMENTS)]
    yield
    for room, entries in before:
        room.keep(entries)


@pytest.fixture(scope="session")
def gains() -> GainSet:
    return GainSet.of(NOMINAL_DRIVE)
