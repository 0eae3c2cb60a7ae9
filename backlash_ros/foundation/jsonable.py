"""Prepares results for JSON, which has no infinity and no nan."""

import math
from typing import Any


def jsonable(value: Any) -> Any:
    """Return ``value`` with None in place of every infinity and nan in its dicts, lists and tuples."""
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
