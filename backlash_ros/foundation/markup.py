"""Text and tables as HTML, for notebooks and pages."""

from collections.abc import Iterable
from html import escape

_HARD_SPACE, _NO_LETTER = "\u00a0", "\ufffd"


def text_of(text: str) -> str:
    """Return a text escaped for HTML, without control characters, which a file name may have."""
    shown = "".join(letter if letter.isprintable() or letter == _HARD_SPACE else _NO_LETTER for letter in text)
    return escape(shown)


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of names and values."""
    cells = [f'<tr><th scope="row">{text_of(name)}</th><td>{text_of(value)}</td></tr>' for name, value in rows]
    return "\n".join(["<table>", "<tbody>", *cells, "</tbody>", "</table>"])
