"""The page of `backlash report` as a browser shows it."""

from pathlib import Path

from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

PATIENCE = 30.0
"""How long a page may take, s."""


def opened(browser: Chrome, page: Path) -> list[WebElement]:
    """Open a page and return its charts, when all are drawn."""
    browser.get(page.as_uri())
    wait(browser, "return document.documentElement.dataset.charts === 'ready'")
    browser.execute_script("document.querySelectorAll('details').forEach(each => { each.open = true })")
    charts = browser.find_elements(By.CSS_SELECTOR, "figure.chart")
    for chart in charts:
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
        wait(browser, "return arguments[0].querySelectorAll('svg path').length > 10", chart)
    return charts


def wait(browser: Chrome, script: str, *arguments: object) -> None:
    """Wait until a script returns true."""
    WebDriverWait(browser, PATIENCE, 0.05).until(lambda b: b.execute_script(script, *arguments))


def shown(chart: WebElement) -> tuple[float, float]:
    """Return the part of the time that a chart says it shows, s."""
    low, high = chart.find_element(By.TAG_NAME, "output").text.removesuffix(" s").replace("\u2212", "-").split(" to ")
    return float(low), float(high)
