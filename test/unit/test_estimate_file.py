"""The estimate file on the disk: made, replaced whole or not at all, and never another drive's."""

import errno
import os
import re
import stat
from datetime import datetime, timezone
from pathlib import Path

import pytest

from backlash_ros.control import Method
from backlash_ros.control.estimates import DriveIdentity, EstimateFile, History, KeptEstimate, parse, render

DRIVE = DriveIdentity("/controller", "motor", "load", 10.0)
DAY = datetime(2026, 3, 29, 1, 30, tzinfo=timezone.utc)
ONE = History(DRIVE, (KeptEstimate(DAY, Method.GAP_PROBE, {"backlash_angle": 0.02}, {}, applied=True),))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "estimates.yaml"


def refused(path: Path, why: str, drive: DriveIdentity = DRIVE) -> None:
    with pytest.raises(ValueError, match=rf"learning\.estimate_file {re.escape(str(path))}: .*{re.escape(why)}"):
        EstimateFile(str(path), drive)


def test_a_new_file_has_no_estimates_and_belongs_to_the_drive(path: Path) -> None:
    assert EstimateFile(str(path), DRIVE).history == History(DRIVE)
    assert parse(path.read_bytes(), DRIVE) == History(DRIVE)
    assert os.listdir(path.parent) == [path.name]
    refused(
        path, "drive.controller must be '/axis2/controller'", DriveIdentity("/axis2/controller", "motor", "load", 10.0)
    )
    refused(path, "drive.load_joint must be 'wrist'", DriveIdentity("/controller", "motor", "wrist", 10.0))
    refused(path, "drive.gear_reduction must be 12.0", DriveIdentity("/controller", "motor", "load", 12.0))
    assert parse(path.read_bytes(), DRIVE) == History(DRIVE)


def test_what_is_written_is_there_at_the_next_start(path: Path) -> None:
    file = EstimateFile(str(path), DRIVE)
    file.write(ONE)
    file.write(ONE.with_newest(ONE.estimates[0]))
    assert len(EstimateFile(str(path), DRIVE).history.estimates) == 2
    assert os.listdir(path.parent) == [path.name]


def test_opening_a_file_leaves_it_as_it_is(path: Path) -> None:
    path.write_text("# a word of mine\n" + render(ONE))
    before = path.read_bytes(), path.stat().st_mtime_ns
    assert EstimateFile(str(path), DRIVE).history == ONE
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    assert os.listdir(path.parent) == [path.name]


def test_a_file_that_cannot_be_read_is_refused_and_left_as_it_is(path: Path) -> None:
    for content in (b"", b"\xff\xfe", render(ONE).encode()[:-30], b"0" * 2_000_000):
        path.write_bytes(content)
        refused(path, "it is")
        assert path.read_bytes() == content
    path.write_text(render(ONE).replace("0.02\n", "4.0\n"))
    refused(path, "estimates[0].parameters.backlash_angle must be > 0 rad and <= 3.2 rad, got 4.0")


def test_no_folder_no_file(tmp_path: Path) -> None:
    refused(tmp_path / "nosuch" / "estimates.yaml", f"there is no folder {tmp_path / 'nosuch'}")
    refused(tmp_path, "it is not a regular file")
    (tmp_path / "file").touch()
    refused(tmp_path / "file" / "estimates.yaml", "there is no folder")
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", "it is not a regular file")
    refused(tmp_path / ("x" * 250), "it cannot be used: File name too long")
    refused(Path("/proc/backlash_estimates"), "it cannot be used")


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_what_is_write_protected_is_refused(path: Path) -> None:
    EstimateFile(str(path), DRIVE)
    path.chmod(0o444)
    refused(path, "it cannot be used: Permission denied")
    path.chmod(0o644)
    path.parent.chmod(0o555)
    refused(path, "it cannot be used: Permission denied")
    path.parent.chmod(0o755)


@pytest.mark.parametrize("call", ["fsync", "replace", "fchmod"])
def test_a_write_that_fails_leaves_the_old_file(path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    file = EstimateFile(str(path), DRIVE)
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        with pytest.raises(OSError, match="No space left"):
            file.write(ONE)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]
    file.write(ONE)
    assert parse(path.read_bytes(), DRIVE) == ONE


def test_it_is_on_the_disk_before_it_takes_the_place_of_the_old_one(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda d: (calls.append("fsync"), fsync(d)))
    monkeypatch.setattr(os, "replace", lambda a, b: (calls.append("replace"), replace(a, b)))
    EstimateFile(str(path), DRIVE)
    assert calls == ["fsync", "replace", "fsync"]  # the last one is the folder's


def test_a_file_that_somebody_else_has_changed_is_left_as_it_is(path: Path) -> None:
    """Two axes that were started at the same moment with one file: the second one to write is told."""
    first = EstimateFile(str(path), DRIVE)
    other = render(History(DriveIdentity("/axis2/controller", "motor", "load", 10.0)))
    path.write_text(other)
    with pytest.raises(ValueError, match="another program has changed it since it was read; it was left unchanged"):
        first.write(ONE)
    assert path.read_text() == other


def test_a_file_that_was_taken_away_is_made_anew(path: Path) -> None:
    file = EstimateFile(str(path), DRIVE)
    path.unlink()
    file.write(ONE)
    assert parse(path.read_bytes(), DRIVE) == ONE


def test_a_link_is_followed_and_the_mode_kept(path: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(path)
    file = EstimateFile(str(link), DRIVE)
    path.chmod(0o640)
    file.write(ONE)
    assert link.is_symlink()
    assert parse(path.read_bytes(), DRIVE) == ONE
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_home_is_written_as_a_tilde(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert EstimateFile("~/estimates.yaml", DRIVE).path == tmp_path.resolve() / "estimates.yaml"
