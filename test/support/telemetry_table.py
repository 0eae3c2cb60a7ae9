"""The table of what ``~/state`` has, in docs/interface.md between two marks; made from the code."""

from pathlib import Path

from backlash_ros.control.telemetry import TELEMETRY

BEGIN, END = "<!-- telemetry -->\n", "\n\n## Time and rate"


def telemetry_table() -> str:
    rows = ["| name | unit | meaning |", "|---|---|---|"]
    for name, plotted in TELEMETRY.items():
        words = ", ".join(f"{number} {word}" for number, word in plotted.words.items()) if name != "fault" else ""
        meaning = plotted.meaning + (f": {words}" if words else "")
        meaning += ": 0 none, others in docs/faults.md" if name == "fault" else ""
        rows.append(f"| `{name}` | {plotted.unit} | {meaning} |")
    return "\n".join(rows)


def renew(page: Path) -> None:
    before, _, rest = page.read_text().partition(BEGIN)
    page.write_text(before + BEGIN + telemetry_table() + END + rest.partition(END)[2])


if __name__ == "__main__":
    renew(Path("docs/interface.md"))
