"""python-control designs, and is loaded when something is designed: it takes more than a second."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOADED = "import sys; print('control' in sys.modules)"


def loaded_by(code: str) -> bool:
    """Whether ``code`` loads python-control in a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{LOADED}"], cwd=ROOT, capture_output=True, text=True, timeout=600, check=True
    )
    return done.stdout.strip() == "True"


def test_importing_the_package_does_not_load_python_control() -> None:
    assert not loaded_by("import backlash_ros.control, backlash_ros.simulation")


def test_designing_loads_python_control() -> None:
    code = "from backlash_ros.control import design_gains; from backlash_ros.drivetrain import NOMINAL_DRIVE\n"
    assert loaded_by(code + "design_gains('q', NOMINAL_DRIVE, [4.0, 0.0])")
