"""Draws the dashboard's pictures in docs/images, in Chromium, with `make live`: the page and the tooth."""

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
STEP, BACK = "Step of 0.5 rad", "Step back 0.5 rad"


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


def draw(browser: Chrome, address: str, folder: Path) -> None:
    """Do what the newcomer does, and take the pictures."""
    screen = {"width": 1400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    browser.get(address)
    _wait("samples", lambda: browser.execute_script("return window.live?.joints.length > 100"))
    _click(browser, "30 s")
    _click(browser, STEP)
    _pause(browser, 5.0)
    browser.find_element(By.ID, "tooth").screenshot(str(folder / "tooth.png"))
    for words, result in (("Learn the backlash", "b = "), ("Identify the drive", "load inertia ")):
        _click(browser, words)
        _wait(result, lambda result=result: result in browser.find_element(By.CLASS_NAME, "strip").text)
        _pause(browser, 2.0)
    _click(browser, BACK)
    _pause(browser, 5.0)
    browser.save_screenshot(str(folder / "dashboard.png"))


def main() -> int:
    """Start it all, draw, end it all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder to write to")
    out = parser.parse_args().out
    with TemporaryDirectory() as folder, Path(folder, "log").open("w+") as log:
        command = [sys.executable, "-m", "backlash_ros.dashboard.live", "--out", folder]
        running = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            said = Path(log.name).read_text
            address = _wait("the address", lambda: re.search(r"^http://\S+$", said(), re.MULTILINE))[0]
            with chromium(Path(folder, "browser")) as browser:
                draw(browser, address, out)
        finally:
            running.send_signal(signal.SIGINT)
            running.wait()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
