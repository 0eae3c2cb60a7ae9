"""The page in a real browser, beside real nodes: what is seen, and what is done by clicks and keys."""

import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph import Lifecycle, Parameters, Peer
from in_browser import children, chromium, console_of, emulate, missing, requests_of
from selenium.common.exceptions import ElementClickInterceptedException, StaleElementReferenceException
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from served import WATCHDOG, B, Served, Start, System, begin
from std_msgs.msg import Float64, Float64MultiArray

from backlash_ros.ros.topics import RECEIVE

LOOKS = Path(__file__).parents[1] / "support" / "looks.js"
PLAYED_STEP = LOOKS.with_name("played_step.js")
WIDTHS = (360, 901, 1920)
BOXES = ("[data-name=stop]", ".strip", ".curves", "#tooth", "[data-name=go]")


def screen(width: int, height: int) -> dict[str, Any]:
    return {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 900}


class Page:
    """The page in a browser, used as a person would: by what is written on it."""

    def __init__(self, browser: Chrome, address: str, peer: Peer) -> None:
        self.browser, self._peer, self.look = browser, peer, {}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen(1400, 900))
        browser.get(address)
        self.wait("samples", lambda: self.run("return window.live?.joints.length ?? 0") > 100)

    def run(self, script: str, *arguments: str) -> Any:
        return self.browser.execute_script(script, *arguments)

    def wait(self, what: str, condition: Callable[[], Any]) -> Any:
        return self._peer.wait(lambda: f"{what}; {self.look or ''} the page says {self.text()}", condition)

    def text(self) -> str:
        return str(self.run("return document.body.innerText"))

    def said(self, name: str) -> str:
        return str(self.run(f"return document.querySelector('[data-name={name}]')?.textContent ?? ''"))

    def click(self, words: str) -> None:
        """Click on a button that stays where it is: while cards fill, they move, and a click meets what came there."""
        self.run(
            "window.met = null; window.meets ??= addEventListener('click',"
            " event => { window.met = event.target.closest('button')?.innerText.trim() }, {capture: true}) ?? true"
        )
        script = """
            const buttons = [...document.querySelectorAll('button:enabled')];
            const found = buttons.find(each => each.innerText.trim() === arguments[0] && each.checkVisibility());
            return found ? [found, JSON.stringify(found.getBoundingClientRect())] : [null, null]"""
        before: str | None = None

        def clicked() -> bool:
            nonlocal before
            (button, place), seen = self.run(script, words), before
            before = place
            if button is None or place != seen:
                return False
            with suppress(ElementClickInterceptedException, StaleElementReferenceException):
                button.click()
            return self.run("return window.met") == words

        self.wait(f"a click on the button {words!r}", clicked)

    def unfold(self, words: str) -> None:
        script = """
            const heads = [...document.querySelectorAll('.fold .q-item')];
            heads.find(head => head.innerText.startsWith(arguments[0])).click()"""
        self.run(script, words)

    def box(self, selector: str) -> dict[str, float]:
        return dict(self.run("return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()", selector))

    def looks(self, states: list[str]) -> dict[tuple[int, str], Any]:
        """Return where the first screen's boxes are in one of these states, by width and scheme, while it lasts."""
        self.wait(f"the state {states}", lambda: self.said("state") in states)
        places = {}
        for scheme, width in product(("light", "dark"), WIDTHS):
            emulate(self.browser, scheme=scheme)
            self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen(width, 900))
            self.wait(f"a look that is fine, {width} px wide, {scheme}", self.is_fine)
            found = [self.box(each) for each in BOXES]
            if self.said("state") not in states:
                break
            places[width, scheme] = found
        assert places
        emulate(self.browser)
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen(1400, 900))
        return places

    def is_fine(self) -> bool:
        """Return whether no text overlaps another, is pale or beyond the screen; colours take a moment to change."""
        self.look = self.run(LOOKS.read_text())
        return bool(self.look == {"overlaps": [], "pale": [], "wide": False})

    def slider(self, name: str) -> Any:
        """Return what of a slider takes keys."""
        return self.browser.find_element(By.CSS_SELECTOR, f"[data-name={name}] [tabindex='0']")

    def value_of(self, name: str) -> float:
        return float(self.run(f"return document.querySelector('[data-name={name}]').ariaValueNow"))

    def at_rest_at(self, angle: float) -> bool:
        load = self.run("return window.live?.joints.last('load')")
        reference = self.run("return window.live?.state.last('reference')")
        return None not in (load, reference) and abs(load - angle) < B and reference == pytest.approx(angle)

    def swing(self) -> float:
        """Return how far the load swung in the last second, rad, of the samples drawn; nan while the page is loaded."""
        swing = self.run(
            "const joints = window.live?.joints; if (!joints?.length) return null;"
            "const load = joints.of('load').slice(joints.from(joints.last('time') - 1));"
            "return Math.max(...load) - Math.min(...load)"
        )
        return math.nan if swing is None else float(swing)

    def trail(self) -> float:
        """Return how far apart the pictures of the load's last second are, in gaps."""
        return float(
            self.run(
                "const places = [...document.querySelectorAll('#trail .load')].filter(e => e.checkVisibility())"
                ".map(e => e.getBoundingClientRect().x), scale = document.querySelector('#scale');"
                "return (Math.max(...places) - Math.min(...places)) / scale.getBoundingClientRect().width"
            )
        )

    def two_steps(self) -> list[list[str]]:
        """Return the figures of the last step and of the one before it: rise, settling, overshoot, swing, impacts."""
        cells = "[...row.cells].slice(1).map(cell => cell.innerText)"
        return list(self.run(f"return [...document.querySelectorAll('#steps tbody tr')].map(row => {cells})"))

    def drawn(self, name: str, row: str = "") -> list[Any]:
        """Return the points of a curve as the chart has them; ``row``: 0 with the angles, 1 with the error."""
        script = f"s => s.name === '{name}' && s.id.endsWith('{row}')"
        return list(self.run(f"return window.live.chart.getOption().series.find({script}).data"))


class TestOneDrive:
    """What leaves the nodes whole, beside the same ones."""

    def test_a_newcomer_sees_the_rattle_and_ends_it_by_clicks(self, system: System, browser: Chrome) -> None:
        served, peer = system.served, system.peer
        page = Page(browser, served.address, peer)
        assert page.said("learn-result") == "backlash b is not known"
        page.click("Step of 0.5 rad")
        page.wait("the step", lambda: page.at_rest_at(0.5))
        page.wait("the rattle", lambda: 0.5 * B < page.swing() < 1.5 * B)
        before = page.drawn("error")[-1]
        page.wait("curves that move", lambda: page.drawn("error")[-1] != before)
        time, error = np.array(page.drawn("error"), dtype=float).T
        assert 0.5 * B < 1e-3 * np.ptp(error[time > time[-1] - 1.0]) < 1.5 * B  # in mrad while b is not known
        page.wait("the rattle in words", lambda: re.search(r"The load moved by 1\d\.\d mrad", page.text()))
        page.wait("the rattle as a figure", lambda: re.search(r"rattles by 1\d\.\d mrad", page.text()))
        assert "The tooth beats on both flanks." in page.text()
        assert page.trail() > 0.5  # its second is seen on a still picture
        page.run(  # what is said in between, however seldom this process looks
            "window.told = []; new MutationObserver(() => told.push("
            "document.querySelector('[data-name=learn-result]')?.textContent))"
            ".observe(document.body, {subtree: true, childList: true, characterData: true})"
        )
        page.click("Learn the backlash")
        page.wait(
            "what was learned, with its uncertainty",
            lambda: re.fullmatch(r"backlash b = (19\.9|20\.[01])\d* ± 0\.\d+ mrad", page.said("learn-result")),
        )
        told = page.run("return window.told")  # nothing if the page was loaded anew meanwhile
        assert told is None or any(re.fullmatch(r"computing for \d+ s", each or "") for each in told)
        page.wait("quiet", lambda: page.swing() < 0.05 * B)
        page.click("Step back 0.5 rad")
        page.wait("the step back", lambda: page.at_rest_at(0.0))
        page.wait("quiet", lambda: page.swing() < 0.05 * B)
        page.wait("b in the text", lambda: re.search(r"The load moved by 0\.0\d b in the last second", page.text()))
        page.wait("a still picture of it", lambda: page.trail() < 0.05)  # drawn a little later
        page.wait("the step in figures", lambda: re.search(r"settled in \d\.\d{3} ± 0\.004 s", page.text()))
        page.wait("its figures, which are told four times a second", lambda: float(page.two_steps()[0][3]) < 0.05)
        quiet, rattle = page.wait("both steps", lambda: (found := page.two_steps())[0][4].isdigit() and found)
        assert float(quiet[1]) < 1.0
        assert rattle[1] == "never"  # by the same measure, though b was not known then
        assert float(quiet[3]) < 0.05
        assert 0.5 < float(rattle[3]) < 1.5
        assert int(quiet[4]) < 10 < int(rattle[4])
        assert 0.5 < np.ptp([each for _, each in page.drawn("step before", "1")][-100:]) < 1.5
        assert page.run("return document.scrollingElement.scrollTop") == 0.0  # all that it takes is on the first screen
        assert console_of(browser) == []
        own = f"http://{served.host}/"
        assert all(url.startswith((own, f"ws://{served.host}/", "data:", "blob:")) for url in requests_of(browser))

    @pytest.mark.grid
    def test_stop_never_moves_and_no_text_overlaps_or_is_pale(self, system: System, browser: Chrome) -> None:
        """Nor does any other box in the first screen: in each state, at each width, light and dark."""
        page = Page(browser, system.served.address, system.peer)
        simulator = Parameters(system.peer, "plant_simulator")
        places = page.looks(["active"])
        page.click("Identify the drive")
        assert page.looks(["identifying"]).items() <= places.items()
        if page.said("state") == "identifying":
            page.click("Cancel")
            page.wait("why it has no result", lambda: "cancelled" in page.said("step-identify-answer"))
        page.click("Stop: 0 V")
        assert page.looks(["inactive"]) == places
        assert "stopped: 0 V" in page.text()
        assert page.said("step-identify-answer") == ""  # it was about another state
        page.click("Activate")
        assert page.looks(["ready", "active"]) == places
        assert "stopped: 0 V" not in page.text()
        try:
            assert simulator.set(sensors__load_offset=0.5)[0]
            assert page.looks(["fault"]) == places
            page.wait("what happened", lambda: len(page.said("fault-text")) > 200)
            assert page.said("fault-text").endswith("Then reset.")
        finally:
            assert simulator.set(sensors__load_offset=0.0)[0]
        page.click("Reset")
        assert page.looks(["active"]) == places

    def test_an_answer_can_be_read_whole(self, system: System, browser: Chrome) -> None:
        page = Page(browser, system.served.address, system.peer)
        room = (
            "const box = document.querySelector('[data-name=step-learn]'); return box.clientHeight - box.scrollHeight"
        )
        page.run("document.querySelector('[data-name=step-learn-answer]').textContent = 'no gap '.repeat(60)")
        assert page.run(room) >= 0

    def test_a_step_is_judged_once_and_a_rattle_is_one_figure_until_it_stays_away(
        self, system: System, browser: Chrome
    ) -> None:
        page = Page(browser, system.served.address, system.peer)

        def told(load: str, rattle: str = "0", reference: str = "t < 0 ? 0 : 0.5") -> list[str]:
            return [words for words, _ in page.run(PLAYED_STEP.read_text(), load, rattle, reference)]

        move = "(t < 0 ? 0 : 0.5 * Math.min(1, t / 0.16))"
        settled = ["no step yet", "moves", "settled in 0.160 ± 0.010 s"]
        rattles = ["moves", "rattles by 1.00 b"]
        assert told(move) == settled
        assert told(f"{move} + (t > 5 && t < 6 ? 0.03 : 0)") == settled  # a load torque is no part of the step
        assert told("t < 0 ? 0 : 0.5 * Math.min(1, t / 5)")[1:] == ["moves", "settled in 4.960 ± 0.010 s"]
        assert told("t < 0 ? 0 : 0.48 * Math.min(1, t / 0.16)")[1:] == ["moves", "did not settle"]
        beats = f"{move} + (t > 0.16 ? 0.01 * Math.sin(200 * t) : 0)"
        assert told(beats, "t > 1 ? 0.02 : 0")[1:] == rattles
        assert told(beats, "t > 1 && t % 2 < 1 ? 0.02 : 0")[1:] == rattles  # it comes and goes
        ended = "(t > 0.16 && t < 3 ? 0.01 * Math.sin(200 * t) : 0)"  # the over-damped gains ended it; it is told still
        assert told(f"{move} + {ended}", "t > 1 ? 0.02 : 0")[1:3] == rattles
        assert told(f"{move} + {ended}", "t > 1 ? 0.02 : 0")[-1] == "settled in 3.000 ± 0.010 s"
        sine = "t < 4 ? 0.5 : 0.5 + 0.1 * Math.sin(t - 4)"  # a motion since then is no step
        assert told(f"t < 4 ? {move} : {sine}", "0", f"t < 0 ? 0 : {sine}") == settled

    def test_numbers_are_written_for_people(self, system: System, browser: Chrome) -> None:
        """With as many digits as tell two ticks apart, and without exponents."""
        page = Page(browser, system.served.address, system.peer)
        tick = "return live.chart.getOption().yAxis[0].axisLabel.formatter(Number(arguments[0]))"
        assert [page.run(tick, each) for each in ("1.0005", "0.30000000000000004", "-3")] == ["1.0005", "0.3", "-3"]
        digits = "const {digits} = await import('/static/steps.js'); return digits(Number(arguments[0]), 2)"
        assert [page.run(digits, each) for each in ("223", "2.23", "0.1", "1e-9")] == ["223", "2.2", "0.10", "0"]

    @pytest.mark.grid
    def test_angles_are_in_the_unit_that_was_chosen_and_moves_stay_what_they_were(
        self, system: System, browser: Chrome
    ) -> None:
        """A number is taken in the unit beside it; the cursor tells values with units, and none where none came."""
        page = Page(browser, system.served.address, system.peer)
        try:
            page.click("deg")
            page.wait("the step in degrees", lambda: "Step of 28.65 deg" in page.text())
            field = browser.find_element(By.CSS_SELECTOR, "[data-name=angle-deg]")
            assert (field.get_attribute("value"), page.run("return live.units[0]")) == ("57.2958", "deg")
            field.send_keys(Keys.CONTROL, "a")
            field.send_keys("30")
            page.click("Go there")
            page.wait("30 degrees", lambda: page.at_rest_at(math.radians(30.0)))
            page.wait("the curve", lambda: page.drawn("load")[-1][1] == pytest.approx(30.0, abs=math.degrees(B)))
            page.click("arcmin")
            page.wait("the step in arcmin", lambda: "Step of 1719 arcmin" in page.text())
            browser.refresh()
            page.wait("the unit that it remembers", lambda: "Step of 1719 arcmin" in page.text())
            page.wait("samples", lambda: page.run("return window.live?.joints.length ?? 0") > 600)
        finally:
            page.run("localStorage.clear()")
        page.click("Pause")
        page.run(
            "const {state} = live, from = state.from(live.zero - 2), to = state.from(live.zero - 1);"
            "state.values.forEach(column => column.splice(from, to - from)); live.fill()"
        )
        for name in ("command", "setpoint", "error"):
            assert None in [value for time, value in page.drawn(name) if -2.1 < time < -1.0], name
        assert None not in [value for _, value in page.drawn("load")]
        said = page.run("return [-0.5, -1.5].map(at => live.atCursor(at))")
        (there, missing) = (re.sub("<[^>]*>", "", each) for each in said)
        assert re.match(r"-0\.500 s.*load 1[78]\d\d[.\d]* arcmin.*command -?[\d.]+ V.*region fast gains", there)
        assert "load 1" in missing
        assert not {"command", "setpoint", "error", "region"} & set(missing.split())
        curves = browser.find_element(By.CSS_SELECTOR, ".curves")
        over_angle = round(-0.35 * curves.size["height"])  # from its middle
        ActionChains(browser).move_to_element_with_offset(curves, 0, over_angle).perform()
        page.wait("values at the cursor", lambda: re.search(r"-\d\.\d{3} s\s+● load 1", page.text()))
        assert console_of(browser) == []

    @pytest.mark.grid
    def test_gains_that_are_refused_say_why_and_go_back(self, system: System, browser: Chrome) -> None:
        served, peer = system.served, system.peer
        page = Page(browser, served.address, peer)
        margins = page.wait("margins", lambda: page.said("fast-gains"))
        assert re.fullmatch(r"k = \[[\d., e-]+\]; margins: \d+ deg of phase, [\d.]+ ms of delay", margins)
        slider = page.slider("fast-0")
        while not page.said("law-answer"):  # to ever higher gains
            before, shown = system.parameters.get("gains.fast.q"), page.said("fast-gains")
            slider.send_keys(Keys.PAGE_UP)
            page.wait("an answer", lambda shown=shown: page.said("law-answer") or page.said("fast-gains") != shown)
        refused = page.said("law-answer")
        assert refused.startswith("gains.fast")
        assert "unstable" in refused
        assert system.parameters.get("gains.fast.q") == before
        assert page.said("fast-gains") != margins  # some were taken before
        power = math.log10(before[0][0])
        page.wait("the slider to go back", lambda: page.value_of("fast-0") == pytest.approx(power, abs=0.05))
        slider.send_keys(Keys.ARROW_LEFT)
        page.wait("lower gains", lambda: system.parameters.get("gains.fast.q") != before)
        page.wait("no refusal", lambda: page.said("law-answer") == "")

    @pytest.mark.parametrize("by", ["the button", pytest.param("Escape", marks=pytest.mark.grid)])
    def test_stop_puts_out_0_v_amid_motion_and_the_drive_goes_on_when_asked(
        self, system: System, browser: Chrome, by: str
    ) -> None:
        """Within a watchdog's time, while references come and curves are drawn."""
        served, peer = system.served, system.peer
        commands: list[tuple[float, float]] = []
        subscription = peer.node.create_subscription(
            Float64MultiArray,
            "command",
            lambda m, info: commands.append((1e-9 * info["source_timestamp"], m.data[0])),
            RECEIVE,  # the newest alone: this process looks at the page most of the time
        )
        page = Page(browser, served.address, peer)

        def moves() -> bool:
            if "the motion has ended" in page.text():  # the browser stood still for too long
                page.click("Sine")
            return page.swing() > 0.1

        def stop() -> float:
            """Stop amid a sine and return after how long the last command, 0, was sent, s."""
            page.click("Sine")
            page.wait("motion", moves)
            peer.wait("commands", lambda: commands and commands[-1][1] != 0.0)
            page.run(
                "window.asked = undefined; for (const kind of ['click', 'keydown'])"
                " addEventListener(kind, () => { window.asked ??= Date.now() / 1000; }, true)"
            )
            if by == "Escape":
                ActionChains(browser).send_keys(Keys.ESCAPE).perform()
            else:
                page.click("Stop: 0 V")
            page.wait("the stop", lambda: "stopped: 0 V" in page.text())
            peer.wait("the last command", lambda: commands[-1][1] == 0.0)
            return commands[-1][0] - float(page.run("return window.asked"))

        for _ in range(3):  # the machine may stand still for a while
            if stop() < WATCHDOG:
                break
            page.click("Activate")
            page.wait("the state", lambda: page.said("state") == "active")
        else:
            pytest.fail(f"0 V came later than {WATCHDOG} s after the request, each time")
        assert Lifecycle(peer, "controller").state == "inactive"
        page.wait("the state", lambda: page.said("state") == "inactive")
        page.click("Activate")
        page.wait("the state", lambda: page.said("state") == "active")
        references: list[float] = []
        peer.node.create_subscription(Float64, "reference", lambda m: references.append(m.data), 10)
        page.click("Step forward")  # the sine has ended, so this is all that comes
        peer.wait("a reference", lambda: references)
        assert len(references) == 1
        page.wait("the step", lambda: page.at_rest_at(references[0]))
        peer.node.destroy_subscription(subscription)

    @pytest.mark.skipif(bool(missing()), reason=missing())
    def test_the_load_moves_while_a_button_is_held_and_no_longer(self, system: System, tmp_path: Path) -> None:
        """By pointer, until it is let go or leaves; by key; by a finger; until *Stop*; and until the browser dies."""
        with chromium(tmp_path / "profile") as other:  # it is killed in the end
            page = Page(other, system.served.address, system.peer)
            other.execute_script("document.getElementById('jog-share').value = '0.03'")
            forward, back = (other.find_element(By.CSS_SELECTOR, f"[data-jog='{way}']") for way in (1, -1))
            finger = [{"x": forward.rect["x"] + 10, "y": forward.rect["y"] + 10}]

            def touch(kind: str, points: list[dict[str, int]]) -> None:
                other.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

            def act() -> ActionChains:
                return ActionChains(other, duration=0)

            def press(way: float, begin: Callable[[], object], end: Callable[[], object]) -> None:
                """Move the load; a machine that stands still may end it, so begin as often as it takes."""

                def again() -> None:
                    if not page.run("return document.querySelector('.held')"):
                        end()
                        begin()

                system.moved(way, again)

            def let_go() -> object:
                return act().release().perform()

            def click(on: WebElement) -> Callable[[], object]:
                return lambda: act().click_and_hold(on).perform()  # a chain forgets what it has performed

            press(0.3, click(forward), let_go)
            let_go()
            system.stands()
            press(0.3, click(forward), let_go)
            act().move_by_offset(0, 200).perform()  # still held, elsewhere
            system.stands()
            let_go()
            act().click(back).perform()  # it has the focus then
            system.stands()
            press(-0.3, lambda: act().key_down(Keys.SPACE).perform(), lambda: act().key_up(Keys.SPACE).perform())
            act().key_up(Keys.SPACE).perform()
            system.stands()
            press(0.3, lambda: touch("touchStart", finger), lambda: None)
            touch("touchEnd", [])
            system.stands()
            press(-0.3, click(back), let_go)
            act().send_keys(Keys.ESCAPE).perform()
            page.wait("the stop", lambda: "stopped: 0 V" in page.text())
            let_go()
            act().click_and_hold(back).perform()  # no time passes for a drive in lockstep that gets no commands
            page.wait("why not", lambda: re.search("no joint states come|holds no position", page.text()))
            let_go()
            page.click("Activate")
            page.wait("the state", lambda: page.said("state") == "active")
            press(-0.3, click(back), let_go)
            for process in children(other.service.process.pid):
                os.kill(process, signal.SIGKILL)
            system.stands()

    @pytest.mark.grid
    def test_a_page_that_hangs_moves_nothing_any_more(self, system: System, browser: Chrome) -> None:
        sent: list[float] = []
        subscription = system.peer.node.create_subscription(
            Float64, "reference", lambda _, info: sent.append(1e-9 * info["source_timestamp"]), 1000
        )
        page = Page(browser, system.served.address, system.peer)
        page.click("Sine")
        page.wait("motion", lambda: page.swing() > 0.1)
        woke = page.run("const end = Date.now() + 10000; while (Date.now() < end); return Date.now() / 1000")
        page.wait("why", lambda: page.said("move-answer").startswith("the motion has ended: the page"))
        heard: list[int] = []
        system.peer.wait("all that was sent", lambda: heard.append(len(sent)) or 0 < heard[-1] == heard[-20:][0])
        assert sent[0] < woke - 8.0
        assert sent[-1] < woke - 1.0
        page.click("Stay")
        page.wait("no more words", lambda: page.said("move-answer") == "")
        system.peer.node.destroy_subscription(subscription)

    @pytest.mark.grid
    def test_a_recording_is_made_and_ended(self, system: System, browser: Chrome) -> None:
        served, peer = system.served, system.peer
        page = Page(browser, served.address, peer)
        page.click("Record")
        page.wait("its size", lambda: re.search(r"recording [1-9][\d.]* [kM]B", page.said("recording")))
        (recorder,) = children(served.process.pid)
        assert os.getpriority(os.PRIO_PROCESS, recorder) < os.getpriority(os.PRIO_PROCESS, served.process.pid)
        page.click("End the recording")
        page.wait("its end", lambda: page.said("recording").startswith("recorded"))
        (bag,) = served.folder.glob("recording_*/metadata.yaml")
        assert "/joint_states" in bag.read_text()
        page.click("Write its report")
        page.wait(
            "the report", lambda: page.run("return document.querySelector('[data-name=report-link]').offsetParent")
        )
        link = page.run("return document.querySelector('[data-name=report-link]').getAttribute('href')")
        status, text = served.ask("GET", link)
        assert status == 200
        assert "<h1>" in text

    @pytest.mark.grid
    def test_the_keyboard_alone_moves_the_drive(self, system: System, browser: Chrome) -> None:
        page = Page(browser, system.served.address, system.peer)
        seen: list[str] = []
        while "Step forward" not in seen[-1:]:
            ActionChains(browser).send_keys(Keys.TAB).perform()
            seen.append(page.run("return document.activeElement.textContent.trim()"))
            assert len(seen) < 60, seen
        assert "Stop: 0 V" in seen  # before all that moves
        assert page.run("return getComputedStyle(document.activeElement).boxShadow") != "none"  # one sees where one is
        ActionChains(browser).send_keys(Keys.ENTER).perform()
        page.wait("the step", lambda: page.at_rest_at(0.5))

    @pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.grid)])
    def test_it_fits_a_telephone(self, system: System, browser: Chrome, scheme: str) -> None:
        emulate(browser, scheme=scheme)
        try:
            page = Page(browser, system.served.address, system.peer)
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen(390, 844))
            page.wait("the narrow page", lambda: page.box(".curves")["width"] < 390.0)
            assert page.run("return document.documentElement.scrollWidth") <= 390
            assert page.box("[data-name=stop]")["height"] >= 44  # for a thumb
            assert page.box(".curves")["width"] > 300
            touch = {"type": "touchStart", "touchPoints": [{"x": 300, "y": page.box(".curves")["top"] + 60}]}
            browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
            for event in (touch, {"type": "touchEnd", "touchPoints": []}):
                browser.execute_cdp_cmd("Input.dispatchTouchEvent", event)
            page.wait("values where it was touched", lambda: re.search(r"-\d\.\d{3} s\s+● load", page.text()))
            steps = (
                "[data-name=learn-button]",
                "[data-name=identify-button]",
                "[data-name=move-button]",
                "[data-name=unit]",
            )
            acts = (".curves", "#tooth", "[data-name=go]", "[data-name=stay]")
            for part in ("[data-name=stop]", ".step.now", *steps, *acts):
                box = page.box(part)
                assert 0 <= box["left"] < box["right"] <= 390, part
                assert 0 <= box["top"] < box["bottom"] <= 844, part  # on one screen
        finally:
            browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
            browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    @pytest.mark.grid
    def test_faults_and_load_torque_are_injected_and_taken_back(self, system: System, browser: Chrome) -> None:
        served, peer = system.served, system.peer
        page = Page(browser, served.address, peer)
        page.click("Step forward")
        page.wait("the step", lambda: page.at_rest_at(0.5))
        field = browser.find_element(By.CSS_SELECTOR, "[data-name=angle-rad]")
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys("7")
        page.click("Go there")
        page.wait(
            "why not", lambda: page.said("move-answer").endswith("7 rad is more than limits.step = 6.283 rad away")
        )
        page.unfold("Simulated drive")
        page.slider("load-torque").send_keys(Keys.PAGE_UP)
        page.wait("the load torque", lambda: page.run("return window.live.state.last('load_torque')") > 0.05)
        page.click("Load encoder jumps")
        page.wait("the fault", lambda: page.said("fact-fault").startswith("ENCODERS_DISAGREE: "))
        page.click("As it was")
        page.click("Reset")
        page.wait("no fault", lambda: page.said("fact-fault") == "none")
        assert Parameters(peer, "plant_simulator").get("sensors.load_offset") == [0.0]


@pytest.mark.grid
def test_a_drive_that_goes_and_comes_is_said_and_watched_again(
    start: Start, peer: Peer, serve: Callable[..., Served], browser: Chrome
) -> None:
    drive = begin(start, state_timeout=2.0)
    page = Page(browser, serve().address, peer)
    page.wait("the drive", lambda: page.said("fact-drive") == "simulated by /plant_simulator")
    drive.kill()
    page.wait("its absence", lambda: "no joint states from the drive" in page.said("acts"))
    page.wait("the fault", lambda: page.said("fact-fault").startswith("NO_SAMPLES: No usable joint states came"))
    assert page.said("fault-text").endswith("Then reset.")
    page.click("Step forward")
    page.wait("that it is not sent", lambda: "the controller holds no position" in page.said("move-answer"))
    start("plant_simulator", lockstep=True)
    page.wait("its return", lambda: "no joint states" not in page.said("acts"))
    page.click("Reset")
    page.wait("no fault", lambda: page.said("fact-fault") == "none")
    page.wait("a held position", lambda: "no position" not in page.said("acts"))
    page.click("Step forward")
    page.wait("a step", lambda: page.swing() > 0.1)
    assert console_of(browser) == []


@pytest.mark.grid
def test_read_only_shows_everything_and_takes_nothing(
    start: Start, peer: Peer, serve: Callable[..., Served], browser: Chrome
) -> None:
    begin(start)
    served = serve("-p", "read_only:=true")
    page = Page(browser, served.address, peer)
    page.wait("the drive", lambda: page.said("fact-drive") == "simulated by /plant_simulator")
    words = [each.text.strip() for each in browser.find_elements(By.TAG_NAME, "button") if each.text.strip()]
    assert {"Pause", "Live", "Zoom in"} <= set(words)
    assert not {"Stop: 0 V", "Go there", "Learn the backlash", "Record", "Activate"} & set(words)
    assert browser.find_elements(By.CSS_SELECTOR, "[role=slider]") == []
    status, _ = served.ask("POST", "/stop?axis=/", Origin=f"http://{served.host}")
    assert status in {404, 405}
    assert Lifecycle(peer, "controller").state == "active"


@pytest.mark.grid
def test_axes_are_told_apart_by_name(start: Start, peer: Peer, serve: Callable[..., Served], browser: Chrome) -> None:
    names = ["arm/elbow", "wrist"]
    start("plant_simulator", non_ros=["--axes", *names], lockstep=True)
    start("controller", non_ros=["--axes", *names], state_timeout=10.0, use_sim_time=True)
    page = Page(browser, serve().address, peer)
    page.wait("both", lambda: json.loads(page.run("return JSON.stringify(window.facts)"))["axis"] == "/arm/elbow")
    page.click("Step forward")
    page.wait("the step", lambda: page.at_rest_at(0.5))
    browser.find_element(By.CSS_SELECTOR, "[data-name=axis]").click()
    option = "//div[@role='option'][.//*[text()='/wrist']]"
    page.wait("the other axis", lambda: browser.find_elements(By.XPATH, option))[0].click()
    page.wait("its name", lambda: page.run("return window.live.axis") == "/wrist")
    page.wait("its samples", lambda: page.run("return window.live.joints.length") > 100)
    assert page.at_rest_at(0.5) is False
    assert abs(page.run("return window.live.joints.last('load')")) < B


@contextmanager
def living(folder: Path, peer: Peer, *arguments: str) -> Iterator[tuple["subprocess.Popen[bytes]", str]]:
    """Run `backlash live`, with what it says in a log; yield its process and its address."""
    command = [sys.executable, "-m", "backlash_ros.dashboard.live", "--port", "0", "--out", str(folder), *arguments]
    log = folder / "log"
    with log.open("wb") as output:
        live = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        pattern = re.compile(r"^http://127\.0\.0\.1:\d+$", re.MULTILINE)
        yield live, peer.wait("the address", lambda: pattern.search(log.read_text()))[0]
    finally:
        with suppress(ProcessLookupError):
            os.killpg(live.pid, signal.SIGKILL)


@pytest.mark.grid
def test_make_live_shows_a_drive_that_ends_with_it(tmp_path: Path, peer: Peer, browser: Chrome) -> None:
    root = Path(__file__).parents[2]
    recipe = subprocess.run(
        ["make", "--no-print-directory", "--dry-run", "live"], cwd=root, capture_output=True, text=True, check=True
    ).stdout
    assert recipe.splitlines()[-1].endswith("/python -m backlash_ros.dashboard.live")
    with living(tmp_path, peer) as (live, address):
        page = Page(browser, address, peer)
        page.click("Step forward")
        page.wait("the rattle", lambda: page.at_rest_at(0.5) and 0.5 * B < page.swing() < 1.5 * B)
        os.killpg(live.pid, signal.SIGINT)  # as Ctrl-C in a terminal does
        assert live.wait(60) == 0
        with pytest.raises(ProcessLookupError):
            os.killpg(live.pid, 0)
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.grid
def test_backlash_live_shows_the_drive_of_a_file(tmp_path: Path, peer: Peer, browser: Chrome) -> None:
    """Drive and controller both get it."""
    file = tmp_path / "drive.yaml"
    file.write_text("/**: {ros__parameters: {gear.backlash_angle: 0.03, gear.reduction: 20.0}}")
    with living(tmp_path, peer, "--drive", str(file)) as (_, address):
        page = Page(browser, address, peer)
        page.wait("the gap of the drive", lambda: page.run("return window.facts.gap") == 0.03)
        page.unfold("Parameters in use")
        page.wait("the controller's reduction", lambda: re.search(r"gear\.reduction\s+20\b", page.text()))
