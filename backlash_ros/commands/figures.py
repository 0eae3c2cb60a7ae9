"""`backlash figures`: the paper's figures and page, or the figures that explain the law of planned moves."""

import argparse
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from backlash_ros.commands.command import DONE, Command
from backlash_ros.commands.output import json_text
from backlash_ros.foundation.jsonable import jsonable
from backlash_ros.foundation.staging import staging
from backlash_ros.pages.paper.page import write_page
from backlash_ros.studies.paper import PARTS, reproduce

_EXAMPLE = "examples: backlash figures --out results/figures; backlash figures planned --out results/figures"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.epilog = _EXAMPLE
    add = parser.add_argument
    add("of", nargs="?", choices=("paper", "planned"), default="paper", help="by default paper")
    add("--out", type=Path, required=True, help="folder for the figures")
    add("--page", type=Path, help="also write the page that discusses the paper's")


def figures(given: argparse.Namespace, console: Console) -> int:
    """Draw and write; ValueError for a page that there is not."""
    if given.of == "paper":
        draw_paper(given.out, given.page, console)
        return DONE
    if given.page is not None:
        raise ValueError("argument --page: is about the paper's figures")
    from backlash_ros.studies.law_pictures import draw  # noqa: PLC0415 - matplotlib takes a second

    console.print(f"{', '.join(draw(given.out))} in {given.out}", highlight=False)
    return DONE


def draw_paper(out: Path, page: Path | None, console: Console) -> None:
    """Compute everything; write figures and figures.json into ``out``, and the page to ``page``: all or nothing."""
    from backlash_ros.studies.figures import FIGURES, draw  # noqa: PLC0415 - matplotlib takes a second

    with ExitStack() as stack:
        drawn = stack.enter_context(staging(out / "figures.json"))
        results = {drawn: out}
        if page is not None:
            written = stack.enter_context(staging(page))
            results[written] = page.parent
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as bar:
            task = bar.add_task("the paper", total=PARTS + len(FIGURES))

            def progress(what: str) -> None:
                bar.update(task, advance=1, description=what)

            done = reproduce(progress)
            draw(done, drawn, progress)
        numbers = jsonable(done.numbers)
        (drawn / "figures.json").write_text(json_text(numbers))
        if page is not None:
            (written / page.name).write_text(write_page(numbers))
        for folder, place in results.items():
            for file in folder.iterdir():
                file.replace(place / file.name)
    console.print(f"{len(FIGURES)} figures (PNG, SVG) and figures.json in {out}", highlight=False)
    if page is not None:
        console.print(f"{page}", highlight=False)


COMMAND = Command(figures, add_arguments, written=("page",), folders=("out",))
