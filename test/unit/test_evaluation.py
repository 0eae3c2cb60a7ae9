"""`backlash evaluate`: verdicts, the summary, and files that are the same whatever happens on the way."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_page import PAGE, filled

from backlash_ros.cli import main
from backlash_ros.commands.evaluation import report_of, table_of
from backlash_ros.commands.evaluation_effects import effects_table, with_effect
from backlash_ros.control.experiment import DriveEstimate, Method
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, IntegrationError
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.simulation import Run
from backlash_ros.studies.evaluation import task as task_module
from backlash_ros.studies.evaluation.failures import group_failures, worst_drives
from backlash_ros.studies.evaluation.population import Member, draw_member
from backlash_ros.studies.evaluation.summary import Collected, failed, summarize, wilson
from backlash_ros.studies.evaluation.task import (
    CHANGE,
    HOLD,
    STAND,
    STEP,
    Learned,
    Task,
    Verdict,
    evaluate_drive,
    first_reading,
    judge_run,
    learn,
    perform,
    prepare,
    scenario_of,
    settings_for,
    true_reading,
)
from backlash_ros.studies.judging import Move

CONFIG = Path(__file__).parents[2] / "config" / "nominal_drive.yaml"
EASY = Member(0, NOMINAL_DRIVE, Sensors(motor_counts=2.0**18, load_counts=2.0**18), Delay(), 1000.0, 0.0, 0.2)
"""The nominal drive, on which all is known."""
GOOD = Verdict(
    quiet=True,
    precise=True,
    overshoot_ok=True,
    faulted=False,
    step=Move(0.0, 0.0, 0.0, 0.2, 0.08),
    short=Move(0.0, 0.0, 0.0, 0.2, 0.08),
    peak_force=100.0,
    recover=0.1,
)
GOOD_LEARNED = Learned(valid=True, angle=0.0201, gap=0.02)


# The task.


def run_of(member: Member, position: np.ndarray, fault_sample: int = -1) -> Run:
    """Return a run in which the load takes the angles ``position``, one a sample."""
    count = position.size - 1
    state = np.zeros((count + 1, 5))
    state[:, 2] = position
    signal_ = np.zeros(count)
    fault = "LOAD_SPEED: too fast" if fault_sample >= 0 else ""
    grid = np.arange(count + 1) / member.rate
    signals = signal_, signal_, signal_, signal_, np.full(count, 7.0), position[1:]
    return Run(member.drive, "two_region", grid, state, *signals, fault, fault_sample)


def followed(member: Member) -> np.ndarray:
    """Return the angles of a load that is where it should be, always."""
    reference = scenario_of(member).reference - scenario_of(member).reference[0]
    return np.append(reference[0], reference)


def test_the_task_is_a_step_of_1_rad_one_of_5_b_and_a_change_of_the_load_torque() -> None:
    scenario = scenario_of(replace(EASY, load_torque=0.3, torque_change=-0.2))
    reference = scenario.reference - scenario.reference[0]
    assert reference.size == 23_000
    assert reference[[999, 1000, 6999, 7000, -1]].tolist() == pytest.approx([0, 1, 1, 1.1, 1.1])
    torque = np.asarray(scenario.load_torque)
    assert torque[[0, 17_999, 18_000, -1]].tolist() == pytest.approx([0.3, 0.3, 0.1, 0.1])


def test_a_load_that_is_where_it_should_be_passes() -> None:
    verdict = judge_run(EASY, scenario_of(EASY), run_of(EASY, followed(EASY)))
    assert (verdict.quiet, verdict.precise, verdict.overshoot_ok, verdict.faulted) == (True, True, True, False)
    assert verdict.step.settle < 0.002
    assert verdict.recover == 0.0
    assert verdict.peak_force == 7.0


def test_either_step_can_fail() -> None:
    b = NOMINAL_DRIVE.gear.backlash_angle
    for begin in (STAND, STAND + STEP):
        position = followed(EASY)
        grid = np.arange(position.size) / EASY.rate
        middle = (grid > begin + 1) & (grid < begin + 1.5)
        end = (grid > begin + STEP - 0.9) & (grid < begin + STEP - 0.1)
        high = judge_run(EASY, scenario_of(EASY), run_of(EASY, position + 0.3 * b * middle))
        assert (high.quiet, high.precise, high.overshoot_ok) == (True, True, False)
        swinging = position + 0.05 * b * end * np.sin(100 * grid)
        swing = judge_run(EASY, scenario_of(EASY), run_of(EASY, swinging))
        assert (swing.quiet, swing.precise, swing.overshoot_ok) == (False, True, True)
        off = judge_run(EASY, scenario_of(EASY), run_of(EASY, position - 0.2 * b * (grid > begin + 2)))
        assert (off.quiet, off.precise, off.overshoot_ok) == (True, False, True)


def test_recovery_counts_from_the_change_of_the_load_torque() -> None:
    position = followed(EASY)
    grid = np.arange(position.size) / EASY.rate
    pushed = position + 0.01 * (grid > CHANGE) * (grid < CHANGE + 0.7)
    verdict = judge_run(EASY, scenario_of(EASY), run_of(EASY, pushed))
    assert verdict.recover == pytest.approx(0.7, abs=2e-3)
    assert verdict.quiet


def test_a_faulted_run_fails_every_share() -> None:
    verdict = judge_run(EASY, scenario_of(EASY), run_of(EASY, followed(EASY), fault_sample=20_000))
    assert verdict.faulted
    assert (verdict.quiet, verdict.precise, verdict.overshoot_ok) == (False, False, False)
    assert (verdict.step.settle, verdict.recover, verdict.fault_time) == (STEP, 0.5 * HOLD, 20.0)


def test_judged_is_what_a_perfect_encoder_with_the_same_zero_and_eccentricity_reads() -> None:
    """A load that follows its encoder, eccentricity included, makes no error."""
    sensors = Sensors(
        ("theta_m", "theta_l"), load_counts=2.0**18, load_offset=0.7, load_eccentricity=0.01, eccentricity_phase=1.0
    )
    member = replace(EASY, sensors=sensors)
    scenario = scenario_of(member)
    assert scenario.reference[0] == pytest.approx(0.7 + 0.01 * math.sin(1.0), abs=member.load_count)
    grid = np.linspace(-0.1, 1.3, 100_001)
    angles = np.interp(np.append(scenario.reference[0], scenario.reference), true_reading(member, grid), grid)
    verdict = judge_run(member, scenario, run_of(member, angles))
    assert verdict.precise
    assert verdict.step.error < 1e-4


def test_with_the_motors_encoder_alone_the_zero_is_the_motors() -> None:
    member = replace(EASY, sensors=Sensors(("theta_m",), motor_counts=2.0**12, motor_offset=1.0, load_offset=3.0))
    assert first_reading(member) == pytest.approx(0.1, abs=member.load_count)
    assert true_reading(member, np.zeros(1)) == pytest.approx(0.1)


def test_learning_is_judged_by_the_gap_where_it_took_place() -> None:
    gear = replace(NOMINAL_DRIVE.gear, backlash_variation=0.3)
    member = replace(EASY, drive=replace(NOMINAL_DRIVE, gear=gear))
    learned, _ = learn(member, NOMINAL_DRIVE, settings_for(NOMINAL_DRIVE, member), ("limit_cycle",))
    assert learned.valid
    assert learned.gap == pytest.approx(0.026, rel=0.01)
    assert learned.angle == pytest.approx(learned.gap, rel=0.1)
    assert 1.0 < learned.time < 3.0


def test_the_nominal_drive_is_learned_and_the_two_region_law_uses_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Task, "member", lambda _self, _number: replace(EASY, rate=250.0))
    learned, verdicts, runs = perform(Task(1, experiments=("limit_cycle",)), 0, ("fast", "two_region"))
    assert learned.valid
    assert not verdicts["fast"].quiet
    assert verdicts["two_region"].quiet
    assert verdicts["two_region"].overshoot_ok
    assert set(runs) == {"fast", "two_region"}


@pytest.mark.parametrize(("experiments", "used"), [((), True), (("gap_probe",), False)])
def test_a_drive_is_known_by_what_identify_answers(experiments: tuple[str, ...], used: bool) -> None:
    """As in a controller: what ~/learn finds is a gap, and identifies nothing."""
    member = draw_member(3, 0, "core")
    ready = prepare(Task(3, "core", "identified", experiments=experiments), member)
    assert ready.learned.valid
    assert ready.settings.backlash_angle == ready.learned.angle
    assert ready.settings.identified == ready.learned.identified == used
    if used:
        assert ready.known.load.inertia == ready.learned.inertia == pytest.approx(member.drive.load.inertia, rel=0.05)
    else:
        assert ready.known.load == NOMINAL_DRIVE.load
        assert math.isnan(ready.learned.inertia)


def test_what_was_found_but_cannot_be_used_leaves_the_controller_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    heavy = DriveEstimate(0.02, Method.IDENTIFY, valid=True, reason="made up", drive={"load.inertia": -1.0})
    monkeypatch.setattr(task_module, "excite", lambda *_, **__: heavy)
    ready = prepare(Task(3, "core", "identified"), draw_member(3, 0, "core"))
    assert not ready.learned.valid
    assert "could not be used: load.inertia must be" in ready.learned.reason
    assert ready.known.load == NOMINAL_DRIVE.load
    assert ready.settings.backlash_angle == 0.0


def test_where_learning_is_refused_there_are_verdicts() -> None:
    """The limit cycle needs an encoder on the load."""
    value = evaluate_drive(Task(1, encoders="motor", experiments=("limit_cycle",), laws=("two_region",)), 3)
    assert not value["learned"]["valid"]
    assert "a motor encoder alone does not see the gap" in value["learned"]["reason"]
    assert set(value["laws"]) == {"fast", "two_region"}


def test_a_law_that_cannot_be_simulated_or_designed_has_its_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_args: Any, **_kwargs: Any) -> Run:
        raise IntegrationError("too stiff", 1.0, np.zeros(7))

    monkeypatch.setattr(task_module, "run", broken)
    verdict = evaluate_drive(Task(1, laws=("fast",)), 3)["laws"]["fast"]
    assert verdict["faulted"]
    assert "too stiff" in verdict["failure"]

    def refused(*_args: Any) -> None:
        raise ValueError("unstable")

    monkeypatch.setattr(task_module.Tuning, "start", refused)
    value = evaluate_drive(Task(1), 3)
    assert value["learned"]["reason"] == "unstable"
    assert {law["failure"] for law in value["laws"].values()} == {"unstable"}


# The summary.


def collected_from(values: list[dict[str, Any]], members: list[Member] | None = None) -> Collected:
    collected = Collected(("fast", "two_region"))
    for number, value in enumerate(values):
        collected.add(members[number] if members else replace(EASY, number=number), value)
    return collected


def value_of(verdict: Verdict = GOOD, learned: Learned = GOOD_LEARNED) -> dict[str, Any]:
    return {"learned": asdict(learned), "laws": {"fast": asdict(GOOD), "two_region": asdict(verdict)}}


KEYS = {
    *("quiet", "precise", "overshoot_ok", "faulted", "settle_median", "settle_p95", "settle_p95_free", "rise_ratio"),
    *("peak_force_ratio", "rise_ratio_p95", "peak_force_ratio_p95", "recover_p95"),
    *("quiet_interval", "precise_interval", "overshoot_ok_interval", "faulted_interval"),
}


@pytest.mark.parametrize(
    ("changes", "law"),
    [
        ({}, "two_region"),
        ({"model": "identified"}, "planned"),
        ({"model": "true"}, "planned"),
        ({"model": "identified", "encoders": "load"}, "planned"),
    ],
)
def test_the_default_law_is_what_auto_stands_for(changes: dict[str, Any], law: str) -> None:
    assert Task(1, **changes).default_law == law


def test_the_summary_has_every_key() -> None:
    summary = summarize(collected_from([value_of()]), "two_region")
    assert set(summary) == {
        *("learned", "learned_interval", "learned_within_5", "learned_within_5_interval", "wrong_valid"),
        *("covered", "covered_interval", "all_close", "all_close_interval", "ratio_close", "ratio_close_interval"),
        *("identified", "identified_interval", "laws", "default_law"),
    }
    assert set(summary["laws"]["fast"]) == KEYS
    assert summary["all_close"] is None
    assert summary["default_law"] == "two_region"


def test_shares_and_percentiles() -> None:
    slow = replace(GOOD, quiet=False, step=replace(GOOD.step, settle=1.0, rise=0.16), peak_force=300.0)
    summary = summarize(collected_from([value_of(), value_of(), value_of(), value_of(slow)]), "two_region")
    law = summary["laws"]["two_region"]
    assert (law["quiet"], law["precise"], law["faulted"]) == (0.75, 1.0, 0.0)
    assert law["quiet_interval"] == wilson(3, 4)
    assert law["settle_median"] == 0.2
    assert (law["rise_ratio"], law["peak_force_ratio"]) == (1.0, 1.0)
    assert law["rise_ratio_p95"] == pytest.approx(np.percentile([1, 1, 1, 2], 95))
    assert law["peak_force_ratio_p95"] == pytest.approx(np.percentile([1, 1, 1, 3], 95))


def test_a_failed_run_counts_in_every_share_and_in_no_ratio() -> None:
    summary = summarize(collected_from([value_of(), failed(("fast", "two_region"), "it hung")]), "two_region")
    law = summary["laws"]["two_region"]
    assert (law["quiet"], law["precise"], law["overshoot_ok"], law["faulted"]) == (0.5, 0.5, 0.5, 0.5)
    assert summary["learned"] == 0.5
    assert law["rise_ratio_p95"] == 1.0
    assert law["settle_p95"] == pytest.approx(np.percentile([0.2, STEP], 95))


def test_learning_is_counted_among_the_drives_whose_load_can_be_outrun() -> None:
    free, heavy = EASY, replace(EASY, load_torque=2.0)
    refused = Learned(reason="no valid cycle")
    values = [value_of(), value_of(learned=refused), value_of(learned=refused)]
    summary = summarize(collected_from(values, [free, free, heavy]), "two_region")
    assert summary["learned"] == 0.5
    assert summary["learned_interval"] == wilson(1, 2)
    assert summary["learned_within_5"] == 1.0


@pytest.mark.parametrize(
    ("angle", "bits", "close", "wrong"),
    [
        (0.0209, 18, 1.0, 0),
        (0.0211, 18, 0.0, 0),
        (0.0159, 18, 0.0, 1),
        (0.0241, 18, 0.0, 1),
        (0.0212, 12, 1.0, 0),  # one count is 0.0015 rad
        (0.0241, 11, 0.0, 0),  # two counts are 0.0061 rad
        (math.nan, 18, 0.0, 0),
    ],
)
def test_what_is_close_and_what_is_wrong(angle: float, bits: int, close: float, wrong: int) -> None:
    member = replace(EASY, sensors=replace(EASY.sensors, load_counts=2.0**bits))
    learned = replace(GOOD_LEARNED, angle=angle)
    summary = summarize(collected_from([value_of(learned=learned)], [member]), "two_region")
    assert (summary["learned_within_5"], summary["wrong_valid"]) == (close, wrong)


def test_what_does_not_exist_is_null() -> None:
    summary = summarize(collected_from([failed(("fast", "two_region"), "it hung")]), "two_region")
    assert summary["learned_within_5"] is None
    assert summary["learned_within_5_interval"] is None
    assert summary["laws"]["two_region"]["rise_ratio"] is None
    assert ["rise against fast, median", "-", "-"] in table_of(summary)


def test_the_worst_drives_lead_and_those_that_pass_are_none_of_them() -> None:
    bad = [replace(GOOD, step=replace(GOOD.step, swing=0.05 * times)) for times in (0.5, 3.0, 7.0)]
    values = [*(value_of(verdict) for verdict in bad), failed(("fast", "two_region"), "it hung")]
    assert worst_drives(collected_from(values), "two_region") == [
        {"number": 3, "times": math.inf},
        {"number": 2, "times": pytest.approx(7.0)},
        {"number": 1, "times": pytest.approx(3.0)},
    ]


def test_failures_are_grouped_with_what_they_have_in_common() -> None:
    members = [replace(EASY, number=k, rate=250.0 if k % 2 else 1000.0, load_torque=k / 100) for k in range(40)]
    rattling = replace(GOOD, quiet=False)
    groups = group_failures(
        collected_from([value_of(rattling if member.rate == 250 else GOOD) for member in members], members),
        "two_region",
    )
    assert [(group["what"], group["drives"]) for group in groups] == [("two_region: swings", 20)]
    assert groups[0]["numbers"] == list(range(1, 20, 2))
    assert groups[0]["in_common"] == [{"condition": "250 Hz", "share": 1.0, "share_of_all": 0.5}]


def test_wilson_interval() -> None:
    assert wilson(0, 0) is None
    for count, low, high in ((0, 0.0, 0.2775), (5, 0.2366, 0.7634), (10, 0.7225, 1.0)):  # Wilson's formula by hand
        assert wilson(count, 10) == pytest.approx([low, high], abs=1e-4)


def test_the_page_describes_every_key() -> None:
    summary = summarize(collected_from([value_of()]), "two_region")
    keys = {*summary, *summary["laws"]["two_region"]} - {"laws"}
    page = PAGE.read_text().replace("`laws.<name>.quiet`", "`quiet`")
    assert {key for key in keys if not key.endswith("_interval") and f"`{key}`" not in page} == set()


def test_the_page_is_filled_from_a_report(tmp_path: Path) -> None:
    collected = collected_from([value_of(), value_of(replace(GOOD, quiet=False))])
    text = filled(report_of(Task(1, laws=("fast", "two_region")), 2, collected, [], ""))
    assert "`backlash evaluate --seed 1 --drives 2 --population full " in text
    assert " --laws fast two_region --json evaluation.json`." in text
    assert "| quiet, % | 100.0 (34.2 to 100.0) | 50.0 (9.5 to 90.5) |" in text
    assert "| 1 | two\\_region: swings |" in text
    assert PAGE.read_text().count("<!-- filled: ") == 2


def test_the_default_law_is_judged_unless_others_are_named() -> None:
    assert Task(1).laws == ("fast", "overdamped", "two_region")
    assert Task(1, model="identified").laws == ("fast", "overdamped", "two_region", "planned")
    assert Task(1, model="identified", laws=("fast",)).laws == ("fast",)
    task = Task(1, model="identified")
    collected = Collected(task.laws)
    collected.add(EASY, {"learned": asdict(GOOD_LEARNED), "laws": dict.fromkeys(task.laws, asdict(GOOD))})
    report = report_of(task, 1, collected, [], "")
    assert report["judged_law"] == report["summary"]["default_law"] == "planned"
    assert all("--laws" not in each["command"] for each in report["worst"])


@pytest.mark.parametrize(("uncertainty", "covered"), [(0.00004, 0.0), (0.00006, 1.0), (0.0, 0.0)])
def test_covered_is_a_gap_within_two_of_its_standard_uncertainties(uncertainty: float, covered: float) -> None:
    """The learned one is off by 0.0001 rad."""
    value = value_of(learned=replace(GOOD_LEARNED, uncertainty=uncertainty))
    assert summarize(collected_from([value]), "two_region")["covered"] == covered


def test_each_effect_is_a_row() -> None:
    reports = {}
    for name in ("none", "cogging"):
        task = with_effect(Task(4, "core", laws=("fast", "two_region")), name)
        assert task.effects == (() if name == "none" else ("cogging",))
        reports[name] = report_of(task, 1, collected_from([value_of()]), [], "")
    head, *rows = effects_table({"effects": reports})
    assert [row[0] for row in rows] == ["none", "cogging"]
    assert dict(zip(head, rows[1], strict=True))["quiet, %"] == "100"


def test_replayed_drive_has_its_effect() -> None:
    task = with_effect(Task(4, "core", laws=("fast", "two_region")), "cogging")
    report = report_of(task, 1, collected_from([value_of(replace(GOOD, faulted=True))]), [], "")
    assert "--population core --laws fast two_region --effects cogging --only 0" in report["worst"][0]["command"]


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--effects", "coging"], "--effects: invalid choice: 'coging'"),
        (["--effects", "cogging", "--out", "x"], "--out: has no use with --effects"),
    ],
)
def test_effects_that_make_no_sense_are_refused(
    more: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(command(tmp_path, *more))
    assert text in " ".join(capsys.readouterr().err.split())


# The command.


BRIEF = ("--laws", "fast", "--experiments", "limit_cycle")
"""One law, and learning that takes a tenth of a second a drive: enough where it is asked how drives are handed out and
put down."""


def command(folder: Path, *more: str, drives: int = 2) -> list[str]:
    return ["evaluate", "--seed", "1", "--drives", str(drives), "--json", str(folder / "result.json"), *more]


@pytest.mark.grid
@pytest.mark.population
def test_the_same_command_gives_the_same_files(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    import pyarrow.parquet  # noqa: PLC0415

    files = []
    for name in ("first", "second"):
        folder = tmp_path / name
        assert main(command(folder, "--out", str(folder / "out"), "--laws", "two_region", *BRIEF[2:])) == 0
        assert {path.name for path in folder.iterdir()} == {"result.json", "out"}
        assert {path.name for path in (folder / "out").iterdir()} == {"runs.parquet", "shares.png", "settling.png"}
        files.append({path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()})
    assert files[0] == files[1]
    content = json.loads(files[0]["result.json"])
    assert (content["seed"], content["drives"], content["laws"]) == (1, 2, ["two_region"])
    assert set(content["summary"]["laws"]) == {"two_region"}
    table = pyarrow.parquet.read_table(tmp_path / "first" / "out" / "runs.parquet")
    assert table.num_rows == 4  # the fast law is run besides: ratios refer to it
    rows = table.to_pylist()
    assert [(row["number"], row["law"]) for row in rows[:2]] == [(0, "fast"), (0, "two_region")]
    for row in rows:
        drawn = draw_member(1, row["number"]).parameters()
        assert {name: row[name] for name in drawn} == drawn


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What a brief batch gives where nothing happens to it."""
    folder = tmp_path_factory.mktemp("undisturbed")
    assert main(command(folder, *BRIEF, drives=8)) == 0
    return (folder / "result.json").read_bytes()


@pytest.mark.grid
def test_a_batch_that_was_killed_ends_in_the_same_file(tmp_path: Path, undisturbed: bytes) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    killed = tmp_path / "killed"
    arguments = [sys.executable, "-m", "backlash_ros.cli", *command(killed, *BRIEF, drives=8)]
    first = subprocess.Popen(arguments, env=environment, stdout=subprocess.DEVNULL)
    end = time.monotonic() + 120
    while not (journals := list(killed.glob(".result.json.*.journal"))) or journals[0].read_bytes().count(b"\n") < 2:
        assert time.monotonic() < end
        assert first.poll() is None
        time.sleep(0.02)
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert not (killed / "result.json").exists()
    resumed = subprocess.run(arguments, env=environment, capture_output=True, text=True, check=True, timeout=600)
    assert "of 8 drives are in" in resumed.stdout
    assert (killed / "result.json").read_bytes() == undisturbed
    assert [path.name for path in killed.iterdir()] == ["result.json"]


def test_one_drive_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = tmp_path / "drive_2.png"
    words = ["evaluate", "--seed", "1", "--only", "3", "--laws", "two_region", *BRIEF[2:], "--plot", str(plot)]
    assert main(words) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["parameters"]["number"] == 3
    assert set(content["laws"]) == {"two_region"}
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--drives", "3", "--json", "x"], "the following arguments are required: --seed"),
        (["--seed", "-1", "--only", "1"], "argument --seed: must be a whole number >= 0, got '-1'"),
        (["--seed", "1", "--drives", "0", "--json", "x"], "argument --drives: must be a whole number >= 1, got '0'"),
        (["--seed", "1", "--drives", "3"], "argument --json: must be given without --only"),
        (["--seed", "1", "--drives", "3", "--json", "x", "--plot", "p"], "argument --plot: needs --only"),
        (["--seed", "1", "--only", "1", "--model", "best"], "argument --model: invalid choice: 'best'"),
        (["--seed", "1", "--only", "1", "--laws", "best"], "argument --laws: must be one of ['auto', 'cascade', "),
        (
            ["--seed", "1", "--only", "1", "--experiments", "best"],
            "argument --experiments: must be one of ['auto', 'gap_map', ",
        ),
        (["--seed", "1", "--only", "1", "--population", "best"], "argument --population: invalid choice: 'best'"),
        (["--seed", "1", "--only", "1", "--drive", "/nowhere"], "/nowhere: No such file or directory"),
        (["--seed", "1", "--only", "1", "--json", "x"], "argument --json: has no use with --only"),
        (["--seed", "1", "--drives", "3", "--json", "/proc/x/y"], "argument --json: must be writable"),
        (
            ["--seed", "1", "--drives", "3", "--json", "x", "--out", "/dev/null"],
            "argument --out: must be writable",
        ),
        (["--seed", "1", "--drives", "1", "--json", "x", "--scheduler", "nonsense"], "no scheduler at 'nonsense'"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code: Any = main(["evaluate", *arguments])
    except SystemExit as error:
        code = error.code
    assert code == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_failed_is_in_the_report_with_its_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that raises, in the worker: its drive has a verdict all the same."""
    plugin = tmp_path / "broken_law.py"
    plugin.write_text(
        "from backlash_ros.control.law import NamedLaw\n"
        "def design(drive, settings, parameters):\n"
        "    raise RuntimeError('a law with a bug')\n"
        "LAWS = {'broken': NamedLaw('broken', design)}\n"
    )
    monkeypatch.setenv("BACKLASH_ROS_PLUGINS", str(plugin))
    from backlash_ros.control import LAWS  # noqa: PLC0415

    LAWS.add(plugin)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0})  # one worker is enough
    assert main(command(tmp_path, *BRIEF, "--laws", "broken")) == 0
    content = json.loads((tmp_path / "result.json").read_text())
    assert [each["failure"] for each in content["failed_runs"]] == ["RuntimeError: a law with a bug"] * 2
    assert content["failed_runs"][1]["parameters"]["number"] == 1
    assert content["summary"]["laws"]["broken"]["faulted"] == 1.0
    assert content["worst"][0]["times"] is None
    assert "2 drives could not be run" in capsys.readouterr().out


@pytest.mark.grid
@pytest.mark.population
def test_a_cluster_writes_the_same_file(tmp_path: Path, undisturbed: bytes) -> None:
    distributed = pytest.importorskip("distributed")
    environment = {"PYTHONPATH": os.pathsep.join(sys.path)}
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None, env=environment
    ) as cluster:
        address = cluster.scheduler_address
        assert main(command(tmp_path, "--scheduler", address, *BRIEF, drives=8)) == 0
    assert (tmp_path / "result.json").read_bytes() == undisturbed


def test_a_drive_from_a_parameter_file(tmp_path: Path) -> None:
    assert Drive.read(CONFIG) == NOMINAL_DRIVE
    own = tmp_path / "own.yaml"
    own.write_text(
        "motor: {resistance: 3.0, inertia: 3e-5}\ncommand_interface: current\n"
        "contact: {law: elastic, elastic: {damping: 7.0}}\n"
    )
    drive = Drive.read(own)
    assert drive.motor == replace(NOMINAL_DRIVE.motor, resistance=3.0, inertia=3e-5)
    assert (type(drive.gear.contact).__name__, drive.takes_current) == ("ElasticContact", True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("motor: {resistance: -1.0}", "motor.resistance must be > 0 ohm"),
        (
            "motor: {resistence: 1.0}",
            "'motor.resistence', got 1.0: did you mean 'motor.resistance'?",
        ),
        ("gear: 3", "there is no parameter 'gear', got 3"),
        ("load: {}\ncontact: {law: rubber}", "contact.law must be one of"),
        ("nothing: here", "must have ROS parameters of motor, gear or load"),
        ("motor: {", "expected the node content"),
        (
            "load: {}\nmotor:\n  inertia: 1.0\n  inertia: 2.0",
            "line 4: the key 'inertia' appears twice, first in line 3",
        ),
        ("load: {inertia: 1.0}\nload.inertia: 2.0", "load.inertia must be given once, in its section or"),
        ("load:\n  # inertia: 1.0", "load must be a name, with a value, got none"),
        ("1: 2", "1 must be a name, with a value"),
        ("motor: {inertia: 2026-01-31}", "line 1: must be a number, true, false or text between quotes"),
        ("motor: &a {}\nload: *a", "line 2: ROS has no aliases"),
        ("motor: {inertia: \x00}", "may not be in YAML"),
        ("[" * 5000, "too many levels"),
        (
            "motor: {inertia: 1" + 400 * "0" + "}",
            "line 1: '1000000000000000000000000000000000000000' cannot be read as int",
        ),
    ],
)
def test_a_parameter_file_that_is_refused(text: str, message: str, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(text)
    with pytest.raises(ValueError, match=r"own\.yaml: ") as refused:
        Drive.read(own)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
