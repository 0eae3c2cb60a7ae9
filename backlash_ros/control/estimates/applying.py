"""Applies or offers estimates, stores them, and answers the request once they are stored. Without ROS or a clock.

All times are integer nanoseconds of the caller's steady clock, except the date of an estimate.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, wait
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any, NamedTuple

from backlash_ros.control.estimates.file import EstimateFile
from backlash_ros.control.estimates.record import DriveIdentity, KeptEstimate, in_words
from backlash_ros.control.experiment import BacklashEstimate
from backlash_ros.identification.gap_map import GapMap

APPLY = ("auto", "ask")
"""When a valid estimate is applied: at once, or on request."""

PATIENCE = 5 * 10**9
"""Longest time that an answer waits for the file to be written, ns."""


class Answer(NamedTuple):
    """The answer to a request; ``service`` is "learn", "identify", "home", "set_zero" or "apply_estimate"."""

    service: str
    success: bool
    text: str


class Estimates:
    """The offered estimate and the estimate file of one controller.

    Parameters
    ----------
    put_in_use : sets parameters, all or none, and returns why they were refused, empty if they were not
    workers : write the file, one job after the other, while the loop goes on
    today : the date in UTC
    """

    def __init__(
        self,
        put_in_use: Callable[[Mapping[str, Any]], str],
        workers: Executor,
        today: Callable[[], datetime] = lambda: datetime.now(timezone.utc),
    ) -> None:
        self._put_in_use, self._workers, self._today = put_in_use, workers, today
        self.newest: KeptEstimate | None = None
        self.map: GapMap | None = None
        self.trouble = ""
        self._file: EstimateFile | None = None
        self._path = ""
        self._writing: Future[None] | None = None
        self._held: tuple[Answer, int] | None = None

    # From configure to clean-up.

    def begin(self, path: str, drive: DriveIdentity, *, use: bool) -> str:
        """Open the file at ``path``, if any, and apply its estimates if ``use``; return a line for the log.

        Raises
        ------
        ValueError
            If the file or its content cannot be used.
        """
        self.forget()
        if not path:
            return ""
        if self._writing is not None and not self._writing.done():
            raise ValueError(f"learning.estimate_file {path}: the previous estimate is still being written")
        self._file = EstimateFile(path, drive)
        self._path = where = str(self._file.path)
        history = self._file.history
        newest, parameters = history.applied, history.parameters
        if not use:
            return f"estimates are kept in {where}"
        if newest is None:
            return f"{where} has no applied estimate: the parameters stay as given"
        if refusal := self._put_in_use(parameters):
            raise ValueError(f"learning.estimate_file {where}: {in_words(parameters)}: {refusal}")
        return f"{in_words(parameters)}, the newest learned {newest.date} by {newest.method.value}, from {where}"

    def forget(self) -> None:
        """Withdraw the offer; the file still has the estimate."""
        self.newest, self.map, self.trouble, self._file = None, None, "", None

    # Requests.

    @property
    def busy(self) -> str:
        """Why no request is possible now: the last one has not been answered; empty if one is possible."""
        return "the previous estimate is still being written" if self._held else ""

    def learned(self, estimate: BacklashEstimate, text: str, now: int, *, apply: bool, service: str = "learn") -> None:
        """Take a valid estimate, ``text`` in words; apply it if ``apply``, else offer it."""
        refusal = ""
        try:
            date = self._today().replace(microsecond=0)
            kept = KeptEstimate(date, estimate.method, estimate.parameters, estimate.uncertainties, applied=False)
        except ValueError as error:
            self._hold(Answer(service, False, f"{text}, but it was refused: {error}"), now)
            return
        if (before := self._before) and (otherwise := kept.contradicts(before)):
            text = f"{text}; {otherwise}"
        if apply:
            refusal = self._put_in_use(kept.parameters)
            kept = replace(kept, applied=not refusal)
        self.newest, self.map = kept, estimate.map
        if self._file is not None:
            self._file.history = self._file.history.with_newest(kept)
            self._write(self._file)
        if refusal:
            text = f"{text}, but it was refused: {refusal}"
        elif not apply:
            text = f"{text}; call apply_estimate to use it"
        self._hold(Answer(service, not refusal, text), now)

    @property
    def _before(self) -> KeptEstimate | None:
        """The newest estimate, of this run or in the file."""
        kept = self._file.history.estimates[-1:] if self._file else ()
        return self.newest or next(iter(kept), None)

    def apply(self, now: int) -> str:
        """Apply the offered estimate; return an empty text, or why not, in which case nothing changes."""
        if self.busy:
            return f"cannot apply: {self.busy}"
        if self.newest is None:
            return "there is no estimate to apply: none has been learned since the controller was configured"
        values = in_words(self.newest.parameters)
        if self.newest.applied:
            return f"the newest estimate has already been applied: {values}; set these parameters to use it again"
        if refusal := self._put_in_use(self.newest.parameters):
            return f"{values} was refused: {refusal}"
        self.newest = replace(self.newest, applied=True)
        if self._file is not None:
            self._file.history = self._file.history.with_newest_applied()
            self._write(self._file)
        self._hold(Answer("apply_estimate", True, f"in use: {values}"), now)
        return ""

    def _write(self, file: EstimateFile) -> None:
        self._writing = self._workers.submit(file.write, file.history)

    def _hold(self, answer: Answer, now: int) -> None:
        self._held = answer, now + PATIENCE

    def poll(self, now: int, *, wait_no_more: bool = False) -> Answer | None:
        """Return the answer, once, as soon as the file was written or writing failed."""
        if self._writing is not None and self._writing.done():
            error, self._writing = self._writing.exception(), None
            self.trouble = f"it could not be stored in {self._path}: {error}" if error else ""
        if self._held is None:
            return None
        answer, until = self._held
        writing = self._writing is not None
        if writing and now < until and not wait_no_more:
            return None
        self._held = None
        unsure = f"it is still being written to {self._path}" if writing else self.trouble
        return answer._replace(text=f"{answer.text}; {unsure}") if unsure else answer

    def finish(self, seconds: float) -> bool:
        """Wait for the file to be written; return whether it was."""
        return self._writing is None or not wait([self._writing], seconds).not_done

    # Diagnostics.

    @property
    def offer(self) -> str:
        """The estimate that waits to be applied, in words; empty if there is none."""
        if self.newest is None or self.newest.applied:
            return ""
        return f"an estimate waits for apply_estimate: {in_words(self.newest.parameters)}"

    def values(self) -> dict[str, Any]:
        """Return the newest estimate by name, with its gap map if it has one."""
        newest, names = self.newest, ("rad", "uncertainty_rad", "parameters", "method", "learned_at", "applied")
        shown: tuple[Any, ...] = ("",) * len(names)
        if newest is not None:
            angle, sure = (each.get("backlash_angle", "") for each in (newest.parameters, newest.uncertainties))
            shown = angle, sure, in_words(newest.parameters), newest.method.value, newest.date, newest.applied
        listed = {f"estimate_{name}": value for name, value in zip(names, shown, strict=True)}
        around = self.map.values() if self.map else {}
        return {**listed, "estimate_file": self._path if self._file else "", **around}
