"""What the pure tests share: the nominal gains."""

import pytest

from backlash_ros.control import GainSet, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE


@pytest.fixture(scope="session")
def gains() -> GainSet:
    return GainSet(
        fast=design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0]),
        overdamped=design_gains("overdamped", NOMINAL_DRIVE, [4.0, 0.0]),
    )
