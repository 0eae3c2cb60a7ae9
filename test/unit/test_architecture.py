"""Imports point one way and in no circle, only the ROS side knows ROS, and functions and files are short."""

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "backlash_ros"
BELOW: dict[str, set[str]] = {
    "foundation": set(),
    "gates": set(),
    "drivetrain": {"foundation"},
    "identification": {"drivetrain", "foundation"},
}
BELOW["control"] = {"gates", *BELOW["identification"], "identification"}
BELOW["simulation"] = {"control", *BELOW["control"]}
BELOW["drive_file"] = {"control", *BELOW["control"]}
BELOW["export"] = {"simulation", "drive_file", *BELOW["drive_file"]}
BELOW["recordings"] = {"drive_file", *BELOW["drive_file"]}
BELOW["studies"] = {"recordings", "simulation", *BELOW["recordings"]}
BELOW["pages"] = {"studies", *BELOW["studies"]}
BELOW["commands"] = {"pages", "export", *BELOW["pages"]}
BELOW["ros"] = {"gates", "drivetrain", "foundation"}
BELOW["nodes"] = {"ros", "recordings", "simulation", *BELOW["recordings"]}
BELOW["contract"] = {"ros", "drive_file", *BELOW["drive_file"]}
BELOW["measure"] = {"ros", "commands", *BELOW["commands"]}
BELOW["dashboard"] = {"nodes", "measure", *BELOW["nodes"]}
BELOW["demo"] = {"ros", "studies", *BELOW["studies"]}
"""What each room may import beside itself."""
ROS_ROOMS = {"ros", "nodes", "contract", "measure", "dashboard", "demo"}
ROS = {"rclpy", "rcl_interfaces", "sensor_msgs", "std_msgs", "std_srvs", "diagnostic_msgs", "lifecycle_msgs", "launch"}


@cache
def parsed(source: Path) -> ast.Module:
    return ast.parse(source.read_text())


def imported(source: Path) -> set[str]:
    names = set()
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: relative import"
            from_package = node.module == "backlash_ros"
            names |= {f"backlash_ros.{alias.name}" for alias in node.names} if from_package else {node.module or ""}
    return names


@pytest.mark.parametrize(
    "line", ["import backlash_ros.nodes", "from backlash_ros.nodes import run", "from backlash_ros import nodes"]
)
def test_every_way_to_import_is_seen(line: str, tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    source.write_text(line)
    assert imported(source) == {"backlash_ros.nodes"}


def test_every_folder_is_a_room() -> None:
    assert {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()} == set(BELOW)


@pytest.mark.parametrize("room", BELOW)
def test_imports_point_one_way(room: str) -> None:
    assert room not in set().union(*(BELOW[below] for below in BELOW[room]))
    sources = sorted((PACKAGE / room).rglob("*.py"))
    assert sources
    for source in sources:
        for name in imported(source):
            parts = name.split(".")
            if parts[0] == "backlash_ros" and len(parts) > 1:
                assert parts[1] in BELOW[room] | {room}, f"{source.name} imports {name}"
            if room not in ROS_ROOMS:
                assert parts[0] not in ROS, f"{source.name} imports {name}"


def module_of(source: Path) -> str:
    parts = source.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_no_file_imports_itself_by_a_detour() -> None:
    """A package's own ``__init__`` only gathers what is inside; who imports from inside a package skips it."""
    sources = {module_of(source): source for source in PACKAGE.rglob("*.py")}
    needs = {
        module: {name for name in imported(source) if name in sources and not module.startswith(f"{name}.")}
        for module, source in sources.items()
    }
    done: set[str] = set()

    def visit(module: str, above: tuple[str, ...]) -> None:
        assert module not in above, f"a circle: {' -> '.join((*above, module))}"
        if module not in done:
            for name in sorted(needs[module]):
                visit(name, (*above, module))
            done.add(module)

    for module in sorted(needs):
        visit(module, ())


def assigned(source: Path) -> set[str]:
    """Return the names that a file assigns anywhere."""
    names = set()
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.alias) and node.asname:
            names.add(node.asname)
    return names


SIGNALS = {"THETA_M", "OMEGA_M", "THETA_L", "OMEGA_L", "CURRENT", "LOAD_TORQUE", "SUPPLIED", "LOST"}
SIGNALS |= {"POSITION", "VELOCITY", "ACCELERATION"}


def test_the_order_of_the_signals_is_said_in_one_file() -> None:
    names = {source: assigned(source) for source in sorted(PACKAGE.rglob("*.py"))}
    where = {name: [source.name for source in names if name in names[source]] for name in SIGNALS}
    assert where == {name: ["signals.py"] for name in SIGNALS}


@pytest.mark.parametrize("line", ["X = 1", "A, X = range(2)", "from a import b as X", "for X in range(2): pass"])
def test_every_way_to_assign_is_seen(line: str, tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    source.write_text(line)
    assert "X" in assigned(source)


COUNTED = {
    "signals.py": "the signals, which are looped over and sent",
    "delay.py": "streams of random numbers",
    "integrator.py": "how an integration ended",
    "isolation.py": "domain ids",
}
"""Files that number things with ``range``, and what; all other cells of rows have names: `foundation.record`."""


def counted(source: Path) -> bool:
    """Return whether a file gives names to the numbers of a ``range``."""
    values = [node.value for node in parsed(source).body if isinstance(node, ast.Assign)]
    calls = [value.func for value in values if isinstance(value, ast.Call)]
    return any(isinstance(call, ast.Name) and call.id == "range" for call in calls)


def test_cells_have_names_and_not_numbers() -> None:
    assert {source.name for source in PACKAGE.rglob("*.py") if counted(source)} == COUNTED.keys()


def test_every_file_says_in_its_first_line_why_it_exists() -> None:
    said = {source: ast.get_docstring(parsed(source)) or "" for source in PACKAGE.rglob("*.py")}
    assert [source.name for source, text in said.items() if len(text.partition("\n")[0]) <= 20] == []


STRICT = "control/laws", "control/monitoring"
LINES, STRICT_LINES, STRICT_FILE, ARGUMENTS = 60, 40, 250, 8


def is_strict(source: Path) -> bool:
    return source.relative_to(PACKAGE).as_posix().startswith(STRICT)


def arguments_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = function.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return len(named) - (named[:1] != [] and named[0].arg in ("self", "cls"))


def test_functions_and_files_are_short_enough_to_be_read_at_once() -> None:
    long, wide = [], []
    for source in sorted(PACKAGE.rglob("*.py")):
        lines = STRICT_LINES if is_strict(source) else LINES
        for node in ast.walk(parsed(source)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.end_lineno is not None
                long += [f"{source.name}: {node.name}"] * (node.end_lineno - node.lineno >= lines)
                wide += [f"{source.name}: {node.name}"] * (arguments_of(node) > ARGUMENTS)
    assert (long, wide) == ([], [])
    strict = filter(is_strict, PACKAGE.rglob("*.py"))
    assert [source.name for source in strict if len(source.read_text().splitlines()) > STRICT_FILE] == []
