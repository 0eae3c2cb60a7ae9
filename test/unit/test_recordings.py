"""Reading recordings of others: units, clocks, what is missing, and a reason for each file that cannot be used."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded import stepped, without, write_bag, write_csv

from backlash_ros.identification.recording import Recording
from backlash_ros.recordings.bag_topics import Topics, read_topics
from backlash_ros.recordings.csv_file import ColumnNames, read_csv
from backlash_ros.recordings.encoder import Encoder
from backlash_ros.recordings.samples import Reading, drive_for, recording_of
from backlash_ros.studies.evaluation.population import Member

NUMBER = 3
TURN = 2.0 * math.pi


def sample() -> tuple[Member, Recording]:
    member, recording = stepped(NUMBER, "core", length=1.0)
    return member, recording


def read(path: Path, reading: Reading | None = None, names: ColumnNames | None = None) -> tuple[Recording, list[str]]:
    return recording_of(read_csv(path, names or ColumnNames()), reading or Reading(), sample()[0].drive)


def read_bag(path: Path, topics: Topics | None = None, reading: Reading | None = None) -> tuple[Recording, list[str]]:
    return recording_of(read_topics(path, topics or Topics()), reading or Reading(), sample()[0].drive)


def assert_same(found: Recording, wanted: Recording, *, shifted: bool = False) -> None:
    """Assert that two recordings are one; angles that began again after a turn may be off by whole turns."""
    assert found.time - found.time[0] == pytest.approx(wanted.time - wanted.time[0], abs=1e-8)
    ratio = sample()[0].drive.gear.ratio
    for a, b, turn in ((found.motor, wanted.motor, TURN * ratio), (found.load, wanted.load, TURN)):
        off = np.median(a - b)
        assert a - off == pytest.approx(b, abs=1e-9)
        assert off == pytest.approx(turn * round(off / turn) if shifted else 0.0, abs=2e-6)
    assert found.command == pytest.approx(wanted.command, nan_ok=True)


@pytest.mark.corners(4)
@pytest.mark.parametrize("motor", ["rad", "deg", "turns", "counts"])
@pytest.mark.parametrize("load", ["rad", "deg", "turns", "counts"])
def test_every_unit_of_an_angle_is_read(motor: str, load: str, tmp_path: Path) -> None:
    member, recording = sample()
    path = write_csv(tmp_path / "a.csv", member, recording, motor=motor, load=load)
    sensors = member.sensors
    reading = Reading(motor=Encoder(motor, sensors.motor_counts), load=Encoder(load, sensors.load_counts))
    assert_same(read(path, reading)[0], recording)


@pytest.mark.parametrize("unit", ["rad", "deg", "turns", "counts"])
def test_angles_that_begin_again_after_a_turn_are_continued(unit: str, tmp_path: Path) -> None:
    member, recording = stepped(NUMBER, "core", step=3.0, length=2.0)
    path = write_csv(tmp_path / "a.csv", member, recording, motor=unit, load=unit, wrapped=True)
    sensors = member.sensors
    reading = Reading(motor=Encoder(unit, sensors.motor_counts), load=Encoder(unit, sensors.load_counts))
    found, notes = read(path, reading)
    assert_same(found, recording, shifted=True)
    assert any("begins again after" in note and "column 'motor'" in note for note in notes)


def test_a_counter_of_16_bits_is_continued_where_it_is_told() -> None:
    time = 1e-3 * np.arange(2000)
    counts = np.round(60000 + 2e5 * time * (1.0 + 0.2 * np.sin(9.0 * time)))
    encoder = Encoder("counts", 1000.0, wraps=65536.0)
    angle, note = encoder.radians(time, np.mod(counts, 65536), "column 'motor'", str)
    assert angle - angle[0] == pytest.approx(TURN * (counts - counts[0]) / 1000.0)
    assert "65536" in note


def test_a_shaft_that_turns_too_fast_to_be_continued_is_refused() -> None:
    time = 1e-3 * np.arange(200)
    angle = np.mod(np.where(time < 0.1, 0.0, 0.5 * TURN * (time - 0.1) / 1e-3), TURN)
    angle[:10] = np.linspace(5.0, 0.0, 10)
    with pytest.raises(ValueError, match=r"column 'load' goes from 0 to 3.14159 in row 1\d\d"):
        Encoder(wraps=TURN).radians(time, angle, "column 'load'", lambda k: f"in row {k}")


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_every_unit_of_time_is_read(unit: str, scale: float, tmp_path: Path) -> None:
    member, recording = sample()

    def edit(rows: list[list[str]]) -> None:
        for row in rows:
            row[0] = repr(float(row[0]) * scale)

    path = write_csv(tmp_path / "a.csv", member, recording, edit=edit)
    assert_same(read(path, Reading(time_unit=unit))[0], recording)


def test_columns_are_found_by_name_in_any_order_with_any_separator(tmp_path: Path) -> None:
    member, recording = sample()
    path = write_csv(tmp_path / "a.tsv", member, recording, header="t\tm (rad)\tl\tu")
    text = path.read_text()
    path.write_text("\ufeff# a remark\n\n" + text)
    assert_same(read(path, names=ColumnNames("t", "m (rad)", "l", "u"))[0], recording)


def test_a_duty_cycle_times_the_supply_is_the_voltage(tmp_path: Path) -> None:
    member, recording = sample()
    half = recording._replace(command=recording.command / 48.0)
    path = write_csv(tmp_path / "a.csv", member, half)
    found, _ = read(path, Reading(command_unit="duty", supply=48.0))
    assert found.command == pytest.approx(recording.command)
    with pytest.raises(ValueError, match=r"'command' must be a duty cycle from -1 to 1, got \d"):
        read(write_csv(tmp_path / "b.csv", member, recording), Reading(command_unit="duty", supply=48.0))
    with pytest.raises(ValueError, match="supply must be > 0 V"):
        Reading(command_unit="duty")


def test_a_current_makes_the_drive_take_currents() -> None:
    drive = sample()[0].drive
    assert drive_for(drive, Reading(command_unit="A")).command_interface == "current"
    assert drive_for(drive, Reading()).command_interface == drive.command_interface


def test_the_command_that_acted_is_the_answer_before(tmp_path: Path) -> None:
    member, recording = sample()
    acting = recording._replace(command=np.append(0.0, recording.command[:-1]))
    found, _ = read(write_csv(tmp_path / "a.csv", member, acting), Reading(answer=False))
    assert found.command[:-1] == pytest.approx(recording.command[:-1])
    assert found.command[-1] == found.command[-2]
    assert found.doubt[-1] > 0.0
    assert not np.any(found.doubt[:-1])


def test_a_lost_sample_leaves_a_row_of_nothing(tmp_path: Path) -> None:
    member, recording = sample()
    fewer = without(recording, 0.03)
    found, notes = read(write_csv(tmp_path / "a.csv", member, fewer))
    lost = recording.time.size - fewer.time.size
    assert lost > 3
    assert np.sum(np.isnan(found.motor)) == lost
    assert np.any(found.doubt[np.isnan(found.motor)] > 0.0)
    assert not np.any(found.doubt[np.isfinite(found.motor)])
    assert found.time == pytest.approx(recording.time)
    assert f"{lost} of {recording.time.size} samples are missing: what was commanded then is guessed" in notes


def test_uneven_samples_stay_as_they_are(tmp_path: Path) -> None:
    member, recording = stepped(NUMBER, "core", length=1.0, uneven=True)
    found, notes = read(write_csv(tmp_path / "a.csv", member, recording))
    assert_same(found, recording)
    assert notes == []


def test_a_part_is_used_where_it_is_told(tmp_path: Path) -> None:
    member, recording = sample()
    found, _ = read(write_csv(tmp_path / "a.csv", member, recording, offset=1e6), Reading(start=0.1995, end=0.5005))
    assert found.time[0] == pytest.approx(0.2, abs=1e-6)
    assert found.time[-1] == pytest.approx(0.5, abs=1e-6)


def cell(row: int, column: int, text: str) -> Callable[[list[list[str]]], None]:
    def edit(rows: list[list[str]]) -> None:
        rows[row][column] = text

    return edit


def repeat(rows: list[list[str]]) -> None:
    rows[100][:1] = rows[99][:1]


def go_back(rows: list[list[str]]) -> None:
    rows[100:] = [list(row) for row in rows[: len(rows) - 100]]


def empty(column: int) -> Callable[[list[list[str]]], None]:
    def edit(rows: list[list[str]]) -> None:
        for row in rows[50:400]:
            row[column] = "nan"

    return edit


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (cell(10, 1, "12,5"), r"row 12: must have 4 cells as the header, has 5"),
        (cell(10, 1, "abc"), r"a.csv, row 12: column 'motor' must be a number, got 'abc'"),
        (cell(10, 0, ""), r"column 'time' must have a number in each row, and has none in row 12"),
        (go_back, r"column 'time' must not go back, and goes from 0.099000 to 0.000000 s in row 102"),
        (repeat, r"column 'time' has 0.099000 s twice in row 102, where column 'motor' has"),
        (empty(2), r"column 'load' has no number in 350 of 1000 rows, first in row 52, and may lack 20 %"),
        (lambda rows: rows.clear(), r"two samples at least, got 0"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_with_its_row(
    edit: Callable[[list[list[str]]], None], reason: str, tmp_path: Path
) -> None:
    member, recording = sample()

    def moving(rows: list[list[str]]) -> None:
        for k, row in enumerate(rows):
            row[1] = repr(0.001 * k)
        edit(rows)

    with pytest.raises(ValueError, match=reason):
        read(write_csv(tmp_path / "a.csv", member, recording, edit=moving))


def test_readings_without_a_number_are_left_out(tmp_path: Path) -> None:
    member, recording = sample()
    found, notes = read(write_csv(tmp_path / "a.csv", member, recording, edit=cell(10, 2, "NaN")))
    assert math.isnan(found.load[10])
    assert np.sum(np.isnan(found.load)) == 1
    assert "column 'load' has no number in 1 of 1000 rows: these are not used" in notes


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "there is nothing in it"),
        ("0.0,1,2,3\n0.1,1,2,3\n", r"row 1: must be a header"),
        ("time,motor,command\n", r"must have one column 'load', has 0; columns: \['time', 'motor', 'command'\]"),
        ("time,motor,load,load,command\n", r"must have one column 'load', has 2"),
        (
            "time,motor,load,command\n" + "".join(f"{4 * k},{k},{k},{k}\n" for k in range(200)),
            r"column 'time' steps by 4 s \(median\), and must by 2e-05 to 0.05 s: check the unit of the time",
        ),
    ],
)
def test_what_is_no_table_of_samples_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=reason):
        read(tmp_path / "a.csv")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("labels", [True, False])
def test_a_bag_is_read(storage: str, tmp_path: Path, *, labels: bool) -> None:
    member, recording = sample()
    path = write_bag(tmp_path / "bag", member, recording, storage=storage, labels=labels)
    assert_same(read_bag(path)[0], recording)
    single = next(file for file in path.iterdir() if file.suffix in {".mcap", ".db3"})
    assert_same(read_bag(single)[0], recording)


def test_an_answer_to_a_sample_that_is_not_there_is_kept(tmp_path: Path) -> None:
    member, recording = sample()
    path = write_bag(tmp_path / "bag", member, recording, unseen=frozenset({100, 101, 300}))
    found, _ = read_bag(path)
    assert found.time == pytest.approx(recording.time, abs=1e-8)
    assert np.flatnonzero(np.isnan(found.motor)).tolist() == [100, 101, 300]
    assert found.command == pytest.approx(recording.command)


def test_commands_from_before_the_first_sample_are_no_second_controller_s(tmp_path: Path) -> None:
    """A recorder may hear one topic long before the other; twice the commands while samples come are refused."""
    member, recording = sample()
    count = recording.time.size
    path = write_bag(tmp_path / "early", member, recording, unseen=frozenset(range(count // 3)))
    found, _ = read_bag(path)
    assert found.time.size == count - count // 3
    assert found.command == pytest.approx(recording.command[count // 3 :])
    twice = write_bag(tmp_path / "twice", member, recording, unseen=frozenset(range(0, count, 2)))
    with pytest.raises(ValueError, match=r"commands for \d+ samples on '/joint_states', and may have 1.2 for each"):
        read_bag(twice)


def test_other_names_are_told(tmp_path: Path) -> None:
    member, recording = sample()
    path = write_bag(
        tmp_path / "bag",
        member,
        recording,
        labels=False,
        joints=("m1", "axis"),
        topics=("/robot/states", "/robot/effort"),
        command_type="std_msgs/msg/Float64",
    )
    with pytest.raises(ValueError, match=r"'/robot/states' has no joint 'motor'; it has \['axis', 'm1', 'other'\]"):
        read_bag(path, Topics(command="/robot/effort"))
    with pytest.raises(ValueError, match=r"there is no joint states on '/a'; there is on \['/robot/states'\]"):
        read_bag(path, Topics(command="/robot/effort", joint_states="a"))
    with pytest.raises(ValueError, match=r"'/robot/effort' must have a number data\[1\]"):
        read_bag(path, Topics(command="/robot/effort", motor_joint="m1", load_joint="axis", index=1))
    found, _ = read_bag(path, Topics(command="/robot/effort", motor_joint="m1", load_joint="axis"))
    assert_same(found, recording)


def test_the_recorder_s_clock_is_taken_where_it_is_asked_for(tmp_path: Path) -> None:
    member, recording = sample()
    path = write_bag(tmp_path / "bag", member, recording)
    assert_same(read_bag(path, Topics(stamps="log"))[0], recording)


@pytest.mark.parametrize("name", ["bag", "bag.mcap", "bag.db3"])
def test_what_is_no_bag_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if path.suffix:
        path.write_bytes(b"\x00" * 500)
    else:
        path.mkdir()
    with pytest.raises(ValueError, match=r"is no rosbag2 that can be read"):
        read_bag(path)
