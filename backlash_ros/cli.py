"""The command `backlash`: the paper's figures, and single closed-loop runs, without ROS."""

import argparse
import errno
import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from backlash_ros.analysis.figures import FIGURES, draw
from backlash_ros.analysis.jsonable import jsonable
from backlash_ros.analysis.page import write_page
from backlash_ros.analysis.paper import CASES, PARTS, judge, reproduce, respond
from backlash_ros.analysis.staging import staging
from backlash_ros.control import LAWS


def figures(out: Path, page: Path | None, console: Console) -> None:
    """Compute all, write figures and figures.json into ``out``, and the page to ``page``: all of it or nothing."""
    with ExitStack() as stack:
        drawn = stack.enter_context(staging(out / "figures.json"))
        results = {drawn: out}
        if page is not None:
            if page.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(page))
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
        (drawn / "figures.json").write_text(json.dumps(numbers, indent=1) + "\n")
        if page is not None:
            (written / page.name).write_text(write_page(numbers))
        for folder, place in results.items():
            for file in folder.iterdir():
                file.replace(place / file.name)
    console.print(f"{len(FIGURES)} figures (PNG, SVG) and figures.json in {out}", highlight=False)
    if page is not None:
        console.print(f"{page}", highlight=False)


def simulate(law: str, case: str, console: Console) -> None:
    """Run one step response and print its figures as JSON."""
    condition = CASES[case]
    console.print_json(json.dumps(jsonable({"law": law, "case": case, **judge(respond(law, condition), condition)})))


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the exit code is 2 for arguments that cannot be used."""
    parser = argparse.ArgumentParser(prog="backlash", description=__doc__)
    commands = parser.add_subparsers(required=True)
    drawing = commands.add_parser("figures", help="the paper's figures, computed and drawn")
    drawing.add_argument("--out", type=Path, required=True, help="folder to write into")
    drawing.add_argument("--page", type=Path, help="also write the page that judges them")
    drawing.set_defaults(run=lambda a, console: figures(a.out, a.page, console))
    single = commands.add_parser("simulate", help="one step response of 1 rad: its figures as JSON")
    single.add_argument("--law", choices=sorted(LAWS), default="two_region")
    single.add_argument("--case", choices=list(CASES), default="nominal")
    single.set_defaults(run=lambda a, console: simulate(a.law, a.case, console))
    parsed = parser.parse_args(args)
    command: Callable[[argparse.Namespace, Console], None] = parsed.run
    try:
        command(parsed, Console())
    except OSError as error:
        print(f"backlash: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
