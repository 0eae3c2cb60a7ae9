"""What can be added as one new file: control laws, contact laws and experiments, found by name.

A file of such a room has a table, say ``LAWS = {"name": ...}``. The room finds its own files by itself; others are
added with `Registry.add`, or for every process with the variable BACKLASH_ROS_PLUGINS: paths of files, joined as in
PATH, which are imported when a registry is first asked.
"""

import importlib.util
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Generic, TypeVar

T = TypeVar("T")

PLUGINS = "BACKLASH_ROS_PLUGINS"


class Registry(Mapping[str, T], Generic[T]):
    """The entries of one kind by name, in the order of their files.

    Parameters
    ----------
    package : ``__name__`` of the room
    path : its ``__path__``
    table : name of the table that each file has
    first : the file whose entries lead every listing
    """

    def __init__(self, package: str, path: list[str], table: str, first: str) -> None:
        self._table = table
        self._entries: dict[str, T] = {}
        names = sorted((module.name for module in iter_modules(path)), key=lambda name: (name != first, name))
        for name in names:
            self._take(import_module(f"{package}.{name}"))
        self._complete = False

    def _all(self) -> dict[str, T]:
        """Return the entries; the first time, with those of the plugins, which may import all of the package."""
        if not self._complete:
            self._complete = True  # for the plugins themselves
            try:
                for file in filter(None, os.environ.get(PLUGINS, "").split(os.pathsep)):
                    self.add(Path(file), must=False)
            except BaseException:
                self._complete = False
                raise
        return self._entries

    def add(self, file: Path, *, must: bool = True) -> list[str]:
        """Import ``file`` and take the entries of its table; return their names.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it has no such table and ``must`` have one, or a name is taken.
        """
        name = f"backlash_ros_plugins.{file.stem}"
        module = sys.modules.get(name)
        if module is None or Path(str(module.__file__)) != file.resolve():
            spec = importlib.util.spec_from_file_location(name, file.resolve())
            if spec is None or spec.loader is None or not file.is_file():
                raise FileNotFoundError(f"{self._table}: no Python file at {file}")
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
            try:
                spec.loader.exec_module(module)
            except BaseException:
                del sys.modules[name]  # half a module is none
                raise
        if must and not hasattr(module, self._table):
            raise ValueError(f"{file} must have a table {self._table} of its entries by name, and has none")
        return self._take(module)

    def _take(self, module: ModuleType) -> list[str]:
        table: Mapping[str, T] = getattr(module, self._table, {})
        for name, entry in table.items():
            if self._entries.get(name, entry) is not entry:
                raise ValueError(f"{self._table}: {name!r} in {module.__file__} is the name of another entry")
        self._entries |= table
        return list(table)

    def keep(self, names: Iterable[str]) -> None:
        """Forget the entries whose names are not among ``names``."""
        self._entries = {name: entry for name, entry in self._all().items() if name in set(names)}

    def choose(self, parameter: str, name: str, *besides: str) -> T:
        """Return the entry called ``name``; a ValueError names ``parameter``, the names that there are, and others."""
        if name not in self._all():
            raise ValueError(f"{parameter} must be one of {sorted([*self._all(), *besides])}, got {name!r}")
        return self._all()[name]

    def __getitem__(self, name: str) -> T:
        """Return the entry called ``name``."""
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._all())

    def __len__(self) -> int:
        """Return how many entries there are."""
        return len(self._all())
