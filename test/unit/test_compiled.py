"""Compiled code on disk: never stale, never in the way, and nothing but our own folders is ever deleted."""

import errno
import importlib.util
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numba import float64

from backlash_ros.foundation import compiled as _compiled  # noqa: F401  the function; the module is below
from backlash_ros.foundation.compiled import compiled, compiled_as, specialize

module: Any = sys.modules["backlash_ros.foundation.compiled"]

TEMPLATE = """
def inner(x):
    raise NotImplementedError


def template(x):
    return inner(x) + 1.0
"""

SHAPES = """
from backlash_ros.foundation.compiled import compiled


@compiled
def double(x):
    return 2.0 * x


@compiled
def square(x):
    return x * x
"""

SCRIPT = """
import sys
from numba import float64
sys.path.insert(0, sys.argv[1])
import base
import shapes
from backlash_ros.foundation.compiled import specialize
for bound in (shapes.double, shapes.square):
    function = specialize(base.template, float64(float64), inner=bound)
    print(function(5.0), sum(function.stats.cache_hits.values()))
"""


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing has been warned of yet."""
    monkeypatch.setattr(module, "_warned", [])
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        yield


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of this test's own, in use."""
    monkeypatch.setattr(module._config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "_CACHE", module._cache_folder())
    return Path(module._CACHE)


def offset() -> Any:
    """A new function to compile."""

    def add_three(x: float) -> float:
        return x + 3.0

    return compiled(add_three)


def test_only_our_own_outdated_folders_are_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "elsewhere"
    kept = [
        *(".git/config", "docs/page.md", "backlash_ros/__init__.py", "source-0123456789abcdef/mine"),
        *(f"backlash_ros_compiled/{name}/mine" for name in ("source-0123", "source-0123456789ABCDEF", "results")),
        "elsewhere/mine",
    ]
    stale = tmp_path / "backlash_ros_compiled" / "source-0123456789abcdef"
    for name in (*kept, "backlash_ros_compiled/source-0123456789abcdef/index.nbi"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("something")
    link = tmp_path / "backlash_ros_compiled" / "source-fedcba9876543210"
    link.symlink_to(elsewhere)
    monkeypatch.setattr(module._config, "CACHE_DIR", str(tmp_path))
    folder = module._cache_folder()
    assert folder == tmp_path / "backlash_ros_compiled" / module._source_digest()
    assert folder.is_dir()
    assert not stale.exists()
    assert all((tmp_path / name).read_text() == "something" for name in kept)
    assert link.is_symlink()


def test_full_disk_compiles_all_the_same_and_warns_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Any, name: str, _data: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), name)

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    with warnings.catch_warnings(record=True) as seen:
        functions = [offset(), compiled_as(float64(float64))(lambda x: x + 3.0)]
        assert [function(1.0) for function in functions] == [4.0, 4.0]
    (warning,) = seen
    assert "cannot be stored: [Errno 28] No space left" in str(warning.message)
    assert "Set NUMBA_CACHE_DIR to a writable folder" in str(warning.message)


def test_without_any_writable_folder_nothing_is_cached_and_it_warns_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No home, and the package where nothing can be made."""

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setattr(module._config, "CACHE_DIR", "")
    monkeypatch.setattr(module, "_PACKAGE", file)
    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    with warnings.catch_warnings(record=True) as seen:
        monkeypatch.setattr(module, "_CACHE", module._cache_folder())
        assert module._CACHE is None
        assert offset()(1.0) == 4.0
        assert module._cache_folder() is None
    (warning,) = seen
    assert "no folder for compiled code is writable" in str(warning.message)


def test_folder_that_cannot_be_used_gives_way_to_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setattr(module._config, "CACHE_DIR", str(file))
    monkeypatch.setattr(module, "_PACKAGE", file)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert module._cache_folder().is_relative_to(tmp_path / "home" / "backlash_ros_compiled")


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("left", [0, 10, 100])
def test_cache_file_that_was_cut_short_is_compiled_anew(cache: Path, suffix: str, left: int) -> None:
    assert offset()(1.0) == 4.0
    files = list(cache.rglob(f"*add_three*.{suffix}"))
    assert files
    for file in files:
        file.write_bytes(file.read_bytes()[:left])
    again = offset()
    assert again(1.0) == 4.0
    assert not sum(again.stats.cache_hits.values())
    third = offset()
    assert third(1.0) == 4.0
    assert sum(third.stats.cache_hits.values()) == 1


def test_copies_of_the_same_sources_share_the_code(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the checkout and what was installed of it do; one that was edited has its own."""

    def hits(copy: str, text: str) -> int:
        file = tmp_path / copy / "control" / "shapes.py"
        file.parent.mkdir(parents=True)
        file.write_text(text)
        monkeypatch.setattr(module, "_PACKAGE", tmp_path / copy)
        spec = importlib.util.spec_from_file_location("shapes", file)
        assert spec is not None
        assert spec.loader is not None
        shapes = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "shapes", shapes)
        spec.loader.exec_module(shapes)
        assert (shapes.double(5.0), shapes.square(5.0)) == (20.0 if "4.0" in text else 10.0, 25.0)
        return sum(shapes.double.stats.cache_hits.values())

    edited = SHAPES.replace("2.0 * x", "4.0 * x")
    assert [hits("here", SHAPES), hits("installed", SHAPES), hits("edited", edited)] == [0, 1, 0]


def run_shapes(folder: Path, cache: Path) -> list[tuple[float, int]]:
    """Results of the template with either function bound, and how often it came from the cache, in a new process."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", SCRIPT, str(folder)]
    output = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=600).stdout
    return [(float(value), int(hits)) for value, hits in (line.split() for line in output.splitlines())]


@pytest.mark.grid
def test_functions_bound_to_a_template_are_told_apart_and_compiled_again_when_edited(tmp_path: Path) -> None:
    """In one process, from the cache of a second one, and after a change of the same length."""
    shapes, cache = tmp_path / "shapes.py", tmp_path / "cache"
    (tmp_path / "base.py").write_text(TEMPLATE)
    shapes.write_text(SHAPES)
    assert run_shapes(tmp_path, cache) == [(11.0, 0), (26.0, 0)]
    assert run_shapes(tmp_path, cache) == [(11.0, 1), (26.0, 1)]
    shapes.write_text(SHAPES.replace("2.0 * x", "4.0 * x"))
    assert run_shapes(tmp_path, cache) == [(21.0, 0), (26.0, 0)]  # the template's own file is as it was


def test_copies_of_a_template_are_independent() -> None:
    @compiled
    def halve(x: float) -> float:
        return 0.5 * x

    @compiled
    def square(x: float) -> float:
        return x * x

    def template(x: float) -> float:
        return inner(x)  # type: ignore[name-defined]  # noqa: F821

    halved, squared = specialize(template, inner=halve), specialize(template, float64(float64), inner=square)
    assert (halved(16.0), squared(16.0)) == (8.0, 256.0)
    assert halved.__name__ == squared.__name__ == "template"


COUNTING = """
import logging
import sys
from numba.core import event
from backlash_ros.drivetrain import delay
logging.basicConfig(stream=sys.stderr, format="%(message)s", level=logging.INFO)
constants = delay.delay_constants(delay.Delay(), 0.004)
with event.install_recorder("numba:compile") as recorder:
    delay.taken_at(constants, 1), delay.acts_at(constants, 1)
begun = [e.data["dispatcher"].py_func for _, e in recorder.buffer if e.is_start]
print(*sorted(f"{f.__module__}.{f.__qualname__}" for f in begun if f.__module__.startswith("backlash_ros")))
"""


@pytest.mark.grid
def test_processes_that_start_together_compile_each_function_once(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", COUNTING], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    ended = [process.communicate(timeout=600) for process in started]
    assert [process.returncode for process in started] == [0, 0]
    compiled_by = [printed.split() for printed, _ in ended]
    once = [
        "delay.acts_at",
        "delay.stamped_at",
        "delay.taken_at",
        *["sensors.uniform"] * 3,
    ]  # one `uniform` for each call
    assert sorted(compiled_by[0] + compiled_by[1]) == [f"backlash_ros.drivetrain.{name}" for name in once]
    assert all(said.count("compiling, once") == bool(own) for (_, said), own in zip(ended, compiled_by, strict=True))
    again = subprocess.run(
        [sys.executable, "-c", COUNTING], env=environment, capture_output=True, text=True, timeout=600, check=True
    )
    assert (again.stdout.split(), again.stderr) == ([], "")


CALLERS = """
from backlash_ros.foundation.compiled import compiled


@compiled
def called(x):
    return x + 1.0


@compiled
def double(x):
    return 2.0 * called(x)


@compiled
def square(x):
    return called(x) ** 2
"""

IN_ORDER = """
import sys
from numba.core import event
sys.path.insert(0, sys.argv[1])
import callers
with event.install_recorder("numba:compile") as recorder:
    assert [getattr(callers, name)(4.0) for name in sys.argv[2:]]
print(*(e.data["dispatcher"].py_func.__name__ for _, e in recorder.buffer if e.is_start))
"""


def test_processes_that_begin_at_either_end_share_the_work(tmp_path: Path) -> None:
    """Neither waits for a function that it does not need, nor both for one another."""
    (tmp_path / "callers.py").write_text(CALLERS)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", IN_ORDER, str(tmp_path)]
    started = [
        subprocess.Popen([*command, *order], env=environment, stdout=subprocess.PIPE, text=True)
        for order in (("double", "square"), ("square", "double"))
    ]
    compiled_by = [process.communicate(timeout=600)[0].split() for process in started]
    assert [process.returncode for process in started] == [0, 0]
    assert sorted(compiled_by[0] + compiled_by[1]) == ["called", "double", "square"]


def test_what_another_process_compiles_holds_up_no_other_function(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_wait(_seconds: float) -> None:
        raise AssertionError("waited")

    other, own = offset(), compiled(lambda x: x - 3.0)
    elsewhere = module._Turn(other._cache.turn._path)
    elsewhere.take()
    monkeypatch.setattr(module.time, "sleep", no_wait)
    assert own(1.0) == -2.0
    with pytest.raises(AssertionError, match="waited"):
        other(1.0)
    elsewhere.leave()
    assert other(1.0) == 4.0


def test_a_process_that_keeps_the_lock_does_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(module._Turn, "_PATIENCE", 0.2)
    first, second = (module._Turn(tmp_path / "lock") for _ in range(2))
    first.take()
    second.take()
    assert not second._taken()
    first.leave()
    second.leave()
    second.take()
    assert second._taken()
    second.leave()
