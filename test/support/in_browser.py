"""A headless Chromium for tests, and what its pages said and loaded."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
CHROMEDRIVER = shutil.which("chromedriver")
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1280,1000")


def missing() -> str:
    """Return why no browser can be started; empty where one can."""
    found = {"chromium": CHROMIUM, "chromedriver": CHROMEDRIVER}
    return ", ".join(f"{name} is not installed" for name, place in found.items() if place is None)


@contextmanager
def chromium(profile: Path) -> Iterator[Chrome]:
    """Start a browser that keeps its files in ``profile``, and end it."""
    options = ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for option in (*OPTIONS, f"--user-data-dir={profile}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = Chrome(options=options, service=Service(CHROMEDRIVER))
    try:
        yield driver
    finally:
        driver.quit()


def children(process: int) -> list[int]:
    """Return the processes that a process has started."""
    threads = Path(f"/proc/{process}/task").iterdir()
    return [int(pid) for thread in threads for pid in (thread / "children").read_text().split()]


def console_of(driver: Chrome) -> list[str]:
    """Return what pages have said on the console since the last call: errors, warnings, words."""
    return [f"{entry['level']}: {entry['message']}" for entry in driver.get_log("browser")]


def requests_of(driver: Chrome) -> list[str]:
    """Return the addresses that pages have asked for since the last call, without the browser's own pages."""
    events: list[dict[str, Any]] = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    asked = [e["params"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [
        each["request"]["url"] for each in asked if not each["documentURL"].startswith(("chrome:", "chrome-untrusted:"))
    ]


def emulate(driver: Chrome, *, scheme: str = "", media: str = "") -> None:
    """Show pages in the scheme ``light`` or ``dark``, on ``screen`` or in ``print``; empty: as the browser does."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
