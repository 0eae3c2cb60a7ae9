"""The one way this package compiles a function, so that a stale machine-code cache cannot run.

numba keys its disk cache on the file that holds the function, not on the functions it calls: after an
update of ``contact.py`` a cached ``integrator.py`` would go on running the old contact law. Here the
cache folder is named after the text of every source file of the package, so any change starts afresh.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

_config: Any = numba.config

_PACKAGE = Path(__file__).resolve().parent.parent


def _source_digest() -> str:
    digest = hashlib.sha256()
    for room in ("drivetrain", "control", "simulation"):
        for source in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _usable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _cache_folder() -> Path | None:
    """Return the first writable place for this source digest; None when there is none: compile every time."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    places = [_PACKAGE / "__pycache__" / "compiled", user_cache / "backlash_ros" / "compiled"]
    if _config.CACHE_DIR:  # the user's NUMBA_CACHE_DIR
        places.insert(0, Path(_config.CACHE_DIR) / "backlash_ros")
    digest = _source_digest()
    for place in places:
        if _usable(place / digest):
            for stale in place.iterdir():
                if stale.name != digest:
                    shutil.rmtree(stale, ignore_errors=True)
            return place / digest
    return None


_CACHE = _cache_folder()


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` with numba on its first call, cached on disk.

    Division by zero and overflow follow IEEE 754 (inf and nan), as numpy has them: the callers look at
    the results. No fast-math: a mirrored input must give the mirrored output, bit for bit.
    """
    result: Callable[P, R] = _cached(numba.njit(error_model="numpy")(function))
    return result


def compiled_as(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile for one numba signature, at once, so that the function can be handed to a compiled one as a value."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        dispatcher = _cached(numba.njit(error_model="numpy")(function))
        dispatcher.compile(signature)
        dispatcher.disable_compile()
        result: Callable[P, R] = dispatcher
        return result

    return decorate


def _cached(dispatcher: Any) -> Any:
    if _CACHE is not None:
        chosen, _config.CACHE_DIR = _config.CACHE_DIR, str(_CACHE)
        try:
            dispatcher.enable_caching()
        finally:
            _config.CACHE_DIR = chosen
    return dispatcher
