"""Pages of `backlash report` in a browser: charts drawn and zoomed, in light, dark and on paper, without a network."""

import re
from pathlib import Path

import pytest
import reported
from in_browser import console_of, emulate, requests_of
from plain_bag import PlainBag
from report_page import PATIENCE, opened, shown, wait
from reported import in_use
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from backlash_ros.cli import main
from backlash_ros.simulation.colours import DARK, LIGHT, PRINT


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the pages of two axes of ours and of somebody else's drive."""
    folder = tmp_path_factory.mktemp("pages")
    drive = reported.write_drive(folder)
    made = {
        "ours": (reported.axes_bag(["/axis1", "/axis2"]), []),
        "foreign": (reported.foreign_bag(), [*reported.FOREIGN, "--drive", str(drive)]),
    }
    for name, (bag, options) in made.items():
        words = ["report", str(bag.write(folder / name)), "--out", str(folder / f"{name}.html"), *options]
        assert main(words) == 0
    return {name: folder / f"{name}.html" for name in made}


def curves(chart: WebElement) -> str:
    """Return all that is drawn in a chart."""
    return str(chart.find_element(By.TAG_NAME, "svg").get_attribute("innerHTML"))


def plot(chart: WebElement) -> WebElement:
    return chart.find_element(By.CSS_SELECTOR, ".plot")


@pytest.mark.corners(1)
@pytest.mark.parametrize("name", ["ours", "foreign"])
def test_all_charts_are_drawn_and_nothing_is_loaded(browser: Chrome, pages: dict[str, Path], name: str) -> None:
    charts = opened(browser, pages[name])
    assert len(charts) >= {"ours": 8, "foreign": 4}[name]
    for chart in charts:
        low, high = shown(chart)
        assert low < high
        curve = chart.find_elements(By.CSS_SELECTOR, "svg path[stroke-linejoin='bevel']")
        assert sum(len(str(path.get_attribute("d"))) for path in curve) > 500
    asked = requests_of(browser)
    assert asked[0] == pages[name].as_uri()
    assert all(address.startswith("blob:null/") for address in asked[1:])
    assert console_of(browser) == []


def test_the_first_screen_is_the_answer_and_the_rest_unfolds(browser: Chrome, pages: dict[str, Path]) -> None:
    """Verdicts, and a row with a small picture for each step; a click on a step's number unfolds its chart."""
    size = {"width": 1400, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        browser.get(pages["foreign"].as_uri())
        wait(browser, "return document.documentElement.dataset.charts === 'ready'")
        seen = browser.find_elements(By.CSS_SELECTOR, ".verdict, section > .wide tbody tr, .sketch")
        assert len(seen) == 2 + 2 + 2
        assert all(each.rect["width"] > 100 and each.rect["y"] + each.rect["height"] < 450 for each in seen)
        assert browser.execute_script("return document.documentElement.scrollHeight") < 2 * 900
        chart = browser.find_element(By.ID, "chart-2")
        assert not chart.is_displayed()
        browser.find_element(By.LINK_TEXT, "2").click()
        wait(browser, "return arguments[0].querySelectorAll('svg path').length > 10", chart)
        assert chart.is_displayed()
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.fixture(scope="module")
def marked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a step with marks close to each other, and one at its very end."""
    folder, bag = tmp_path_factory.mktemp("marked"), PlainBag()
    for version, law in enumerate(("fast", "overdamped", "fast", "overdamped"), 1):
        bag.in_use("/controller/parameters_in_use", 0.24 * (version > 1) + 0.01 * version, version, in_use(law, 0.02))
    for time, torque in ((3.0, 0.1), (3.01, -0.1), (3.45, 0.25), (3.48, 0.0)):
        bag.number("/load_torque", time, torque)
    for k in range(875):
        time = 0.004 * k
        bag.sample("/joint_states", time, ("motor", "load"), (0.0, float(time >= 0.3)))
        bag.status("/controller/state", time, "servo", {"reference": float(time >= 0.3), "experiment": int(time > 3.2)})
    assert main(["report", str(bag.write(folder / "bag")), "--out", str(folder / "page.html")]) == 0
    return folder / "page.html"


LABELS = """
const plot = arguments[0].querySelector("svg").getBoundingClientRect();
return [...arguments[0].querySelectorAll("svg text")].filter((each) => each.style.fontSize === "10px").map((each) => {
  const { left, right, top, bottom } = each.getBoundingClientRect();
  return [each.textContent, left - plot.left, right - plot.right, top - plot.top, bottom - plot.top];
});
"""


def labels(browser: Chrome, chart: WebElement) -> list[tuple[str, float, float, float, float]]:
    """Return the labels of a chart's marks: text, distances from the left and the right edge, top and bottom."""
    found = [tuple(label) for label in browser.execute_script(LABELS, chart)]
    for text, left, right, top, _ in found:
        assert left > 60.0, text
        assert right < 0.0, text
        assert top > 35.0, text  # below the name of the panel
    for k, (text, left, right, top, bottom) in enumerate(found):
        width = plot(chart).rect["width"]
        for other, low, high, above, below in found[:k]:
            apart = width + right <= low + 1.0 or width + high <= left + 1.0
            assert apart or bottom <= above + 2.0 or below <= top + 2.0, (text, other)
    return found


def test_labels_of_marks_stay_in_the_plot_and_apart(browser: Chrome, marked: Path) -> None:
    """Also where they crowd, and when the chart is zoomed."""
    step, overview, *_ = opened(browser, marked)
    assert {label[0] for label in labels(browser, overview)} == {
        "1",
        "run 1",
        "0.1 N m",
        "-0.1 N m",
        "0.25 N m",
        "0 N m",
    }
    assert {label[0] for label in labels(browser, step)} >= {"law", "0.1 N m"}
    for move in ("in", "right", "in", "right", "right"):
        button = overview.find_element(By.CSS_SELECTOR, f"[data-zoom={move}]")
        browser.execute_script("arguments[0].click()", button)
        labels(browser, overview)
    WebDriverWait(browser, PATIENCE).until(lambda _: "0.1 N m" in {label[0] for label in labels(browser, overview)})
    assert "1" not in {label[0] for label in labels(browser, overview)}  # it lies before
    assert console_of(browser) == []


def test_a_click_on_a_step_shows_the_title_of_what_it_unfolds(browser: Chrome, pages: dict[str, Path]) -> None:
    browser.get(pages["foreign"].as_uri())
    wait(browser, "return document.documentElement.dataset.charts === 'ready'")
    browser.find_element(By.LINK_TEXT, "2").click()
    chart = browser.find_element(By.ID, "chart-2")
    top = "return arguments[0].closest('details').querySelector('summary').getBoundingClientRect().top"
    WebDriverWait(browser, PATIENCE).until(lambda _: chart.is_displayed())
    assert 0.0 <= browser.execute_script(top, chart) < 500.0


def test_on_a_phone_a_column_without_a_name_has_no_colon(browser: Chrome, pages: dict[str, Path]) -> None:
    browser.get(pages["ours"].as_uri())
    assert browser.find_elements(By.CSS_SELECTOR, "td:not([data-name])")
    assert not browser.find_elements(By.CSS_SELECTOR, 'td[data-name=""]')


@pytest.mark.grid
def test_a_chart_is_zoomed_by_buttons_keys_wheel_and_drag(browser: Chrome, pages: dict[str, Path]) -> None:
    step = opened(browser, pages["foreign"])[1]
    whole, before = shown(step), curves(step)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", step)
    buttons = {str(b.get_attribute("data-zoom")): b for b in step.find_elements(By.TAG_NAME, "button")}
    buttons["in"].click()
    near = shown(step)
    assert near[1] - near[0] == pytest.approx(0.5 * (whole[1] - whole[0]), rel=0.01)
    WebDriverWait(browser, PATIENCE).until(lambda _: curves(step) != before)
    buttons["right"].click()
    assert shown(step)[0] > near[0]
    buttons["all"].send_keys(Keys.ENTER)
    assert shown(step) == whole
    buttons["all"].send_keys(Keys.TAB)
    assert browser.switch_to.active_element != buttons["all"]
    browser.switch_to.active_element.send_keys(Keys.SHIFT, Keys.TAB)
    buttons["in"].send_keys(Keys.SPACE)
    assert shown(step) == near
    buttons["out"].click()
    assert shown(step) == whole

    ActionChains(browser).scroll_from_origin(ScrollOrigin.from_element(plot(step)), 0, -300).perform()
    WebDriverWait(browser, PATIENCE).until(lambda _: shown(step) != whole)
    wheeled = shown(step)
    assert wheeled[1] - wheeled[0] < 0.95 * (whole[1] - whole[0])
    ActionChains(browser).drag_and_drop_by_offset(plot(step), 120, 0).perform()
    WebDriverWait(browser, PATIENCE).until(lambda _: shown(step)[0] < wheeled[0])
    assert console_of(browser) == []


def colours_of(browser: Chrome, chart: WebElement) -> set[str]:
    found = browser.execute_script(
        "return [...arguments[0].querySelectorAll('svg [stroke]')].map((curve) => curve.getAttribute('stroke'))", chart
    )
    return set(found)


@pytest.mark.grid
def test_colours_follow_the_scheme_and_paper_is_light(browser: Chrome, pages: dict[str, Path]) -> None:
    ground = "return getComputedStyle(document.body).backgroundColor"
    chart = opened(browser, pages["foreign"])[0]
    for scheme, colours in (("dark", DARK), ("light", LIGHT), ("dark", DARK)):
        emulate(browser, scheme=scheme)
        WebDriverWait(browser, PATIENCE).until(lambda _, c=colours: c["load"] in colours_of(browser, chart))
        red, green, blue = (int(colours["paper"][k : k + 2], 16) for k in (1, 3, 5))
        assert browser.execute_script(ground) == f"rgb({red}, {green}, {blue})"
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    assert {PRINT["load"], PRINT["faint"]} <= colours_of(browser, chart)
    emulate(browser, scheme="dark", media="print")
    assert browser.execute_script(ground) == "rgb(255, 255, 255)"
    browser.execute_script("dispatchEvent(new Event('afterprint'))")
    assert DARK["load"] in colours_of(browser, chart)


@pytest.mark.grid
def test_it_prints_all_charts_even_those_that_nobody_scrolled_to(browser: Chrome, pages: dict[str, Path]) -> None:
    browser.get(pages["ours"].as_uri())
    wait(browser, "return document.documentElement.dataset.charts === 'ready'")
    drawn = "return document.querySelectorAll('figure.chart .plot:has(svg path)').length"
    assert browser.execute_script(drawn) < len(browser.find_elements(By.CSS_SELECTOR, "figure.chart"))
    browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    assert browser.execute_script(drawn) == len(browser.find_elements(By.CSS_SELECTOR, "figure.chart"))


@pytest.mark.grid
def test_without_scripts_the_figures_are_there(browser: Chrome, pages: dict[str, Path]) -> None:
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get(pages["foreign"].as_uri())
        text = browser.find_element(By.TAG_NAME, "body").text
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    assert "The charts need JavaScript" in text
    assert re.search(r"\b85\.\d{3}\b", text)  # the overshoot, mrad: 4.89 degrees
