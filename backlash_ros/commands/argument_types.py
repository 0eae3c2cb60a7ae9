"""What the value of an argument must be: a number within bounds, or a name that is known."""

import argparse
import math
from collections.abc import Callable, Mapping
from typing import Any


def number_of(least: float, *, above: bool = False) -> Callable[[str], float]:
    """Return a parser of a finite number that is at least, or if ``above`` more than, the least."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or value < least or (above and value == least):
            raise argparse.ArgumentTypeError(f"must be a number {'>' if above else '>='} {least:g}, got {text!r}")
        return value

    return parse


def whole(least: int) -> Callable[[str], int]:
    """Return a parser of a whole number that is at least the least."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"must be a whole number >= {least}, got {text!r}")
        return value

    return parse


def entry_of(registry: Mapping[str, Any], *besides: str) -> Callable[[str], str]:
    """Return a parser of a name in a registry, or one of those besides."""

    def parse(text: str) -> str:
        if text not in registry and text not in besides:
            raise argparse.ArgumentTypeError(f"must be one of {sorted([*registry, *besides])}, got {text!r}")
        return text

    return parse
