"""A digest of the code: results of two versions do not belong in one table."""

import hashlib
import os
from functools import cache
from pathlib import Path

from backlash_ros.foundation.registry import PLUGINS

_PACKAGE = Path(__file__).parents[2]


@cache
def code_digest() -> str:
    """Return a digest of the sources of this package and of its plugins."""
    digest = hashlib.sha256()
    plugins = [Path(file) for file in os.environ.get(PLUGINS, "").split(os.pathsep) if file]
    for source in (*sorted(_PACKAGE.rglob("*.py")), *plugins):
        digest.update(source.read_bytes())
    return digest.hexdigest()
