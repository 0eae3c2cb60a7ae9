"""Run tests again and again, several runs at once, which is what loads the machine; all must be green.

Usage: python test/support/repeat.py --times 20 --at-once 4 test/nodes/test_faults.py
"""

import argparse
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def run(number: int, tests: list[str], folder: Path) -> bool:
    log = folder / f"run{number}.log"
    began = time.monotonic()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests]
    with log.open("wb") as output:
        code = subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=False).returncode
    lines = log.read_text().splitlines()
    print(f"run {number}: {lines[-1] if lines else 'no output'} ({time.monotonic() - began:.0f} s)", flush=True)
    if code:
        print("\n".join(line for line in lines if line.startswith(("FAILED", "ERROR", "E  "))), flush=True)
        print(f"log: {log}", flush=True)
    return code == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--at-once", type=int, default=4)
    parser.add_argument("tests", nargs="+")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="repeat."))
    with ThreadPoolExecutor(options.at_once) as pool:
        green = list(pool.map(lambda number: run(number, options.tests, folder), range(1, options.times + 1)))
    print(f"{sum(green)} of {len(green)} runs green, {options.at_once} at once")
    return 0 if all(green) else 1


if __name__ == "__main__":
    raise SystemExit(main())
