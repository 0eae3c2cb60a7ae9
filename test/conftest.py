"""What all tests share: which cases of a test are run where, and one browser for those of pages."""

from collections.abc import Generator, Iterator
from itertools import combinations_with_replacement, groupby
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--first-parameters", action="store_true", help="run each test with its first parameters only")


def pairs_of(item: Any) -> set[Any]:
    """Return each value of the parameters of a case, and each pair of them."""
    values = ((name, id(value)) for name, value in item.callspec.params.items())
    return set(combinations_with_replacement(sorted(values), 2))


@pytest.hookimpl(hookwrapper=True)
def pytest_pycollect_makeitem() -> Generator[None, Any, None]:
    """Mark all but the corners of a test as its grid: those cases that show most pairs of values not seen before."""
    made = (yield).get_result()
    if isinstance(made, list) and made and (corners := made[0].get_closest_marker("corners")):
        left, seen = list(made), set[Any]()
        for _ in range(*corners.args):
            left.remove(corner := max(left, key=lambda item: len(pairs_of(item) - seen)))
            seen |= pairs_of(corner)
        for item in left:
            item.add_marker("grid")


def mixed(items: list[pytest.Item]) -> list[pytest.Item]:
    """Spread the files with nodes among the others, so that some of both run at a time; the last ones are short.

    A node takes part of a core as long as it runs, whatever it does.
    """
    placed: list[tuple[float, list[pytest.Item]]] = []
    live: dict[bool, list[list[pytest.Item]]] = {True: [], False: []}
    for file, group in groupby(items, key=lambda item: item.path):
        live[file.parent.name in {"nodes", "system"}].append(list(group))
    for takes_long, files in live.items():
        end = 0.8 if takes_long else 1.0
        placed += [(end * (k + 0.5) / len(files), file) for k, file in enumerate(files)]
    return [item for _, file in sorted(placed, key=lambda each: each[0]) for item in file]


@pytest.hookimpl(trylast=True)  # after those that a marker deselects
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mix the files of kinds that are run side by side; keep one item of each function, where this is asked for."""
    items[:] = mixed(items)
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
