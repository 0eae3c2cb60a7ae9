"""What all tests share: an option to run each with its first parameters only, and one browser for those of pages."""

from collections.abc import Iterator
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--first-parameters", action="store_true", help="run each test with its first parameters only")


@pytest.hookimpl(trylast=True)  # after those that a marker deselects
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep one item of each function, where this is asked for."""
    if not config.getoption("--first-parameters"):
        return
    first: dict[str, pytest.Item] = {}
    for item in items:
        first.setdefault(item.nodeid.split("[")[0], item)
    kept = list(first.values())
    config.hook.pytest_deselected(items=[item for item in items if first[item.nodeid.split("[")[0]] is not item])
    items[:] = kept


@pytest.fixture(scope="session")
def _chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from in_browser import chromium, missing  # noqa: PLC0415 - other tests need no selenium

    if why := missing():
        pytest.skip(why)
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@pytest.fixture
def browser(_chromium: Any) -> Iterator[Any]:
    """Give a headless Chromium with an empty page and empty logs; skip where there is none."""
    from in_browser import console_of, emulate, requests_of  # noqa: PLC0415

    emulate(_chromium)
    console_of(_chromium)
    requests_of(_chromium)
    yield _chromium
    _chromium.get("about:blank")  # it would draw on
