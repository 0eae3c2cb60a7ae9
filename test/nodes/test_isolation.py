"""A domain of one's own: nobody takes part in it, nobody else claims it, and nothing is left of it."""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions

from backlash_ros.ros import isolation
from backlash_ros.ros.isolation import own_domain

CLAIM = """
import sys, time
from backlash_ros.ros import isolation
isolation._DOMAINS = range(int(sys.argv[1]), int(sys.argv[1]) + 1)
with isolation.own_domain() as domain:
    print(domain, flush=True)
    time.sleep(600)
"""


@contextmanager
def somebody_else(domain: int) -> Iterator[subprocess.Popen[str]]:
    """Let another process claim the domain."""
    with subprocess.Popen([sys.executable, "-c", CLAIM, str(domain)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == f"{domain}\n"
        yield process
        process.kill()


@contextmanager
def participant(domain: int) -> Iterator[None]:
    """Take part in the domain, as a process does that knows nothing of claims."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("foreign", context=context)
    yield
    node.destroy_node()
    context.shutdown()


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> int:
    """Leave one domain to be claimed."""
    with own_domain() as domain:
        monkeypatch.setattr(isolation, "_DOMAINS", range(domain, domain + 1))
    return domain


def assert_taken(domain: int) -> None:
    with pytest.raises(RuntimeError, match=f"no ROS domain is free between {domain} and {domain}"), own_domain():
        pass


def assert_free(domain: int) -> None:
    with own_domain() as claimed:
        assert claimed == domain


def test_domain_is_claimed_by_one_process_and_free_when_that_is_killed(only: int) -> None:
    with somebody_else(only):
        assert_taken(only)
    assert_free(only)


def test_domain_is_free_again_in_the_same_process(only: int) -> None:
    with own_domain():
        assert_taken(only)
    assert_free(only)


def test_claims_leave_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with own_domain():
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "variables",
    [{}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}],
    ids=["subnet", "localhost", "off"],
)
def test_domain_with_a_live_graph_is_left_alone(
    only: int, variables: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with participant(only):
        assert_taken(only)
    assert_free(only)
