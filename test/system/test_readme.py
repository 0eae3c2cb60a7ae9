"""What a newcomer does: commands of the environment that make makes, and those of ROS in the order of the guides."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pages import DESIGNED, ROOT, commands, commands_of
from reported import axes_bag

from backlash_ros.cli import main
from backlash_ros.ros.isolation import isolated

COMMANDS = commands("test_readme.py")
ENVIRONMENT = ROOT / ".venv" / "bin"
GUIDES = [ROOT / "docs" / name for name in ("quickstart.md", "axes.md")]
ROS_COMMANDS = list(dict.fromkeys(c for page in GUIDES for c in commands_of(page) if c.startswith("ros2 ")))
PATIENT = {"plant_simulator": "command_timeout", "controller": "state_timeout"}
"""What lets the nodes bear a machine on which each command starts a Python of its own."""
SAID = {"simulate": '"peak_force_N"', "report": "written: results/report.html"}
"""What each subcommand of `backlash` prints when it has done its work."""


def test_make_runs_what_the_tests_run() -> None:
    def recipe(target: str) -> str:
        dry = ["make", "-n", *target.split(), "VENV=.venv"]
        return subprocess.run(dry, cwd=ROOT, capture_output=True, text=True, check=True).stdout

    assert "-m backlash_ros" not in recipe("install")  # what a newcomer's own drive needs: nothing runs
    assert recipe("") == recipe("install")
    assert "-m backlash_ros.demo" in recipe("demo")
    assert "-m pytest" in recipe("test")
    assert "-m backlash_ros.cli figures" in recipe("paper")
    assert "-m pytest -m grid" in recipe("test-grid")
    assert re.search(r"^make test$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with isolated():
        yield dict(os.environ)


def end(process: subprocess.Popen[str]) -> str:
    """Stop a command as Ctrl-C does, with all that it started, and return what it printed."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
    try:
        return process.communicate(timeout=60)[0]
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def begin(command: str, environment: dict[str, str], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        ["bash", "-c", f"exec {command}"],
        cwd=folder,
        env={**environment, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what the commands read."""
    for name in ("config", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "gains.yaml").write_text(DESIGNED)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("backlash ")])
def test_command_line_works(command: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = command.split()[1]
    if name == "report":
        axes_bag([""]).write(folder / "results" / "demo" / "bag")  # in the demo's place
    assert main(shlex.split(command)[1:]) == 0
    assert SAID[name] in capsys.readouterr().out


def test_the_command_line_is_installed(folder: Path) -> None:
    if not (ENVIRONMENT / "backlash").exists():
        pytest.skip("needs the .venv that make makes")
    command = min((c for c in COMMANDS if c.startswith("backlash ")), key=len)
    words = [str(ENVIRONMENT / "backlash"), *shlex.split(command)[1:]]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert SAID[words[1]] in done.stdout


@pytest.mark.parametrize("command", [c for c in COMMANDS if re.match("plant_simulator|controller|recorder", c)])
def test_nodes_start_from_the_environment(command: str, environment: dict[str, str], tmp_path: Path) -> None:
    if not (ENVIRONMENT / command.split(maxsplit=1)[0]).exists():
        pytest.skip("needs the .venv that make makes")
    shutil.copy(ROOT / "config" / "nominal_drive.yaml", tmp_path / "my_drive.yaml")
    process = begin(str(ENVIRONMENT / command), environment, tmp_path)
    printed = ""
    try:
        printed = read_until(process, r"simulating at 250 Hz|ready at 250 Hz|recording")
    finally:
        printed += end(process)
    assert process.returncode == 0, printed


def why_not_ros2() -> str:
    if shutil.which("ros2") is None:
        return "needs the ros2 command"
    if subprocess.run(["ros2", "pkg", "prefix", "backlash_ros"], capture_output=True, check=False).returncode != 0:
        return "needs the package built and sourced"
    return ""


@pytest.fixture
def ros2(environment: dict[str, str]) -> Iterator[dict[str, str]]:
    """An environment with the ros2 command, whose daemon ends with the test."""
    if reason := why_not_ros2():
        pytest.skip(reason)
    yield environment
    subprocess.run(["ros2", "daemon", "stop"], env=environment, capture_output=True, timeout=60, check=False)


def read_until(process: subprocess.Popen[str], *patterns: str) -> str:
    """Return what a process prints until every pattern has been seen."""
    assert process.stdout is not None
    printed = ""
    while not all(re.search(pattern, printed) for pattern in patterns):
        line = process.stdout.readline()
        assert line, printed
        printed += line
    return printed


def ends_well(command: str, environment: dict[str, str], folder: Path) -> None:
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    printed = done.stdout + done.stderr
    assert done.returncode == 0, f"{command}\n{printed}"
    assert "failed" not in printed, f"{command}\n{printed}"
    if "/learn " in command or "/identify " in command:
        assert "success=True" in printed, printed


def test_ros2_commands_work_in_their_order(ros2: dict[str, str], tmp_path: Path) -> None:
    """What runs until it is stopped goes on in the background; the rest has to end well."""
    running: list[subprocess.Popen[str]] = []
    try:
        for command in ROS_COMMANDS:
            if command.startswith("ros2 launch") or "--axes" in command:
                continue  # in place of the two nodes: next tests
            if command.startswith("ros2 run") and (name := command.split()[3]) != "backlash":
                patient = f" --ros-args -p {PATIENT[name]}:=10.0" if name in PATIENT else ""
                if name == "plant_simulator" and running:  # in the place of the first one
                    end(running.pop(0))
                running.append(begin(command + patient, ros2, tmp_path))
                read_until(running[-1], "simulating at|ready at|recording")
                continue
            if command.startswith("ros2 topic hz"):
                process = begin(command, ros2, tmp_path)
                read_until(process, "average rate: [12]")
                end(process)
                continue
            ends_well(command, ros2, tmp_path)
            if command.startswith("ros2 topic pub"):
                time.sleep(1.0)  # as a reader of the README would: the load moves
    finally:
        printed_by = [end(process) for process in running]
    assert [process.returncode for process in running] == [0] * len(running), printed_by


def test_a_real_drive_is_tried_and_closed_step_by_step(ros2: dict[str, str], tmp_path: Path) -> None:
    """The way of docs/real_drive.md, with the simulator for the drive, and no ros2_control before it."""
    steps = [c for c in commands_of(ROOT / "docs" / "real_drive.md") if c.startswith("ros2 ")]
    steps = [c.replace(" -r command:=/motor_controller/commands", "") for c in steps if "controller_manager" not in c]
    tools = [command.split()[1] for command in steps]
    assert tools == ["run", *(4 * ["topic"]), "lifecycle", "lifecycle", "topic", "service", "param"]
    shutil.copy(ROOT / "config" / "nominal_drive.yaml", tmp_path / "my_drive.yaml")
    shutil.copy(ROOT / "config" / "ros2_control.yaml", tmp_path)
    drive = "ros2 run backlash_ros plant_simulator --ros-args -p command_timeout:=10.0"
    running = [begin(drive, ros2, tmp_path), begin(f"{steps[0]} -p state_timeout:=10.0", ros2, tmp_path)]
    try:
        read_until(running[0], "simulating at")
        read_until(running[1], "waiting for the requests to configure")
        zeros = begin(steps[1], ros2, tmp_path)
        try:
            read_until(zeros, "publishing #3")
            for command in steps[2:5]:
                ends_well(command, ros2, tmp_path)
        finally:
            end(zeros)
        for command in steps[5:]:
            if (
                "/learn " not in command
            ):  # in real time on a shared machine it may be refused; quickstart's is tried above
                ends_well(command, ros2, tmp_path)
        assert "backlash_angle: 0.0" in (tmp_path / "learned.yaml").read_text()
    finally:
        printed_by = [end(process) for process in running]
    assert [process.returncode for process in running] == [0, 0], printed_by


@pytest.mark.parametrize(
    ("arguments", "gain_set"),
    [("", "nominal"), (" gain_set:=gentle", "gentle"), (" namespace:=a gain_set:=gentle log_level:=debug", "gentle")],
)
@pytest.mark.parametrize("command", [c for c in ROS_COMMANDS if "servo.launch.py" in c])
def test_launch_file_starts_both_nodes(
    command: str, arguments: str, gain_set: str, ros2: dict[str, str], tmp_path: Path
) -> None:
    pytest.importorskip("launch_ros", reason="needs launch_ros")
    process = begin(command + arguments, ros2, tmp_path)
    try:
        printed = read_until(process, "simulating at 250 Hz", f"ready at 250 Hz with gain set '{gain_set}'")
    finally:
        rest = end(process)
    assert rest.count("process has finished cleanly") == 2, printed + rest


@pytest.mark.parametrize("command", [c for c in ROS_COMMANDS if "ros2 launch" in c])
def test_launch_without_its_parameter_file_starts_nothing(command: str, ros2: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip("launch_ros", reason="needs launch_ros")
    process = begin(f"{command} config:=nosuch.yaml", ros2, tmp_path)
    printed = process.communicate(timeout=60)[0]
    assert process.returncode == 1, printed
    assert "config: there is no file 'nosuch.yaml'" in printed
    assert "process started" not in printed


@pytest.mark.parametrize("command", [c for c in ROS_COMMANDS if "ros2 run" in c and "--axes" in c])
def test_one_process_runs_six_axes(command: str, ros2: dict[str, str]) -> None:
    process = begin(command, ros2, ROOT)
    printed = ""
    try:
        for _ in range(6):
            printed += read_until(process, "simulating at 250 Hz|ready at 250 Hz")
    finally:
        printed += end(process)
    assert process.returncode == 0, printed


@pytest.mark.parametrize(
    ("arguments", "processes", "first", "second"),
    [
        ("", 2, "nominal", "stiff"),
        (" gain_set:=gentle", 2, "gentle", "gentle"),
        (" simulator:=false", 1, "nominal", "stiff"),
    ],
)
@pytest.mark.parametrize("command", [c for c in ROS_COMMANDS if "axes.launch.py" in c])
def test_launch_file_starts_the_axes(
    command: str, arguments: str, processes: int, first: str, second: str, ros2: dict[str, str], tmp_path: Path
) -> None:
    pytest.importorskip("launch_ros", reason="needs launch_ros")
    process = begin(command + arguments, ros2, tmp_path)
    wanted = [f"[axis1.controller]: ready at 250 Hz with gain set '{first}'"]
    wanted += [f"[axis2.controller]: ready at 250 Hz with gain set '{second}'"]
    wanted += [f"[axis{k}.plant_simulator]: simulating at 250 Hz" for k in range(1, 4) if processes == 2]
    printed = ""
    try:
        printed = read_until(process, *map(re.escape, wanted))
    finally:
        printed += end(process)
    assert printed.count("process has finished cleanly") == processes, printed
