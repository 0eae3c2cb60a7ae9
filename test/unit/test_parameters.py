"""Validation: every bound is enforced, and the error names the parameter, the value, the bound and the unit."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from backlash_ros.control import LearningSettings, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE, Gear, Load, Motor, Validated, quantities

PARTS = [NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear, NOMINAL_DRIVE.load, LearningSettings()]
FIELDS = [(part, name) for part in PARTS for name in quantities(type(part))]


def test_nominal_drive_is_the_reference_drive() -> None:
    reference = yaml.safe_load((Path(__file__).parent / "data" / "nominal_drive.yaml").read_text())
    assert Motor(**reference["motor"]) == NOMINAL_DRIVE.motor
    assert Gear(**reference["gear"]) == NOMINAL_DRIVE.gear
    assert Load(**reference["load"]) == NOMINAL_DRIVE.load


def test_derived_values_of_the_nominal_drive() -> None:
    assert NOMINAL_DRIVE.gear.ratio == pytest.approx(0.1)
    assert NOMINAL_DRIVE.gear.backlash_angle == pytest.approx(0.02)
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


def test_contact_exponent_must_be_odd() -> None:
    with pytest.raises(ValueError, match=r"gear\.contact_exponent must be an odd integer, got 20"):
        replace(NOMINAL_DRIVE.gear, contact_exponent=20)
    with pytest.raises(ValueError, match=r"gear\.contact_exponent must be a whole number .*, got 3\.5"):
        replace(NOMINAL_DRIVE.gear, contact_exponent=3.5)


def test_contact_law_is_one_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"gear\.contact_law must be one of \['power', .*'restitution'\], got 'soft'"):
        replace(NOMINAL_DRIVE.gear, contact_law="soft")


def test_servo_settings_are_validated(gains) -> None:
    with pytest.raises(ValueError, match=r"^backlash_angle must be >= 0 rad and <= 3\.2 rad, got -0\.1$"):
        ServoSettings(gains, backlash_angle=-0.1)
