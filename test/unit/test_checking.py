"""`backlash check`: a drive file's figures, its warnings with what to do, and what is refused."""

import json
import math
from pathlib import Path

import pytest
import yaml

from backlash_ros.cli import main
from backlash_ros.studies.check import check_drive

ROOT = Path(__file__).parents[2]
ENDS = {"limits": {"position_lower": -3.0, "position_upper": 3.0}}


def file_of(folder: Path, **sections: object) -> Path:
    path = folder / "drive.yaml"
    nominal = {"gear": {"reduction": 10.0}, **ENDS}
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": nominal | sections}}))
    return path


def test_a_sound_drive_has_figures_and_no_warning(tmp_path: Path) -> None:
    checked = check_drive(file_of(tmp_path))
    assert checked.fails == ""
    assert checked.warnings == ()
    assert checked.figures["torque at standstill"] == "6 N m at the output"
    assert checked.figures["load's inertia over the motor's"].startswith("0.25,")
    assert checked.figures["margins of the fast gains"] == "90 deg of phase, 19.5 ms of delay, at 250 Hz"


@pytest.mark.parametrize(
    ("sections", "what", "remedy"),
    [
        ({"load": {"inertia": 2e-3}}, "1 times the motor's inertia", "backlash design"),
        ({"motor": {"torque_constant": 50.0}}, "the motor turns at 0.48 rad/s without load", "1 mN m/A is 1e-3"),
        ({"gear": {"reduction": 10.0, "backlash_angle": 1.0}}, "the gap is 1 rad", "1 deg is 0.0175"),
        ({"motor": {"inductance": 2.0}}, "the winding takes motor.inductance / motor.resistance = 1 s", "1 mH is 1e-3"),
        (
            {"load": {"inertia": 0.5}},
            "2.5e+02 times the motor's inertia, seen from the output: few",
            "1 g cm^2 is 1e-7",
        ),
        ({"load": {"inertia": 1e-2}}, "load.inertia / load.viscous_friction = 2 s", "load.coulomb_friction"),
        ({"load": {"viscous_friction": 0.0}}, "load.viscous_friction = inf s", "load.coulomb_friction"),
        ({"motor": {"inertia": 2.0}}, "2.5e-06 times the motor's inertia", "gear.reduction"),
        ({"load": {"gravity_torque": 0.1}}, "a command of 0 does not hold it", "brake"),
        ({"load": {"gravity_torque": 5.5}}, "5.5 N m of 6 N m at standstill", "stronger motor"),
        ({"sensors": {"load_counts": 4096.0}}, "13 counts of the load's encoder", "finer encoder"),
        ({"sensors": {"measured": ["theta_m"]}}, "the load has no encoder", "call identify"),
        (
            {"sensors": {"measured": ["theta_m"], "motor_counts": 512.0}},
            "16 counts of the only encoder",
            "set law: two_region",
        ),
        ({"limits": {}}, "no ends", "limits.position_lower"),
        ({"loop_delay": 0.014}, "fast gains tolerate less", "lower the weights"),
    ],
)
def test_each_warning_says_what_to_do(tmp_path: Path, sections: dict[str, object], what: str, remedy: str) -> None:
    warnings = check_drive(file_of(tmp_path, **sections)).warnings
    (found,) = [warning for warning in warnings if what in warning.what]
    assert remedy in found.remedy


@pytest.mark.parametrize(("measured", "designs"), [(["theta_l"], True), (["theta_m"], False)])
def test_no_remedy_needs_an_encoder_that_is_not_there(tmp_path: Path, measured: list[str], *, designs: bool) -> None:
    sensors = {"measured": measured, "load_counts": 4096.0, "motor_counts": 256.0}
    checked = check_drive(file_of(tmp_path, load={"inertia": 2e-3}, sensors=sensors))
    remedies = [warning.remedy for warning in checked.warnings]
    assert any(remedy.startswith("leave law at auto and call identify") for remedy in remedies)
    assert any("backlash design" in remedy for remedy in remedies) == designs
    assert not any("two encoders" in remedy for remedy in remedies)


def test_a_load_that_dry_friction_stops_does_not_drift(tmp_path: Path) -> None:
    path = file_of(tmp_path, load={"inertia": 1e-2, "coulomb_friction": 0.02})
    assert not any("viscous" in warning.what for warning in check_drive(path).warnings)


def test_gains_that_would_be_refused_fail(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = file_of(tmp_path, gain_sets={"nominal": {"fast": {"q": [1e6, 0.0]}}}, loop_delay=0.02)
    assert main(["check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "fails: " in said
    assert "unstable" in said
    assert "  -> stable with gain_sets.nominal.fast.q of [" in said


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"motor": {"resistance": -2.0}}, "motor.resistance must be > 0 ohm and <= 1e+06 ohm, got -2.0"),
        ({"gear": {"ratio": 0.1}}, "there is no parameter 'gear.ratio', got 0.1: did you mean 'gear.reduction'?"),
        (
            {"moter": {"inertia": 1e-5}},
            "there is no parameter 'moter.inertia', got 1e-05: did you mean 'motor.inertia'?",
        ),
        ({"rates": 500.0}, "there is no parameter 'rates', got 500.0: did you mean 'rate'?"),
        ({"law": "plan"}, "'planned', 'switched_linear', 'two_region'], got 'plan'"),
        ({"load": {"inertia": math.nan}}, "load.inertia must be a finite number, >= 1e-09 kg m^2"),
        ({"sensors": {"measured": 3}}, "sensors.measured must be a list with something in it, got 3"),
        ({"gain_set_names": []}, "gain_set_names must be a list with something in it, got []"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_one_line(
    tmp_path: Path, sections: dict[str, object], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["check", str(file_of(tmp_path, **sections))])
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        *(["check"], ["design"], ["simulate"], ["export", "--format", "urdf"]),
        *(["evaluate", "--seed", "1", "--only", "0", "--drive"], ["identify", "axis.csv", "--drive"]),
    ],
)
def test_no_command_takes_a_misspelled_drive_for_the_nominal_one(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy")  # only the nodes know all names
    try:
        code = main([*words, str(file_of(tmp_path, moter={"inertia": 1e-5}))])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert "drive.yaml: there is no parameter 'moter.inertia'" in capsys.readouterr().err


def test_whoever_has_chosen_gains_is_not_told_to_choose_some(tmp_path: Path) -> None:
    heavy, gains = file_of(tmp_path, load={"inertia": 2e-3}), tmp_path / "gains.yaml"
    gains.write_text("/**: {ros__parameters: {gains: {overdamped: {k: [4.0, 0.4, 0.1]}}}}")
    assert [len(check_drive(*files).warnings) for files in ((heavy,), (heavy, gains))] == [1, 0]


def test_the_gains_of_a_design_are_checked_with_its_drive(tmp_path: Path) -> None:
    """A later file overrides an earlier one, as for a node."""
    drive, gains = file_of(tmp_path), tmp_path / "gains.yaml"
    gains.write_text("/**: {ros__parameters: {law: two_region, gains: {fast: {k: [10.0, 0.4, 0.1]}}}}")
    margins = "margins of the fast gains"
    assert check_drive(drive, gains).figures[margins] != check_drive(drive).figures[margins]
    with pytest.raises(ValueError, match=r"gains.yaml: must have ROS parameters of motor, gear or load"):
        check_drive(gains)


BUS_SERVO = {
    "rate": 100.0,
    "motor": {"resistance": 4.44, "torque_constant": 7.2e-3, "inertia": 1e-7, "viscous_friction": 1e-7}
    | {"inductance": 5e-4, "voltage_limit": 12.0},
    "gear": {"reduction": 345.0, "backlash_angle": 0.0175},
    "load": {"inertia": 5e-3, "viscous_friction": 1e-2, "gravity_torque": 0.5},
    "sensors": {"measured": ["theta_l"], "load_counts": 4096.0},
}
"""A servo with the load's encoder alone, whose arm has a weight."""


def sags(folder: Path, **sections: object) -> list[str]:
    """Return what is warned of a load that is held off its target, with the remedy."""
    warnings = check_drive(file_of(folder, **BUS_SERVO | sections)).warnings
    return [f"{each.what} -> {each.remedy}" for each in warnings if "off its target" in each.what]


def test_a_weight_that_pulls_the_load_off_its_target_is_said_with_how_far(tmp_path: Path) -> None:
    """The simulation of the next test ends there."""
    (sag,) = sags(tmp_path)
    assert "with the load's encoder alone, until identify has run, weight holds the load up to 28.3 mrad" in sag
    assert "28.3 mrad, 97.3 arcmin or 1.6 b, off" in sag
    assert "call identify, or measure the motor's shaft as well" in sag
    assert sags(tmp_path, sensors={"measured": ["theta_m", "theta_l"], "load_counts": 4096.0}) == []
    assert sags(tmp_path, load={"inertia": 5e-3, "viscous_friction": 1e-2}) == []


def test_losses_and_friction_make_it_more_and_a_lower_torque_bandwidth_is_a_cause(tmp_path: Path) -> None:
    lossy = {**BUS_SERVO["gear"], "efficiency_forward": 0.44, "efficiency_backward": 0.4}
    (sag,) = sags(tmp_path, gear=lossy)
    assert "weight and the losses of the gear hold the load up to 64.4 mrad" in sag
    heavy = {**BUS_SERVO["load"], "coulomb_friction": 0.1}
    (sag,) = sags(tmp_path, load=heavy)
    assert "weight and friction hold the load up to 34 mrad" in sag
    (sag,) = sags(tmp_path, torque_bandwidth=0.0, sensors={"measured": ["theta_m", "theta_l"]})
    assert "with torque_bandwidth 0 weight" in sag
    assert "-> set torque_bandwidth to 40" in sag
    warnings = check_drive(file_of(tmp_path, **BUS_SERVO | {"gear": lossy})).warnings
    assert any("lets through 40 % of the torque" in each.what for each in warnings)


def test_the_load_of_a_simulation_sags_as_far_as_check_says_until_it_is_identified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = file_of(tmp_path, **BUS_SERVO)

    def end_of(*words: str) -> float:
        assert main(["simulate", str(path), "--reference", "1.5", *words]) == 0
        return float(json.loads(capsys.readouterr().out)["final_error_b"])

    assert end_of("--law", "two_region") == pytest.approx(-1.6, abs=0.1)
    assert abs(end_of()) <= 0.1
    error = check_drive(path).figures["error of a load at rest"]
    assert error.startswith("1.8 mrad, 6 arcmin, on 19 of 20 drives")
    assert "drawn at random (docs/evaluation.md), once identified" in error


@pytest.mark.parametrize(
    "place",
    [
        *("config/nominal_drive.yaml", "docs/examples/axis.yaml"),
        *("docs/examples/low_resistance_actuator.yaml", "docs/examples/harmonic_drive.yaml"),
    ],
)
def test_files_of_ours_are_stable(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(ROOT / place)]) == 0
    assert "the loop is stable" in capsys.readouterr().out
