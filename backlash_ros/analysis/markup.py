"""Self-contained pages of HTML: escaped text, tables of pairs, the frame of a page."""

from collections.abc import Iterable
from html import escape

from backlash_ros.analysis.style import STYLE

_HARD_SPACE, _NO_LETTER = "\u00a0", "\ufffd"


def text_of(text: str) -> str:
    """Return a text escaped for HTML, without control characters, which a file name may have."""
    shown = "".join(letter if letter.isprintable() or letter == _HARD_SPACE else _NO_LETTER for letter in text)
    return escape(shown)


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph with any text and a style class."""
    return f'<p class="{kind}">{text_of(text)}</p>' if kind else f"<p>{text_of(text)}</p>"


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of names and values."""
    cells = [f'<tr><th scope="row">{text_of(name)}</th><td>{text_of(value)}</td></tr>' for name, value in rows]
    return "\n".join(["<table>", "<tbody>", *cells, "</tbody>", "</table>"])


def document(title: str, body: str, style: str = "") -> str:
    """Return a whole page; ``body`` is HTML, ``style`` is added to that of every page."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text_of(title)}</title>\n<style>{STYLE}{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )
