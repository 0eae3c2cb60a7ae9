"""`Drive.read`: the drive of parameter files, and what it refuses."""

import re
from pathlib import Path

import pytest
import yaml

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.contacts.elastic import ElasticContact

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config" / "nominal_drive.yaml"


def written(place: Path, text: str) -> Path:
    place.write_text(text)
    return place


def test_the_nominal_drive_is_read_from_its_file_by_path_or_text() -> None:
    assert Drive.read(CONFIG) == Drive.read(str(CONFIG)) == NOMINAL_DRIVE


def test_later_files_override_earlier_ones_and_the_rest_is_nominal(tmp_path: Path) -> None:
    heavy = written(tmp_path / "heavy.yaml", "/**: {ros__parameters: {load: {inertia: 2e-3}}}")
    teeth = written(
        tmp_path / "teeth.yaml", "contact: {law: elastic, elastic: {wind_up: 2e-3}}\ncommand_interface: current"
    )
    drive = Drive.read(CONFIG, heavy, teeth)
    assert drive.load.inertia == 2e-3
    assert drive.gear.contact == ElasticContact(wind_up=2e-3)
    assert drive.takes_current
    assert (drive.motor, drive.gear.backlash_angle) == (NOMINAL_DRIVE.motor, NOMINAL_DRIVE.gear.backlash_angle)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("load: {inertai: 1}", "there is no parameter 'load.inertai', got 1: did you mean 'load.inertia'?"),
        ("moter: {inertia: 1e-5}", "there is no parameter 'moter.inertia', got 1e-05: did you mean 'motor.inertia'?"),
        ("gear: {ratio: 10}", "did you mean 'gear.reduction'?"),
        ("load: {}\ncommand_interfase: current", "did you mean 'command_interface'?"),
        ("contact: {lw: elastic}\nload: {}", "did you mean 'contact.law'?"),
        ("load: {}\ncontact: {law: elastc}", "contact.law must be one of"),
        ("load: {inertia: -1.0}", "load.inertia must be >= 1e-09 kg m^2 and <= 100000 kg m^2, got -1.0"),
        ("load: 3", "there is no parameter 'load', got 3: did you mean 'load.inertia'?"),
        ("load:\n  inertia: 1.0\n  inertia: 2.0", "line 3: the key 'inertia' appears twice, first in line 2"),
        ("load: {}\nload: {inertia: 1.0}", "line 2: the key 'load' appears twice, first in line 1"),
        ("rate: 250.0", "must have ROS parameters of motor, gear or load"),
        ("- 1", "must have ROS parameters of motor, gear or load"),
        ("load: [", "line"),
        ("", "must have ROS parameters of motor, gear or load"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_wrong_in_it(tmp_path: Path, text: str, says: str) -> None:
    file = written(tmp_path / "my_drive.yaml", text)
    with pytest.raises(ValueError, match=re.escape(f"{file}: ")) as refused:
        Drive.read(file)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_page_quotes_the_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "my_drive.yaml", "gear: {ratio: 10.0}")
    with pytest.raises(ValueError, match="ratio") as refused:
        Drive.read("my_drive.yaml")
    assert f"\n{refused.value}\n" in (ROOT / "docs" / "python.md").read_text()


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"my_drive\.yaml"):
        Drive.read(tmp_path / "my_drive.yaml")
    with pytest.raises(ValueError, match="needs a parameter file"):
        Drive.read()


def test_no_parameter_of_any_node_is_taken_for_a_misspelled_one_of_the_drive(tmp_path: Path) -> None:
    parameters = pytest.importorskip("backlash_ros.nodes.fixed_parameters", reason="needs rclpy")
    drives = ("motor.", "gear.", "load.", "contact.", "effects.", "command_in")
    of_others = {name: 1.0 for name in parameters.all_names({}) if not name.startswith(drives)}
    assert len(of_others) > 100
    file = written(tmp_path / "all.yaml", yaml.safe_dump({"load": {}, **of_others}))
    assert Drive.read(file) == NOMINAL_DRIVE


def test_the_parameters_of_every_contact_law_may_stand_in_a_file(tmp_path: Path) -> None:
    contact = {law.section.removeprefix("contact."): {} for law in CONTACTS.values()}
    for name in CONTACTS:
        file = written(tmp_path / f"{name}.yaml", yaml.safe_dump({"contact": {"law": name, **contact}, "load": {}}))
        assert type(Drive.read(file).gear.contact) is CONTACTS[name]


def test_a_notebook_shows_what_differs_from_the_defaults_with_units() -> None:
    shown = NOMINAL_DRIVE._repr_html_()
    assert '<tr><th scope="row">gear.backlash_angle</th><td>0.02 rad</td></tr>' in shown
    assert ">contact.law</th><td>power<" in shown
    assert "gravity_torque" not in shown
