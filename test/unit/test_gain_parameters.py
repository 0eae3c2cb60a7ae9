"""What a request for some gain parameters means for all of them."""

from dataclasses import replace

import pytest

from backlash_ros.control import design_gains
from backlash_ros.control.design.gain_sets import CUSTOM, expand, gain_set_of, resolve_set, what_stays
from backlash_ros.drivetrain import NOMINAL_DRIVE

WEIGHTS = {"fast": {"q": [1000.0, 1.0], "k": [0.0] * 3}, "overdamped": {"q": [4.0, 0.0], "k": [0.0] * 3}}
NUMBERS = {"fast": {"q": [0.0, 0.0], "k": [20.0, 0.6, 0.1]}, "overdamped": {"q": [0.0, 0.0], "k": [1.5, 0.03, 0.0]}}
PERIOD = 0.004
SETS = {
    "nominal": resolve_set("nominal", WEIGHTS, NOMINAL_DRIVE, PERIOD, 0.0),
    "gentle": resolve_set("gentle", NUMBERS, NOMINAL_DRIVE, PERIOD, 0.0),
}
START = {"gain_set": "nominal", **SETS["nominal"]}


def request(**changes: object) -> dict[str, object]:
    return {**START, **expand({k.replace("__", "."): v for k, v in changes.items()}, SETS, NOMINAL_DRIVE)}


def check(values: dict[str, object]) -> object:
    return gain_set_of(values, SETS, NOMINAL_DRIVE, PERIOD, 0.0)


def test_choosing_a_set_sets_its_gains() -> None:
    values = request(gain_set="gentle")
    assert values["gains.fast.k"] == [20.0, 0.6, 0.1]
    assert values["gains.fast.q"] == [0.0, 0.0]
    assert check(values).overdamped.position == 1.5


def test_setting_gains_makes_the_set_custom_and_the_weights_void() -> None:
    values = request(gains__fast__k=[25.0, 0.7, 0.1])
    assert values["gain_set"] == CUSTOM
    assert values["gains.fast.q"] == [0.0, 0.0]
    assert values["gains.overdamped.q"] == [4.0, 0.0]
    assert check(values).fast.position == 25.0


def test_setting_weights_designs_the_gains() -> None:
    values = request(gains__overdamped__q=[9.0, 0.0])
    assert values["gain_set"] == CUSTOM
    assert check(values).overdamped == design_gains("q", NOMINAL_DRIVE, [9.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"gain_set": "nosuch"}, r"gain_set must be one of \['nominal', 'gentle', 'custom'\], got 'nosuch'"),
        (
            {"gain_set": "gentle", "gains__fast__k": [1.0, 0.0, 0.0]},
            r"gains.fast.k = .* contradicts gain_set 'gentle'",
        ),
        (
            {"gain_set": "nominal", "gains__fast__q": [500.0, 1.0]},
            r"gains.fast.q = \[500.0, 1.0\] contradicts gain_set 'nominal', that has \[1000.0, 1.0\]; set only one of",
        ),
        ({"gains__fast__k": [1.0, 0.1, 0.0], "gains__fast__q": [4.0, 0.0]}, "does not follow from gains.fast.q"),
        (
            {"gains__fast__k": [1.001 * k for k in SETS["nominal"]["gains.fast.k"]], "gains__fast__q": [1000.0, 1.0]},
            "does not follow from gains.fast.q",
        ),
        ({"gains__fast__k": [1e5, 0.0, 0.0]}, r"gains.fast.k = .* is unstable at 250 Hz"),
        ({"gains__overdamped__k": [1e5, 0.0, 0.0]}, r"gains.overdamped.k = .* is unstable at 250 Hz"),
        ({"gains__overdamped__k": [1.0]}, "gains.overdamped.k must be three gains"),
    ],
)
def test_requests_that_contradict_themselves_are_refused(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        check(request(**changes))


@pytest.mark.parametrize("chosen", [{"q": [0.0, 0.0], "k": [0.0] * 3}, {"q": [4.0, 0.0], "k": [1.0, 0.1, 0.0]}])
def test_a_named_set_gives_either_gains_or_weights(chosen: dict[str, list[float]]) -> None:
    with pytest.raises(ValueError, match=r"gain_sets.odd.fast: give either k \(gains\) or q \(LQR weights\)"):
        resolve_set("odd", {"fast": chosen, "overdamped": NUMBERS["overdamped"]}, NOMINAL_DRIVE, PERIOD, 0.0)


@pytest.mark.parametrize("region", ["fast", "overdamped"])
def test_a_named_set_that_is_unstable_is_refused_by_its_name(region: str) -> None:
    wild = {**NUMBERS, region: {"q": [0.0, 0.0], "k": [1e5, 0.0, 0.0]}}
    with pytest.raises(ValueError, match=rf"gain_sets.wild.{region}.k = \[100000, 0, 0\] is unstable at 250 Hz"):
        resolve_set("wild", wild, NOMINAL_DRIVE, PERIOD, 0.0)


def test_gains_are_judged_with_the_delay_that_was_given() -> None:
    """The nominal gains bear 19.5 ms at 250 Hz."""
    resolve_set("late", WEIGHTS, NOMINAL_DRIVE, PERIOD, 0.019)
    with pytest.raises(ValueError, match=r"gain_sets\.late\.fast\.k = .* unstable at 250 Hz with a delay of 0\.02 s"):
        resolve_set("late", WEIGHTS, NOMINAL_DRIVE, PERIOD, 0.02)
    values = {"gain_set": "nominal", **SETS["nominal"]}
    gain_set_of(values, SETS, NOMINAL_DRIVE, PERIOD, 0.019)
    with pytest.raises(ValueError, match=r"gains\.fast\.k = .* with a delay of 0\.02 s"):
        gain_set_of(values, SETS, NOMINAL_DRIVE, PERIOD, 0.02)


HEAVY = replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, inertia=4 * NOMINAL_DRIVE.load.inertia))
FOR_HEAVY = {
    "nominal": resolve_set("nominal", WEIGHTS, HEAVY, PERIOD, 0.0),
    "gentle": resolve_set("gentle", NUMBERS, HEAVY, PERIOD, 0.0),
}


@pytest.mark.parametrize(
    ("before", "changes", "fast", "overdamped"),
    [
        ({}, {}, "weights", "weights"),
        ({"gain_set": "gentle"}, {}, "numbers", "numbers"),
        ({"gains.fast.k": [25.0, 0.7, 0.1]}, {}, [25.0, 0.7, 0.1], "weights"),
        ({"gain_set": CUSTOM}, {}, "weights", "weights"),
        ({}, {"gains.fast.k": [25.0, 0.7, 0.1]}, [25.0, 0.7, 0.1], "weights"),
        ({}, {"gain_set": "gentle"}, "numbers", "numbers"),
        ({"gain_set": "gentle"}, {"gain_set": "nominal"}, "weights", "weights"),
        ({"gain_set": "gentle"}, {"gains.overdamped.q": [4.0, 0.0]}, "numbers", "weights"),
        ({}, {"gain_set": CUSTOM}, "weights", "weights"),
    ],
)
def test_for_another_drive_what_was_designed_is_designed_anew_and_numbers_stay(
    before: dict[str, object], changes: dict[str, object], fast: object, overdamped: object
) -> None:
    values = {**START, **expand(before, SETS, NOMINAL_DRIVE)}
    full = expand({**what_stays(changes, values), **changes}, FOR_HEAVY, HEAVY)
    values |= full
    gain_set_of(values, FOR_HEAVY, HEAVY, PERIOD, 0.0)
    for region, wanted in (("fast", fast), ("overdamped", overdamped)):
        k, q = f"gains.{region}.k", f"gains.{region}.q"
        designed = {"weights": FOR_HEAVY["nominal"][k], "numbers": SETS["gentle"][k]}
        assert values[k] == (designed[wanted] if isinstance(wanted, str) else wanted)
        assert values[q] == (WEIGHTS[region]["q"] if wanted == "weights" else [0.0, 0.0])
    own = {**before, **changes}
    named = CUSTOM if any(name.startswith("gains.") for name in own) else own.get("gain_set", "nominal")
    assert values["gain_set"] == named
    assert FOR_HEAVY["nominal"]["gains.fast.k"] != SETS["nominal"]["gains.fast.k"]
