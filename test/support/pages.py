"""README and docs as a reader has them: the pages, their commands, and which test runs each command."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
RUN_BY = {
    r"make (test|lint)": ".ci/run",
    r"make demo": "test/system/test_demo.py",
    r"make live": "test/nodes/test_page.py",
    r"rosdep |pip install ": "test/unit/test_dependencies.py",
    r"colcon |\. install": "test/system/test_install.py",
    r"python benchmarks/": "Makefile",
    r"python docs/examples/learn_and_step": "test/nodes/test_start.py",
    r"python docs/examples/(why_not_pid|following)": "test/unit/test_simulate.py",
    r"dask |backlash .*--scheduler": "test/unit/test_evaluation.py",
    r"backlash identify results/step.csv": "test/unit/test_simulate.py",
    r"backlash identify|backlash .*results/axis": "test/unit/test_identify_command.py",
    r"backlash figures planned": "test/unit/test_law_pictures.py",
    r"backlash lost-motion": "test/unit/test_lost_motion_command.py",
    r"backlash setup": "test/unit/test_setup.py",
    r"backlash measure": "test/nodes/test_measure.py",
    r"backlash report their_bag": "test/unit/test_report.py",
    r"backlash replay": "test/system/test_demo.py",
    r"backlash (report|simulate)|(plant_simulator|controller|recorder)\b|\. \.venv/": "test/system/test_readme.py",
    r"backlash export-c my_drive|cd my_axis|cc -O2": "test/unit/test_export_c.py",
    r"(ros2 run backlash_ros )?backlash ": "test/unit/test_pages.py",
    r"pytest --pyargs": "test/system/test_contract.py",
    r"ros2 run controller_manager": "test/nodes/test_ros2_control.py",
    r"ros2 run backlash_ros": "test/nodes/test_commands.py",
    r"ros2 param load \S+ gains.yaml": "test/nodes/test_config.py",
    r"ros2 ": "test/system/test_readme.py",
}
"""How a command begins, and what runs it, or does the same where it needs what tests lack. The first match counts."""
DESIGNED = "/**: {ros__parameters: {law: two_region, gains: {overdamped: {k: [4.0, 0.4, 0.1]}}}}"
"""A file in the place of that of `backlash design`, which takes long to make."""


def commands_of(page: Path) -> list[str]:
    """Return the commands of a page in their order: those of fenced blocks, then those of indented ones."""
    text = page.read_text().replace("\\\n", " ")
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines() if line]
    lines += re.findall(r"^    ((?:ros2 run|backlash [a-z]+) .*)$", text, re.MULTILINE)
    return [re.sub(" +", " ", line.partition("   #")[0]).strip() for line in lines]


def commands(by: str = "") -> list[str]:
    """Return the commands of all pages, or those that the test file ``by`` runs."""
    found = dict.fromkeys(command for page in PAGES for command in commands_of(page))
    return [command for command in found if not by or runner(command).endswith(f"/{by}")]


def runner(command: str) -> str:
    """Return what runs a command; empty where nothing does."""
    return next((test for begin, test in RUN_BY.items() if re.match(begin, command)), "")
