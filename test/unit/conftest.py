"""What the pure tests share: the nominal gains."""

import pytest

from backlash_ros.control import DEFAULT_WEIGHTS, GainSet, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE


@pytest.fixture(scope="session")
def gains() -> GainSet:
    return GainSet(
        **{region: design_gains(region, NOMINAL_DRIVE, weights) for region, weights in DEFAULT_WEIGHTS.items()},
    )
