"""The demo, as the README has it, in real time: its numbers and its files."""

import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from in_browser import console_of, requests_of
from report_page import opened, shown
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from viewers import foxglove_values, messages, plotjuggler_names

from backlash_ros.analysis import read_bag
from backlash_ros.cli import main

ROOT = Path(__file__).parents[2]
DEMO = [sys.executable, "-m", "backlash_ros.demo"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "results"
    done = subprocess.run(
        [*DEMO, "--out", str(out)], cwd=ROOT, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "two-region law" in done.stdout
    return out


@pytest.fixture(scope="module")
def summary(results: Path) -> dict:
    return json.loads((results / "summary.json").read_text())


def test_backlash_is_learned_within_half_a_percent(summary: dict) -> None:
    learned = summary["learned"]
    assert learned["valid"] is True
    assert learned["method"] == "gap_probe"
    assert learned["true_backlash_angle"] == pytest.approx(0.02)
    assert learned["backlash_angle"] == pytest.approx(0.02, rel=0.005)


def test_two_region_law_comes_to_rest(summary: dict) -> None:
    assert summary["responses"]["two_region"]["residual"] <= 0.02
    assert summary["responses"]["overdamped"]["residual"] <= 0.02


def test_fast_gains_alone_rattle(summary: dict) -> None:
    assert summary["responses"]["fast"]["residual"] >= 0.7


def test_gains_are_swapped_while_the_load_moves(summary: dict) -> None:
    assert summary["gain_swap"]["accepted"] is True
    assert 0 <= summary["gain_swap"]["applied_after"] < 0.1


def test_load_torque_is_estimated_and_held(summary: dict) -> None:
    load = summary["load_torque"]
    assert load["torque"] == 0.1
    assert load["estimate"] == pytest.approx(0.1, rel=0.05)
    assert abs(load["final_error"]) < 0.1
    assert load["residual"] < 0.1


def test_readme_reads_the_bag(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(
        r"```python\n(from backlash_ros.analysis.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL
    )
    exec(example.replace("results/demo", str(results)), {})
    assert int(capsys.readouterr().out.split()[0]) > 1000


def counts(log: Path, pattern: str) -> list[int]:
    (found,) = re.finditer(pattern, log.read_text())
    return [int(number) for number in found.groups()]


def test_bag_has_every_topic_with_the_messages_that_the_run_implies(results: Path, summary: dict) -> None:
    recording = read_bag(results / summary["bag"])
    assert recording.messages == summary["messages"]
    stamps = recording.joint_states.time
    beats = round((stamps[-1] - stamps[0]) * 250) + 1
    published, late = counts(results / "plant_simulator.log", r"stopped after (\d+) samples, (\d+) of them late")
    assert beats - late - 1 <= stamps.size <= beats
    # Each sample that the controller answered since it was first heard has one command, and every fifth has telemetry;
    # there is 0 V now and then besides: before the first sample, and at the end.
    commands = recording.scalars["/command"]
    samples = int(np.count_nonzero((stamps > commands.time[0]) & (stamps < commands.time[-1])))
    (answered,) = counts(results / "controller.log", r"stopped after (\d+) samples")
    unheard = published - stamps.size + int(np.count_nonzero(stamps <= commands.time[0]))
    assert answered - unheard <= commands.time.size <= samples + 10
    telemetry = recording.scalars["/controller/state/error"].time
    meanwhile = np.count_nonzero((commands.time >= telemetry[0]) & (commands.time <= telemetry[-1]))
    # References, laws, gain sets and what was learned are said at once; a step that is made once more has its own.
    changes = recording.messages["/reference"] + recording.messages["/parameter_events"]
    assert meanwhile / 5 - 3 <= telemetry.size <= meanwhile / 5 + changes
    assert recording.messages["/controller/backlash_estimate"] == 1
    assert recording.messages["/reference"] >= 7
    assert recording.messages["/load_torque"] == 1
    assert recording.scalars["/command"].values[-1] == 0.0
    changed = [name for _, name, _ in recording.parameters]
    assert {"law", "gain_set", "gains.overdamped.k"} <= set(changed)
    # The first events may have been sent before the recorder was found; what is in use is kept for who comes late.
    assert recording.in_use[-1][2]["backlash_angle"] == summary["learned"]["backlash_angle"]


@pytest.fixture(scope="module")
def page(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the report of the bag, with its numbers beside it."""
    page = tmp_path_factory.mktemp("report") / "report.html"
    words = ["report", str(results / "bag"), "--out", str(page), "--json", str(page.with_suffix(".json"))]
    assert main(words) == 0
    return page


def test_its_report_says_what_the_summary_says(page: Path, summary: dict) -> None:
    (axis,) = json.loads(page.with_suffix(".json").read_text())["axes"]
    assert axis["backlash_angle"] == summary["learned"]["backlash_angle"]
    assert axis["learning_runs"][-1]["learned"] == summary["learned"]["backlash_angle"]
    assert axis["missing"] == []
    up = [step for step in axis["steps"] if step["origin"] < 0.5 < step["target"]]
    swapped = [step for step in up if any("gain_set" in remark for remark in step["remarks"])]
    assert len(swapped) == 1
    for law, response in summary["responses"].items():
        step = [step for step in up if step["law"] == law and step not in swapped][-1]
        assert step["rise"] == pytest.approx(response["rise_time"], rel=0.02)
        assert step["overshoot_b"] == pytest.approx(response["overshoot"], abs=0.02)
        if summary["in_time"][law]["end"]:
            assert step["residual_b"] == pytest.approx(response["residual"], abs=0.02)


def test_its_report_is_drawn_and_zoomed(page: Path, browser: Chrome) -> None:
    charts = opened(browser, page)
    assert len(charts) >= 10  # all of it, seven steps, a learning run, the timing
    whole = shown(charts[1])
    charts[1].find_element(By.CSS_SELECTOR, "[data-zoom=in]").click()
    near = shown(charts[1])
    assert near[1] - near[0] < 0.6 * (whole[1] - whole[0])
    assert [address for address in requests_of(browser) if not address.startswith(("file:", "blob:"))] == []
    assert console_of(browser) == []


def test_figure_is_there(results: Path) -> None:
    assert (results / "step_response.png").read_bytes().startswith(b"\x89PNG")


def test_layout_for_plotjuggler_names_what_is_recorded(results: Path) -> None:
    layout = ElementTree.parse(ROOT / "config" / "plotjuggler_layout.xml")
    shown = {curve.attrib["name"] for curve in layout.iter("curve")}
    assert len(shown) > 25
    assert shown - {name for each in messages(results / "bag") for name in plotjuggler_names(*each)} == set()
    for splitter in layout.iter("DockSplitter"):
        assert len(splitter) == int(splitter.attrib["count"]) == len(splitter.attrib["sizes"].split(";"))


def test_layout_for_foxglove_names_what_is_recorded(results: Path) -> None:
    layout = json.loads((ROOT / "config" / "foxglove_layout.json").read_text())
    panels = layout["configById"]
    shown = {path["value"] for panel in panels.values() for path in panel.get("paths", ())}
    assert len(shown) > 25
    seen = set()
    for topic, _, message in messages(results / "bag"):
        of_topic = {path for path in shown - seen if re.match(r"[\w/]+", path)[0] == topic}
        seen |= {path for path in of_topic if len(foxglove_values(path, topic, message)) == 1}
    assert shown - seen == set()
    assert set(re.findall(r"\w+!\w+", json.dumps(layout["layout"]))) == set(panels)
