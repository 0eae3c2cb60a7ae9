"""The strip on top: connect, learn, identify, move; where one is, each step's button, result and gain."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from lifecycle_msgs.msg import Transition
from nicegui import ui

from backlash_ros.control.telemetry import TELEMETRY
from backlash_ros.dashboard.axis import ANSWER, SILENCE, Answer, Axis
from backlash_ros.dashboard.cards.card import Refresh, Said, Shown, button, fill
from backlash_ros.dashboard.cards.move import step
from backlash_ros.dashboard.state import (
    EXPERIMENTS,
    STEPS,
    AngleUnit,
    Run,
    fault_of,
    of_identification,
    of_learning,
    remedy,
    remedy_first,
    servo_says,
    step_of,
)

_WAY = 0.5
"""Length of a step, rad."""

_TITLES = {
    "learn": "b: the angle that the load can turn while the motor stands",
    "identify": "J_l: the moment of inertia of all that turns with the load",
}
"""Explanations of results, by step."""

Words = Callable[[Axis, AngleUnit], tuple[str, str]]
"""Result of a step, and what it gains, or would gain."""


def steps_card(page: Shown) -> Refresh:
    """Make the strip; a fault takes its place, so that nothing moves."""
    with ui.element("nav").classes("strip").props('aria-label="steps"'):
        refreshers = [
            _connect(page),
            _experiment(page, "learn", "Learn", "Learn the backlash", of_learning),
            _experiment(page, "identify", "Identify", "Identify the drive", of_identification),
            _move(page),
        ]
        with ui.element("div").classes("alert").props('role="alert" data-name=fault') as alert:
            name = ui.label("").classes("bad")
            text = ui.label("").props("data-name=fault-text")

    def refresh(axis: Axis) -> None:
        fault, why = fault_of(axis)
        alert.set_visibility(bool(fault))
        if fault:
            name.set_text(fault)
            text.set_text(f"{why}. {remedy(fault)} Then reset.")
        for each in refreshers:
            each(axis)

    return refresh


class _Step:
    """One step: its number and title, its button, its result, what it gains, and why it was refused."""

    def __init__(self, name: str, title: str) -> None:
        self.name = name
        self.box = ui.element("section").classes("step").props(f"data-name=step-{name}")
        with self.box:
            self.head = ui.element("div").classes("head")
            with self.head:
                ui.html(f"<h2><b>{STEPS.index(name) + 1}</b> {title}</h2>", sanitize=False)
            self._said = Said(f"step-{name}-answer")
            self._result = (
                ui.label("").classes("result").props(f'data-name={name}-result title="{_TITLES.get(name, "")}"')
            )
            self._gain = ui.label("").classes("muted").props(f"data-name={name}-gain")
        self._button: ui.button | None = None

    def offer(self, text: str, act: Callable[..., Any]) -> None:
        """Add its button."""
        with self.head:
            self._button = button(text, act, f"{self.name}-button")

    def tell(self, axis: Axis | None, answer: Answer) -> None:
        """Say why it was refused."""
        self._said.tell(axis, answer)

    def refresh(self, axis: Axis, words: tuple[str, str], label: str = "", *, wanted: bool = True) -> None:
        """Show result and gain, and the button with another ``label``, if it is ``wanted``."""
        now = step_of(axis) == self.name
        fault = bool(fault_of(axis)[0])
        self.box.set_visibility(not fault)
        self.box.classes(add="now" if now else "", remove="" if now else "now")
        self.box.props('aria-current="step"' if now else 'aria-current="false"')
        self._said.refresh(axis)
        result, gain = words
        self._result.set_text(result)
        self._gain.set_text(gain)
        if self._button is not None:
            self._button.set_visibility(wanted)
            self._button.set_text(label or self._button.text)
            fill(self._button, now and label != "Cancel")


def _connect(page: Shown) -> Refresh:
    shown = _Step("connect", "Connect")

    async def activate() -> None:
        if page.axis is not None:
            if page.axis.lifecycle == "unconfigured":
                await page.axis.change(Transition.TRANSITION_CONFIGURE)
            shown.tell(page.axis, await page.axis.change(Transition.TRANSITION_ACTIVATE))

    if not page.read_only:
        shown.offer("Activate", activate)

    def refresh(axis: Axis) -> None:
        idle = axis.present and axis.lifecycle in ("inactive", "unconfigured")
        timing = axis.diagnoses.get("controller: timing")
        if idle:
            words = "0 V", "activate it to hold the load"
        elif step_of(axis) == "connect":
            there = axis.silent < SILENCE
            what = (
                "see the drive's encoders and its joint_states"
                if there
                else "start the drive: it publishes joint_states"
            )
            words = f"no {'usable ' if there else ''}samples", what
        else:
            rate = timing.values.get("rate_Hz", "nan") if timing else "nan"
            late = timing.values.get("late_samples", "0") if timing else "0"
            words = f"{float(rate):.4g} Hz", f"{late} samples late" + (", simulated drive" if axis.simulated else "")
        shown.refresh(axis, words, wanted=idle)

    return refresh


def _experiment(page: Shown, name: str, title: str, label: str, words: Words) -> Refresh:
    """Make a step that runs an experiment: its button starts, cancels, or applies."""
    shown, does = _Step(name, title), ""

    async def act() -> None:
        axis = page.axis
        if axis is None:
            return
        if does == "run":
            answer = await page.station.experiment(page.title, name)
            shown.tell(axis, replace(answer, text=remedy_first(answer.text)))
        else:
            shown.tell(axis, await axis.call(does, ANSWER))

    if not page.read_only:
        shown.offer(label, act)

    def refresh(axis: Axis) -> None:
        nonlocal does
        run = page.station.of(axis.title).run
        if run is not None:
            run.look(axis)
        if progress := _progress(axis, run, name):
            does = "cancel"
            shown.refresh(axis, (progress, "the motor moves" if "%" in progress else ""), "Cancel")
        elif _waits(axis, name):
            does = "apply_estimate"
            shown.refresh(axis, words(axis, page.angle), "Apply the estimate")
        else:
            does = "run"
            shown.refresh(axis, words(axis, page.angle), label)

    return refresh


def _progress(axis: Axis, run: Run | None, name: str) -> str:
    """Return what an experiment is doing; empty if it does not run."""
    state = axis.last_state
    word = TELEMETRY["experiment"].words.get(int(state.get("experiment", 0.0)), "")
    if EXPERIMENTS.get(word) == name:
        return f"{word}: {100.0 * state.get('progress', 0.0):.0f} %"
    if run is None or run.service != name:
        return ""
    if math.isfinite(run.computing_since):
        return f"computing for {time.monotonic() - run.computing_since:.0f} s"
    return "begins"


def _waits(axis: Axis, name: str) -> bool:
    """Return whether an estimate of this step waits to be applied."""
    kept = servo_says(axis)
    by = {"identify": "identify", "homing": "home", "set_zero": "home"}.get(str(kept.get("estimate_method")), "learn")
    return kept.get("estimate_applied") == "False" and by == name


def _move(page: Shown) -> Refresh:
    shown = _Step("move", "Move")
    with shown.box:  # the browser fills it
        ui.html('<p class="result" id="step-result"></p><p class="muted" id="step-more"></p>', sanitize=False)
    sign = 1.0

    def act() -> None:
        nonlocal sign
        if page.axis is not None:
            why = step(page, page.axis, sign * _WAY)
            shown.tell(page.axis, Answer(not why, why))
            sign = sign if why else -sign

    if not page.read_only:
        shown.offer("", act)

    def refresh(axis: Axis) -> None:
        large = page.angle.large
        shown.refresh(axis, ("", ""), f"Step {'of' if sign > 0.0 else 'back'} {large.factor * _WAY:.4g} {large.name}")

    return refresh
