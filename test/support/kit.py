"""The drive contract kit, run as a user runs it, and what it says of a drive."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

CHECKS = 31


class Verdict(NamedTuple):
    passed: set[str]
    failed: dict[str, str]
    output: str


def kit(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the kit as a user does, from a folder of no importance; -p, as the entry point may not be installed."""
    words = ["-p", "backlash_ros.contract.plugin", "--pyargs", "backlash_ros.contract", *arguments]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *words],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},  # other plugins take as long to load as a few moves
        capture_output=True,
        text=True,
        timeout=800,
        check=False,
    )


def judge(folder: Path, command: str, *arguments: str) -> Verdict:
    done = kit(folder, "--junitxml=result.xml", "--drive-command", command, *arguments)
    failed, passed = {}, set()
    for case in ElementTree.parse(folder / "result.xml").iter("testcase"):
        name = case.get("name", "")
        faults = [fault.get("message", "") for kind in ("failure", "error") for fault in case.iter(kind)]
        if faults:
            failed[name] = faults[0]
        elif case.find("skipped") is None:
            passed.add(name)
    return Verdict(passed, failed, done.stdout + done.stderr)
