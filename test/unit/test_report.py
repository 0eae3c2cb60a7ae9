"""`backlash report`: figures known in advance come back from bags of any drive, and what is missing is said."""

import base64
import gzip
import json
import math
import re
import shlex
import shutil
import sqlite3
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import reported
from made_report import Made, report
from plain_bag import START, PlainBag
from recorded import probed, true_gap, write_bag, write_drive
from reported import CYCLE, DAMPING, END, FIRST, FOREIGN, FREQUENCY, HEIGHT, LOST, PEAK, PERIOD, SECOND, B
from rosbags.rosbag2 import StoragePlugin

from backlash_ros.cli import main
from backlash_ros.pages.report import charts
from backlash_ros.pages.report.charts import Chart, ChartBook, Line, Panel, thinned
from backlash_ros.pages.report.cures import cure
from backlash_ros.pages.report.steps import Step
from backlash_ros.pages.report.timing import last_quiet, late_answers
from backlash_ros.pages.report.yardstick import limit_cycle
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.recordings.bag import Series

DEGREE = math.pi / 180.0
NASTY = "</script><script>alert('&\"')</script>"


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the one line with which the command refuses."""
    try:
        code = main(["report", *words])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    return said


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with somebody else's bag, as mcap and as sqlite3, and one of three axes."""
    folder = tmp_path_factory.mktemp("bags")
    foreign = reported.foreign_bag()
    foreign.write(folder / "foreign")
    foreign.write(folder / "foreign_db", StoragePlugin.SQLITE3)
    reported.axes_bag([f"/axis{k}" for k in range(1, 4)]).write(folder / "three")
    reported.write_drive(folder)
    return folder


@pytest.fixture(scope="module")
def foreign(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> Made:
    options = [*FOREIGN, "--drive", str(bags / "their_drive.yaml"), "--backlash-angle", str(B * DEGREE)]
    return report(bags / "foreign", tmp_path_factory.mktemp("foreign"), *options)


@pytest.fixture(scope="module")
def three(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> Made:
    return report(bags / "three", tmp_path_factory.mktemp("three"))


def crossing(level: float) -> float:
    """Return when the second-order response first reaches a level."""
    time = np.linspace(0.0, 1.0, 1_000_001)
    return float(time[np.argmax(reported.second_order(time) >= level)])


def test_a_second_order_step_has_the_figures_of_its_formula(foreign: Made) -> None:
    step = foreign.axis["steps"][0]
    assert step["start"] == pytest.approx(FIRST, abs=1e-6)
    assert step["target"] == pytest.approx(HEIGHT * DEGREE)
    line = (
        reported.NATURAL**2 * PERIOD**2 / 8.0 / 7.0
    )  # of straight lines between samples, where it rises by 7 a second
    assert step["rise"] == pytest.approx(crossing(0.9) - crossing(0.1), abs=1.5 * line)
    overshoot = HEIGHT * math.exp(-math.pi * DAMPING / math.sqrt(1.0 - DAMPING**2))
    assert step["overshoot"] == pytest.approx(overshoot * DEGREE, rel=2e-3)
    assert step["overshoot_b"] == pytest.approx(overshoot / B, rel=2e-3)
    time = np.linspace(0.0, SECOND - FIRST, 300_001)
    off = HEIGHT * np.abs(reported.second_order(time) - 1.0)
    assert step["settling"] == pytest.approx(time[np.flatnonzero(off > 0.25 * B)[-1]], abs=PERIOD)
    last = HEIGHT * reported.second_order(time[time > SECOND - FIRST - 1.0])
    assert step["residual"] == pytest.approx(np.ptp(last) * DEGREE, abs=1e-7)
    assert step["frequency"] is None
    assert step["impacts"] == 0
    assert step["peak_torque"] == pytest.approx(1e-3 * PEAK)
    assert step["peak_speed"] == pytest.approx(reported.SPEED * math.pi / 30.0)


def test_a_limit_cycle_has_its_amplitude_its_frequency_and_its_impacts(foreign: Made) -> None:
    step = foreign.axis["steps"][1]
    assert step["amplitude"] == pytest.approx(CYCLE * DEGREE, rel=5e-3)
    assert step["amplitude_b"] == pytest.approx(CYCLE / B, rel=5e-3)
    assert step["frequency"] == pytest.approx(FREQUENCY, rel=2e-3)
    assert step["residual"] == step["amplitude"]
    assert step["settling"] is None
    assert step["impacts"] == 2.0 * FREQUENCY * (END - reported.MEETING)


def test_a_step_says_where_its_samples_were_late(foreign: Made) -> None:
    first, second = foreign.axis["steps"]
    assert not first["late_rising"]
    assert not first["late_rest"]
    assert second["late_rest"]  # ten samples are lost in its second half
    assert "Step 2: never 1.3 s without a late sample at its end" in foreign.page.text


def test_timing_is_as_the_bag_was_made(foreign: Made) -> None:
    timing = foreign.axis["timing"]
    count = round(END / PERIOD)
    assert timing["samples"] == count - len(LOST)
    assert timing["lost"] == timing["holes"] == len(LOST)
    assert timing["rate"] == pytest.approx(1.0 / PERIOD, rel=1e-3)
    assert timing["jitter"] == pytest.approx(2.0 * reported.JITTER, rel=0.01)
    assert timing["longest"] == pytest.approx(2.0 * PERIOD, rel=1e-4)
    assert timing["age"] == pytest.approx(np.mean(reported.AGES), rel=5e-3)
    assert timing["age_most"] == pytest.approx(max(reported.AGES), rel=1e-3)
    assert timing["answers"] == count - len(LOST)


def test_the_page_says_what_the_numbers_say(foreign: Made) -> None:
    text, step = foreign.page.text, foreign.axis["steps"][0]
    for name in ("rise", "settling"):
        assert f"{step[name]:.3g}" in text
    assert f"{step['overshoot_b']:.3f}" in text
    assert "Begun 2023-11-14 22:13:20 UTC" in text
    assert f"{B * DEGREE:.5g} rad, from --backlash-angle" in text
    assert "drive_shaft, table" in text
    assert f"{foreign.axis['steps'][1]['amplitude_b']:.3f} at {foreign.axis['steps'][1]['frequency']:.3g}" in unescape(
        text.replace("\u00a0", " ")
    )


def test_a_step_ends_in_one_way_and_the_law_that_acted_is_named(tmp_path: Path) -> None:
    """Of three steps of one law the first one swings within the band, and the last one is too short to judge."""
    bag, starts, b = PlainBag(), (1.0, 5.0, 9.0, 9.8), 0.02
    bag.in_use("/controller/parameters_in_use", 0.0, 1, reported.in_use("auto", b))
    for k in range(2500):
        time = 0.004 * k
        target = float(np.searchsorted(starts, time, side="right") % 2)
        swing = 0.1 * b * math.sin(50.0 * time) if 1.1 < time < 5.0 else 0.0
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, target + swing if time < 9.8 else 0.5))
        state = {"reference": target, "holding": 1.0, "backlash_angle": b, "phase": float(5.0 < time < 5.2)}
        bag.status("/controller/state", time, "servo", state)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert 'verdict bad">4 steps: 2 settled, 1 ended in a limit cycle, 1 ended too soon to tell.' in made.html
    assert re.search(
        r"Step 1 with law two_region swung: 0\.\d+ b peak to peak, at [\d.]+.Hz\. To end it, identify", made.page.text
    )
    laws = [(step["law"], step["gain_set"]) for step in made.axis["steps"]]
    assert laws == [("two_region", "nominal"), ("planned", ""), *[("two_region", "nominal")] * 2]
    first, *_, last = re.findall(r'<th scope="row"><a href="#chart-\d">.*?</tr>', made.html)
    assert [re.search('data-name="settled, s">([^<]*)', row)[1] for row in (first, last)] != ["never", "never"]
    heights = [float(each) for each in re.findall(r" ([\d.]+)", re.search(' d="M([^"]*)', first)[1])]
    assert max(heights[80:]) - min(heights[80:]) == pytest.approx(32 * 0.1, abs=0.3)  # of 2 b


@pytest.mark.parametrize(
    ("law", "gap", "do"),
    [
        ("two_region", 0.0, "learn the backlash"),
        ("fast", 0.0, "learn the backlash, and choose law auto"),
        ("fast", 0.02, "choose law auto"),
        ("cascade", 0.02, ""),
        ("", None, ""),
    ],
)
def test_what_ends_a_limit_cycle_depends_on_the_law_and_on_what_it_knew(law: str, gap: float | None, do: str) -> None:
    told = {} if gap is None else {"backlash_angle": Series(np.array([0.0, 1.0]), np.array([0.0, gap]))}
    axis = cast("Axis", SimpleNamespace(state=told))
    assert cure(axis, Step(0.0, 2.0, 0.0, 1.0, law=law)) == do


@pytest.mark.population
def test_each_axis_begins_with_how_it_went(foreign: Made, three: Made) -> None:
    """And with what puts it in doubt."""

    def verdicts(made: Made) -> list[str]:
        return [unescape(said) for said in re.findall(r'<p class="(verdict[^<]*)', made.html)]

    assert verdicts(foreign) == [
        'verdict bad">2 steps: 1 settled, 1 ended in a limit cycle. Step 2 swung: 0.800 b peak to peak, at 8\u00a0Hz.',
        'verdict bad">of 1750 samples 10 are missing and 10 were not answered within their period: what the load does '
        "here may be due to the machine's timing.",
    ]
    assert verdicts(three)[0].endswith("at 31.3\u00a0Hz. To end it, choose law auto.")
    assert verdicts(three)[1:4] == [
        'verdict bad">1 step: 1 did not settle.',
        'verdict bad">1 fault: LOAD_JUMP.',
        'verdict">1 step: 1 settled.',
    ]


def test_the_page_is_whole_and_loads_nothing(foreign: Made, three: Made) -> None:
    for made in (foreign, three):
        assert not re.search(r"""(src|href)\s*=\s*["']?\s*(https?:)?//""", made.html)
        assert all(reference.startswith("#") for reference in made.page.references)
        assert {reference[1:] for reference in made.page.references} <= set(made.page.ids)
        assert len(made.page.ids) == len(set(made.page.ids))
        assert "src" not in {name for script in made.page.scripts for name in script}
        assert len(made.html) < 2_000_000
        assert "<noscript>" in made.html
        pictures = len(re.findall(r'<figure class="chart"|<svg class="sketch"', made.html))
        assert made.html.count('role="img" aria-label="') == pictures > 4


def test_sqlite3_bags_are_read_as_well(bags: Path, foreign: Made, tmp_path: Path) -> None:
    options = [*FOREIGN, "--drive", str(bags / "their_drive.yaml"), "--backlash-angle", str(B * DEGREE)]
    made = report(bags / "foreign_db", tmp_path, *options)
    assert made.content["axes"] == foreign.content["axes"]


def test_each_axis_has_its_section_and_its_own_events(three: Made) -> None:
    axes = three.content["axes"]
    assert [axis["name"] for axis in axes] == [f"/axis{k}" for k in range(1, 4)]
    assert {f"axis-{k}" for k in range(1, 4)} <= set(three.page.ids)
    for k, axis in enumerate(axes):
        (step,) = axis["steps"]
        assert step["law"] == reported.LAWS[k % 3]
        assert [fault["name"] for fault in axis["faults"]] == (["LOAD_JUMP"] if k == 1 else [])
        assert axis["backlash_angle"] == pytest.approx(0.02)
        (change,) = axis["changes"]
        assert change["values"] == {"law": [reported.LAWS[k % 3], "cascade"]}
        (run,) = axis["learning_runs"]
        assert (run["start"], run["learned"]) == (pytest.approx(0.0), pytest.approx(0.02))
        assert axis["timing"]["lost"] == 0
        assert axis["timing"]["answered"] == pytest.approx(3e-4, rel=1e-2)
    fast, overdamped, both = (axis["steps"][0] for axis in axes)
    assert fast["amplitude_b"] == pytest.approx(0.80, abs=0.02)  # as eight samples in a cycle see 0.86
    assert both["rise"] == pytest.approx(fast["rise"], rel=0.05)
    assert overdamped["rise"] > 5.0 * both["rise"]
    assert both["residual_b"] < 0.05
    assert fast["impacts"] > 50 > both["impacts"]
    assert not any(step["late_rising"] or step["late_rest"] for axis in axes for step in axis["steps"])
    assert axes[1]["steps"][0]["ended_by"] == "the fault LOAD_JUMP"
    (warned,) = three.content["diagnostics"]
    assert (warned["times"], warned["text"]) == (2, "3 samples late within 1.0 s")


def test_an_axis_in_the_root_has_its_own_topics_alone(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(300):
        for space, angle in (("", 1.0), ("/axis1", 2.0)):
            bag.sample(f"{space}/joint_states", 0.004 * k, ("motor", "load"), (0.0, angle * (k > 110)))
            bag.numbers(f"{space}/command", 0.004 * k + 1e-3, (0.0,))
    for space, target in (("", 1.0), ("/axis1", 2.0)):
        bag.number(f"{space}/reference", 0.0, 0.0)
        bag.number(f"{space}/reference", 0.4, target)
    axes = report(bag.write(tmp_path / "bag"), tmp_path).content["axes"]
    assert [axis["command"] for axis in axes] == ["/command", "/axis1/command"]
    assert [axis["steps"][0]["target"] for axis in axes] == [1.0, 2.0]


@pytest.mark.parametrize("lockstep", [False, True])
def test_in_lockstep_no_answer_is_late_whenever_it_was_recorded(tmp_path: Path, lockstep: bool) -> None:
    bag = PlainBag()
    bag.in_use("/plant_simulator/parameters_in_use", 0.0, 1, {"lockstep": lockstep})
    for k in range(1000):
        stamp, received = 0.004 * k - 1000.0, 0.001 * k  # a clock of its own
        late = 0.0012 if k % 50 == 25 else 0.0008
        bag.sample("/joint_states", stamp, ("motor", "load"), (0.0, 1.0 * (k > 110)), received=received)
        bag.numbers("/command", received + late, (0.0,), answers=stamp)
    bag.number("/reference", 0.0, 0.0)
    bag.number("/reference", 0.1, 1.0)
    axis = report(bag.write(tmp_path / "bag"), tmp_path).axis
    assert axis["timing"]["answers"] == 1000
    assert (axis["timing"]["unanswered"] == 0) is lockstep


def test_late_answers_are_those_that_come_after_the_next_sample() -> None:
    samples = np.array([0.0, 1.0, 2.0, 3.0])
    assert late_answers(samples, np.array([0.1, 2.1, 2.2])).tolist() == [1.0]
    assert late_answers(samples, np.array([0.1, 1.1, 2.1])).tolist() == []


def test_rest_is_judged_where_the_loop_ran_as_it_should() -> None:
    samples = 0.004 * np.arange(1001)
    assert last_quiet(samples, samples + 0.001, 2.0) == samples[-1]
    assert last_quiet(samples, np.delete(samples + 0.001, 900), 2.0) == samples[900]
    assert last_quiet(samples, np.delete(samples + 0.001, range(500, 1000, 50)), 2.0) is None


def test_without_options_a_foreign_bag_says_what_it_lacks(bags: Path, tmp_path: Path) -> None:
    made = report(bags / "foreign", tmp_path)
    assert made.axis["steps"] == []
    assert made.axis["timing"]["lost"] == len(LOST)
    said = " ".join(made.axis["missing"])
    for word in ("--motor-joint", "--load-joint", "--reference-topic", "--command-topic", "--drive", "/plc/target"):
        assert word in said, word
    assert "no joint 'motor' there (has drive_shaft, other, table)" in said
    for what in made.axis["missing"]:
        assert what in made.page.text


def test_without_a_backlash_figures_are_in_rad_and_the_page_says_so(bags: Path, tmp_path: Path) -> None:
    made = report(bags / "foreign", tmp_path, *FOREIGN)
    step = made.axis["steps"][0]
    assert made.axis["backlash_angle"] is None
    assert "overshoot_b" not in step
    assert step["band"] == pytest.approx(0.02 * HEIGHT * DEGREE)
    assert step["impacts"] is None
    assert "overshoot, mrad" in made.page.text
    assert "figures are in mrad" in made.page.text


@pytest.mark.grid
def test_the_backlash_is_estimated_with_an_uncertainty_that_holds(tmp_path: Path) -> None:
    """By the learning run in it alone: what comes after it is a motion that no drive makes."""
    member, recording = probed(0)
    bag, ratio = PlainBag(), member.drive.gear.ratio
    for time, motor, load, command in zip(*recording[:4], strict=True):
        bag.sample("/joint_states", time, ("motor", "load"), (motor / ratio, load))
        bag.numbers("/command", time + 5e-4, (command,), answers=time)
    last, period = float(recording.time[-1]), float(np.median(np.diff(recording.time)))
    for k in range(1, 2000):
        rests = float(k * period > 0.5) * math.sin(0.3 * k)
        bag.sample("/joint_states", last + k * period, ("motor", "load"), (motor / ratio, load + rests))
        bag.numbers("/command", last + k * period + 5e-4, (0.1,), answers=last + k * period)
    for time, under_way, angle in ((0.0, 1, 0.0), (last, 0, 0.0), (last + 1.0, 0, 0.123)):
        bag.status("/controller/state", time, "servo", {"experiment": under_way, "backlash_angle": angle, "fault": 0})
    made = report(bag.write(tmp_path / "bag"), tmp_path, "--drive", str(write_drive(tmp_path / "drive.yaml", member)))
    (run,) = made.axis["learning_runs"]
    assert (run["end"], run["learned"]) == (pytest.approx(last), 0.123)
    found = made.axis["estimate"]
    assert found["told"], found["why"]
    assert found["part"] == "the learning run at 0.00 s"
    assert abs(found["angle"] - true_gap(member)) < 3.0 * found["uncertainty"] < 0.05 * true_gap(member)
    assert (made.axis["backlash_angle"], made.axis["backlash_angle_from"]) == (0.123, "~/state")


@pytest.mark.grid
def test_the_estimate_is_the_unit_where_nobody_tells_the_backlash(tmp_path: Path) -> None:
    member, recording = probed(0)
    write_bag(tmp_path / "bag", member, recording)
    made = report(tmp_path / "bag", tmp_path, "--drive", str(write_drive(tmp_path / "drive.yaml", member)))
    assert made.axis["estimate"]["angle"] == pytest.approx(true_gap(member), rel=0.01)
    assert made.axis["backlash_angle"] == made.axis["estimate"]["angle"]
    assert "from the estimate from this recording" in made.page.text
    given = report(tmp_path / "bag", tmp_path, "--backlash-angle", "0.1")
    assert given.axis["backlash_angle"] == 0.1


def torn_mcap(bags: Path, place: Path) -> Path:
    """Leave a bag as a recorder does that is killed: no metadata, and the file ends in the middle."""
    (file,) = (bags / "foreign").glob("*.mcap")
    place.mkdir()
    (place / "torn.mcap").write_bytes(file.read_bytes()[: 3 * file.stat().st_size // 4])
    return place


def torn_database(bags: Path, place: Path) -> Path:
    (file,) = (bags / "foreign_db").glob("*.db3")
    place.mkdir()
    (place / "torn.db3").write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return place


def unfinished_database(bags: Path, place: Path) -> Path:
    """Leave what a recorder that writes ahead leaves: the newest messages are in a file beside."""
    (file,) = (bags / "foreign_db").glob("*.db3")
    place.mkdir()
    copy = place / "open.db3"
    shutil.copyfile(file, copy)
    database = sqlite3.connect(copy, isolation_level=None)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("UPDATE messages SET timestamp = timestamp + 1")
    shutil.copytree(place, place.with_name("killed"))
    database.close()
    return place.with_name("killed")


def overwritten_database(bags: Path, place: Path) -> Path:
    """Leave a database in whose middle a piece of a disk is lost."""
    (file,) = (bags / "foreign_db").glob("*.db3")
    place.mkdir()
    content = bytearray(file.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = bytes(4096)
    (place / "lost.db3").write_bytes(content)
    return place


DAMAGES = {torn_mcap: "has no end", torn_database: "has no end", unfinished_database: "has no end"}
DAMAGES[overwritten_database] = "is damaged"


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_bag_gives_what_it_holds(bags: Path, tmp_path: Path, damage: Any) -> None:
    made = report(damage(bags, tmp_path / "bag"), tmp_path, *FOREIGN)
    assert any("metadata.yaml is missing" in what for what in made.content["damage"])
    assert any(DAMAGES[damage] in what for what in made.content["damage"])
    assert "The bag is not whole: " in made.page.text
    assert made.axis["timing"]["samples"] > 300
    if damage in {torn_mcap, unfinished_database}:
        assert made.axis["steps"][0]["rise"] == pytest.approx(crossing(0.9) - crossing(0.1), abs=5e-4)


def test_a_file_that_the_bag_should_have_is_missed(bags: Path, tmp_path: Path) -> None:
    shutil.copytree(bags / "foreign", tmp_path / "bag")
    listed = tmp_path / "bag" / "metadata.yaml"
    text = listed.read_text()
    listed.write_text(text.replace("relative_file_paths:", "relative_file_paths:\n  - foreign_0.mcap", 1))
    made = report(tmp_path / "bag", tmp_path, *FOREIGN)
    assert made.content["damage"] == ["foreign_0.mcap is missing"]
    assert len(made.axis["steps"]) == 2


def test_an_empty_bag_and_one_without_joint_states_make_pages_that_say_so(tmp_path: Path) -> None:
    made = report(PlainBag().write(tmp_path / "empty"), tmp_path)
    assert "There is no message in this bag." in made.page.text
    bag = PlainBag()
    for k in range(100):
        values = {"fault": 20 * (k > 50), "reference": float(k > 20), "experiment": 0}
        bag.status("/controller/state", 0.02 * k, "servo", values)
    made = report(bag.write(tmp_path / "state"), tmp_path)
    assert any("joint states" in what for what in made.axis["missing"])
    assert [fault["name"] for fault in made.axis["faults"]] == ["NO_SAMPLES"]
    assert made.axis["steps"] == []


def test_what_is_no_bag_is_refused_in_one_line(
    bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noise.mcap").write_bytes(b"noise" * 1000)
    (tmp_path / "noise.db3").write_bytes(b"noise" * 1000)
    (tmp_path / "folder").mkdir()
    assert "nowhere: No such file or directory" in refused(capsys, "nowhere")
    for name in ("noise.mcap", "noise.db3"):
        assert "is no rosbag2 that can be read" in refused(capsys, name), name
    assert "folder" in refused(capsys, "folder")
    (tmp_path / "table.csv").write_text("time,motor\n0.0,0.0\n")
    assert "is a table, not a rosbag2: backlash identify reads it, with --certificate" in refused(capsys, "table.csv")
    foreign = str(bags / "foreign")
    assert "--reference-topic: there are no numbers on '/x'" in refused(capsys, foreign, "--reference-topic", "x")
    assert "--joint-topic: there are no joint states on '/x'" in refused(capsys, foreign, "--joint-topic", "x")
    assert "--effort-unit: A needs" in refused(capsys, foreign, "--effort-unit", "A")
    assert "--motor-at: output needs" in refused(capsys, foreign, "--motor-at", "output")
    assert list(tmp_path.glob("*.html")) == []
    (tmp_path / "foreign.html").write_text("before")
    assert "'foreign.html' exists; --force overwrites it" in refused(capsys, foreign)
    assert (tmp_path / "foreign.html").read_text() == "before"


def test_names_from_a_bag_run_nothing(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(200):
        bag.sample("/joint_states", 0.004 * k, (NASTY, "load"), (0.1 * k, 0.01 * k))
        values = {"fault": 0, "reference": float(k > 50), "experiment": 0}
        bag.status("/controller/state", 0.004 * k, "servo", values)
    bag.status("/diagnostics", 0.5, NASTY, level=2, text=NASTY)
    bag.in_use("/controller/parameters_in_use", 0.0, 1, reported.in_use(NASTY, 0.02))
    bag.in_use("/controller/parameters_in_use", 0.5, 2, reported.in_use("fast", 0.02))
    made = report(bag.write(tmp_path / "bag"), tmp_path, "--motor-joint", NASTY)
    assert len(made.page.scripts) == 3
    assert made.page.text.count(NASTY) >= 5
    assert "alert" not in made.html.replace(unescape("alert(&#x27;"), "").replace("alert(&#x27;", "")


def test_stamps_that_stand_still_leave_the_recorders_times(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(300):
        bag.sample("/joint_states", 0.0, ("motor", "load"), (0.0, 0.01 * k), received=0.004 * k)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert made.axis["timing"]["period"] == pytest.approx(0.004, rel=1e-3)
    assert any("so the recorder's times are used" in note for note in made.axis["notes"])


def test_samples_sent_again_until_they_are_answered_are_counted_and_left_out(tmp_path: Path) -> None:
    """In lockstep one may come many times; the stamps stay the clock, which differs from the recorder's."""
    bag = PlainBag()
    for k in range(300):
        for again in range(1 + 9 * (k % 10 == 5)):
            received = 0.001 * k + 1e-5 * again
            bag.sample("/joint_states", 0.004 * k - START, ("motor", "load"), (0.0, 0.01 * k), received=received)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    timing = made.axis["timing"]
    assert timing["period"] == pytest.approx(0.004, rel=1e-5)
    assert (timing["samples"], timing["repeated"], timing["lost"]) == (300, 270, 0)
    assert made.axis["notes"] == []


def test_a_clock_of_its_own_is_said_and_its_age_is_not_told(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(500):
        stamp = 0.004 * k - START + 5.0  # simulated time, which runs twice as fast as it is recorded
        bag.sample("/joint_states", stamp, ("motor", "load"), (0.0, float(k > 250)), received=0.002 * k)
    bag.number("/reference", 0.0, 0.0)
    bag.number("/reference", 0.5, 1.0)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert "a clock of its own" in made.axis["clock"]
    assert made.axis["timing"]["age"] is None
    assert "stamps and recorder have different clocks" in made.page.text
    (step,) = made.axis["steps"]
    assert step["start"] == pytest.approx(1.0, abs=0.004)


def test_a_step_ends_where_samples_are_missing_for_long(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in (*range(1000), *range(1250, 1500)):
        bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, float(k > 110)))
    bag.number("/reference", 0.0, 0.0)
    bag.number("/reference", 0.4, 1.0)
    (step,) = report(bag.write(tmp_path / "bag"), tmp_path).axis["steps"]
    assert step["ended_by"] == "samples missing for 1.00 s"
    assert step["end"] == pytest.approx(3.996)


def test_an_encoder_that_jumps_is_told_and_makes_a_page(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(500):
        jumps = 4.0 * (k % 100 == 50) + 3.0 * (k % 100 == 70)  # two thirds of a turn, and half of one
        bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, jumps))
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert any("joint 'load'" in note and "taken as it is" in note for note in made.axis["notes"])


def test_the_example_of_the_docs_reads_the_bag_that_it_speaks_of(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    docs = (Path(__file__).parents[2] / "docs" / "report.md").read_text()
    (example,) = re.findall(r"^backlash (report their_bag .*?)^```", docs, re.DOTALL | re.MULTILINE)
    words = shlex.split(example.replace("\\\n", " "))
    monkeypatch.chdir(tmp_path)
    shutil.copytree(bags / "foreign", "their_bag")
    shutil.copy(bags / "their_drive.yaml", tmp_path)
    assert main([*words, "--json", "figures.json"]) == 0
    (axis,) = json.loads(Path("figures.json").read_text())["axes"]
    assert axis["steps"][1]["frequency"] == pytest.approx(FREQUENCY, rel=2e-3)
    assert Path("their_bag.html").exists()


@pytest.mark.parametrize("reference", [0.0, math.nan])
def test_a_recording_in_which_nothing_moved_makes_a_page(tmp_path: Path, reference: float) -> None:
    bag = PlainBag()
    for k in range(250):
        bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, 0.0))
    for k in range(5):
        bag.status("/controller/state", 0.2 * k, "servo", {"reference": reference, "holding": 1.0})
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert made.axis["steps"] == made.axis["paths"] == []


SWING, OFTEN, GOAL = 0.19, 0.92, 0.5
"""Of a load that swings about a goal that never changes: to either side, rad; Hz; rad."""


def swinging_bag(seconds: float, still: float = 0.0, reference: str = "") -> PlainBag:
    """Return a recording of a load that swings, or stands still for a while first, about a goal that never changes."""
    bag = PlainBag()
    for k in range(round(100 * seconds)):
        time = 0.01 * k
        load = GOAL + (SWING * math.sin(2.0 * math.pi * OFTEN * time) if time >= still else 0.0)
        bag.sample("/joint_states", time, ("motor", "load"), (load, load))
        if k % 10 == 0 and not reference:
            bag.status("/controller/state", time, "servo", {"reference": GOAL, "holding": 1.0, "backlash_angle": 0.02})
        elif k % 10 == 0 and reference != "none":
            bag.number(reference, time, GOAL)
    return bag


@pytest.mark.parametrize("reference", ["", "/reference"])
def test_a_load_that_swings_about_a_goal_that_never_changes_is_a_limit_cycle(
    reference: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = report(swinging_bag(20.0, reference=reference).write(tmp_path / "bag"), tmp_path)
    assert made.axis["steps"] == []
    (hold,) = made.axis["holds"]
    assert hold["amplitude"] == pytest.approx(2.0 * SWING, rel=0.01)
    assert hold["frequency"] == pytest.approx(OFTEN, rel=0.01)
    assert hold["target"] == GOAL
    said = capsys.readouterr().out
    assert "  limit cycle: +-0.19 rad" in said
    assert "at 0.92 Hz about 0.5 rad, 0.00 to 19.99 s" in said
    assert "limit cycle while the reference stood still at 0.5 rad" in made.page.text


def test_a_load_that_stands_still_has_no_limit_cycle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = report(swinging_bag(10.0, still=10.0).write(tmp_path / "bag"), tmp_path)
    (hold,) = made.axis["holds"]
    assert (hold["residual"], hold["error"], hold["amplitude"]) == (0.0, 0.0, None)
    assert "limit cycle" not in capsys.readouterr().out


def test_a_reference_of_another_type_is_said_not_to_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = swinging_bag(2.0, reference="none")
    bag.status("/reference", 0.0, "target", {"value": 1.0})
    path = bag.write(tmp_path / "bag")
    made = report(path, tmp_path)
    said = "not read, since only numbers of std_msgs such as Float64 are: '/reference' (diagnostic_msgs/msg/Diagnos"
    assert any(said in what for what in made.axis["missing"])
    assert said in capsys.readouterr().out
    why = refused(capsys, str(path), "--reference-topic", "/reference", "--out", str(tmp_path / "other.html"))
    assert (
        "there are no numbers on '/reference', but diagnostic_msgs/msg/DiagnosticArray: only numbers of std_ms" in why
    )


def test_a_path_is_no_step(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(500):
        bag.sample("/joint_states", 0.004 * k, ("motor", "load"), (0.0, 0.0))
        bag.number("/reference", 0.004 * k, float(np.clip(k - 100, 0, 100)) / 100.0)
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert made.axis["steps"] == []
    (path,) = made.axis["paths"]
    assert (path["origin"], path["target"]) == (0.0, 1.0)


def test_a_path_is_judged_where_the_controller_tells_its_setpoint(tmp_path: Path) -> None:
    """There and back 20 ms late, then a step, which is none: of the path rms and largest error, lag and turn."""
    bag, late, period = PlainBag(), 0.02, 0.004

    def wanted(time: float) -> list[float]:
        """Return position, velocity and acceleration: a raised cosine from 0.4 to 2.4 s, and 0.5 rad from 4 s on."""
        phase = np.clip(0.5 * (time - 0.4), 0.0, 1.0) * 2.0 * math.pi
        moves = 0.0 < phase < 2.0 * math.pi
        speed, bend = (math.pi * math.sin(phase), math.pi**2 * math.cos(phase)) if moves else (0.0, 0.0)
        return [1.0 - math.cos(phase) + 0.5 * (time >= 4.0), speed, bend]

    names = "setpoint", "setpoint_velocity", "setpoint_acceleration"
    for k in range(1500):
        time = k * period
        load = wanted(time - (late if time < 3.0 else 0.0))[0]
        bag.sample("/joint_states", time, ("motor", "load"), (100.0 * load, load))
        if k % 5 == 0:
            told = wanted(time)
            state = {"reference": 0.5 * (time >= 4.0), "error": told[0] - load, "experiment": 0, "backlash_angle": 0.1}
            bag.status("/controller/state", time, "servo", state | dict(zip(names, told, strict=True)))
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    (path,) = made.axis["paths"]
    assert path["start"] == pytest.approx(0.4, abs=0.03)
    assert path["end"] == pytest.approx(2.4, abs=0.03)
    assert path["rms_b"] == pytest.approx(late * math.pi / math.sqrt(2.0) / 0.1, rel=0.05)
    assert path["largest_b"] == pytest.approx(late * math.pi / 0.1, rel=0.02)
    assert path["final"] == pytest.approx(0.0, abs=1e-9)
    assert path["lag"] == pytest.approx(late, rel=0.02)
    assert path["reversals"] == 1
    (step,) = made.axis["steps"]
    assert (step["origin"], step["target"]) == (0.0, 0.5)
    assert "1 path: at most 0.62" in made.page.text
    assert "Path 1: 0 to 0 rad" in made.page.text


def test_a_motion_that_dies_out_or_is_uneven_is_no_limit_cycle() -> None:
    time = np.arange(0.0, 2.0, 0.004)
    swing, frequency = limit_cycle(time, 0.5 + 0.1 * np.sin(2.0 * math.pi * 7.3 * time), 0.01)
    assert (swing, frequency) == (pytest.approx(0.2, rel=1e-2), pytest.approx(7.3, rel=1e-3))
    assert math.isnan(limit_cycle(time, 0.1 * np.exp(-8.0 * time) * np.sin(40.0 * time), 0.01)[0])
    swing, frequency = limit_cycle(time, 0.1 * np.sin(20.0 * np.square(time)), 0.01)
    assert swing == pytest.approx(0.2, rel=1e-2)
    assert math.isnan(frequency)  # it swings, but has no even period
    assert math.isnan(limit_cycle(time, np.random.default_rng(1).normal(size=time.size).cumsum(), 0.01)[1])
    assert math.isnan(limit_cycle(time, 0.001 * np.sin(40.0 * time), 0.01)[1])


def test_thinned_curves_keep_their_extremes() -> None:
    random = np.random.default_rng(2)
    time, values = np.arange(50_000.0), random.normal(size=50_000)
    values[12_345], values[34_567] = 99.0, -99.0
    shown_time, shown = thinned(time, values, 1000)
    assert shown.size <= 1000
    assert (np.max(shown), np.min(shown)) == (99.0, -99.0)
    assert shown_time[np.argmax(shown)] == 12_345.0
    assert np.all(np.diff(shown_time) > 0.0)


def test_the_page_says_where_it_was_thinned(tmp_path: Path) -> None:
    bag = PlainBag()
    for k in range(5000):
        bag.sample("/joint_states", 0.001 * k, ("motor", "load"), (0.0, math.sin(0.01 * k)))
    made = report(bag.write(tmp_path / "bag"), tmp_path)
    assert re.search(r"Thinned: \d+ of \d+ points", made.page.text)


def test_a_page_with_many_points_thins_what_comes_later(monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(3000.0)
    chart = Chart("Step", "", [Panel("angle", [Line("load", time, np.sin(time), "load")])])
    book = ChartBook()
    monkeypatch.setattr(charts, "BUDGET", 3000)
    assert not book.add(chart).thinned
    assert "Thinned: 1000 of 3000 points" in book.add(chart).thinned


def test_a_page_has_the_library_as_published_whose_version_and_licences_are_beside_it() -> None:
    book, time = ChartBook(), np.arange(3.0)
    book.add(Chart("Step", "", [Panel("angle", [Line("load", time, time, "load")])]))
    drawn, folder = book.drawn(), Path(charts.__file__).parent / "echarts"
    assert drawn is not None
    library = gzip.decompress(base64.b64decode(drawn.library)).decode()
    assert library == (folder / "echarts.common.min.js").read_text("utf-8")
    told = (folder / "README.md").read_text("utf-8")
    (version,) = re.findall(r't\.version="([\d.]+)"', library)
    assert f"Apache ECharts {version} " in told
    licences = {each.name for each in folder.iterdir()} - {"README.md", "echarts.common.min.js"}
    assert licences == set(re.findall(r"`((?:LICENSE|NOTICE)[\w-]*)`", told))
