"""Tables as loggers and spreadsheets write them are read, and what cannot be is named with its row and a remedy."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.recordings.csv_file import ColumnNames, is_table, read_csv
from backlash_ros.recordings.samples import Columns, Reading, began, recording_of

PLAIN = "time,motor,load,command\n0.000,1.5,-2.25,0.5\n0.004,1.75,-2.5,-0.125\n0.008,2.0,-2.75,1e-3\n"
GERMAN = PLAIN.replace(",", ";").replace(".", ",")
DAY = "2026-01-31T23:59:59"


def table(folder: Path, text: str | bytes, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def read(path: Path) -> Columns:
    return read_csv(path, ColumnNames())


def content(path: Path) -> np.ndarray:
    columns = read(path)
    return np.array([columns.time, columns.motor, columns.load, columns.command])


@pytest.mark.parametrize(
    "text",
    [
        GERMAN,
        GERMAN.replace(";", "\t"),
        PLAIN.replace(",", ";"),
        "\ufeff" + GERMAN.replace("\n", "\r\n"),
        GERMAN.encode("utf-16"),
        PLAIN.replace("time,motor,load,command", '"time", "motor", "load", "command"'),
        "Device: X200\nDate,2026-01-31\n\n" + PLAIN,
        "Abtastrate;250\n# Kommentar\n\n" + GERMAN,
        "# " + PLAIN,  # as numpy writes it
        PLAIN.replace("command\n", "command\ns,rad,rad,V\n"),
        PLAIN.replace("\n", ",\n").replace("command,", "command"),
        PLAIN + "\n# end\n\n",
        gzip.compress(GERMAN.encode(), mtime=0),
    ],
    ids=lambda text: repr(text)[:40],
)
@pytest.mark.parametrize("name", ["a.csv", "a.log", "a.csv.gz", "a"])
def test_a_table_is_read_whatever_wrote_it(text: str | bytes, name: str, tmp_path: Path) -> None:
    path = table(tmp_path, text, name)
    assert is_table(path)
    assert content(path).tolist() == content(table(tmp_path, PLAIN, "plain.csv")).tolist()


def test_the_example_of_the_docs_is_the_same_from_a_spreadsheet_with_decimal_commas(tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "docs" / "examples" / "axis.csv"
    head, _, rows = example.read_text().partition("\n")
    text = "Zeit [s];Motor [ink];Abtrieb [°];Spannung [V]\n" + rows.replace(",", ";").replace(".", ",")
    spoken = table(tmp_path, ("\ufeff" + text).replace("\n", "\r\n"))
    german = read_csv(spoken, ColumnNames("Zeit [s]", "Motor [ink]", "Abtrieb [°]", "Spannung [V]"))
    english = read_csv(example, ColumnNames(*head.split(",")))
    for name in ("time", "motor", "load", "command"):
        assert np.array_equal(getattr(german, name), getattr(english, name)), name


def test_decimal_commas_and_lines_before_the_header_are_said(tmp_path: Path) -> None:
    notes = read(table(tmp_path, "Abtastrate;250\n" + GERMAN.replace("command\n", "command\ns;rad;rad;V\n"))).notes
    assert notes == (
        "1 line before the header, in row 2, was passed over",
        "row 3, which has no number, was taken for units",
        "its numbers have decimal commas",
    )


@pytest.mark.parametrize(
    ("times", "start"),
    [
        ([f"{DAY}.{ms}Z" for ms in ("990", "992", "994")], 1769903999.99),
        ([f"{DAY}.{ms}123456+01:00" for ms in ("990", "992", "994")], 1769900399.990123456),
        ([f"{DAY.replace('T', ' ')},{ms}" for ms in ("990", "992", "994")], 1769903999.99),
        (["2026-01-31T23:59:59.998", "2026-02-01T00:00:00", "2026-02-01T00:00:00.002"], 1769903999.998),
        (["08:15:59.998", "08:16:00", "08:16:00.002"], None),
    ],
)
def test_times_may_be_dates(times: list[str], start: float | None, tmp_path: Path) -> None:
    text = "time;motor;load;command\n" + "".join(f"{time};0.1;0.2;0.3\n" for time in times)
    columns = read(table(tmp_path, text))
    recording, notes = recording_of(columns, Reading(), NOMINAL_DRIVE)
    assert recording.time - recording.time[0] == pytest.approx([0.0, 0.002, 0.004], abs=1e-9)
    assert "dates or times of day" in notes[0]
    moment = began(columns, Reading())
    assert (moment.timestamp() if moment else None) == (pytest.approx(start, abs=1e-6) if start else None)
    with pytest.raises(ValueError, match="which need no unit: leave --time-unit ms out"):
        recording_of(columns, Reading(time_unit="ms"), NOMINAL_DRIVE)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PLAIN.replace("time", "t"), r"row 1: must have one column 'time', has 0; .*: --time-column names another"),
        (PLAIN.replace("motor", "time"), r"row 1: must have one column 'time', has 2"),
        (PLAIN.partition("\n")[2], r"row 1: must be a header with the names of the columns above it"),
        (GERMAN.replace("-2,25", "-2.250"), r"comma in row 2 and a decimal point in row 2: write all with one of them"),
        (GERMAN.replace("-2,25", "-2.250,5"), r"row 2: column 'load' must be a number.* without separators of thous"),
        (PLAIN.replace(".", ","), r"row 2: must have 4 cells as the header, has 8: decimal commas need semicolons"),
        (PLAIN + "0.012,1\n", r"row 5: must have 4 cells as the header, has 2: .*begin it with # if it is no sample"),
        (PLAIN + "mean,1,2,3\n", r"row 5: column 'time' must be a number, got 'mean'"),
        (
            PLAIN.encode() + b"\xb0",
            r"row 5: must be text in UTF-8, byte \d+ is not: save it as 'CSV UTF-8', or convert",
        ),
        (PLAIN + "\0", r"row 5: must be text, and has a byte 0"),
        (gzip.compress(PLAIN.encode(), mtime=0)[:-9], r"is packed with gzip and damaged"),
        (gzip.compress(b"SQLite format 3\0", mtime=0), r"is no packed table: unpack it with gunzip"),
        ("", r"there is nothing in it"),
        ("time,motor,load,command\n" + "x" * 200000 + ",1,2,3\n", r"row 2: must have 4 cells as the header, has 1"),
        (
            f"time,motor,load,command\n{DAY},1,2,3\nsoon,1,2,3\n",
            r"row 3: column 'time' must be a time as in the rows bef",
        ),
        ("time,motor,load,command\n2026-13-01T00:00:00,1,2,3\n", r"row 2: column 'time' must be a number"),
    ],
)
def test_what_cannot_be_read_is_named_with_its_row_and_a_remedy(text: str | bytes, reason: str, tmp_path: Path) -> None:
    path = table(tmp_path, text)
    with pytest.raises(ValueError, match=r"a\.csv(: |, row)") as refused:
        read(path)
    assert refused.match(reason)


def test_a_reading_that_no_sensor_has_is_refused_before_any_arithmetic(tmp_path: Path) -> None:
    text = PLAIN.replace("1.75", "1e300")
    with pytest.raises(ValueError, match=r"column 'motor' must be within \+-1e\+15, got 1e\+300 in row 3"):
        recording_of(read(table(tmp_path, text)), Reading(), NOMINAL_DRIVE)


@pytest.mark.parametrize(
    ("begins", "reason"),
    [
        (b"PK\x03\x04", "is a spreadsheet or an archive: save it as CSV"),
        (b"\x28\xb5\x2f\xfd", "is compressed: unpack it with zstd -d"),
        (b"rosbag2_bagfile_information:", "is the list of a bag's files: name its folder"),
    ],
)
def test_other_files_are_named_for_what_they_are(begins: bytes, reason: str, tmp_path: Path) -> None:
    name = "metadata.yaml" if begins.startswith(b"rosbag2") else "a.csv"
    with pytest.raises(ValueError, match=reason):
        is_table(table(tmp_path, begins, name))


@pytest.mark.parametrize(
    ("name", "begins"), [("a.log", b"\x89MCAP0\r\n"), ("a", b"SQLite format 3\0"), ("a.mcap", b"")]
)
def test_a_bag_s_file_is_no_table_whatever_its_name(name: str, begins: bytes, tmp_path: Path) -> None:
    assert not is_table(table(tmp_path, begins, name))
    assert not is_table(tmp_path)
