"""docs/extending.md: its code runs, and does what the page says."""

import re
from pathlib import Path

import pytest

from backlash_ros.drivetrain import Gear

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
BLOCK = re.compile(r"```python(?: file=(\S+))?\n(.*?)```", re.DOTALL)


def test_code_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = BLOCK.findall(PAGE.read_text())
    assert [file for file, _ in blocks] == ["", "", "my_law.py", "", ""]
    for file, code in blocks:
        if file:
            Path(file).write_text(code)
        else:
            exec(compile(code, str(PAGE), "exec"), names)
    answers = capsys.readouterr().out.splitlines()
    assert len(answers) == 4
    for answer in answers[:2]:
        angle = re.fullmatch(r"(\d\.\d{3}) rad after 3 s, fault: none", answer)
        assert angle, answer
        assert abs(float(angle[1]) - 1.0) < 0.02
    found = [re.fullmatch(r"(\w+): at most (-?\d+\.\d) mrad, (-?\d+\.\d) mrad after 1 s", each) for each in answers[2:]]
    (_, _, held), (law, farthest, _) = (each.groups() for each in found if each)
    assert law == "my_law"
    assert float(farthest) <= float(held) + 0.2


def test_refusal_is_the_one_that_the_page_quotes() -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        Gear(reduction=0, backlash_angle=0.01)
    assert f"`{refused.value}`" in PAGE.read_text().replace("\n", " ")
