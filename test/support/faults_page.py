"""The fault table, made from the names of the tests that inject the faults and from the times that they measured.

A test is named ``test_<fault>__<what the motor does>__<how to recover>``; each of its cases is a row.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from backlash_ros.gates import FAULTS

SECTION = "## One wrong sample, or ten"
"""Heading of what `bad_samples` writes behind the table."""

HEAD = """# Faults

Each row is a test that injects a fault into live processes over DDS and observes the result; `make faults` runs the
tests and writes this page. The time is from the fault to the motor at 0 V (or to a command of 0 V, if the drive is what
failed), with both watchdogs at 1 s (`command_timeout`, `state_timeout`; their default is 0.1 s). If the test acts as
the drive, the time is the drive's own. "Reset" is the service `~/reset_fault` of the node. Until then, or until the
node is configured again, the fault is latched, its reason is in `/diagnostics`, and the motor stays at 0 V. After a
reset the controller holds the load at its present position.

With Fast DDS' shared memory a node may be held up by others. A subscriber that is stopped (Ctrl-Z, a debugger) while it
holds the lock of its queue makes each `publish()` to it wait 1 s. This happened in 45 of 389 stops, and in none of 1442
with messages over UDP (`taskset -c 0,1 python benchmarks/stopped_listener.py`). A new subscriber, such as any `ros2`
command, makes the participant that first writes to it check whether it is alive. This takes up to 1 s, most often
1/3 s, in which the participant's other threads cannot write either; the watchdogs are shorter. So the nodes use only
UDP, unless the variable `FASTDDS_BUILTIN_TRANSPORTS` or a profile says otherwise.

With `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` (or `ROS_LOCALHOST_ONLY`) rmw_fastrtps uses shared memory in spite of
these settings. The nodes then use the profile `loopback_udp.xml`, UDP on this machine only, and other nodes with
LOCALHOST find them. `ROS_STATIC_PEERS`, `ROS_DISCOVERY_SERVER`, or your own profile or transport take precedence. Your
own drives can use the profile too: it is installed beside the configuration and explains itself. Tests, demo and
benchmarks use it.

Fast DDS 2.14 may deadlock when a participant leaves while others join or leave: it waits for a callback that waits for
it. A node of this package has stopped its motor before that; after 10 s its process ends itself, with code 1 and a
traceback. A `ros2 topic pub --once` does not end: it hangs until it is killed.

| fault | the motor, or who acts | within | recovery |
|---|---|---|---|
"""


def in_words(text: str) -> str:
    words = text.replace("_", " ")
    for abbreviation in ("0 v",):
        words = re.sub(rf"\b{abbreviation}\b", abbreviation.upper(), words)
    return words


def parts_of(test: str) -> tuple[str, str, str] | None:
    """Return fault, motor and recovery in words, with the case; None for a test that is not of the table."""
    name, _, case = test.partition("[")
    parts = name.removeprefix("test_").split("__")
    if len(parts) != 3:
        return None
    fault, motor, recovery = (in_words(part) for part in parts)
    return (f"{fault}: {case[:-1]}" if case else fault), motor, recovery


def in_time(seconds: Sequence[float]) -> str:
    if not seconds:
        return ""
    longest = max(seconds)
    return "the same period" if longest == 0 else f"{1e3 * longest:.0f} ms"


def page(measured: Mapping[str, Sequence[float]]) -> str:
    """Return the page for tests by name, each with the times that it measured, s."""
    rows = [(parts_of(test), times) for test, times in measured.items()]
    lines = [f"| {p[0]} | {p[1]} | {in_time(times)} | {p[2]} |" for p, times in rows if p is not None]
    return HEAD + "\n".join(lines) + f"\n\n{meanings()}"


MEANINGS = "## What latches, and what to do about it"


def meanings() -> str:
    """Return the section that says what each fault means: names as in diagnostics, ~/state (its number) and answers."""
    rows = [f"| `{f.name}` | {f.value} | {said.meaning} | {said.remedy} |" for f, said in FAULTS.items()]
    return f"""{MEANINGS}

The name is beside the text in `/diagnostics` (`fault_name`) and in the answer of `~/reset_fault`, the number in
`~/state`.

| name | number | meaning | what to do |
|---|---|---|---|
{chr(10).join(rows)}

### When the load leaves its reference

`TRACKING` watches the result instead of a cause. Let e be the distance between setpoint and load. Within any second e
may grow by the sum of

- the way that the setpoint itself went in that second,
- the way on which a load that moves can stop: w_l^2/(2 a), with a tenth of the acceleration at standstill for a,
- what a load torque explains: the unexplained torque times the speed that 1 N m gives the motor, times its mechanical
  time constant plus 25 ms (0.36 rad per N m for the nominal drive). With the load's encoder alone, where no load torque
  is estimated, it is the error that the smaller k1 leaves, if that is more,
- `faults.tracking`: by default the way at 1.5 times the no-load speed in the mechanical time constant and 25 ms (3.24
  rad for the nominal drive). Healthy loops at their limits go as far: steps of 10 rad at 100 Hz need 1.5 rad
  (`elastic_lqg`) and 0.7 rad (`planned`), a load torque of 3.3 N m at full speed 2 rad. At least 0.05 rad and twice
  `gear.backlash_angle`, and never less than twice the learned gap.

More latches the fault, so law, gains, plans or estimates that are wrong cannot take the load further. A drift of less
than `faults.tracking` a second is not seen, nor is anything while an experiment moves the load: experiments have bounds
of their own. **Set `faults.tracking` to what your axis bears**: where nothing knocks on the load, 0.05 rad or twice the
gap is enough. With that bound no law faulted in the steps and changes of load torque of 12 drives of `core`.
"""


def fault_tests_of(folder: Path) -> set[str]:
    """Return the names, without cases, of the tests in a folder that belong in the table."""
    names = re.findall(
        r"^def (test_\w+)\(", "\n".join(path.read_text() for path in folder.glob("test_*.py")), re.MULTILINE
    )
    return {name for name in names if parts_of(name)}
