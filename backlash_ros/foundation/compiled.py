"""The one way in which this package compiles functions, so that stale machine code from a cache cannot run.

numba keys its disk cache on the file that holds the function, not on the functions it calls: after an update of one
file a cached caller would go on running the old code. Here the cache folder is named after the text of every source
file that is compiled, so any change starts a new one. If nothing can be cached, functions are compiled every time.
Copies of the same sources, such as installed ones, share the code if they are given the same folder (NUMBA_CACHE_DIR).
"""

import contextlib
import fcntl
import hashlib
import inspect
import logging
import os
import re
import shutil
import tempfile
import time
import types
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

P = ParamSpec("P")
R = TypeVar("R")

_config: Any = numba.config
_FunctionCache: Any = FunctionCache
_IndexFile: Any = IndexDataCacheFile

_PACKAGE = Path(__file__).resolve().parent.parent
_FOLDER = "backlash_ros_compiled"
_ROOMS = "foundation", "gates", "drivetrain", "identification", "control", "simulation"
"""Where functions are compiled."""
_OURS = re.compile(r"source-[0-9a-f]{16}")
"""Name pattern of a folder of machine code: only such folders are ever deleted."""


def _source_digest() -> str:
    digest = hashlib.sha256()
    for room in _ROOMS:
        for source in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(str(source.relative_to(_PACKAGE)).encode())
            digest.update(source.read_bytes())
    return f"source-{digest.hexdigest()[:16]}"


def _usable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"room for a byte")
            file.flush()
            return True
    except OSError:
        return False


def _cache_places() -> list[Path]:
    places = [Path(_config.CACHE_DIR)] if _config.CACHE_DIR else []  # the user's NUMBA_CACHE_DIR
    places.append(_PACKAGE / "__pycache__")
    with contextlib.suppress(RuntimeError):  # this user has no home
        places.append(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"))
    return [place / _FOLDER for place in places]


def _cache_folder() -> Path | None:
    """Return the first writable place for this source digest; None where there is none."""
    digest = _source_digest()
    for place in _cache_places():
        if _usable(place / digest):
            for stale in place.iterdir():
                if stale.name != digest and _OURS.fullmatch(stale.name) and not stale.is_symlink():
                    shutil.rmtree(stale, ignore_errors=True)
            return place / digest
    _warn_uncached("no folder for compiled code is writable")
    return None


_warned: list[str] = []


def _warn_uncached(why: str) -> None:
    """Warn once, for all functions, that the next start will take as long as this one."""
    if _warned:
        return
    _warned.append(why)
    text = (
        f"backlash_ros: {why}; compiling takes about a minute at every start. Set NUMBA_CACHE_DIR to a writable folder"
    )
    warnings.warn(text, RuntimeWarning, stacklevel=3)


class _Turn:
    """Lets one process at a time compile a function; waiting processes then load what it compiled.

    A function keeps its lock while it waits for the functions that it calls, and these never wait for it: no deadlock.
    Functions that do not call each other are compiled in parallel.
    """

    _PATIENCE = 120.0
    """Seconds: a process that holds the lock longer is taken to be stopped, not compiling."""

    def __init__(self, lock: Path) -> None:
        self._path = lock
        self._lock: int | None = None

    def take(self) -> None:
        """Wait for the lock, unless it is held; go on without it if there can be none."""
        if self._lock is not None:
            return
        with contextlib.suppress(OSError):
            self._lock = os.open(self._path, os.O_CREAT | os.O_RDWR, 0o666)
            end = time.monotonic() + self._PATIENCE
            while not self._taken() and time.monotonic() < end:
                time.sleep(0.05)

    def leave(self) -> None:
        """Release the lock if it is held."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _taken(self) -> bool:
        assert self._lock is not None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


_log = logging.getLogger(__name__)
_said: list[str] = []


def _say_once() -> None:
    """Log once that compiling takes a while, as soon as the log has a reader."""
    if not _said and _log.isEnabledFor(logging.INFO):
        _said.append("compiling, once for this version of the package: about half a minute")
        _log.info(_said[0])


@cache
def _text_digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


class _Cache(_FunctionCache):  # type: ignore[misc]
    """A cache that is skipped if the disk is full or a file cannot be read."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        file, name = Path(inspect.getfile(function)).resolve(), self._impl.filename_base
        if any(file.is_relative_to(_PACKAGE / room) for room in _ROOMS):
            # Identified by name and text: the file's place and date do not matter.
            self._cache_path = os.path.join(_config.CACHE_DIR, function.__module__)
            os.makedirs(self._cache_path, exist_ok=True)
            self._cache_file = _IndexFile(self._cache_path, name, _text_digest(file))
        self.turn = _Turn(Path(self._cache_path, f"{name}.lock"))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load(sig, target_context)
        if found is None:
            self.turn.take()
            found = self._load(sig, target_context)  # another process may have been at it
        if found is None:
            _say_once()
        return found

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a file that was cut short raises whatever its bytes happen to mean
            with contextlib.suppress(OSError):
                self.flush()  # a broken index would also prevent storing
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn_uncached(f"compiled code cannot be stored: {error}")


_CACHE = _cache_folder()

_INLINES = numba.version_info[:2] >= (0, 59)
"""Whether numba inlines functions: older versions take minutes for that, so it is left to LLVM."""


def _keep(dispatcher: Any, cache: _Cache) -> None:
    """Make ``dispatcher`` load its code from the cache, and compile under a lock what is not there."""
    compile_one = dispatcher.compile

    def compile_in_turn(signature: Any) -> Any:
        try:
            return compile_one(signature)
        finally:
            cache.turn.leave()

    dispatcher._cache, dispatcher.compile = cache, compile_in_turn


def _dispatcher(function: Callable[..., Any], *, fused: bool = False, inlined: bool = False) -> Any:
    """Return numba's dispatcher for ``function``, cached on disk where possible.

    Division by zero and overflow follow IEEE 754 (inf and nan), as numpy has them: the callers look at the results. No
    fast-math: a mirrored input must give the mirrored output, bit for bit. It does so with ``fused``, too, which lets
    the processor round a product and a sum once.
    """
    options: dict[str, Any] = {"fastmath": {"contract"} if fused else False}
    if inlined:
        options |= {"inline": "always"} if _INLINES else {"forceinline": True}
    dispatcher: Any = numba.njit(error_model="numpy", **options)(function)
    if _CACHE is not None:
        chosen, _config.CACHE_DIR = _config.CACHE_DIR, str(_CACHE)
        try:
            _keep(dispatcher, _Cache(function))
        except (OSError, RuntimeError) as error:
            _warn_uncached(f"compiled code cannot be stored: {error}")
        finally:
            _config.CACHE_DIR = chosen
    return dispatcher


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` with numba on its first call."""
    result: Callable[P, R] = _dispatcher(function)
    return result


def fused(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `compiled` does, with fused multiply-add if the processor has it."""
    result: Callable[P, R] = _dispatcher(function, fused=True)
    return result


def compiled_as(signature: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile for one numba signature, at once, so that the function can be handed to a compiled one as a value."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        dispatcher = _dispatcher(function)
        dispatcher.compile(signature)
        dispatcher.disable_compile()
        result: Callable[P, R] = dispatcher
        return result

    return decorate


def unbound(*_: Any) -> Any:
    """Hold the place of a function that `specialize` binds in a template: ``_force: ForceFunction = unbound``."""
    raise NotImplementedError("a template must be compiled by `specialize`, with its functions")


def specialize(
    template: Callable[P, R], signature: Any = None, *, fused: bool = False, inlined: bool = False, **bound: Any
) -> Callable[P, R]:
    """Compile a copy of ``template`` in which the global names ``bound`` stand for compiled functions and for values.

    So a tick is compiled once for each control law, an integrator once for each contact law, and neither pays for a
    call through a pointer. A compiled function that takes another function as an argument needs a signature that says
    so (`numba.types.FunctionType`). Otherwise numba stores its code under the identity of the argument, and the next
    process may load the code for a different one.

    The cached copy is named after the text of the bound functions' files: after an edit of a law outside this package
    it is compiled again.

    Parameters
    ----------
    template : a plain function, not compiled
    signature : to compile for at once, so that the copy can be handed to a compiled function as a value
    fused : as `fused` does
    inlined : into those that call it
    """
    dispatcher = _dispatcher(_copy_with(template, bound), fused=fused, inlined=inlined)
    if signature is not None:
        dispatcher.compile(signature)
        dispatcher.disable_compile()
    result: Callable[P, R] = dispatcher
    return result


def _copy_with(template: Any, bound: dict[str, Any]) -> Any:
    """Return a copy of a plain function in which global names stand for other things."""
    digest = hashlib.sha256()
    for name, thing in sorted(bound.items()):
        digest.update(name.encode())
        if callable(thing):
            source = getattr(thing, "py_func", thing)
            digest.update(f"{source.__module__} {source.__qualname__}".encode())
            digest.update(Path(inspect.getfile(source)).read_bytes())
        else:
            digest.update(repr(thing).encode())
    copy = types.FunctionType(template.__code__, {**template.__globals__, **bound}, template.__name__)
    copy.__qualname__ = f"{template.__qualname__}_{digest.hexdigest()[:16]}"
    copy.__module__ = template.__module__
    return copy
