"""Harmonic balance against simulation, where its assumption holds and where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.analysis.paper import backlash, cycle_of
from backlash_ros.control import GainSet
from backlash_ros.control.describing_function import describing_function, predict_limit_cycle
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.contacts.elastic import ElasticContact


@pytest.mark.parametrize("damping", [0.2, 2.0, 10.0])
def test_elastic_teeth_are_predicted_within_15_percent(gains: GainSet, damping: float) -> None:
    drive = backlash(1.0, contact=ElasticContact(damping=damping))
    predicted, seen = predict_limit_cycle(drive, gains.fast, 0.001), cycle_of(drive)
    assert predicted is not None
    assert predicted.amplitude / 0.02 == pytest.approx(seen["amplitude_b"], rel=0.15)
    assert predicted.gap_travel / 1e-3 == pytest.approx(seen["gap_travel_d"], rel=0.15)
    assert predicted.period == pytest.approx(seen["period_s"], rel=0.15)


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_lossy_teeth_are_predicted_in_amplitude_only(gains: GainSet, factor: float) -> None:
    """The gap rests at +-d/2 between flights: no sinusoid, and the period is far off."""
    drive = backlash(factor)
    predicted, seen = predict_limit_cycle(drive, gains.fast, 0.001), cycle_of(drive)
    assert predicted is not None
    assert predicted.amplitude / drive.gear.backlash_angle == pytest.approx(seen["amplitude_b"], rel=0.15)
    assert predicted.period < 0.7 * seen["period_s"]


def test_dead_zone_has_its_textbook_describing_function() -> None:
    """Slotine & Li, sect. 5.3: N = 2k/pi (pi/2 - asin(a) - a sqrt(1 - a^2)), a = (d/2)/A."""
    gear = replace(NOMINAL_DRIVE.gear, contact=ElasticContact(damping=0.0, wind_up=0.04))
    drive = replace(NOMINAL_DRIVE, gear=gear)
    for ratio in (1.1, 2.0, 10.0):
        a = 1 / ratio
        expected = 2e4 / np.pi * (np.pi / 2 - np.arcsin(a) - a * np.sqrt(1 - a * a))
        found = describing_function(drive, ratio * 0.5e-3, 100.0)
        assert found.real == pytest.approx(expected, rel=1e-3)
        assert abs(found.imag) < 1e-6 * expected
    assert describing_function(drive, 0.4e-3, 100.0) == 0
