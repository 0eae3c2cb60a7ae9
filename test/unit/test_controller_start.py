"""What decides whether a controller starts: the winding it emulates, its default weights, and remedies that work."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from drives import varied
from hypothesis import given
from hypothesis import strategies as st
from searched import searched

from backlash_ros.cli import main
from backlash_ros.control import DEFAULT_WEIGHTS, Gains, check_stable, design_gains
from backlash_ros.control.design.choice import Choice, Tuning, chosen_for_rate, given_sets
from backlash_ros.control.design.start import CannotStartError, default_weights, emulated, least_winding
from backlash_ros.drive_file.drive_file import read_axis
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.simulation import Scenario, run
from backlash_ros.studies.judging import judge_move

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
LOW, HARMONIC = (read_axis(EXAMPLES / f"{name}.yaml").drive for name in ("low_resistance_actuator", "harmonic_drive"))
NO_GAINS = Gains(1e-9, 0.0, 0.0)


def started(drive: Drive, rate: float, **values: Any) -> Choice:
    return Tuning(given_sets(values), rate).start(values, drive)


# The emulated winding


@pytest.mark.parametrize("interface", ["voltage", "current"])
@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_the_nominal_drive_is_controlled_as_it_is(interface: str, rate: float) -> None:
    drive = replace(NOMINAL_DRIVE, command_interface=interface)
    choice = started(drive, rate)
    assert choice.drive == drive
    assert [choice.values[f"gains.{region}.q"] for region in ("fast", "overdamped")] == [[1000.0, 1.0], [4.0, 0.0]]
    assert chosen_for_rate(choice) == []


@searched(
    60,
    200,
    given(
        resistance=st.floats(0.01, 10),
        torque_constant=st.floats(0.005, 0.5),
        inertia=st.floats(1e-7, 1e-2),
        rate=st.floats(20, 2000),
        late=st.floats(0, 3),
    ),
)
def test_the_emulated_winding_is_stable_inside_the_gap_with_one_more_period_of_delay(
    resistance: float, torque_constant: float, inertia: float, rate: float, late: float
) -> None:
    """The least one is about the least: half of it is not stable."""
    motor = {"motor_resistance": resistance, "motor_torque_constant": torque_constant, "motor_inertia": inertia}
    drive = varied(replace(NOMINAL_DRIVE, command_interface="current"), **motor, motor_viscous_friction=0.0)
    period = 1.0 / rate
    delay, least = late * period, least_winding(drive, period, late * period)
    try:
        chosen = emulated(drive, period, delay)
    except CannotStartError as refused:
        assert 24.0 / (3.0 * least) < 0.05 * drive.motor.current_limit
        if refused.remedy:
            (faster,) = values_in(refused.remedy, "a rate")
            emulated(drive, 1.0 / faster, delay)
        return
    assert chosen.motor.resistance >= resistance
    assert emulated(chosen, period, delay) == chosen
    if chosen == drive:
        assert resistance >= least
    else:
        assert chosen.motor.resistance == pytest.approx(3.0 * least, rel=0.06)
    check_stable("k", chosen, NO_GAINS, period, delay + period)
    with pytest.raises(ValueError, match="is unstable at"):
        check_stable("k", varied(drive, motor_resistance=0.45 * least), NO_GAINS, period, delay + period)


def test_what_is_emulated_is_said_with_figures() -> None:
    (said,) = chosen_for_rate(started(LOW, 250.0))
    assert "a winding of 1.7 ohm is emulated, since that of motor.resistance = 0.17 ohm would brake" in said
    assert "at 250 Hz" in said
    (said,) = chosen_for_rate(started(HARMONIC, 250.0))
    assert "it lets 4.9 A of 10 A through, all from 511 Hz on" in said
    assert chosen_for_rate(started(LOW, 1000.0)) == []


@pytest.mark.parametrize("interface", ["voltage", "current"])
@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize(("drive", "step"), [(LOW, 0.5), (HARMONIC, 0.05)])
def test_an_actuator_of_low_resistance_and_a_harmonic_drive_start_step_and_hold(
    drive: Drive, step: float, rate: float, interface: str
) -> None:
    """With their encoders' counts and nothing else, before anything is learned."""
    drive = replace(drive, command_interface=interface)
    choice = started(drive, rate)
    sensors = Sensors(measured=("theta_m", "theta_l"), motor_counts=2.0**14, load_counts=2.0**19)
    scenario = Scenario(np.full(round(5.0 * rate), step), sensors=sensors)
    done = run(drive, choice.settings, scenario, model=choice.drive)
    b, count = drive.gear.backlash_angle, 2.0 * math.pi / sensors.load_counts
    move = judge_move(done.time, done.load_angle, step, b, count)
    assert done.fault == ""
    assert move.swing <= max(0.05, count / b)
    assert move.error <= 0.25
    assert move.settle < 4.0


# Default weights


def test_default_weights_are_lowered_where_rate_or_delay_needs_it() -> None:
    """They stay what they are where they are stable."""
    assert default_weights(NOMINAL_DRIVE, 0.004, 0.019) == DEFAULT_WEIGHTS
    for period, delay in ((0.004, 0.02), (0.004, 0.04), (0.1, 0.0), (0.5, 1.0)):
        lower = default_weights(NOMINAL_DRIVE, period, delay)
        assert lower["fast"][0] < 1000.0
        assert lower["fast"][0] == 1000.0 * lower["fast"][1]
        gains = design_gains("q", NOMINAL_DRIVE, lower["fast"])
        for late in (delay, min(delay + period, 10 * period)):
            check_stable("k", NOMINAL_DRIVE, gains, period, late)
        (said,) = [
            each for each in chosen_for_rate(started(NOMINAL_DRIVE, 1.0 / period, loop_delay=delay)) if "fast" in each
        ]
        assert f"since the default [1000, 1] would be unstable at {1 / period:g} Hz" in said


def test_a_delay_that_is_found_while_it_runs_lowers_the_default_weights_and_no_others() -> None:
    given: dict[str, Any] = {"gain_set_names": ["nominal", "own"]}
    given |= {"gain_sets.own.fast.q": [900.0, 1.0], "gain_sets.own.overdamped.q": [4.0, 0.0]}
    tuning = Tuning(given_sets({}), 250.0)
    before = tuning.start({}, NOMINAL_DRIVE)
    late = tuning.choice({**before.values, **tuning.completed({"loop_delay": 0.03}, before)})
    assert late.values["gains.fast.q"] == [250.0, 0.25]
    assert late.values["gain_set"] == "nominal"
    back = tuning.choice({**late.values, **tuning.completed({"loop_delay": 0.0}, late)})
    assert back == before
    own = Tuning(given_sets(given), 250.0)
    with pytest.raises(ValueError, match=r"gain_sets\.own\.fast\.k = .* is unstable at 250 Hz with a delay of 0\.03 s"):
        own.sets(NOMINAL_DRIVE, 0.03)


def test_a_delay_that_is_found_while_it_runs_changes_the_emulated_winding() -> None:
    tuning = Tuning(given_sets({}), 1000.0)
    before = tuning.start({}, LOW)
    late = tuning.choice({**before.values, **tuning.completed({"loop_delay": 0.001}, before)})
    assert before.drive.motor.resistance == late.values["motor.resistance"] == 0.17
    assert late.drive.motor.resistance == pytest.approx(0.67, abs=0.01)


# Refusals


def values_in(remedy: str, name: str) -> list[float]:
    """Return the numbers of a remedy that begins with a name."""
    found = re.search(rf"{name} of (\[[^\]]+\]|[-+.\de]+)", remedy)
    assert found, remedy
    return [float(each) for each in re.findall(r"[-+]?\d[\d.e+-]*", found[1])]


def test_a_rate_at_which_the_motor_would_get_hardly_any_current_is_refused_with_one_that_works() -> None:
    with pytest.raises(
        CannotStartError, match=r"rate = 10 Hz is too low for the motor inside the gap: .* of 12 A"
    ) as refused:
        started(LOW, 10.0)
    (rate,) = values_in(refused.value.remedy, "a rate")
    assert started(LOW, rate).drive.motor.resistance < 24.0 / 0.6 * 1.1


REFUSED: list[tuple[Drive, Mapping[str, Any]]] = [
    (NOMINAL_DRIVE, {"gains.fast.k": [1000.0, 0.6, 0.1]}),
    (NOMINAL_DRIVE, {"gain_sets.nominal.fast.q": [1e6, 0.0], "loop_delay": 0.02}),
    (NOMINAL_DRIVE, {"gains.overdamped.k": [2.0, 0.0, 3.0], "loop_delay": 0.004}),
    (LOW, {"gains.fast.k": [10.0, 0.6, 2.0]}),
    (LOW, {"gains.fast.k": [1000.0, 0.6, 0.0], "loop_delay": 0.004}),
    (HARMONIC, {"gain_sets.nominal.fast.q": [1e9, 1.0]}),
]


@pytest.mark.parametrize(("drive", "values"), REFUSED)
def test_each_remedy_of_a_refusal_works_alone(drive: Drive, values: Mapping[str, Any]) -> None:
    with pytest.raises(CannotStartError, match="is unstable at 250 Hz") as refused:
        started(drive, 250.0, **values)
    remedy, tried = refused.value.remedy, 0
    assert str(refused.value) == f"{refused.value.why}; {remedy}"
    if "a rate of" in remedy:
        started(drive, *values_in(remedy, "a rate"), **values)
        tried += 1
    for name in [name for name in values if f"{name} of" in remedy]:
        started(drive, 250.0, **{**values, name: values_in(remedy, re.escape(name))})
        tried += 1
    if "a motor.resistance of" in remedy:
        (resistance,) = values_in(remedy, "a motor.resistance")
        started(varied(drive, motor_resistance=resistance), 250.0, **values)
        tried += 1
    if "a delay of" in remedy:
        (delay,) = values_in(remedy, "a delay")
        started(drive, 250.0, **{**values, "loop_delay": 1e-3 * delay})
        tried += 1
    assert tried == remedy.count(" of ") >= 1


@pytest.mark.parametrize(
    "words",
    [["check"], ["simulate"], ["design"], ["evaluate", "--seed", "1", "--only", "0", "--drive"]],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"gains": {"fast": {"k": [10.0, 0.6, 2.0]}}}, "gains.fast.k = [10, 0.6, 2] is unstable at 250 Hz"),
        (
            {
                "gain_set_names": ["nominal", "wild"],
                "gain_sets": {"wild": {region: {"k": [1e5, 0.0, 0.0]} for region in DEFAULT_WEIGHTS}},
            },
            "gain_sets.wild.fast.k = [100000, 0, 0] is unstable at 250 Hz",
        ),
        (
            {"law": "dual_loop", "laws": {"dual_loop": {"reference_bandwidth": 500.0}}}
            | {"identified": True, "backlash_angle": 0.0033},
            "laws.dual_loop.reference_bandwidth must be",
        ),
    ],
    ids=["gains", "set", "law"],
)
def test_every_command_refuses_what_the_controller_refuses(
    words: list[str], values: Mapping[str, Any], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also a gain set that is not in use."""
    content = yaml.safe_load((EXAMPLES / "low_resistance_actuator.yaml").read_text())["/**"]["ros__parameters"]
    path = tmp_path / "drive.yaml"
    path.write_text(yaml.safe_dump(content | dict(values)))
    try:
        code = main([*words, str(path)])
    except SystemExit as ended:
        code = ended.code
    said = "".join(capsys.readouterr())
    assert code == 1, said
    assert says in said
