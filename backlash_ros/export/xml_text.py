"""XML as text: numbers in full precision, names escaped, comments in lines of their own."""

import textwrap
from collections.abc import Iterable
from xml.etree import ElementTree as ET

_WIDTH = 110


def number(*values: float) -> str:
    """Return numbers as an attribute: the shortest text that reads back as the same."""
    return " ".join(repr(float(value)) for value in values)


def element(parent: ET.Element | None, tag: str, **attributes: str | float) -> ET.Element:
    """Return a new element, in ``parent`` if there is one; attributes that are numbers are written as such."""
    written = {name: value if isinstance(value, str) else number(value) for name, value in attributes.items()}
    return ET.Element(tag, written) if parent is None else ET.SubElement(parent, tag, written)


def text_element(parent: ET.Element, tag: str, value: str | float, **attributes: str | float) -> ET.Element:
    """Return a new element in ``parent`` that holds a text or a number."""
    made = element(parent, tag, **attributes)
    made.text = value if isinstance(value, str) else number(value)
    return made


def comment(parent: ET.Element, *paragraphs: str) -> None:
    """Add a comment."""
    parent.append(ET.Comment(_folded(paragraphs, "    ")))


def document(root: ET.Element, *paragraphs: str) -> str:
    """Return the whole text, with a comment above the root."""
    ET.indent(root)
    head = ET.tostring(ET.Comment(_folded(paragraphs, "  ")), encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}\n{ET.tostring(root, encoding="unicode")}\n'


def _folded(paragraphs: Iterable[str], margin: str) -> str:
    lines = [line for text in paragraphs for line in textwrap.wrap(text, _WIDTH, subsequent_indent="  ")]
    if len(lines) == 1:
        return f" {lines[0]} "
    return "".join(f"\n{margin}{line}" for line in lines) + f"\n{margin[2:]}"
