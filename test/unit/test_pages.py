"""README and docs: links lead somewhere, commands are understood and run, nodes and parameters exist."""

import re
import shlex
import subprocess
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from pages import PAGES, ROOT, commands, runner

from backlash_ros import __version__
from backlash_ros.cli import COMMANDS, main, parser_of

PARAMETERS = (ROOT / "docs" / "parameters.md").read_text()
OF_ROS = {"use_sim_time"}
OF_RECORDER = {"output", "topics"}


@cache
def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        place = (page.parent / path).resolve() if path else page
        assert place.exists(), target
        assert not anchor or anchor in anchors(place), target


@pytest.mark.parametrize("command", [c for c in commands() if c.startswith("backlash ")])
def test_commands_are_understood(command: str) -> None:
    words = shlex.split(command)[1:]
    parser_of(words).parse_args(words)  # ends the interpreter where one is not


EVALUATIONS = [c for c in commands("test_pages.py") if c.startswith("backlash evaluate ")]
"""One with few options is enough for every change; the others are a grid of populations, models and encoders."""


def is_long(command: str) -> bool:
    return (command in EVALUATIONS and command != min(EVALUATIONS, key=len)) or command.startswith("backlash design ")


@pytest.mark.population
@pytest.mark.parametrize(
    "command",
    [pytest.param(c, marks=pytest.mark.grid if is_long(c) else []) for c in commands("test_pages.py")],
)
def test_commands_do_what_they_say(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They end well, and write what they name; of the drives that are evaluated, one is, learned in a short way."""
    (tmp_path / "config").symlink_to(ROOT / "config")
    monkeypatch.chdir(tmp_path)
    words = shlex.split(re.sub(r"--drives \d+", "--drives 1", command.removeprefix("ros2 run backlash_ros ")))[1:]
    words += ["--experiments", "limit_cycle"] if words[0] == "evaluate" and "--experiments" not in words else []
    assert main(words) == 0
    written = [Path(name) for option, name in pairwise(words) if option in {"--out", "--plot", "--json"}]
    assert all(path.stat().st_size > 0 for path in written)
    assert written or capsys.readouterr().out


@pytest.mark.parametrize(
    "command", [c for c in commands() if c.startswith("ros2 run backlash_ros ") and " backlash " not in c]
)
def test_nodes_and_their_parameters_exist(command: str) -> None:
    words = shlex.split(command)
    assert f'f"{words[3]} = {{NAME}}' in (ROOT / "setup.py").read_text()
    names = [rule.partition(":=")[0] for flag, rule in pairwise(words) if flag == "-p"]
    for name in names:
        known = OF_RECORDER if words[3] == "recorder" else OF_ROS
        assert f"| `{name}` |" in PARAMETERS or name in known, name


@pytest.mark.parametrize("command", commands())
def test_something_runs_each_command(command: str) -> None:
    assert (ROOT / runner(command)).is_file(), "nothing runs it: see RUN_BY in pages.py"


def test_pages_have_commands_of_both_kinds() -> None:
    assert sum(c.startswith("backlash ") for c in commands()) > 15
    assert sum(c.startswith("ros2 run backlash_ros ") for c in commands()) > 8


@pytest.mark.parametrize("name", re.findall(r"^    ([\w-]+) ", parser_of([]).format_help(), re.MULTILINE))
def test_help_of_each_command_has_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    if name in {"demo", "live"}:
        pytest.importorskip("rclpy", reason="needs rclpy")
    with pytest.raises(SystemExit, match="0"):
        main([name, "--help"])
    assert f"backlash {name} " in capsys.readouterr().out.partition("xample")[2]


def test_all_places_have_one_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"backlash_ros {__version__}\n"
    assert f"<version>{__version__}</version>" in (ROOT / "package.xml").read_text()
    assert f'version="{__version__}"' in (ROOT / "setup.py").read_text()
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_every_command_is_listed() -> None:
    modules = (ROOT / "backlash_ros" / "commands").glob("*.py")
    assert {path.stem.replace("_", "-") for path in modules if "\nCOMMAND = " in path.read_text()} == set(COMMANDS)


def test_help_does_not_wait_for_what_the_commands_import() -> None:
    code = "import sys; from backlash_ros.cli import parser_of; parser_of([]).format_help(); print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numba", "numpy", "scipy", "rclpy"} & set(modules)
