"""Harmonic balance against simulation, where its assumption holds and where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from backlash_ros.control import Gains, GainSet, ServoSettings, design_gains, find_limit_cycle
from backlash_ros.control.design.describing_function import describing_function, predict_limit_cycle
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.paper import backlash, cycle_of

PERIOD = 0.001


def simulated_cycle(drive: Drive, k: Gains, seconds: float, delay: float = 0.0) -> tuple[float, float, float]:
    """Return the load's amplitude (rad), the gap's travel (m) and the period (s) of the cycle that ``k`` keeps up."""
    choice = ServoSettings(GainSet(k, k), law="fast", period=PERIOD)
    late = Delay(command=delay)
    scenario = Scenario(np.ones(round(seconds / PERIOD)), known_load_torque=True, substeps=4, delay=late)
    result = run(drive, choice, scenario)
    tail = slice(result.time.size // 2, None)
    cycle = find_limit_cycle(result.state[tail, 2], result.state[tail, 3], PERIOD / 4)
    assert cycle is not None
    return cycle.amplitude, float(np.ptp(result.gap[tail])), cycle.period


def heavier(motor: float, load: float) -> Drive:
    """Return the nominal drive with other inertias, as factors."""
    return replace(
        NOMINAL_DRIVE,
        motor=replace(NOMINAL_DRIVE.motor, inertia=motor * NOMINAL_DRIVE.motor.inertia),
        load=replace(NOMINAL_DRIVE.load, inertia=load * NOMINAL_DRIVE.load.inertia),
    )


@pytest.mark.corners(2)
@pytest.mark.parametrize("damping", [0.2, 10.0, 2.0])
def test_elastic_teeth_are_predicted_within_15_percent(gains: GainSet, damping: float) -> None:
    drive = backlash(1.0, contact=ElasticContact(damping=damping))
    predicted, seen = predict_limit_cycle(drive, gains.fast, 0.001), cycle_of(drive)
    assert predicted is not None
    assert predicted.amplitude / 0.02 == pytest.approx(seen["amplitude_b"], rel=0.15)
    assert predicted.gap_travel / 1e-3 == pytest.approx(seen["gap_travel_d"], rel=0.15)
    assert predicted.period == pytest.approx(seen["period_s"], rel=0.15)


@pytest.mark.corners(2)
@pytest.mark.parametrize("factor", [0.2, 5.0, 1.0])
def test_lossy_teeth_are_predicted_in_amplitude_only(gains: GainSet, factor: float) -> None:
    """The gap rests at +-d/2 between flights: no sinusoid, and the period is far off."""
    drive = backlash(factor)
    predicted, seen = predict_limit_cycle(drive, gains.fast, 0.001), cycle_of(drive)
    assert predicted is not None
    assert predicted.amplitude / drive.gear.backlash_angle == pytest.approx(seen["amplitude_b"], rel=0.15)
    assert predicted.period < 0.7 * seen["period_s"]


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_cycle_of_elastic_teeth_is_in_proportion_to_the_gap(gains: GainSet, factor: float) -> None:
    """Nothing but the gap sets a length as long as the voltage is not limited."""
    drive = backlash(factor, contact=ElasticContact(damping=2.0))
    drive = replace(drive, motor=replace(drive.motor, voltage_limit=1e4))
    predicted = predict_limit_cycle(drive, gains.fast, PERIOD)
    nominal = predict_limit_cycle(backlash(1.0, contact=ElasticContact(damping=2.0)), gains.fast, PERIOD)
    assert predicted is not None
    assert nominal is not None
    assert predicted.amplitude == pytest.approx(factor * nominal.amplitude)
    assert predicted.period == pytest.approx(nominal.period)
    amplitude, travel, period = simulated_cycle(drive, gains.fast, 3.0)
    assert predicted.amplitude == pytest.approx(amplitude, rel=0.15)
    assert predicted.gap_travel == pytest.approx(travel, rel=0.15)
    assert predicted.period == pytest.approx(period, rel=0.15)


@pytest.mark.corners(2)
@pytest.mark.parametrize("designed", [True, False], ids=["designed gains", "nominal gains"])
@pytest.mark.parametrize(
    "drive", [heavier(100.0, 100.0), heavier(1.0, 100.0)], ids=["motor and load x100", "load x100"]
)
def test_drives_a_hundred_times_heavier_are_predicted_in_amplitude(
    gains: GainSet, drive: Drive, designed: bool
) -> None:
    """Cycles of 0.1 to 0.9 s, one to two decades slower than the nominal drive's."""
    k = design_gains("q", drive, [1000.0, 1.0]) if designed else gains.fast
    predicted = predict_limit_cycle(drive, k, PERIOD)
    assert predicted is not None
    amplitude, travel, _ = simulated_cycle(drive, k, 24.0)
    assert predicted.amplitude == pytest.approx(amplitude, rel=0.15)
    assert predicted.gap_travel == pytest.approx(travel, rel=0.15)


def test_overdamped_gains_keep_up_no_cycle(gains: GainSet) -> None:
    assert predict_limit_cycle(NOMINAL_DRIVE, gains.overdamped, PERIOD) is None


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


@pytest.mark.corners(1)
@pytest.mark.parametrize("delay", [0.002, 0.0005, 0.001])
def test_a_late_loop_is_predicted_as_late(gains: GainSet, delay: float) -> None:
    drive = backlash(1.0, contact=ElasticContact(damping=2.0))
    predicted = predict_limit_cycle(drive, gains.fast, PERIOD, delay)
    at_once = predict_limit_cycle(drive, gains.fast, PERIOD)
    amplitude, travel, period = simulated_cycle(drive, gains.fast, 3.0, delay)
    assert predicted is not None
    assert at_once is not None
    assert predicted.amplitude == pytest.approx(amplitude, rel=0.15)
    assert predicted.gap_travel == pytest.approx(travel, rel=0.15)
    assert predicted.period == pytest.approx(period, rel=0.15)
    assert predicted.period > 1.3 * at_once.period
