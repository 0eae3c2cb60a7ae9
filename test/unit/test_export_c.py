"""`backlash export-c`: the controller in C gives the package's own commands, allocates nothing, refuses bad input."""

import ctypes
import math
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backlash_ros.cli import main
from backlash_ros.control import LAWS
from backlash_ros.control.acting import ActingLaw
from backlash_ros.control.law import LAW_SIGNATURE, ControlLaw
from backlash_ros.drive_file.drive_file import read_axis, read_start, read_surroundings
from backlash_ros.export.c.files import ROWS, Controller, files_of
from backlash_ros.export.c.object_file import TARGETS, object_file
from backlash_ros.export.c.recording import FOLLOW, RESET, record
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.gates.faults import Fault

ROOT = Path(__file__).parents[2]
NOMINAL = ROOT / "config" / "nominal_drive.yaml"
IDENTIFIED = "identified: true\nbacklash_angle: 0.02"
DRIVES = {
    "nominal": IDENTIFIED,
    "current, ends, late, counts": f"""{IDENTIFIED}
command_interface: current
rate: 1000.0
limits: {{position_lower: -0.3, position_upper: 1.2, command: 6.0}}
delay: {{sample: 0.0004, command: 0.0003, sample_jitter: 0.0002, stamp_jitter: 0.0001}}
sensors: {{measured: [theta_m, theta_l], speeds_from_positions: true, motor_counts: 4096.0, load_counts: 16384.0}}
load: {{inertia: 1.0e-3, coulomb_friction: 0.02, gravity_torque: 0.1}}""",
}
ONE_ENCODER = "sensors: {measured: [theta_l, omega_l, current]}"
MATHS = {"cos", "exp", "expm1", "fmod", "hypot", "log", "memcpy", "memmove", "memset", "pow", "sin", "sincos"}
"""What an object file may leave to the C library."""
compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
in_c = pytest.mark.skipif(compiler is None, reason="no C compiler")
HELD, OUT = 0.7, 2.0


def written(folder: Path, parameters: str) -> Path:
    """A parameter file; what it leaves out is the nominal drive's."""
    text = "\n".join(f"    {line}" for line in ("gear: {reduction: 10.0}", *parameters.splitlines()))
    file = folder / "axis.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n{text}\n")
    return file


def controller_of(file: Path, law: str, **given: Any) -> Controller:
    choice = read_start(file)
    settings = choice.settings.with_law(law)
    return Controller(
        choice._replace(settings=settings), read_axis(file).drive, read_surroundings(file), "axis.yaml", **given
    )


def put(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


def run(*words: str | Path, cwd: Path) -> str:
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def build(folder: Path, *words: str) -> None:
    strict = "-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wno-sign-conversion", "-pedantic", "-Werror"
    run(str(compiler), "-O1", *strict, *words, "axis.c", "axis_tick.o", "-lm", cwd=folder)


# Bit for bit


@in_c
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("law", ["two_region", "planned", "dual_loop"])
@pytest.mark.corners(3)
def test_a_recording_is_replayed_bit_for_bit(law: str, drive: str, tmp_path: Path) -> None:
    controller = controller_of(written(tmp_path, DRIVES[drive]), law)
    steps = record(controller.choice, controller.drive, controller.around, 3000).steps
    assert {step.fault for step in steps} >= {Fault.NONE, Fault.MOTOR_JUMP}
    assert {step.event for step in steps} >= {FOLLOW, RESET}
    assert any(np.isnan(step.sample[2]) and step.command for step in steps)
    folder = put(tmp_path / "c", files_of(controller))
    build(folder, "-o", "selftest", "selftest.c")
    assert run(folder / "selftest", cwd=folder) == "3000 steps, bit for bit\n"


@in_c
@pytest.mark.grid
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("law", LAWS)
def test_a_hundred_thousand_steps_of_every_law_are_bit_for_bit(law: str, drive: str, tmp_path: Path) -> None:
    folder = put(tmp_path / "c", files_of(controller_of(written(tmp_path, DRIVES[drive]), law), 100_000))
    build(folder, "-o", "selftest", "selftest.c")
    assert run(folder / "selftest", cwd=folder) == "100000 steps, bit for bit\n"


@in_c
def test_with_one_encoder_it_is_bit_for_bit(tmp_path: Path) -> None:
    folder = put(tmp_path / "c", files_of(controller_of(written(tmp_path, ONE_ENCODER), "cascade"), 1000))
    build(folder, "-o", "selftest", "selftest.c")
    assert run(folder / "selftest", cwd=folder) == "1000 steps, bit for bit\n"


@in_c
def test_the_self_test_sees_one_bit(tmp_path: Path) -> None:
    folder = put(tmp_path / "c", files_of(controller_of(written(tmp_path, IDENTIFIED), "cascade"), 500))
    recording = folder / "axis_recording.h"
    lines = recording.read_text().splitlines()
    at = max(k for k, line in enumerate(lines) if re.fullmatch(r".*\}, -?[\d.]+, 0\},", line))
    start, command, end = re.fullmatch(r"(.*\}, )(\S+)(, 0\},)", lines[at]).groups()  # type: ignore[union-attr]
    lines[at] = f"{start}{math.nextafter(float(command), math.inf)!r}{end}"
    recording.write_text("\n".join(lines) + "\n")
    build(folder, "-o", "selftest", "selftest.c")
    done = subprocess.run([folder / "selftest"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "the package had" in done.stdout


# The object file


@in_c
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.corners(3)
def test_nothing_but_maths_is_missing_from_the_object_file(law: str, tmp_path: Path) -> None:
    files = files_of(controller_of(written(tmp_path, IDENTIFIED), law), 1)
    folder = put(tmp_path / "c", files)
    symbols = [line.split() for line in run("nm", "axis_tick.o", cwd=folder).splitlines()]
    assert {words[-1] for words in symbols if words[-2] == "U"} <= MATHS
    assert {words[-1] for words in symbols if words[-2] == "T"} == {"axis_tick", "axis_slow_tick"}


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.corners(2)
def test_each_target_gets_its_own_code(target: str, law: str, tmp_path: Path) -> None:
    content = files_of(controller_of(written(tmp_path, IDENTIFIED), law, target=target), 1)["axis_tick.o"]
    wide, machine = {"x": (2, 62), "a": (1, 40), "t": (1, 40)}[target[0]]
    if target.startswith("aarch64"):
        wide, machine = 2, 183
    assert content[:5] == b"\x7fELF" + bytes([wide])
    assert int.from_bytes(content[18:20], "little") == machine


def test_the_files_are_the_same_every_time(tmp_path: Path) -> None:
    controller = controller_of(written(tmp_path, IDENTIFIED), "cascade")
    assert files_of(controller, 50) == files_of(controller, 50)


@compiled_as(LAW_SIGNATURE)
def allocating_step(law: Any, state: Any, estimate: Any, path: Any, low: float, high: float) -> float:
    memory = np.zeros(int(estimate[0]) + 3)
    return float(memory[1])


def test_a_law_that_takes_memory_is_refused() -> None:
    law = ActingLaw(ControlLaw(allocating_step, np.zeros(1), np.ones(1)))
    with pytest.raises(ValueError, match=r"needs NRT_.*which no C library has; keep arrays in the law's state"):
        object_file({"tick": law}, next(iter(TARGETS)))


# What is around the tick


class Axis:
    """A controller in C, called from Python."""

    def __init__(self, folder: Path) -> None:
        build(folder, "-shared", "-fPIC", "-o", "axis.so")
        self._code = ctypes.CDLL(str(folder / "axis.so"))
        self._code.axis_step.restype = ctypes.c_double
        size = re.search(r"One axis: (\d+) bytes", (folder / "axis.h").read_text())
        assert size
        self._memory = ctypes.create_string_buffer(int(size[1]))
        self._code.axis_init(self._memory)

    def step(self, motor: float = 0.0, load: float = 0.0, elapsed: float = 0.004) -> float:
        sample = (ctypes.c_double * 5)(motor, 0.0, load, 0.0, 0.0)
        return float(self._code.axis_step(self._memory, sample, ctypes.c_double(elapsed)))

    def refer(self, place: float) -> int:
        return int(self._code.axis_set_reference(self._memory, ctypes.c_double(place)))

    def follow(self, rows: Sequence[Sequence[float]], count: int | None = None) -> int:
        plan = np.array(rows, dtype=np.float64).reshape(-1, 7)
        address = ctypes.c_void_p(plan.ctypes.data)
        return int(
            self._code.axis_follow(self._memory, address, ctypes.c_size_t(len(plan) if count is None else count))
        )

    def row(self, begin: Sequence[float], end: Sequence[float], duration: float) -> list[float]:
        made, three = (ctypes.c_double * 7)(), ctypes.c_double * 3
        self._code.axis_row(three(*begin), three(*end), ctypes.c_double(duration), made)
        return list(made)

    def call(self, name: str, *arguments: Any) -> None:
        getattr(self._code, f"axis_{name}")(self._memory, *arguments)

    @property
    def fault(self) -> int:
        """By the report, 10 numbers before it."""
        report = (ctypes.c_double * 11)()
        self._code.axis_report(self._memory, report)
        return int(ctypes.cast(ctypes.byref(report, 72), ctypes.POINTER(ctypes.c_int))[0])

    def content(self) -> bytes:
        return bytes(self._memory.raw)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if compiler is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("c")
    limits = "limits: {position_lower: -1.0, position_upper: 2.0, step: 1.5}\nfaults: {velocity: 20.0}"
    return put(made / "axis", files_of(controller_of(written(made, f"{IDENTIFIED}\n{limits}"), "planned"), 1))


ACCEPTED, LATCHED, NOT_HOLDING, NO_NUMBER, OUTSIDE, LEAP, TOO_FAST = range(7)
REST = [0.1, 0, 0, 0, 0, 0, 1.0]


@in_c
def test_the_header_says_how_large_an_axis_is(folder: Path) -> None:
    size = re.search(r"One axis: (\d+) bytes", (folder / "axis.h").read_text())
    assert size
    code = f'#include "axis.h"\nchar right[sizeof(struct axis_controller) == {size[1]} ? 1 : -1];\n'
    (folder / "size.c").write_text(code)
    run(str(compiler), "-c", "size.c", cwd=folder)
    if shutil.which("c++"):
        run("c++", "-fsyntax-only", "-Wall", "-Wextra", "-pedantic", "-Werror", "-x", "c++", "size.c", cwd=folder)


@in_c
def test_a_reference_before_the_first_sample_is_refused(folder: Path) -> None:
    axis = Axis(folder)
    assert axis.refer(0.0) == axis.follow([REST]) == NOT_HOLDING


@in_c
@pytest.mark.parametrize(
    ("place", "why"),
    [
        (math.nan, NO_NUMBER),
        (math.inf, NO_NUMBER),
        (-math.inf, NO_NUMBER),
        (2.1, OUTSIDE),
        (-1.1, OUTSIDE),
        (1.6, LEAP),
        (1.4, ACCEPTED),
    ],
)
def test_a_reference_that_is_refused_changes_nothing(place: float, why: int, folder: Path) -> None:
    axis = Axis(folder)
    axis.step()
    before = axis.content()
    assert axis.refer(place) == why
    assert (axis.content() == before) == (why != ACCEPTED)


@in_c
@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ([], NO_NUMBER),
        ([REST] * (ROWS + 1), NO_NUMBER),
        *(([[*REST[:k], bad, *REST[k + 1 :]]], NO_NUMBER) for k in range(7) for bad in (math.nan, math.inf)),
        ([[*REST[:6], 0.0]], NO_NUMBER),
        ([[*REST[:6], -1.0]], NO_NUMBER),
        ([[0, 0, 1.0, 0, 0, 0, 1.5]], OUTSIDE),
        ([[0, 0, -1.0, 0, 0, 0, 1.5]], OUTSIDE),
        ([[0, 0, 3.0, -1.0, 0, 0, 3.0]], OUTSIDE),  # there and back: at its turn
        ([[0, 0, 0, 0, 0, 9e307, 1e9]], OUTSIDE),
        ([[0, 25.0, 0, 0, 0, 0, 0.05]], TOO_FAST),
        ([REST, [1.7, 0, 0, 0, 0, 0, 1.0]], LEAP),
        ([[1.7, 0, 0, 0, 0, 0, 1.0]], LEAP),
        ([REST] * ROWS, ACCEPTED),
    ],
)
def test_a_plan_that_is_refused_changes_nothing(rows: list[list[float]], why: int, folder: Path) -> None:
    axis = Axis(folder)
    axis.step()
    before = axis.content()
    assert axis.follow(rows) == why
    assert (axis.content() == before) == (why != ACCEPTED)


@in_c
def test_a_row_joins_two_states(folder: Path) -> None:
    begin, end, duration = (0.1, -2.0, 3.0), (0.7, 1.5, -4.0), 0.3
    row = Axis(folder).row(begin, end, duration)
    position = np.polynomial.Polynomial(row[:6])
    for order in range(3):
        turned = position.deriv(order) if order else position
        assert turned(0.0) == pytest.approx(begin[order])
        assert turned(duration) == pytest.approx(end[order])
    assert row[6] == duration


@in_c
def test_a_fault_latches_until_it_is_reset(folder: Path) -> None:
    axis = Axis(folder)
    axis.step()
    assert axis.refer(HELD) == ACCEPTED
    assert any(axis.step() for _ in range(20))
    assert [axis.step(500.0) for _ in range(100)][-1] == 0.0
    found = axis.fault
    assert found in {Fault.MOTOR_JUMP, Fault.MOTOR_OVERSPEED, Fault.ENCODERS_DISAGREE}
    axis.call("fail", int(Fault.NO_SAMPLES))
    assert axis.fault == found  # the first one stays
    assert {axis.step() for _ in range(100)} == {0.0}
    assert axis.refer(HELD) == axis.follow([REST]) == LATCHED
    axis.call("reset")
    assert axis.fault == Fault.NONE
    assert axis.step() == 0.0
    assert axis.refer(HELD) == ACCEPTED
    assert any(axis.step() for _ in range(20))


@in_c
@pytest.mark.parametrize("elapsed", [math.nan, 0.0, -1.0, math.inf, 1e9])
@pytest.mark.parametrize("angle", [0.0, math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.corners(6)
def test_wrong_samples_never_give_a_wrong_number(angle: float, elapsed: float, folder: Path) -> None:
    axis = Axis(folder)
    axis.step()
    axis.refer(HELD)
    for k in range(200):
        command = axis.step(angle, angle, elapsed) if k % 7 == 3 else axis.step()
        assert abs(command) <= 24.0
        assert command == 0.0 or axis.fault == Fault.NONE


@in_c
def test_a_loop_that_gets_no_samples_stops_the_motor(folder: Path) -> None:
    axis = Axis(folder)
    axis.step()
    axis.refer(HELD)
    assert any(axis.step() for _ in range(20))
    axis.call("fail", int(Fault.NO_SAMPLES))
    assert (axis.step(), axis.fault) == (0.0, Fault.NO_SAMPLES)


# The command


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["export-c", *map(str, arguments)])
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    return printed.err


@pytest.mark.parametrize(
    ("parameters", "law", "reason"),
    [
        ("load: {inertia: 0.0}", "cascade", "load.inertia must be >= 1e-09 kg m^2"),
        (
            "rate: 250.0",
            "planned",
            "law = 'planned' acts once the backlash is learned and the drive is identified",
        ),
        ("backlash_angle: 0.02", "dual_loop", "law = 'dual_loop' acts once the drive is identified, which"),
        ("profile: {mode: auto}", "cascade", "profile.mode must be 'step': in C a reference is a step, got 'auto'"),
        (f"{IDENTIFIED}\n{ONE_ENCODER}", "planned", "law = 'planned' needs both encoders"),
        ("load: [", "cascade", "line"),
    ],
)
def test_what_lacks_something_is_refused(
    parameters: str, law: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert reason in refusal(capsys, written(tmp_path, parameters), "--law", law, "--out", out)
    assert not out.exists()


def test_options_that_cannot_be_used_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert str(tmp_path / "no.yaml") in refusal(capsys, tmp_path / "no.yaml", "--out", out)
    assert "--law" in refusal(capsys, NOMINAL, "--law", "best", "--out", out)
    assert "--target" in refusal(capsys, NOMINAL, "--target", "vax", "--out", out)
    assert "name must begin with a small letter" in refusal(capsys, NOMINAL, "--name", "1axis", "--out", out)
    assert "got 'example'" in refusal(capsys, NOMINAL, "--name", "example", "--out", out)
    assert "--out" in refusal(capsys, NOMINAL)
    assert not out.exists()
    mine = put(out, {"mine": b"mine"}) / "mine"
    assert f"must be a new or an empty folder, got '{out}'" in refusal(capsys, NOMINAL, "--out", out)
    assert "must be writable" in refusal(capsys, NOMINAL, "--out", mine)
    assert mine.read_bytes() == b"mine"
    assert [each.name for each in out.iterdir()] == ["mine"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert "must be writable" in refusal(capsys, NOMINAL, "--out", tmp_path / "out")


@in_c
def test_the_commands_of_the_readme_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a stranger goes, in the folder and with a name of its own."""
    out = tmp_path / "out"
    out.mkdir()
    assert main(["export-c", str(NOMINAL), "--name", "elbow", "--out", str(out)]) == 0
    assert "law two_region at 250 Hz" in capsys.readouterr().out
    text = (out / "README.md").read_text()
    (block,) = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    said = run("sh", "-ec", block, cwd=out)
    assert "3000 steps, bit for bit\n" in said
    assert re.search(r"fault 0; a step took .* us \(median\)", said)
    named = set(re.findall(r"`(\w+\.[cho])`", text))
    assert named | {"README.md"} == {each.name for each in out.iterdir() if each.suffix}
    (loop,) = re.findall(r"```c\n(.*?)```", text, re.DOTALL)
    assert set(re.findall(r"elbow_\w+(?=\()", text)) <= set(
        re.findall(r"elbow_\w+(?=\()", (out / "elbow.h").read_text())
    )
    # The loop of the README, in a program of one's own.
    include, _, body = loop.partition("\n")
    read = "".join(f"double read_{name};\n" for name in re.findall(r"read_(\w+)", body))
    code = f"{include}\n#include <math.h>\nvoid send(double);\ndouble elapsed;\n{read}"
    declared, _, statements = body.strip().partition("\n")
    (out / "mine.c").write_text(f"{code}{declared}\nvoid loop(void)\n{{{statements}\n}}\n")
    run(str(compiler), "-Wall", "-Werror", "-c", "mine.c", cwd=out)


@in_c
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.corners(1)
def test_the_example_brings_the_load_there_and_back(law: str, drive: str, tmp_path: Path) -> None:
    parameters = DRIVES[drive].replace("gravity_torque: 0.1", "gravity_torque: 0.0")
    folder = put(tmp_path / "c", files_of(controller_of(written(tmp_path, parameters), law), 1))
    build(folder, "-o", "example", "example.c")
    assert "fault 0" in run(folder / "example", cwd=folder)
