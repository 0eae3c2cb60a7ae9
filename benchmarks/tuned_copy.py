"""A copy of the package whose law of planned moves loads its tuned numbers from memory, where a scan changes them.

numba freezes the constants of a module into machine code, which takes minutes to make anew. In the copy each use of a
tuned number in a function of `control/laws/planned` is a call of `tuned.py`. So it is compiled once for all values.
"""

import ast
import json
import shutil
from pathlib import Path

LAW = Path("control/laws/planned")
PACKAGE = "backlash_ros.control.laws.planned"
WHOLE = {"_LASTS", "_MORE_AHEAD"}
"""Tuned whole numbers; all others are sizes, rounds of a solution, or codes."""
_EXACT = {
    *("BUMP_PEAK", "_SOFT_PEAK", "_PEAK", "_INSTANT", "_ROUNDING", "_NO_CHANGE", "_NO_DIRECTION", "_SMALLEST_COUNT"),
    *("FLIGHT", "HOLD", "FOLLOW", "NO_MOVE", "TO_FLY", "TO_SHIFT", "TO_PRESS"),
}
"""Numbers that nobody tuned: peaks of polynomials, rounding, a rate that stands for infinity, codes."""


def numbers_in(tree: ast.Module) -> dict[str, float]:
    """Return the tuned numbers that a module defines."""
    found = {}
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.targets[0], ast.Name)
        ):
            name, value = node.targets[0].id, node.value.value
            if name in WHOLE or (isinstance(value, float) and name not in _EXACT):
                found[name] = float(str(value))
    return found


class _Reading(ast.NodeTransformer):
    """Replaces each use of a tuned number by a call that reads it."""

    def __init__(self, places: dict[str, int]) -> None:
        self._places = places

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace one name."""
        if node.id not in self._places:
            return node
        call = f"tuned({self._places[node.id]})"
        return ast.parse(f"int({call})" if node.id in WHOLE else call, mode="eval").body


def _read_from_memory(stem: str, tree: ast.Module, place_of: dict[str, int]) -> None:
    """Replace the uses of tuned numbers, its own and imported ones, in the functions of a module."""
    places = {name: place_of[f"{stem}.{name}"] for name in numbers_in(tree)}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(f"{PACKAGE}."):
            keys = {each.name: f"{node.module.rpartition('.')[2]}.{each.name}" for each in node.names}
            places |= {name: place_of[key] for name, key in keys.items() if key in place_of}
    reading = _Reading(places)
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            reading.visit(node)
    if places:
        tree.body[1:1] = ast.parse(f"from {PACKAGE}.tuned import tuned").body


def copy_package(source: Path, target: Path) -> None:
    """Copy the package in the folder ``source`` into the folder ``target``, and let its law read from memory."""
    copy = target / source.name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
    trees = {file: ast.parse(file.read_text()) for file in sorted((copy / LAW).glob("*.py"))}
    values = {f"{file.stem}.{name}": value for file, tree in trees.items() for name, value in numbers_in(tree).items()}
    place_of = {name: place for place, name in enumerate(values)}
    for file, tree in trees.items():
        _read_from_memory(file.stem, tree, place_of)
        file.write_text(ast.unparse(tree) + "\n")
    shutil.copy(Path(__file__).with_name("tuned.py"), copy / LAW)
    (copy / LAW / "tuned.json").write_text(json.dumps(values))
