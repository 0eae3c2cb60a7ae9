"""Excludes the kit from every run of pytest without a drive, such as this package's own tests."""

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:  # noqa: ARG001
    """Ignore the checks if there is nothing to check."""
    return None if config.getoption("--drive-command", None) else True
