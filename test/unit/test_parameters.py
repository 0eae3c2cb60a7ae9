"""Validation: every bound is enforced, and the error names the parameter, the value, the bound and the unit."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from backlash_ros.control import LimitCycleSettings, ServoSettings
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Gear, Load, Motor
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.foundation.quantity import Validated, quantities

CONTACT_VALUES = [kind() for kind in CONTACTS.values()]
PARTS = [
    *(NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear, NOMINAL_DRIVE.load, NOMINAL_DRIVE.effects),
    *(*CONTACT_VALUES, LimitCycleSettings()),
]
FIELDS = [(part, name) for part in PARTS for name in quantities(type(part))]


def test_nominal_drive_is_the_reference_drive() -> None:
    reference = yaml.safe_load((Path(__file__).parent / "data" / "nominal_drive.yaml").read_text())
    assert Motor(**reference["motor"]) == NOMINAL_DRIVE.motor
    assert Gear(**reference["gear"], contact=PowerContact(**reference["contact"])) == NOMINAL_DRIVE.gear
    assert Load(**reference["load"]) == NOMINAL_DRIVE.load


def test_derived_values_of_the_nominal_drive() -> None:
    assert NOMINAL_DRIVE.gear.ratio == pytest.approx(0.1)
    assert NOMINAL_DRIVE.gear.backlash_angle == pytest.approx(0.02)
    assert NOMINAL_DRIVE.gear.backlash == pytest.approx(1e-3)
    assert (NOMINAL_DRIVE.gear.motor_radius, NOMINAL_DRIVE.gear.load_radius) == (0.005, 0.05)
    assert NOMINAL_DRIVE.reflected_inertia == pytest.approx(2e-3)
    assert NOMINAL_DRIVE.motor_share == pytest.approx(0.8)


@pytest.mark.parametrize(("part", "name"), FIELDS, ids=lambda value: value if isinstance(value, str) else "")
def test_each_field_refuses_what_is_out_of_bounds(part: Validated, name: str) -> None:
    described = quantities(type(part))[name]
    below = described.lower if described.open_lower else math.nextafter(described.lower, -math.inf) - 1e-300
    above = math.nextafter(described.upper, math.inf)
    for bad in (below, above, math.nan, math.inf, -math.inf, "1.0", None, True):
        with pytest.raises(ValueError, match=rf"^{part.section}\.{name} must be ") as error:
            replace(part, **{name: bad})
        assert repr(bad) in str(error.value)
        if described.unit:
            assert described.unit in str(error.value)


def test_error_names_parameter_value_bound_and_unit() -> None:
    with pytest.raises(ValueError, match=r"^motor\.resistance must be > 0 ohm and <= 1e\+06 ohm, got -2\.0$"):
        replace(NOMINAL_DRIVE.motor, resistance=-2.0)


@pytest.mark.parametrize("name", ["power", "power_no_pull"])
def test_contact_exponent_must_be_odd(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^contact\.{name}\.exponent must be an odd integer, got 20"):
        CONTACTS[name](exponent=20)
    with pytest.raises(ValueError, match=rf"^contact\.{name}\.exponent must be a whole number .*, got 3\.5"):
        CONTACTS[name](exponent=3.5)


def test_contact_law_is_one_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"^contact\.law must be one of \[.*'elastic', .*\], got 'soft'"):
        CONTACTS.choose("contact.law", "soft")
    with pytest.raises(ValueError, match=r"^gear\.contact must be a Contact, such as PowerContact\(\), got 'elastic'"):
        replace(NOMINAL_DRIVE.gear, contact="elastic")


def test_error_about_a_contact_names_its_law() -> None:
    with pytest.raises(ValueError, match=r"^contact\.elastic\.wind_up must be >= 1e-09 rad/\(N m\) and <= 1000 rad"):
        CONTACTS["elastic"](wind_up=0.0)
    for name, kind in CONTACTS.items():
        assert kind.section == f"contact.{name}"
        kind()  # every parameter has a default, by which the nodes declare it


@pytest.mark.parametrize("name", ["elastic", "restitution"])
def test_stiffness_of_elastic_teeth_is_their_wind_up(name: str) -> None:
    """1e-3 rad/(N m) is 4e5 N/m at a radius of 0.05 m; the wind-up at the output is the same at any radius."""
    gear = replace(NOMINAL_DRIVE.gear, contact=CONTACTS[name]())
    assert gear.edge_stiffness == pytest.approx(4e5)
    for radius in (0.05, 0.2):
        at = replace(gear, load_radius=radius)
        constants = plant_constants(replace(NOMINAL_DRIVE, gear=at))
        depth = at.wind_up(3.0) * radius
        force = at.contact.force(constants.contact, constants.half_gap, constants.half_gap + depth, 0.0)[0]
        assert force * radius == pytest.approx(3.0)
        assert at.wind_up(3.0) == pytest.approx(3e-3)


@pytest.mark.parametrize("name", ["power", "power_no_pull"])
def test_wind_up_of_the_power_law_is_what_its_force_needs_beyond_the_gap(name: str) -> None:
    gear = replace(NOMINAL_DRIVE.gear, contact=CONTACTS[name]())
    constants = plant_constants(replace(NOMINAL_DRIVE, gear=gear))
    at = constants.half_gap + gear.wind_up(2.0) * gear.load_radius
    assert gear.contact.force(constants.contact, constants.half_gap, at, 0.0)[0] * gear.load_radius == pytest.approx(
        2.0
    )
    assert gear.wind_up(0.1) == 0.0  # carried inside the gap
    assert gear.edge_stiffness == pytest.approx(10.0 / 0.5e-3)


def test_servo_settings_are_validated(gains) -> None:
    with pytest.raises(ValueError, match=r"^backlash_angle must be >= 0 rad and <= 3\.2 rad, got -0\.1$"):
        ServoSettings(gains, backlash_angle=-0.1)
