"""`backlash design`: gains and width that are quiet over a range of drives, and what the command does with them."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import yaml

from backlash_ros.cli import main
from backlash_ros.control import OVERDAMPED_REGION, Gains, design_gains
from backlash_ros.drive_file.drive_file import read_start, read_surroundings
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, rigid_model
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.studies.check import check_drive
from backlash_ros.studies.design import search
from backlash_ros.studies.design.report import closed_loop_poles, content_of, gain_text
from backlash_ros.studies.design.search import (
    Design,
    default_choice,
    design,
    flank_rate,
    predicted_cycle,
    slow_pole,
)
from backlash_ros.studies.design.trial import Choice, Loop, Outcome, attempt, simulate
from backlash_ros.studies.design.uncertainty import Uncertainty
from backlash_ros.studies.judging import PRECISE, QUIET

FAST = design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0])
B = NOMINAL_DRIVE.gear.backlash_angle
SURE = Uncertainty((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0), 0.0)
"""No range at all."""


def loaded(inertia: float = 1.0, friction: float = 0.0) -> Drive:
    """Return the nominal drive with so many times the load's inertia, and dry friction on it, N m."""
    load = NOMINAL_DRIVE.load
    return replace(NOMINAL_DRIVE, load=replace(load, inertia=inertia * load.inertia, coulomb_friction=friction))


def loop_for(drive: Drive, **kwargs: Any) -> Loop:
    return Loop(drive, design_gains("fast", drive, [1000.0, 1.0]), **kwargs)


# The range


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"inertia": (1.3, 0.7)}, r"inertia must be two factors, 0.01 <= lower <= upper <= 100, got 1.3 and 0.7"),
        ({"inertia": (0.0, 1.0)}, "inertia must be two factors"),
        ({"gap": (1.0, math.inf)}, "gap must be two factors"),
        ({"viscous_friction": (-0.1, 1.0)}, "viscous_friction must be two factors, 0 <= lower"),
        ({"dry_friction": (math.nan, 1.0)}, "dry_friction must be two factors"),
        ({"load_torque": 0.6}, "load_torque must be a share of the torque at standstill, >= 0 and <= 0.5, got 0.6"),
        ({"load_torque": math.nan}, "load_torque must be a share"),
    ],
)
def test_a_range_that_is_none_is_refused(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Uncertainty(**given)


def test_the_corners_of_the_range_and_either_load_torque_are_tried() -> None:
    drive = loaded(friction=0.01)
    cases = Uncertainty((0.5, 2.0), (0.8, 1.2), (0.0, 1.5), (0.9, 1.1), 0.1).cases(drive)
    assert cases[0].drive == drive
    torque = 0.1 * drive.standstill_torque()
    assert {case.load_torque for case in cases} == {0.0, torque, -torque}
    ratios = {
        (
            round(case.drive.load.inertia / drive.load.inertia, 9),
            round(case.drive.load.viscous_friction / drive.load.viscous_friction, 9),
            round(case.drive.load.coulomb_friction / drive.load.coulomb_friction, 9),
            round(case.drive.gear.backlash_angle / B, 9),
        )
        for case in cases
    }
    corners = {(j, v, c, b) for j in (0.5, 2.0) for v in (0.8, 1.2) for c in (0.0, 1.5) for b in (0.9, 1.1)}
    assert corners < ratios
    assert len({type(case.drive.gear.contact) for case in cases}) == 2
    assert len({case.label for case in cases}) == len(cases)


def test_what_the_drive_has_not_is_not_varied() -> None:
    assert not any("tau_c" in case.label for case in Uncertainty().cases(NOMINAL_DRIVE))
    assert [case.label for case in SURE.cases(NOMINAL_DRIVE)] == ["as described"]


# What gains do


def test_other_teeth_are_as_stiff_as_the_motor_is_strong() -> None:
    """A strong motor with a small gap must not wind them up by many gaps: no gear is built so."""
    gear = replace(NOMINAL_DRIVE.gear, reduction=100.0, backlash_angle=2e-3)
    drive = replace(NOMINAL_DRIVE, gear=gear)
    other = [case.drive.gear for case in Uncertainty().cases(drive) if "other teeth" in case.label]
    assert other
    assert all(gear.wind_up(drive.standstill_torque()) == pytest.approx(0.3 * 2e-3) for gear in other)


def test_a_load_is_stopped_by_its_own_friction() -> None:
    """DESIGN: 10 1/s for the nominal drive, a quarter of it with four times the inertia."""
    assert flank_rate(NOMINAL_DRIVE) == pytest.approx(10.0)
    assert flank_rate(loaded(4.0)) == pytest.approx(2.5)
    drive = loaded(4.0, friction=0.01)
    rate, error = flank_rate(drive), 0.25 * B
    needed = rate**2 * error
    given = (drive.load.viscous_friction * rate * error + drive.load.coulomb_friction) / drive.load.inertia
    assert needed == pytest.approx(given)


@pytest.mark.parametrize("gains", [Gains(2.0, 0.0, 0.0), Gains(1.0, 0.2, -1.0), Gains(0.5, -0.1, 2.0)])
def test_the_slow_pole_is_that_of_the_loop_in_contact(gains: Gains) -> None:
    a, b = rigid_model(NOMINAL_DRIVE)
    poles = np.linalg.eigvals(a - b[:, :1] @ gains.as_array()[None, :])
    assert slow_pole(NOMINAL_DRIVE, gains) == pytest.approx(np.min(np.abs(poles)), rel=0.15)


def sampled(gains: Gains, period: float) -> tuple[Any, Any]:
    """Return the open and the closed loop in contact, sampled by python-control."""
    a, b = rigid_model(NOMINAL_DRIVE)
    plant = control.c2d(control.ss(a, b[:, :1], np.eye(3), np.zeros((3, 1))), period)
    k = gains.as_array()[None, :]
    return control.ss(plant.A, plant.B, k, [[0.0]], period), plant.A - plant.B @ k


@pytest.mark.parametrize("gains", [FAST, Gains(2.0, 0.04, 0.0), Gains(1.8, 0.05, -1.0)])
def test_poles_and_margins_are_those_of_python_control(gains: Gains) -> None:
    loop = replace(loop_for(NOMINAL_DRIVE), fast=gains)
    opened, closed = sampled(gains, 0.004)
    wanted = np.log(np.linalg.eigvals(closed).astype(complex)) / 0.004
    poles = closed_loop_poles(loop, gains)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(wanted), rtol=1e-6)
    choice, case = Choice(gains, 1.0), SURE.cases(NOMINAL_DRIVE)[0]
    tried = ((case, Outcome(0.0, 0.0, 0.0, 1.0, 1.0, 0.1)),)
    margins = content_of(Design(loop, SURE, choice, tried, choice, tried), "it")["margins"]["overdamped"]
    at_crossover = opened(np.exp(1j * margins["crossover"] * 0.004))
    assert abs(at_crossover) == pytest.approx(1.0, rel=1e-3)
    assert margins["phase_degrees"] == pytest.approx(180.0 + np.degrees(np.angle(at_crossover)), abs=0.1)


def test_a_delay_is_seen_by_poles() -> None:
    at_once, late = loop_for(NOMINAL_DRIVE), loop_for(NOMINAL_DRIVE, delay=Delay(command=0.004))
    assert closed_loop_poles(at_once, FAST) != pytest.approx(closed_loop_poles(late, FAST)[:3])


def test_a_cycle_is_predicted_where_there_is_one_and_dry_friction_ends_it() -> None:
    """As simulated: the default gains rattle under four times the load; 14 mN m of dry friction stop the fast ones."""
    heavy, choice = loaded(4.0), default_choice(loop_for(NOMINAL_DRIVE))
    cycle = predicted_cycle(loop_for(heavy, rate=1000.0), heavy, choice)
    assert cycle is not None
    assert 0.5 < cycle.amplitude / B < 0.9
    assert predicted_cycle(loop_for(NOMINAL_DRIVE, rate=1000.0), NOMINAL_DRIVE, choice) is None
    rubbed = loaded(4.0, friction=0.05)
    assert predicted_cycle(loop_for(rubbed, rate=1000.0), rubbed, choice) is None


def test_the_width_is_where_the_gains_change() -> None:
    loop, case = loop_for(NOMINAL_DRIVE, rate=1000.0), SURE.cases(NOMINAL_DRIVE)[0]
    for width in (0.5, 1.0, 3.0):
        done = simulate(loop, Choice(default_choice(loop_for(NOMINAL_DRIVE)).gains, width), case)
        first = int(np.flatnonzero(done.region == OVERDAMPED_REGION)[0])
        error = 1.0 - done.load_angle[:: (done.time.size - 1) // done.region.size]
        assert abs(error[first]) < width * B <= abs(error[first - 1])


def test_a_fault_and_a_plant_that_stops_are_no_success() -> None:
    outcome = Outcome(failure="fault")
    assert outcome.excess(B, 0.0, 1.0) > 10.0
    assert Outcome(0.5 * QUIET, 0.5 * PRECISE, 0.0).excess(B, 0.0, 0.6) == 0.0
    assert Outcome(0.7 * QUIET, 0.5 * PRECISE, 0.0).excess(B, 0.0, 0.6) > 0.0
    assert Outcome(0.5 * QUIET, 0.7 * PRECISE, 0.0).excess(B, 0.0, 0.6) > 0.0
    assert Outcome(0.1, 0.05, 0.0).excess(B, 0.1 * B, 0.6) == 0.0  # of which a count is more


# The design


@pytest.mark.grid
def test_a_drive_that_rattles_with_the_default_gains_is_quiet_with_those_designed() -> None:
    drive = loaded(4.0)
    loop = loop_for(drive)
    case = SURE.cases(drive)[0]
    before = attempt(loop, default_choice(loop), case)
    assert before.swing > 0.3
    shares: list[float] = []
    found = design(loop, SURE, lambda _what, share: shares.append(share))
    assert found.refusal == ""
    assert 0.0 < shares[0] < 0.01
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0
    after = attempt(loop, found.choice, case)
    assert after.swing < 0.5 * QUIET
    assert after.error < 0.5 * PRECISE
    assert predicted_cycle(loop, drive, found.choice) is None
    assert found.outcomes == ((case, after),)


def test_a_load_without_encoder_and_unstable_fast_gains_are_refused() -> None:
    with pytest.raises(ValueError, match=r"sensors\.measured must have theta_l"):
        design(loop_for(NOMINAL_DRIVE, sensors=Sensors(measured=("theta_m",))), SURE)
    with pytest.raises(ValueError, match=r"gains\.fast\.k = .* is unstable at 250 Hz with a delay of 0\.022 s"):
        design(loop_for(NOMINAL_DRIVE, delay=Delay(command=0.022)), SURE)


# The command


def test_the_file_has_the_gains_whatever_the_drive_is_called() -> None:
    text = gain_text(loop_for(NOMINAL_DRIVE), Choice(Gains(1e-7, 0.0, -1.0), 2.0), "my\nlaw: fast")
    values = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert values["law"] == "two_region"
    assert values["gains"]["overdamped"]["k"] == [1e-7, 0.0, -1.0]
    assert values["laws"] == {"two_region": {"width": 2.0}}
    assert all(isinstance(value, float) for value in values["gains"]["fast"]["k"])


def test_surroundings_are_the_files(tmp_path: Path) -> None:
    file = tmp_path / "drive.yaml"
    file.write_text(
        "gear: {}\nrate: 500\nsensors: {measured: [theta_l], load_counts: 4096.0}\nloop_delay: 0.002\n"
        "gain_sets: {nominal: {fast: {k: [20.0, 0.6, 0.1]}}}\n"
    )
    around, gains = read_surroundings(file), read_start(file).settings.gains
    assert (around.rate, around.delay, gains.fast) == (500, Delay(command=0.002), Gains(20.0, 0.6, 0.1))
    assert around.sensors == Sensors(measured=("theta_l",), load_counts=4096.0)


QUICK = ["--inertia", "1", "1", "--viscous-friction", "1", "1", "--gap", "1", "1", "--load-torque", "0"]


def test_the_command_writes_files_that_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a search of few points: that the whole one finds what is quiet is a test of the grid."""
    for name, value in {"_SAMPLES": 8, "_BEST": 1, "_SIZES": (0.08,)}.items():
        monkeypatch.setattr(search, name, value)
    drive = tmp_path / "drive.yaml"
    drive.write_text("/**:\n  ros__parameters:\n    load: {inertia: 0.002}\n")
    out, figures, picture = (tmp_path / "new" / name for name in ("gains.yaml", "figures.json", "design.png"))
    words = ["design", str(drive), *QUICK, "--out", str(out), "--json", str(figures), "--plot", str(picture)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    values = yaml.safe_load(out.read_text())["/**"]["ros__parameters"]
    content = json.loads(figures.read_text())
    for region, k in content["gains"].items():
        assert values["gains"][region]["k"] == pytest.approx(k, rel=1e-5)
    assert values["laws"]["two_region"]["width"] == pytest.approx(content["width"], rel=1e-5)
    assert f"k1 {content['gains']['overdamped'][0]:.5g} V/rad" in printed
    assert content["designed"]["swing"]["worst"] < 0.5 * QUIET
    assert content["default"]["swing"]["worst"] > 0.3
    assert content["default"]["predicted_cycle"] == {
        "drives": 1,
        "of": 1,
        "worst": pytest.approx(0.7, abs=0.2),
        "where": "as described",
    }
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert {file.name for file in out.parent.iterdir()} == {"gains.yaml", "figures.json", "design.png"}
    before = out.read_bytes()
    with pytest.raises(SystemExit):
        main(words)
    assert "exists; --force overwrites it" in capsys.readouterr().err
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "options", "reason"),
    [
        ("gear: {reduction: 0.0}", [], "gear.reduction must be >= 0.001"),
        ("gear: {}\nrate: 0.0", [], "rate must be > 0 Hz and <= 2000 Hz, got 0.0"),
        ("gear: {}\nsensors: {measured: [theta_x]}", [], "sensors.measured must be of"),
        ("gear: {}\nsensors: {colour: 1.0}", [], "there is no parameter 'sensors.colour', got 1.0"),
        ("gear: {}\ngain_set_names: [a]\ngain_sets: {a: {fast: {k: [1.0]}}}", [], "gain_sets.a.fast.k must be three"),
        ("gear: {}", ["--inertia", "1.3", "0.7"], "inertia must be two factors"),
        ("gear: {}", ["--rate", "0"], "--rate must be > 0 Hz"),
        ("gear: {}", ["--delay", "-1"], "delay.command must be >= 0 s"),
        ("gear: {}", ["--delay", "0.05"], "delay must be >= 0 s and at most 10 periods"),
        ("gear: {}", ["--load-torque", "2"], "load_torque must be a share"),
    ],
)
def test_a_request_that_cannot_be_used_is_refused_and_writes_nothing(
    content: str, options: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, out = tmp_path / "drive.yaml", tmp_path / "new" / "gains.yaml"
    drive.write_text(content)
    with pytest.raises(SystemExit) as ended:
        main(["design", str(drive), *options, "--out", str(out)])
    assert ended.value.code == 2
    assert reason in capsys.readouterr().err
    assert not out.parent.exists()


@pytest.mark.grid
def test_where_nothing_is_quiet_the_best_is_written_and_marked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A load that hardly stops by itself: the worst drive is named."""
    drive, out, figures = tmp_path / "drive.yaml", tmp_path / "new" / "gains.yaml", tmp_path / "figures.json"
    drive.write_text("load: {inertia: 0.01, viscous_friction: 0.0005}\n")
    assert main(["design", str(drive), *QUICK, "--out", str(out), "--json", str(figures)]) == 1
    why = "no gains are quiet on every drive of the range: with as described"
    assert f"not quiet: {why}" in capsys.readouterr().out
    assert f"# NOT QUIET: {why}" in out.read_text()
    assert why in json.loads(figures.read_text())["not_quiet"]
    assert check_drive(drive, out).fails == ""
