"""What `backlash report` writes, read again: the page, which must be whole, as any of our pages, and the numbers."""

import json
from collections import Counter
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from backlash_ros.cli import main

VOID = {"meta", "br", "hr", "img", "link", "input"}
REFERENCES = "src", "href", "xlink:href", "srcset", "action"


class Parsed(HTMLParser):
    """A page, of which every element must end where it has to."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.scripts: list[dict[str, str | None]] = []
        self.tags: Counter[str] = Counter()
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags[tag] += 1
        self.references += [given[name] or "" for name in REFERENCES if name in given]
        self.ids += [given["id"] or ""] if "id" in given else []
        self.scripts += [given] if tag == "script" else []
        self.open += [] if tag in VOID else [tag]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in {"style", "script"}:
            self.text += data


@dataclass
class Made:
    """What the command wrote: the page as it stands there and as it is read, and the numbers."""

    html: str
    page: Parsed
    content: dict[str, Any]

    @property
    def axis(self) -> dict[str, Any]:
        """The only axis."""
        (axis,) = self.content["axes"]
        return axis


def report(bag: Path, out: Path, *options: str) -> Made:
    """Run the command."""
    page, numbers = out / "report.html", out / "report.json"
    words = ["report", str(bag), "--out", str(page), "--json", str(numbers), "--force", *options]
    assert main(words) == 0
    html = page.read_text("utf-8")
    return Made(html, Parsed(html), json.loads(numbers.read_text()))
