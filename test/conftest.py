"""Real DDS for tests: each has a domain of its own."""

from collections.abc import Iterator

import pytest
from graph import environment

from backlash_ros.nodes.domain import own_domain


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Claim a domain; what the test starts, and its own process, are in it."""
    with own_domain() as number:
        for name, value in environment(number).items():
            monkeypatch.setenv(name, value)
        yield number
