"""The text of an estimate file: it reads back equal, no part passes for the whole, what is foreign is refused."""

import math
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backlash_ros.control import Method
from backlash_ros.control.estimates import DriveIdentity, History, KeptEstimate, parse, render
from backlash_ros.control.estimates.record import MOST

DRIVE = DriveIdentity("/controller", "motor", "load", 10.0)
DAY = datetime(2026, 3, 29, 1, 30, tzinfo=timezone.utc)
SURE = KeptEstimate(DAY, Method.GAP_PROBE, {"backlash_angle": 0.0199}, {"backlash_angle": 5e-05}, applied=True)
OFFERED = KeptEstimate(
    DAY + timedelta(days=1),
    Method.IDENTIFY,
    {"load.inertia": 0.00051, "contact.law": "power", "contact.power.exponent": 21},
    {},
    applied=False,
)
BOTH = History(DRIVE, (SURE, OFFERED))
WIDER = replace(SURE, parameters={"backlash_angle": 0.03})
TEXT = """\
# Estimates of one drive, the newest last: docs/learning.md of backlash_ros.
format: backlash_ros/estimates
version: 2
drive:
  controller: /controller
  motor_joint: motor
  load_joint: load
  gear_reduction: 10.0
count: 2
estimates:
- learned_at: "2026-03-29T01:30:00Z"
  method: gap_probe
  parameters:
    backlash_angle: 0.0199
  standard_uncertainties:
    backlash_angle: 5.0e-05
  applied: true
- learned_at: "2026-03-30T01:30:00Z"
  method: identify
  parameters:
    load.inertia: 0.00051
    contact.law: power
    contact.power.exponent: 21
  standard_uncertainties: {}
  applied: false
"""

NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
PARAMETERS = st.fixed_dictionaries(
    {"backlash_angle": st.floats(0.0, 3.2, exclude_min=True)},
    optional={
        "load.coulomb_friction": st.floats(0.0, 1e5).map(abs),
        "loop_delay": st.floats(0.0, 0.04).map(abs),
        "contact.law": st.sampled_from(["power", "elastic"]),
        "contact.power.exponent": st.integers(1, 101),
    },
)
ESTIMATES = st.builds(
    KeptEstimate,
    st.datetimes(datetime(1, 1, 1), datetime(9999, 12, 31), timezones=st.just(timezone.utc)).map(
        lambda moment: moment.replace(microsecond=0)
    ),
    st.sampled_from(Method),
    PARAMETERS,
    st.dictionaries(st.just("backlash_angle"), st.floats(0.0, 3.2, exclude_min=True), max_size=1),
    st.booleans(),
)
DRIVES = st.builds(DriveIdentity, NAMES, NAMES, NAMES, st.floats(0.01, 1000.0))
HISTORIES = st.builds(History, DRIVES, st.lists(ESTIMATES, max_size=4).map(tuple))


def test_the_text_is_the_documented_one() -> None:
    assert render(BOTH) == TEXT
    assert parse(TEXT.encode(), DRIVE) == BOTH
    page = Path(__file__).parents[2] / "docs" / "learning.md"
    assert TEXT in page.read_text()


@given(HISTORIES)
def test_what_is_written_reads_back_equal(history: History) -> None:
    assert parse(render(history).encode(), history.drive) == history


@pytest.mark.parametrize("history", [BOTH, History(DRIVE, (SURE,)), History(DRIVE)], ids=["two", "one", "none"])
def test_a_file_cut_off_anywhere_reads_equal_or_is_refused(history: History) -> None:
    whole = render(history).encode()
    equal = 0
    for length in range(len(whole)):
        try:
            read = parse(whole[:length], DRIVE)
        except ValueError:
            continue
        assert read == history, whole[:length]
        equal += 1
    assert equal == 1  # where the last line's end alone is missing


@given(st.integers(0, len(TEXT) - 1), st.integers(0, 255))
def test_a_wrong_byte_is_refused_or_a_value_within_bounds(place: int, byte: int) -> None:
    damaged = bytearray(TEXT.encode())
    damaged[place] = byte
    try:
        read = parse(bytes(damaged), DRIVE)
    except ValueError:
        return
    assert read.drive == DRIVE
    assert all(0.0 < each.parameters.get("backlash_angle", 1.0) <= 3.2 for each in read.estimates)
    assert all(0.0 < each.parameters.get("load.inertia", 1.0) <= 1e5 for each in read.estimates)


@given(st.binary(max_size=200))
def test_anything_at_all_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError, match="it is no"):
        parse(content, DRIVE)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("backlash_ros/est", "other/est", "format must be 'backlash_ros/estimates', got 'other/"),
        ("version: 2", "version: 1", "version must be 2, the only known one, got 1"),
        ("version: 2", "version: true", "version must be 2, the only known one, got True"),
        (
            "/controller",
            "/axis2/controller",
            "drive.controller must be '/controller', as in this controller, got '/ax",
        ),
        (
            "motor_joint: motor",
            "motor_joint: m",
            "drive.motor_joint must be 'motor', as in this controller, got 'm'",
        ),
        ("load_joint: load", "load_joint: 3", "drive.load_joint must be 'load', as in this controller, got 3"),
        ("10.0", "12.0", "drive.gear_reduction must be 10.0, as in this controller, got 12.0: these are another"),
        ("10.0", ".nan", "drive.gear_reduction must be a finite number"),
        ("10.0", "[10.0]", "drive.gear_reduction must be a finite number"),
        ("  load_joint: load\n", "", "drive must have the key 'load_joint', got"),
        ("count: 2", "count: 3", "count must be the number of estimates, 2, got 3: part of the file is missing"),
        ("count: 2", "count: true", "count must be the number of estimates, 2, got True"),
        ("0.0199", "7.1", r"estimates[0].parameters.backlash_angle must be > 0 rad and <= 3.2 rad, got 7.1"),
        ("0.0199", "0.0", r"estimates[0].parameters.backlash_angle must be > 0 rad and <= 3.2 rad, got 0.0"),
        ("0.0199", "-0.02", r"estimates[0].parameters.backlash_angle must be > 0 rad and <= 3.2 rad, got -0.02"),
        (
            "0.0199",
            ".nan",
            r"estimates[0].parameters.backlash_angle must be a finite number, > 0 rad and <= 3.2 rad, got nan",
        ),
        ("0.0199", ".inf", r"estimates[0].parameters.backlash_angle must be a finite number"),
        ("0.0199", "true", r"estimates[0].parameters.backlash_angle must be a finite number"),
        ("0.0199", "wide", r"estimates[0].parameters.backlash_angle must be a finite number"),
        ("0.0199", "", r"estimates[0].parameters.backlash_angle must be a finite number"),
        (
            "5.0e-05",
            "-1.0e-05",
            "estimates[0].standard_uncertainties.backlash_angle must be > 0 and <= 1e+09, got -1e-05",
        ),
        ("5.0e-05", ".nan", "estimates[0].standard_uncertainties.backlash_angle must be a finite number"),
        (
            "  backlash_angle: 5.0e-05",
            "  load.inertia: 5.0e-05",
            "must be of numbers in parameters, got 'load.inertia'",
        ),
        (
            "    backlash_angle: 0.0199",
            "    motor.inertia: 1.0",
            "estimates[0].parameters must be of ['contact.law',",
        ),
        ("\n    backlash_angle: 0.0199", " {}", "estimates[0].parameters must have at least one value, got none"),
        ("\n    backlash_angle: 0.0199", " 0.0199", "estimates[0].parameters must be values by name, got 0.0199"),
        (
            "0.00051",
            "0.0",
            "estimates[1].parameters.load.inertia must be >= 1e-09 kg m^2 and <= 100000 kg m^2, got 0.0",
        ),
        ("law: power", "law: glue", "estimates[1].parameters.contact.law must be one of ['"),
        ("21", "21.5", "estimates[1].parameters.contact.power.exponent must be a whole number"),
        (
            "gap_probe",
            "guess",
            r"estimates[0].method must be one of ['gap_travel', 'load_amplitude', 'gap_probe', 'relay', 'gap_map', "
            "'hysteresis', 'identify', 'homing', 'set_zero'], got",
        ),
        ("gap_probe", "[]", r"estimates[0].method must be one of"),
        ("applied: true", "applied: 1", r"estimates[0].applied must be true or false, got 1"),
        ('"2026-03-29T01:30:00Z"', '"yesterday"', r"estimates[0].learned_at must be a date in UTC between quotes"),
        ('"2026-03-29T01:30:00Z"', "2026-03-29T01:30:00Z", "text between quotes, got a timestamp"),
        ('"2026-03-29T01:30:00Z"', '"2026-02-30T01:30:00Z"', r"estimates[0].learned_at must be a date in UTC"),
        ("  applied: true\n", "", r"estimates[0] must have the key 'applied', got"),
        ("  applied: true\n", "  applied: true\n  by: me\n", r"estimates[0] must have only the keys"),
        (
            "  applied: true\n",
            "  applied: true\n  applied: true\n",
            "line 18: the key 'applied' appears twice, first in line 17",
        ),
        ("version: 2", "version: 2\ncount: 2", "the key 'count' appears twice"),
        ("version: 2", "version: 2\nby: me", "the file must have only the keys"),
        ("estimates:", "estimates: 5\nothers:", "the file must have only the keys"),
        ("format:", "--- {}\n---\nformat:", "it is not YAML: line 3: expected a single document"),
        ("gap_probe", "!!python/object/apply:os.getpid []", "text between quotes, got a os.getpid"),
        ("gap_probe", "!!timestamp x", "it is not YAML"),
        ("gap_probe", "[" * 5000, "it is not YAML"),
    ],
)
def test_a_file_that_is_not_ours_is_refused_with_key_value_and_bound(old: str, new: str, why: str) -> None:
    assert old in TEXT
    with pytest.raises(ValueError, match=re.escape(why)):
        parse(TEXT.replace(old, new, 1).encode(), DRIVE)


@pytest.mark.parametrize("written", ["10", "10.000001", "1.0e+1"])
def test_the_same_gear_may_be_written_differently(written: str) -> None:
    assert parse(TEXT.replace("10.0", written, 1).encode(), DRIVE) == BOTH


@pytest.mark.parametrize(("angle", "uncertainty"), [(math.nan, 1e-4), (0.0, 1e-4), (3.3, 1e-4), (0.02, math.inf)])
def test_an_estimate_out_of_bounds_is_none(angle: float, uncertainty: float) -> None:
    with pytest.raises(ValueError, match="backlash_angle must be"):
        KeptEstimate(DAY, Method.GAP_PROBE, {"backlash_angle": angle}, {"backlash_angle": uncertainty}, applied=False)


def test_the_newest_that_was_applied_counts() -> None:
    assert BOTH.applied == SURE
    assert BOTH.parameters == SURE.parameters
    applied = BOTH.with_newest_applied()
    assert applied.applied is not None
    assert applied.applied.parameters == OFFERED.parameters
    assert applied.parameters == {**SURE.parameters, **OFFERED.parameters}
    assert applied.with_newest(WIDER).parameters == {**WIDER.parameters, **OFFERED.parameters}
    assert History(DRIVE, (OFFERED,)).applied is None


def test_the_oldest_are_left_out_but_never_what_is_in_use() -> None:
    applied = replace(OFFERED, applied=True)
    history = History(DRIVE, (SURE, applied))
    for _ in range(2 * MOST):
        history = history.with_newest(OFFERED)
    assert history.estimates == (SURE, applied, *[OFFERED] * (MOST - 2))
    for _ in range(2 * MOST):
        history = history.with_newest(WIDER)
    assert history.estimates == (applied, *[WIDER] * (MOST - 1))
    assert len(render(history)) < 100_000
