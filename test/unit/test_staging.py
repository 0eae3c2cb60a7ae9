"""A staging folder: beside its place, gone in the end, and refused at once where nothing can be put."""

import os
from pathlib import Path

import pytest

from backlash_ros.foundation.staging import staging


def test_what_is_put_in_place_stays_with_the_folders_that_lead_there(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b" / "result"
    with staging(target) as folder:
        (folder / "result").write_text("done")
        (folder / "rest").write_text("")
        (folder / "result").replace(target)
    assert target.read_text() == "done"
    assert [path.name for path in target.parent.iterdir()] == ["result"]


def test_nothing_stays_of_what_fails(tmp_path: Path) -> None:
    def fail() -> None:
        with staging(tmp_path / "a" / "b" / "result") as folder:
            (folder / "half").write_text("")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_relative_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with staging(Path("result")) as folder:
        assert folder.parent == tmp_path


@pytest.mark.parametrize("name", ["x" * 256, "a/" + "x" * 256, "x" * 256 + "/a"])
def test_name_that_is_too_long_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(OSError, match="File name too long") as refused, staging(tmp_path / name):
        pass
    assert refused.value.filename == str(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError, match="result"), staging(tmp_path / "result"):
        pass
    tmp_path.chmod(0o700)


def test_place_where_nobody_may_write_is_refused() -> None:
    with pytest.raises(OSError, match="/proc/result"), staging(Path("/proc/result")):
        pass
