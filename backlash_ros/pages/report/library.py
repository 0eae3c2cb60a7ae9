"""Finds the library that draws the charts: Apache ECharts, a file of NiceGUI, which is not imported."""

import re
from importlib.util import find_spec
from pathlib import Path

FOLDER = Path("elements", "echart", "dist")
"""Folder of the library in the package; its ``index.js`` names the file and its export ``echarts``."""
_IMPORT = re.compile(r'import\{(.+?)\}from"\./([\w.-]+\.js)"')
_EXPORT = re.compile(r"export\{(.+?)\}")
_MAP = re.compile(r"^//# sourceMappingURL=.*$", re.MULTILINE)


class NoLibraryError(ImportError):
    """The library is missing or has moved; the text says what to do."""


def _renamed(names: str) -> dict[str, str]:
    """Return the names before ``as`` by those after it, of an import or export in braces."""
    both = (name.split(" as ") for name in names.split(","))
    return {pair[-1].strip(): pair[0].strip() for pair in both}


def chart_library() -> tuple[str, str]:
    """Return the library, a module of JavaScript, and the name under which it exports ``echarts``.

    Raises
    ------
    NoLibraryError
        If NiceGUI is not installed, or keeps the library elsewhere.
    """
    spec = find_spec("nicegui")
    if spec is None or not spec.submodule_search_locations:
        raise NoLibraryError("charts need NiceGUI: pip install 'backlash_ros[page]'")
    folder = Path(spec.submodule_search_locations[0], FOLDER)
    try:
        index = (folder / "index.js").read_text("utf-8")
        imported, exported = _IMPORT.search(index), _EXPORT.search(index)
        if imported is None or exported is None:
            raise NoLibraryError(f"this NiceGUI has another index of its charts than 3.13: {folder / 'index.js'}")
        name = _renamed(imported[1])[_renamed(exported[1])["echarts"]]
        text = (folder / imported[2]).read_text("utf-8")
    except (OSError, KeyError) as error:
        raise NoLibraryError(f"this NiceGUI keeps its charts elsewhere than 3.13: {error}") from error
    return _MAP.sub("", text), name
