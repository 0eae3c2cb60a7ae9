"""docs/faults.md has a row for each test that injects a fault, and none for one that does not exist."""

from pathlib import Path

from faults_page import MEANINGS, fault_tests_of, meanings, page, parts_of

ROOT = Path(__file__).parents[2]


def test_page_lists_the_tests_that_there_are() -> None:
    names = fault_tests_of(ROOT / "test" / "nodes")
    assert len(names) >= 20
    expected = {parts[0] for parts in map(parts_of, names) if parts}
    table = (ROOT / "docs" / "faults.md").read_text().partition(MEANINGS)[0]
    rows = [line.split(" | ") for line in table.splitlines() if "---" not in line]
    listed = {row[0].removeprefix("| ").split(": ")[0] for row in rows if len(row) == 4}
    assert listed - {"fault"} == expected


def test_row_is_made_of_the_name_and_the_longest_time() -> None:
    row = (
        page({"test_load_jumps__0_v_at_once__reset_it[by 1 rad]": [0.0, 0.25], "test_other": []})
        .partition(MEANINGS)[0]
        .split("\n")[-3]
    )
    assert row == "| load jumps: by 1 rad | 0 V at once | 250 ms | reset it |"


def test_page_says_what_each_fault_means_and_what_to_do() -> None:
    assert meanings() in (ROOT / "docs" / "faults.md").read_text()
