"""Draws docs/images/dashboard.png: the page of `make live` before and after the backlash is learned, in Chromium."""

import argparse
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from in_browser import chromium
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

_PATIENCE = 120.0


def _wait(what: str, condition: Callable[[], Any]) -> Any:
    end = time.monotonic() + _PATIENCE
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(what)
        time.sleep(0.1)
    return value


def _click(browser: Chrome, words: str) -> None:
    next(each for each in browser.find_elements(By.TAG_NAME, "button") if each.text.strip() == words).click()


def _pause(browser: Chrome, seconds: float) -> None:
    """Let simulated time pass."""
    now = browser.execute_script("return live.joints.last('time')")
    _wait("time", lambda: browser.execute_script("return live.joints.last('time')") > now + seconds)


def draw(browser: Chrome, address: str, place: Path) -> None:
    """Do what the newcomer does, and take the picture."""
    browser.set_window_size(1400, 1260)
    browser.get(address)
    _wait("samples", lambda: browser.execute_script("return window.live?.joints.length > 100"))
    _click(browser, "30 s")
    _click(browser, "Step forward")
    _pause(browser, 7.0)
    _click(browser, "Learn the backlash")
    _wait("what is learned", lambda: "backlash in use: 20 mrad" in browser.page_source)
    _pause(browser, 4.0)
    _click(browser, "Step back")
    _pause(browser, 5.0)
    browser.save_screenshot(str(place))


def main() -> int:
    """Start it all, draw, end it all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images/dashboard.png"), help="file to write")
    place = parser.parse_args().out
    with TemporaryDirectory() as folder, Path(folder, "log").open("w+") as log:
        command = [sys.executable, "-m", "backlash_ros.dashboard.live", "--out", folder]
        running = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            said = Path(log.name).read_text
            address = _wait("the address", lambda: re.search(r"^http://\S+$", said(), re.MULTILINE))[0]
            with chromium(Path(folder, "browser")) as browser:
                draw(browser, address, place)
        finally:
            running.send_signal(signal.SIGINT)
            running.wait()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
