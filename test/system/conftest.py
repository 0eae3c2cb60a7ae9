"""What the tests of pages share: one browser for all of them."""

from collections.abc import Iterator

import pytest
from in_browser import chromium, console_of, emulate, missing, requests_of
from selenium.webdriver import Chrome


@pytest.fixture(scope="session")
def _chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    if why := missing():
        pytest.skip(why)
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@pytest.fixture
def browser(_chromium: Chrome) -> Chrome:
    """Give a headless Chromium with an empty page and empty logs; skip where there is none."""
    _chromium.get("about:blank")
    emulate(_chromium)
    console_of(_chromium)
    requests_of(_chromium)
    return _chromium
