"""Real DDS for tests: each has a context of its own, and its processes end with it."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import rclpy
from data_sheet import Rig
from faults_page import SECTION, page
from graph import Peer, Process
from rclpy.signals import SignalHandlerOptions
from served import Served, System

from backlash_ros.ros.isolation import isolated


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--faults-page", type=Path, help="write the fault table there")


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Write the fault table, where it was asked for, from the tests that passed."""
    path = config.getoption("--faults-page")
    if path is not None:
        passed = [report for report in terminalreporter.stats.get("passed", []) if report.when == "call"]
        times = {report.nodeid.split("::", 1)[1]: [t for _, t in report.user_properties] for report in passed}
        rest = path.read_text().partition(SECTION)[2] if path.exists() else ""
        path.write_text(page(times) + (f"\n{SECTION}{rest}" if rest else ""))


@pytest.fixture
def measure(request: pytest.FixtureRequest) -> Callable[[float], None]:
    """Take the time from the fault to 0 V, s, for the fault table."""
    return lambda seconds: request.node.user_properties.append(("seconds", seconds))


@pytest.fixture
def domain() -> Iterator[int]:
    with isolated() as number:
        yield number


@pytest.fixture
def in_process(domain: int) -> Iterator[None]:
    """Let the test make nodes of the package in its own process."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.shutdown()


@pytest.fixture
def peer(domain: int) -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture
def start(domain: int, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Callable[..., Process]]:
    """Start nodes; keyword arguments are parameters (double underscores for dots). All end with the test."""
    started: list[Process] = []

    def start_node(
        name: str,
        *arguments: str,
        non_ros: Sequence[str] = (),
        under: Sequence[str] = (),
        fresh: bool = False,
        **parameters: object,
    ) -> Process:
        words = list(arguments)
        for key, value in parameters.items():
            words += ["-p", f"{key.replace('__', '.')}:={str(value).lower() if isinstance(value, bool) else value}"]
        process = Process(name, words, tmp_path / f"{name}{len(started)}.log", non_ros, under, fresh)
        started.append(process)
        return process

    yield start_node
    for process in started:
        process.kill()
    for process in started:
        # Shown by pytest where the test failed.
        print(f"--- {process.log.stem}\n{re.sub(r'Extension modules:.*', '', process.output())}")


@pytest.fixture
def rig(start: Callable[..., Process], peer: Peer, tmp_path: Path) -> Callable[..., Rig]:
    """Start a controller that is told the data sheet of a `Member`, and the drive; keyword arguments as for `start`."""
    return lambda member, **parameters: Rig(start, peer, tmp_path, member, **parameters)


@pytest.fixture
def serve(tmp_path: Path, peer: Peer) -> Iterator[Callable[..., Served]]:
    """Start a dashboard and wait until it serves."""
    with ExitStack() as ends:

        def started(*arguments: str) -> Served:
            made = Served(tmp_path, *arguments)
            ends.callback(lambda: print(f"--- dashboard\n{made.process.output()}"))
            ends.callback(made.process.kill)
            peer.wait(lambda: f"the dashboard, which said {made.process.output()}", lambda: made.address)
            return made

        yield started


@pytest.fixture(scope="class")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """Run one dashboard with a drive for all tests of a class."""
    with isolated():
        made = System(tmp_path_factory.mktemp("system"))
        yield made
        made.close()


@pytest.fixture
def system(shared: System) -> System:
    """Give that dashboard as it was at first."""
    shared.anew()
    return shared
