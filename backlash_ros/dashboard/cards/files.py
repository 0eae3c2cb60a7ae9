"""The card of what is kept: a recording and its report, a measurement and its certificate."""

import asyncio

from nicegui import ui

from backlash_ros.control import AUTO, EXPERIMENTS
from backlash_ros.dashboard.axis import Answer, Axis
from backlash_ros.dashboard.cards.card import OPTIONS, Refresh, Said, Shown, button, card, line
from backlash_ros.dashboard.station import Station, Work, megabytes
from backlash_ros.ros.client import stop_node


def files_card(page: Shown) -> Refresh:
    """Make the card."""
    with card("Keep"):
        refreshers = [_recording(page), _measurement(page)]

    def refresh(axis: Axis) -> None:
        for each in refreshers:
            each(axis)

    return refresh


def _recording(page: Shown) -> Refresh:
    """Start and end a recording; write its report."""
    station = page.station

    async def toggle() -> None:
        work = station.of(page.title).recorder
        if work is not None and work.running:
            record.disable()
            await asyncio.to_thread(stop_node, work.process)
            record.enable()
        elif page.axis is not None:
            try:
                station.record(page.title)
            except OSError as error:
                said.tell(page.axis, Answer(False, f"folder: {error}"))

    def report() -> None:
        work = station.of(page.title).report
        if work is None or not work.running:
            station.report(page.title)

    with line():
        record = button("Record", toggle, "record", primary=True)
        write = button("Write its report", report)
        link = ui.link("open the report", "", new_tab=True).props("data-name=report-link")
    recorded = ui.label("").classes("muted").props("data-name=recording")
    written = ui.label("").classes("muted").props("data-name=report")
    said = Said("recording-answer")

    def refresh(axis: Axis) -> None:
        said.refresh(axis)
        running = station.of(axis.title)
        work = running.recorder
        goes_on = work is not None and work.running
        write.set_visibility(work is not None and not goes_on)
        record.set_text("End the recording" if goes_on else "Record")
        state = "recording" if goes_on else "recorded"
        recorded.set_text(f"{state} {megabytes(work.size)} in {work.result}" if work is not None else "")
        _show(link, station, axis, "report")
        written.set_text(_progress(running.report, "writing ..."))

    return refresh


def _measurement(page: Shown) -> Refresh:
    """Measure with a certificate; choose the experiment that learns."""
    station = page.station

    def measure() -> None:
        work = station.of(page.title).measurement
        if page.axis is not None and (work is None or not work.running):
            station.end(page.title)
            try:
                station.measure(page.title)
            except OSError as error:
                said.tell(page.axis, Answer(False, f"folder: {error}"))

    async def choose(name: str) -> None:
        axis = page.axis
        if axis is not None and name is not None and axis.told.values.get("learning.experiment") != name:
            answer = await axis.set({"learning.experiment": name})
            said.tell(axis, answer)
            if not answer.success:
                kind.set_value(axis.told.values.get("learning.experiment"))

    with line():
        button("Measure with a certificate", measure, "measure")
        link = ui.link("open the certificate", "", new_tab=True).props("data-name=certificate")
    measured = ui.label("").classes("muted")
    kind = ui.select([AUTO, *sorted(EXPERIMENTS)], label="experiment that learns").props(OPTIONS)
    kind.props("data-name=experiment")
    said = Said("files-answer")
    kind.on_value_change(lambda event: choose(event.value))

    def refresh(axis: Axis) -> None:
        said.refresh(axis)
        kind.set_value(axis.told.values.get("learning.experiment"))
        _show(link, station, axis, "certificate")
        measured.set_text(_progress(station.of(axis.title).measurement, "measuring ..."))

    return refresh


def _show(link: ui.link, station: Station, axis: Axis, kind: str) -> None:
    """Show the link to a page once it is written."""
    link.set_visibility(station.page(axis.title, kind) is not None)
    link.props(f'href="/pages/{kind}?axis={axis.title}"')


def _progress(work: Work | None, doing: str) -> str:
    """Return what a process does, or the last that it said."""
    if work is None:
        return ""
    return doing if work.running else work.last_line()
