"""What the tests of pages share: one browser for all of them."""

from collections.abc import Iterator
from typing import Any

import pytest


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
