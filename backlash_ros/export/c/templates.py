"""Text of C files, and of their README, from the templates ``*.j2`` beside this one; numbers to the last bit."""

import math
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_TEMPLATES = Environment(  # noqa: S701 - C has nothing to escape
    loader=FileSystemLoader(Path(__file__).parent),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


def render(template: str, **values: Any) -> str:
    """Return a file's text from a template and what it names."""
    return _TEMPLATES.get_template(template).render(**values)


def number(value: float) -> str:
    """Return a number as C reads it, to the last bit."""
    value = float(value)
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(value)
