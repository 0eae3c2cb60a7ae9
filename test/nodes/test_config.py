"""Parameter files, ours and those of `backlash params`, have every parameter of the nodes, with its default."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from graph import Parameters, Peer
from rcl_interfaces.srv import ListParameters

from backlash_ros.cli import main
from backlash_ros.control import Gains, design_gains
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.nodes.fixed_parameters import all_names
from backlash_ros.nodes.parameter_file import parameters_of
from backlash_ros.studies.design.report import gain_text
from backlash_ros.studies.design.trial import Choice, Loop

CONFIG = Path(__file__).parents[2] / "config" / "nominal_drive.yaml"
NOT_IN_THE_FILE = ("use_sim_time", "start_type_description_service", "qos_overrides", "gains.")


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for name, value in tree.items():
        flat |= flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def documented() -> dict[str, Any]:
    """Return what the file says, what stands there as a comment since it follows from the drive, too."""
    tree = yaml.safe_load(re.sub(r"^( +)# ( *\w+:)", r"\1\2", CONFIG.read_text(), flags=re.MULTILINE))
    return flatten(tree["/**"]["ros__parameters"])


def test_what_follows_from_the_drive_is_not_given_in_the_file_to_copy() -> None:
    given = flatten(yaml.safe_load(CONFIG.read_text())["/**"]["ros__parameters"])
    assert set(documented()) - set(given) == {
        "limits.command",
        *(f"faults.{x}" for x in ("velocity", "load_torque", "gap", "tracking")),
    }


def declared(peer: Peer, node: str) -> dict[str, Any]:
    names = peer.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
    names = [name for name in names if not name.startswith(NOT_IN_THE_FILE)]
    return dict(zip(names, Parameters(peer, node).get(*names), strict=True))


def test_simulator_has_the_documented_parameters_and_defaults(start: Any, peer: Peer) -> None:
    start("plant_simulator")
    found = declared(peer, "plant_simulator")
    assert found == {name: value for name, value in documented().items() if name in found}


def test_controller_has_the_documented_parameters_and_defaults(start: Any, peer: Peer) -> None:
    start("controller")
    found = {name: v for name, v in declared(peer, "controller").items() if not name.startswith("gain_set")}
    assert found == {name: value for name, value in documented().items() if name in found}


def test_nothing_is_documented_that_no_node_has() -> None:
    assert set(documented()) <= all_names(documented())


DERIVED = ("limits.command", "faults.", "gains.")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of `backlash params`."""
    file = tmp_path_factory.mktemp("params") / "my_drive.yaml"
    assert main(["params", "--out", str(file)]) == 0
    return file


@pytest.mark.parametrize("node", ["plant_simulator", "controller"])
def test_a_node_started_with_the_written_file_has_its_defaults(
    start: Any, peer: Peer, written: Path, node: str
) -> None:
    start(node, "--params-file", str(written))
    defaults = {name: default for name, (_, default) in parameters_of(node).items()}
    names = peer.call(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
    assert set(defaults) == {name for name in names if not name.startswith(NOT_IN_THE_FILE[:-1])}
    assert Parameters(peer, node).get(*defaults) == list(defaults.values())


@pytest.mark.parametrize("nodes", [["plant_simulator"], ["controller"], []])
def test_params_writes_all_parameters_but_those_that_follow_from_others(
    nodes: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["params", *nodes]) == 0
    text = capsys.readouterr().out
    given = flatten(yaml.safe_load(text)["/**"]["ros__parameters"])
    each = [parameters_of(node) for node in nodes or ("plant_simulator", "controller")]
    wanted = {name: default for parameters in each for name, (_, default) in parameters.items()}
    assert given == {name: default for name, default in wanted.items() if not name.startswith(DERIVED)}
    assert "# armature resistance R [ohm]; > 0 and <= 1e+06\n" in text
    commented = yaml.safe_load(re.sub(r"^( +)# (?=( *\w+:|    *#))", r"\1", text, flags=re.MULTILINE))
    assert flatten(commented["/**"]["ros__parameters"]) == wanted


def test_params_describes_the_nominal_drive(written: Path) -> None:
    assert Drive.read(written) == NOMINAL_DRIVE


def test_params_keeps_an_existing_file(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = written.read_text()
    with pytest.raises(SystemExit, match="2"):
        main(["params", "controller", "--out", str(written)])
    told = capsys.readouterr().err
    assert told == f"backlash params: argument --out: '{written}' exists; --force overwrites it\n"
    assert written.read_text() == text


def test_controller_takes_the_file_in_any_namespace(start: Any, peer: Peer) -> None:
    start("controller", "--params-file", str(CONFIG), "-r", "__ns:=/axis1")
    parameters = Parameters(peer, "/axis1/controller")
    assert parameters.get("gain_set_names", "gain_set") == [["nominal", "gentle"], "nominal"]
    accepted, reason = parameters.set(gain_set="gentle")
    assert accepted, reason
    assert parameters.get("gains.fast.k") == [[10.0, 0.4, 0.1]]


def test_controller_takes_gains_that_were_designed_at_its_start_and_while_it_runs(
    start: Any, peer: Peer, tmp_path: Path
) -> None:
    fast = design_gains("fast", NOMINAL_DRIVE, [1000.0, 1.0])
    file = tmp_path / "gains.yaml"
    designed = {}
    for k1 in (1.5, 2.0):
        file.write_text(gain_text(Loop(NOMINAL_DRIVE, fast), Choice(Gains(k1, 0.0, -0.5), k1), "my drive"))
        designed[k1] = flatten(yaml.safe_load(file.read_text())["/**"]["ros__parameters"])
    start("controller", "--params-file", str(CONFIG), "--params-file", str(file))
    parameters = Parameters(peer, "controller")
    names = "law", "gains.overdamped.k", "laws.two_region.width", "gain_set"
    assert parameters.get(*names) == ["two_region", [2.0, 0.0, -0.5], 2.0, "custom"]
    accepted, reason = parameters.set(**{name.replace(".", "__"): value for name, value in designed[1.5].items()})
    assert accepted, reason
    assert parameters.get(*names) == ["two_region", [1.5, 0.0, -0.5], 1.5, "custom"]
