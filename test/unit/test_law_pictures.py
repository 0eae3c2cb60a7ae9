"""The pictures that explain the law of planned moves: the page's command writes what the page shows, as it says."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from pages import ROOT, commands

from backlash_ros.cli import main
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.studies.law_pictures import FIGURES, trace


def test_the_command_writes_the_pictures_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (command,) = commands("test_law_pictures.py")
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(command)[1:]) == 0
    page = (ROOT / "docs" / "law.md").read_text()
    written = {path.name: path.read_bytes() for path in (tmp_path / "docs" / "images").iterdir()}
    assert set(written) == {f"planned_{name}.png" for name in FIGURES}
    for name, content in written.items():
        assert f"](images/{name})" in page
        for picture in (content, (ROOT / "docs" / "images" / name).read_bytes()):
            assert picture.startswith(b"\x89PNG")
            assert len(picture) < 150_000


def test_the_load_is_parked_free_and_then_held() -> None:
    """What the page says of the run behind its pictures, where the load torque comes on and at the end."""
    done, b = trace(), NOMINAL_DRIVE.gear.backlash_angle
    before, end = int(np.flatnonzero(done.load_torque)[0]) - 1, -1
    for k, held, motor in ((before, 0.0, 0.0), (end, 1.0, 0.5)):
        assert done.memories[k].hold.parking_time >= 0.0
        assert done.memories[k].held == held
        assert abs(done.load[k] - 1.0) < 0.1 * b
        assert done.motor[k] - done.load[k] == pytest.approx(motor * b, abs=0.1 * b)


def test_the_page_of_the_paper_has_no_such_pictures(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as end:
        main(["figures", "planned", "--out", str(tmp_path), "--page", str(tmp_path / "page.md")])
    assert end.value.code == 2
    assert not [*tmp_path.iterdir()]
