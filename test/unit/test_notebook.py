"""docs/examples/step.ipynb: its cells run, and the drive rattles first and then comes to rest."""

import ast
import json
import shutil
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from backlash_ros.drivetrain import NOMINAL_DRIVE

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "examples" / "step.ipynb"
CELLS = json.loads(NOTEBOOK.read_text())["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def shown_by(code: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of its last line, which a notebook shows; None if that is no expression."""
    body = ast.parse(code).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), str(NOTEBOOK), "exec"), names)
    return last and eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)


def test_its_cells_run_and_show_what_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    shutil.copytree(ROOT / "config", tmp_path / "config")
    here = tmp_path / "docs" / "examples"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    names: dict[str, Any] = {}
    shown = [each for code in CODE if (each := shown_by(code, names)) is not None]
    plt.close("all")

    assert names["drive"] == NOMINAL_DRIVE
    assert names["found"].angle == pytest.approx(NOMINAL_DRIVE.gear.backlash_angle, rel=0.02)
    swing = {
        name: float(np.ptp(names[name].load_angle[-250:])) / names["found"].angle for name in ("rattling", "quiet")
    }
    assert swing["rattling"] > 0.5
    assert swing["quiet"] < 0.05
    assert names["quiet"].law == "planned"
    assert abs(names["quiet"].error[-1]) < 0.25 * names["found"].angle
    assert [type(each).__name__ for each in shown] == [
        *("Drive", "Run", "Figure", "DriveEstimate", "Run", "Figure", "DataFrame")
    ]
    assert all(isinstance(each, Figure) or each._repr_html_().startswith("<") for each in shown)
    assert (here / "step.png").read_bytes().startswith(b"\x89PNG")
    header = (here / "step.csv").read_text().partition("\n")[0]
    assert header.startswith("time,reference,load,")


def test_it_is_kept_without_outputs() -> None:
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in CELLS if "outputs" in cell)
    assert NOTEBOOK.stat().st_size < 20_000
