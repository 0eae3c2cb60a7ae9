"""One list of dependencies in three places: package.xml for rosdep, setup.py for pip, requirements/ for the locks."""

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
ROSDEP_KEYS = {
    "control": "python-control-pip",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "hypothesis": "python3-hypothesis",
    "pytest": "python3-pytest",
    "pytest-timeout": "python3-pytest-timeout",
    "pyyaml": "python3-yaml",
}
"""PyPI name to rosdep key."""
EXTRAS = {"distributed", "nicegui", "pandas", "pyarrow"}
"""What pip installs only where it is asked for: rosdep has no keys for them."""


def package_keys() -> set[str]:
    tree = ElementTree.parse(ROOT / "package.xml")
    return {element.text or "" for kind in ("exec_depend", "test_depend") for element in tree.iter(kind)}


def setup_requirements() -> dict[str, str]:
    text = (ROOT / "setup.py").read_text()
    return dict(re.findall(r'"([a-z0-9-]+)(?:\[\w+\])?>=([\d.]+)', text))


def listed(name: str) -> set[str]:
    lines = (ROOT / "requirements" / name).read_text().splitlines()
    return {re.split(r"[\[<>=; ]", line)[0] for line in lines if re.match(r"[a-z]", line)}


def test_what_pip_installs_rosdep_installs_too() -> None:
    for name in setup_requirements().keys() - EXTRAS:
        key = name.removeprefix("ros-").replace("-", "_") if name.startswith("ros-") else ROSDEP_KEYS[name]
        assert key in package_keys(), name


def test_every_requirement_is_locked_with_hashes() -> None:
    for source, lock in (("python.in", "python.txt"), ("ros.in", "ros.txt"), ("floors.in", "floors.txt")):
        assert listed(source) <= listed(lock)
        text = (ROOT / "requirements" / lock).read_text()
        assert text.count("==") <= text.count("--hash=sha256:")
    pip = {name for name in setup_requirements() if not name.startswith("ros-")}
    assert pip <= listed("python.in")
    assert set(setup_requirements()) - pip <= listed("ros.in")


def test_floors_are_what_setup_asks_for() -> None:
    floors = dict(
        re.findall(r"^([a-z0-9-]+)==([\d.]+)$", (ROOT / "requirements" / "floors.in").read_text(), re.MULTILINE)
    )
    for name, version in setup_requirements().items():
        if not name.startswith("ros-"):
            assert floors[name].startswith(version), name


def test_designing_gains_loads_nothing_that_plots() -> None:
    """A controller that starts would wait for it, seconds on a small computer."""
    code = (
        "import sys; from backlash_ros.control import design_gains, stability_margins\n"
        "from backlash_ros.drivetrain import NOMINAL_DRIVE\n"
        "stability_margins(NOMINAL_DRIVE, design_gains('q', NOMINAL_DRIVE, [4.0, 0.0]), 0.004)\n"
        "print({'matplotlib', 'scipy.signal', 'control'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
