"""Fills the tables and pictures of docs/evaluation.md from what `backlash evaluate --out` wrote."""

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile
from typing import Any

from backlash_ros.commands.evaluation import learning_of, table_of
from backlash_ros.commands.evaluation_effects import effects_table

PAGE = Path(__file__).parents[2] / "docs" / "evaluation.md"
_EFFECTS = re.compile(r"(<!-- effects: begin -->\n).*(<!-- effects: end -->)", re.DOTALL)
_FILLED = re.compile(r"(<!-- filled: begin -->\n).*(<!-- filled: end -->)", re.DOTALL)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def filled(content: dict[str, Any]) -> str:
    """Return the part of the page that an evaluation fills."""
    head, *rows = table_of(content["summary"])
    text = f"`backlash evaluate --seed {content['seed']} --drives {content['drives']} "
    text += f"--population {content['population']} --model {content['model']} --encoders {content['encoders']} "
    text += f"--laws {' '.join(content['laws'])} --json evaluation.json`. 95 % intervals in brackets.\n\n"
    text += "".join(f"- {line}\n" for line in learning_of(content["summary"])) + "\n"
    text += _row(["", *(f"`{law}`" for law in head[1:])]) + _row(["---"] * len(head))
    text += "".join(map(_row, rows)) + "\n"
    text += f"How `{content['judged_law']}` and the learning fail, and what is more frequent there than among all:\n\n"
    text += _row(["drives", "what", "in common (share there, share of all)"]) + _row(["---"] * 3)
    for group in content["failures"]:
        common = (
            f"{each['condition']} ({100 * each['share']:.0f} %, {100 * each['share_of_all']:.0f} %)"
            for each in group["in_common"]
        )
        text += _row([str(group["drives"]), group["what"].replace("_", "\\_"), "; ".join(common)])
    return text


def effects_filled(content: dict[str, Any]) -> str:
    """Return the table of what `backlash evaluate --effects` wrote."""
    head, *rows = effects_table(content)
    laws = {f"`{report['judged_law']}`" for report in content["effects"].values()}
    text = f"{content['drives']} drives of `{content['population']}` an effect, of seed {content['seed']}, "
    text += f"`--model {content['model']}`; the law is {', '.join(sorted(laws))}.\n\n"
    return text + _row(head) + _row(["---"] * len(head)) + "".join(_row([f"`{name}`", *rest]) for name, *rest in rows)


def main(folder: Path, page: Path) -> None:
    """Fill ``page`` from ``evaluation.json`` and the pictures in ``folder``, and from an ``effects.json``."""
    if (effects := folder / "effects.json").exists():
        text = effects_filled(json.loads(effects.read_text()))
        page.write_text(_EFFECTS.sub(lambda m: m[1] + "\n" + text + "\n" + m[2], page.read_text()))
    content = json.loads((folder / "evaluation.json").read_text())
    text, count = _FILLED.subn(lambda m: m[1] + "\n" + filled(content) + "\n" + m[2], page.read_text())
    if count != 1:
        raise SystemExit(f"{page} must have one part to fill, and has {count}")
    page.write_text(text)
    for name in ("shares", "settling"):
        copyfile(folder / f"{name}.png", page.parent / "images" / f"evaluation_{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), PAGE)
