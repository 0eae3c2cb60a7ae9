"""Self-contained pages of HTML: paragraphs, the frame of a page."""

from backlash_ros.foundation.markup import text_of
from backlash_ros.pages.style import STYLE


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph with any text and a style class."""
    return f'<p class="{kind}">{text_of(text)}</p>' if kind else f"<p>{text_of(text)}</p>"


def document(title: str, body: str, style: str = "") -> str:
    """Return a whole page; ``body`` is HTML, ``style`` is added to that of every page."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text_of(title)}</title>\n<style>{STYLE}{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )
