"""What a report shows of an axis, as values: tables, and parts that unfold."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from backlash_ros.pages.report.charts import Place
from backlash_ros.pages.report.pictures import Sketch

MOST_CHARTS = 60
"""Largest number of steps, of learning runs and of faults of an axis with a chart of their own, the first ones."""


class Folded(NamedTuple):
    """A text that is unfolded by its title."""

    title: str
    text: str


Cell = str | Sketch | Folded
"""What a table holds."""


@dataclass(frozen=True)
class Table:
    """Rows of cells under ``heads``; ``links``: ids that the first cells lead to, empty for none."""

    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    links: Sequence[str] = ()

    @property
    def lines(self) -> Iterator[tuple[str, Cell, list[tuple[str, Cell]]]]:
        """The rows: link, first cell, and the other cells with their heads."""
        for (first, *rest), link in zip(self.rows, self.links or [""] * len(self.rows), strict=True):
            yield link, first, list(zip(self.heads[1:], rest, strict=True))


@dataclass(frozen=True)
class Part:
    """A part of an axis, to be unfolded: a table of figures, or pairs of names and values, remarks, charts and notes.

    A title alone is a line. Where the table ``leads``, it is seen at once, and each chart is unfolded on its own.
    """

    title: str
    table: Table | None = None
    pairs: Sequence[tuple[str, str]] = ()
    about: str = ""
    remarks: Sequence[str] = ()
    charts: Sequence[Place] = ()
    notes: Sequence[str] = ()
    leads: bool = False

    @property
    def alone(self) -> bool:
        """Whether there is nothing but the title."""
        return not (self.table or self.pairs or self.about or self.remarks or self.charts or self.notes)
