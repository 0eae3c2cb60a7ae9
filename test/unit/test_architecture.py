"""Imports point one way, and only the nodes and the drive contract kit know ROS."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "backlash_ros"
ROOMS = ["drivetrain", "control", "simulation", "analysis", "nodes", "contract"]
MAY_IMPORT = {
    "drivetrain": {"drivetrain"},
    "control": {"control", "drivetrain"},
    "simulation": {"simulation", "control", "drivetrain"},
    "analysis": {"analysis", "simulation", "control", "drivetrain"},
    "nodes": {"nodes", "analysis", "simulation", "control", "drivetrain"},
    "contract": {"contract", "nodes"},
}
ROS = {"rclpy", "rcl_interfaces", "sensor_msgs", "std_msgs", "std_srvs", "diagnostic_msgs", "lifecycle_msgs", "launch"}


def imported(source: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(source.read_text())):
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


@pytest.mark.parametrize("room", ROOMS)
def test_imports_point_one_way(room: str) -> None:
    sources = sorted((PACKAGE / room).rglob("*.py"))
    assert sources
    for source in sources:
        for name in imported(source):
            parts = name.split(".")
            if parts[0] == "backlash_ros" and len(parts) > 1:
                assert parts[1] in MAY_IMPORT[room], f"{source.name} imports {name}"
            if room not in {"nodes", "contract"}:
                assert parts[0] not in ROS, f"{source.name} imports {name}"


def assigned(source: Path) -> set[str]:
    """Return the names that a file assigns anywhere."""
    names = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.alias) and node.asname:
            names.add(node.asname)
    return names


SIGNALS = {"THETA_M", "OMEGA_M", "THETA_L", "OMEGA_L", "CURRENT", "LOAD_TORQUE", "SUPPLIED", "LOST"}
SIGNALS |= {"POSITION", "VELOCITY", "ACCELERATION"}


def test_the_order_of_the_signals_is_said_in_one_file() -> None:
    sources = sorted(PACKAGE.rglob("*.py"))
    where = {name: [source.name for source in sources if name in assigned(source)] for name in SIGNALS}
    assert where == {name: ["signals.py"] for name in SIGNALS}


@pytest.mark.parametrize("line", ["X = 1", "A, X = range(2)", "from a import b as X", "for X in range(2): pass"])
def test_every_way_to_assign_is_seen(line: str, tmp_path: Path) -> None:
    source = tmp_path / "source.py"
    source.write_text(line)
    assert "X" in assigned(source)


@pytest.mark.parametrize("source", sorted(PACKAGE.rglob("*.py")), ids=lambda path: path.name)
def test_every_file_says_in_its_first_line_why_it_exists(source: Path) -> None:
    first = (ast.get_docstring(ast.parse(source.read_text())) or "").splitlines()
    assert first
    assert len(first[0]) > 20
