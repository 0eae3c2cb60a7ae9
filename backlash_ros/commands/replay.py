"""`backlash replay`: its arguments; reads a bag, replays, prints and writes."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from backlash_ros.commands.command import DONE, NOTHING, Command
from backlash_ros.commands.output import json_text, say, say_written, staged
from backlash_ros.studies.replay.again import Replayed, replay
from backlash_ros.studies.replay.recorded import read_recorded
from backlash_ros.studies.replay.what_if import Changes

DESCRIPTION = (
    "Recorded samples through the controller's law again, with the recorded parameters, from each activation in the "
    "bag on: whether the commands are equal to the last bit. The exit code is 0 where all are, 1 where not."
)
EXAMPLE = "example: backlash replay results/demo/bag --set 'gains.fast.q=[500.0, 1.0]' --plot replay.png"
_OPEN_LOOP = (
    "Open loop: each command is what these values would have given for the recorded samples, after the recorded "
    "commands. The drive would have moved otherwise."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to a parser."""
    parser.description, parser.epilog = DESCRIPTION, EXAMPLE
    add = parser.add_argument
    add("bag", type=Path, metavar="BAG", help="rosbag2 with the topics of the package's recorder")
    add("--controller", default="", metavar="NAME", help="if there are several, such as /axis1/controller")
    text = "another value of a dynamic parameter, to see the commands that it would have given, in open loop"
    add("--set", action="append", default=[], metavar="NAME=VALUE", dest="changes", help=text)
    add("--json", type=Path, metavar="FILE", help="file for the result")
    add("--plot", type=Path, metavar="FILE", help="file for a picture of both commands, such as replay.png")
    add("--force", action="store_true", help="overwrite existing files")


def _difference(replayed: Replayed, k: int) -> dict[str, float | int]:
    return {
        "time": float(replayed.time[k]),
        "stamp": replayed.stamps[k],
        "recorded": float(replayed.recorded[k]),
        "replayed": float(replayed.replayed[k]),
    }


def _largest(replayed: Replayed) -> int | None:
    """Return the index of the largest difference, or None."""
    sizes = np.abs(replayed.replayed - replayed.recorded)
    return int(np.nanargmax(sizes)) if replayed.differing.size and not np.all(np.isnan(sizes)) else None


def content_of(replayed: Replayed) -> dict[str, Any]:
    """Return the result of one replay as plain values; times in s from the first sample, commands in ``unit``."""
    largest, differing = _largest(replayed), replayed.differing
    return {
        "commands": len(replayed.stamps),
        "seconds": float(replayed.time[-1]),
        "unit": replayed.unit,
        "equal": replayed.equal,
        "different": int(differing.size),
        "first_difference": _difference(replayed, int(differing[0])) if differing.size else None,
        "largest_difference": None if largest is None else _difference(replayed, largest),
        "samples_missing": replayed.lost,
        "commands_missing": replayed.unanswered,
        "notes": list(replayed.notes),
    }


def _in_words(difference: dict[str, Any], unit: str) -> str:
    return (
        f"at {difference['time']:.6f} s, sample {difference['stamp'] // 10**9}.{difference['stamp'] % 10**9:09d}: "
        f"recorded {difference['recorded']!r} {unit}, replayed {difference['replayed']!r} {unit}"
    )


def _lines(content: dict[str, Any], what: str) -> list[str]:
    unit = content["unit"]
    same = content["commands"] - content["different"]
    lines = [f"{what}: {content['commands']} commands in {content['seconds']:.3f} s"]
    lines[0] += ", all equal to the last bit" if not content["different"] else f", {same} equal to the last bit"
    if content["samples_missing"]:
        lines.append(f"  {content['samples_missing']} samples that commands name are not in the bag")
    if content["commands_missing"]:
        lines.append(f"  {content['commands_missing']} samples were taken whose commands are not in the bag")
    if content["samples_missing"] or content["commands_missing"]:
        lines.append("  the recorder lost them: from there on the replay lacks what the controller saw")
    if content["first_difference"]:
        lines.append(f"  first difference {_in_words(content['first_difference'], unit)}")
    if largest := content["largest_difference"]:
        size = abs(largest["replayed"] - largest["recorded"])
        lines.append(f"  largest difference {size:.6g} {unit} {_in_words(largest, unit)}")
    return lines + [f"  {note}" for note in content["notes"]]


def replay_bag(given: argparse.Namespace, console: Console) -> int:
    """Replay, print and write; return the exit code. Files appear complete or not at all.

    Raises
    ------
    OSError, ValueError
        As `read_recorded` and `replay`, and if changes are refused.
    """
    changes = Changes.parsed(given.changes)
    recorded = read_recorded(given.bag, given.controller)
    for text in recorded.damage:
        say(console, f"{given.bag}: {text}")
    pairs = [replay(recorded, activation, changes) for activation in recorded.activations]
    activations = []
    for k, (done, other) in enumerate(pairs):
        content = content_of(done)
        lines = _lines(content, f"activation {k + 1}")
        if other is not None:
            content["changed"] = content_of(other)
            lines += _lines(content["changed"], "  with what was set")
        activations.append(content)
        say(console, "\n".join(lines))
    if changes.given:
        say(console, _OPEN_LOOP)
    equal = all(done.equal for done, _ in pairs)
    result = {"bag": str(given.bag), "controller": recorded.controller, "equal": equal, "activations": activations}
    result["damage"] = list(recorded.damage)
    if changes.given:
        result |= {"set": dict(changes.given), "open_loop": _OPEN_LOOP}
    with staged(given.json, given.plot) as files:
        if given.json is not None:
            files[given.json].write_text(json_text(result), encoding="utf-8")
        if given.plot is not None:
            from backlash_ros.studies.replay.picture import draw  # noqa: PLC0415 - matplotlib takes a second

            draw(pairs, files[given.plot])
    say_written(console, files)
    return DONE if equal else NOTHING


COMMAND = Command(replay_bag, add_arguments, written=("json", "plot"))
