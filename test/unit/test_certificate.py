"""The certificate of `backlash identify`: one page that needs nothing else and says what the JSON says."""

import json
import math
import re
import shlex
import shutil
from dataclasses import dataclass, replace
from html import escape, unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from made_report import Parsed
from rich.console import Console

from backlash_ros.cli import main
from backlash_ros.commands import identification as command
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.identification.gap_map import GapMap, Mapped
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding, findings_of
from backlash_ros.identification.recordings.held_out import free_simulations
from backlash_ros.identification.recordings.identify import Identified, identify
from backlash_ros.identification.recordings.places import map_findings
from backlash_ros.identification.recordings.slow_torque import hysteresis_findings
from backlash_ros.identification.teeth import loop_of, lost_motion_of, static_torque
from backlash_ros.pages.certificate import page
from backlash_ros.pages.certificate.page import certificate
from backlash_ros.recordings.rounding import in_gear_units, in_si, rounded, shown
from backlash_ros.recordings.samples import Columns, Reading, began
from backlash_ros.recordings.subject import Subject

pytestmark = pytest.mark.population

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "identification.md").read_text()
COMMAND = next(line for line in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) if "--certificate" in line)
TRUE_GAP = 0.004228
"""Of the axis in docs/examples/axis.csv, whose output twists by 1 mrad/(N m)."""
NASTY = "<script>alert('&\"')</script>"


@dataclass
class Made:
    """What the command of the page left, in the folder where it ran."""

    folder: Path
    html: str
    json: dict[str, Any]
    about: Subject
    found: Identified


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("certificate")
    shutil.copytree(ROOT / "docs" / "examples", folder / "docs" / "examples", ignore=shutil.ignore_patterns("*.pyc"))
    words = shlex.split(COMMAND)
    given: list[tuple[Subject, Identified]] = []

    def write(about: Subject, found: Identified) -> str:
        given.append((about, found))
        return certificate(about, found)

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(page, "certificate", write)
        assert main([*words[1:], "--json", "results/certificate.json"]) == 0
    out = folder / "results"
    html, content = (out / "certificate.html").read_text("utf-8"), json.loads((out / "certificate.json").read_text())
    return Made(folder, html, content, *given[0])


def rows_of(content: dict[str, Any]) -> list[Finding]:
    return [
        Finding(**{key: math.nan if value is None else value for key, value in row.items() if key != "told"})
        for row in content["findings"] + content["derived"]
    ]


def test_the_page_is_whole_and_needs_nothing_else(made: Made) -> None:
    page = Parsed(made.html)
    assert made.html.startswith("<!DOCTYPE html>\n<html lang=")
    assert page.tags["svg"] == 2
    assert page.tags["h1"] == page.tags["title"] == 1
    assert len(page.ids) == len(set(page.ids))
    assert not {"script", "link", "iframe", "img"} & set(page.tags)
    assert all(reference.startswith("#") for reference in page.references)
    assert {reference[1:] for reference in page.references} <= set(page.ids)
    assert set(re.findall(r"url\(#([^)]*)\)", made.html)) <= set(page.ids)
    assert "http" not in made.html
    assert "@import" not in made.html
    assert len(made.html) < 400_000


def test_it_says_what_the_json_says(made: Made) -> None:
    text = Parsed(made.html).text
    rows = rows_of(made.json)
    assert {"b", "J_l", "lost motion", "stiffness"} <= {row.symbol for row in rows if row.told}
    for row in rows:
        if row.told:
            assert in_si(row) in text, row
            assert in_gear_units(row) in text, row
        else:
            assert row.why in text
    score = made.json["held_out"]
    for value in (score["rms"], score["error"], score["told_rms"], score["told_error"]):
        assert ("inf" if value is None else f"{value:.3g}") in text  # None: the filter cannot follow
    told = yaml.safe_load((made.folder / "docs" / "examples" / "axis.yaml").read_text())
    for value in (*told["motor"].values(), told["gear"]["reduction"]):
        assert f"{float(value):.10g}" in text
    assert "samples lostnone seen" in text
    assert "262144 counts in a turn" in text
    assert "bore \u22121.2 to 1.2 N m. It holds" in text


def test_the_command_in_it_makes_it_again(made: Made) -> None:
    line = re.search(r"<pre>(.*?)</pre>", made.html)
    assert line is not None
    words = shlex.split(unescape(line[1]))
    assert words[: len(shlex.split(COMMAND))] == ["backlash", *shlex.split(COMMAND)[1:]]


def test_a_file_that_exists_is_kept(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made.folder)
    with pytest.raises(SystemExit) as ended:
        main([word for word in shlex.split(COMMAND)[1:] if word != "--force"])
    assert ended.value.code == 2
    assert "argument --certificate: 'results/certificate.html' exists; --force overwrites it" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["identify", "a.csv", "--certificate", "docs", "--force"])
    assert ended.value.code == 2
    assert "argument --certificate: must be writable, got 'docs'" in capsys.readouterr().err


def test_a_page_that_cannot_be_written_whole_is_not_written(
    made: Made, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> str:
        raise OSError(28, "No space left on device")

    recording = still()
    table = tmp_path / "a.csv"
    rows = (",".join(map(str, row)) for row in zip(*recording[:4], strict=True))
    table.write_text("\n".join(["time,motor,load,command", *rows]))
    place = tmp_path / "page.html"
    place.write_text("before")
    monkeypatch.setattr(Path, "replace", fail)
    request = command.Request(table, certificate=place)
    with pytest.raises(OSError, match="No space"):
        command.identify_recording(request, Console(quiet=True))
    assert place.read_text() == "before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "page.html"]


def still() -> Recording:
    """Return a recording that tells nothing: nothing moves."""
    time = 0.004 * np.arange(300)
    return Recording.of(time, np.zeros(300), np.zeros(300), np.zeros(300))


def subject(recording: Recording, **changes: Any) -> Subject:
    return replace(Subject("a.csv", ("motor", "load"), recording, NOMINAL_DRIVE, "my.yaml", "backlash"), **changes)


def test_names_are_shown_as_they_are_and_run_nothing() -> None:
    recording = still()
    found = identify(NOMINAL_DRIVE, recording)
    assert not found.valid
    named = subject(recording, source=NASTY, joints=(NASTY, "b&c"), sheet=NASTY, command=NASTY, notes=(NASTY,))
    text = certificate(named, replace(found, reason=NASTY))
    page = Parsed(text)
    assert page.tags["script"] == 0
    assert page.text.count(NASTY) >= 6
    assert escape(NASTY) in text
    odd = certificate(subject(recording, source="a\udcff\x1b[0m.csv"), found)
    assert "a\ufffd\ufffd[0m.csv" in Parsed(odd.encode("utf-8").decode("utf-8")).text


def test_a_recording_that_tells_nothing_makes_a_page_that_says_why() -> None:
    recording = still()
    found = identify(NOMINAL_DRIVE, recording)
    page = Parsed(certificate(subject(recording, sheet=""), found))
    assert f"Nothing can be determined: {found.reason}." in page.text
    assert "No drive file was given" in page.text
    assert page.tags["svg"] == 1
    assert "Results" not in page.text


def test_a_gap_that_is_not_told_has_its_reason_in_place_of_a_number(made: Made) -> None:
    about, found = made.about, made.found
    assert found.gap is not None
    assert found.fit is not None
    gap = replace(found.gap, angle=0.0, uncertainty=0.0, valid=False, reason="the far flank was not seen")
    rows = tuple(findings_of(about.told, gap, found.fit, found.period))
    unsure = replace(found, gap=gap, findings=rows)
    derived = lost_motion_of(unsure, about.told.standstill_torque())
    page = Parsed(certificate(replace(about, derived=derived), unsure))
    assert "The recording does not show the gap: the far flank was not seen" in page.text
    assert [row.why for row in derived] == [gap.reason] * 2
    assert page.text.count("cannot be determined: the far flank was not seen") == 6
    assert "The gap is unknown." in page.text
    assert page.text.count("arcmin") == 1  # an axis
    assert in_si(unsure.of("J_l")) in page.text


@pytest.mark.population
def test_the_gap_around_the_turn_is_drawn_and_told(made: Made) -> None:
    assert "The gap around the turn: the teeth went to and fro across the gap, after a rest, at 1 place" in unescape(
        made.html
    )
    places, gaps = (-2.5, -1.5, -0.5, 1.0, 2.0, 3.0), (0.004, 0.005, 0.006, 0.005, 0.004, 0.0035)
    seen = GapMap(places, gaps, (2e-5,) * 6, eccentricity=3e-4, phase=0.5, eccentricity_uncertainty=2e-5)
    about = replace(made.about, derived=(*made.about.derived, *map_findings(seen)))
    text = certificate(about, replace(made.found, around=Mapped(seen, "6 of 6 places")))
    page = Parsed(text)
    assert page.tags["svg"] == 3
    assert len(page.ids) == len(set(page.ids))
    for row in map_findings(seen):
        assert in_si(row) in page.text
        assert in_gear_units(row) in page.text
    assert "Around the turn the gap is from 12.032 \u00b1 0.069 arcmin to 20.626 \u00b1 0.069 arcmin" in page.text
    assert "smallest gap, at 3 rad" in page.text
    assert "largest gap, at \u22120.5 rad" in page.text
    assert "at the output at one place. Around the turn" in page.text
    assert f"What is not said of the turn comes from {made.found.stretch}. The gap comes from" in page.text
    assert "at each of 6 places around the turn" in page.text
    assert "reads 0.3 mrad \u00d7 sin(angle + 0.5 rad) too much" in page.text
    assert "The gap around the turn: " not in page.text
    unsure = replace(seen, eccentricity=3e-5)
    text = Parsed(certificate(about, replace(made.found, around=Mapped(unsure, "6 of 6 places")))).text
    assert "no eccentricity was seen; one of 4e-05 rad would have been" in text
    assert map_findings(unsure)[-1].why in text


def test_a_map_is_told_where_the_part_that_was_fitted_tells_nothing() -> None:
    recording = still()
    seen = GapMap((0.0, 1.0, 2.0), (0.02, 0.03, 0.02), (1e-4,) * 3, 0.0, 0.0, 1e-5)
    found = replace(identify(NOMINAL_DRIVE, recording), around=Mapped(seen, "3 of 3 places"))
    page = Parsed(certificate(subject(recording, derived=map_findings(seen)), found))
    assert page.tags["svg"] == 2
    assert "Around the turn the gap is from " in page.text
    assert f"Nothing else can be determined: {found.reason}." in page.text


def test_the_hysteresis_curve_is_drawn_and_told(made: Made) -> None:
    assert "A hysteresis curve, with lost motion and stiffness from a slow torque: the load moved by " in made.html
    recording, torques = still(), np.linspace(-2.0, 2.0, 50)
    slow = LostMotion(
        valid=True,
        reason="3 cycles",
        gap=0.02,
        gap_uncertainty=1e-4,
        lost_motion=0.0211,
        lost_motion_uncertainty=1.2e-4,
        at=0.18,
        stiffness=(334.0, 300.0),
        stiffness_uncertainty=(5.0, 200.0),
        friction=0.3,
        torque=2.4,
        contact="elastic",
        torques=torques,
        angles=0.01 * np.sign(torques),
        modelled=0.01 * np.sign(torques),
    )
    rows = hysteresis_findings(slow)
    assert [row.told for row in rows] == [True, True, True, False, True]
    found = identify(NOMINAL_DRIVE, recording)
    page = Parsed(certificate(subject(recording, derived=rows, slow=slow), found))
    assert page.tags["svg"] == 2
    assert "Under a slow torque the gap is 68.75 \u00b1 0.34 arcmin, and the lost motion 72.54 \u00b1 0.41" in page.text
    assert f"Nothing else can be determined: {found.reason}." in page.text
    for row in rows:
        assert (in_si(row) if row.told else f"cannot be determined: {row.why}") in page.text
    assert "come from the hysteresis curve" in page.text
    assert "A hysteresis curve, with" not in page.text


def test_pictures_show_what_was_judged(made: Made) -> None:
    about, found = made.about, made.found
    assert found.recording is not None
    assert found.before is not None
    assert found.fit is not None
    assert found.score is not None
    runs = free_simulations(about.told, found.before, found.recording)
    rows = [np.searchsorted(found.recording.time, run.time) for run in runs]
    misses = [run.load - found.recording.load[row] for run, row in zip(runs, rows, strict=True)]
    assert np.sqrt(np.mean(np.square(np.concatenate(misses)))) == pytest.approx(found.score.error)
    loop = loop_of(about.told, found.fit, found.recording)
    assert np.min(loop.torque) >= found.fit.torques[0] - 0.2 * np.ptp(loop.torque)
    law = static_torque(found.fit, np.array([-1.0, -0.49, 0.0, 0.49, 1.0]) * found.fit.gap)
    bearing = found.fit.bearing
    torque = bearing * (0.5 * found.fit.gap / (bearing * found.of("wind-up").value)) ** found.fit.shape.exponent
    assert law == pytest.approx([-torque, 0.0, 0.0, 0.0, torque])


def test_lost_motion_is_the_gap_and_the_twist_of_both_sides(made: Made) -> None:
    rows = {row.symbol: row for row in rows_of(made.json)}
    assert (made.json["drive"], rows["lost motion"].unit) == ("docs/examples/axis.yaml", "rad")
    torque = 0.03 * 0.5 * 24.0 / 3.37 * 0.09303 * 5.374597
    fit = made.found.fit
    assert fit is not None
    wind_up = fit.bearing * rows["wind-up"].value * (torque / fit.bearing) ** (1.0 / fit.shape.exponent)
    assert rows["lost motion"].value == pytest.approx(rows["b"].value + 2.0 * wind_up, rel=1e-5)
    assert rows["stiffness"].value == pytest.approx(1.0 / rows["wind-up"].value)
    # Both flanks at a torque that the teeth bore are surer than what they leave at none; the gap's has more to it.
    assert 0.8 * rows["b"].uncertainty < rows["lost motion"].uncertainty < 1.2 * rows["b"].uncertainty
    assert rows["lost motion"].value == pytest.approx(
        TRUE_GAP + 2e-3 * torque, abs=2.0 * rows["lost motion"].uncertainty
    )
    assert rows["stiffness"].value == pytest.approx(1000.0, abs=2.0 * rows["stiffness"].uncertainty)


@pytest.mark.parametrize(
    ("value", "uncertainty", "unit", "said"),
    [
        (0.0042452, 2.23e-5, "rad", "0.004245 \u00b1 0.000022 rad"),
        (-1234.5, 99.6, "N m", "\u22121230 \u00b1 100 N m"),
        (0.0098, 9.96e-4, "", "0.0098 \u00b1 0.0010"),
        (1e-9, 1e-3, "kg m^2", "0 \u00b1 0.0010 kg m\u00b2"),
        (5.8472e-11, 4.8e-13, "kg m^2", "(5.847 \u00b1 0.048) \u00d7 10\u207b\u00b9\u00b9 kg m\u00b2"),
        (2.0, 0.0, "s", "2 \u00b1 0 s"),
    ],
)
def test_numbers_have_two_digits_of_their_uncertainty(value: float, uncertainty: float, unit: str, said: str) -> None:
    assert shown(value, uncertainty, unit) == said
    assert math.isfinite(float(rounded(value, uncertainty)[0].replace("\u2212", "-")))


@pytest.mark.parametrize(
    ("first", "unit", "epoch", "date"),
    [
        (0.0, "s", 0.0, None),
        (1.7e9, "s", 0.0, "2023-11-14 22:13:20"),
        (1.7e12, "ms", 0.0, "2023-11-14 22:13:20"),
        (0.0, "s", 1.7e9, "2023-11-14 22:13:20"),
        (0.0, "s", 12.5, None),
    ],
)
def test_the_date_is_told_where_the_clock_has_one(first: float, unit: str, epoch: float, date: str | None) -> None:
    row = np.array([first, first + 1.0])
    columns = Columns(row, row, row, row, ("t", "m", "l", "c"), str, epoch)
    began_at = began(columns, Reading(time_unit=unit))
    assert (began_at and f"{began_at:%Y-%m-%d %H:%M:%S}") == date
