"""What commands print and write: lines as they are, JSON, files that appear complete or not at all."""

import argparse
import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.staging import staging, write_text


def say(console: Console, text: str) -> None:
    """Print a text as it is: without colours, markup and line breaks of the terminal's width."""
    console.print(text, highlight=False, markup=False, soft_wrap=True)


def say_written(console: Console, places: Iterable[Path]) -> None:
    """Print the names of the files that were written, if there are any."""
    if names := "; ".join(map(str, places)):
        say(console, f"written: {names}")


def json_text(content: Any) -> str:
    """Return the text of a file of JSON; what is not finite is null."""
    return json.dumps(jsonable(content), indent=1) + "\n"


def print_json(console: Console, content: Any) -> None:
    """Print JSON; what is not finite is null."""
    console.print_json(json.dumps(jsonable(content)))


@contextmanager
def staged(*places: Path | None) -> Iterator[dict[Path, Path]]:
    """Yield by place the file to write, beside it; in the end what was written is put there, or nothing on an error."""
    with ExitStack() as stack:
        written = {place: stack.enter_context(staging(place)) / place.name for place in places if place is not None}
        yield written
        for place, file in written.items():
            if file.exists():
                file.replace(place)


def print_or_write(given: argparse.Namespace, text: str) -> None:
    """Print a text, or write it to ``--out``."""
    if given.out is None:
        print(text, end="")
    else:
        write_text(given.out, text, overwrite=given.force)
