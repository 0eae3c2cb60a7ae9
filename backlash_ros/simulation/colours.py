"""The colours of pages and pictures: light, dark, and on paper."""

LIGHT = {
    "paper": "#ffffff",
    "ink": "#1b1f24",
    "faint": "#6a7280",
    "line": "#d4d8de",
    "band": "#e9ecf0",
    "motor": "#0b62a8",
    "load": "#b3470b",
    "model": "#1b1f24",
    "good": "#14703c",
    "doubt": "#b07800",
    "bad": "#a3210f",
}
DARK = {
    "paper": "#14171b",
    "ink": "#e6e8eb",
    "faint": "#9aa3af",
    "line": "#3a4048",
    "band": "#262b31",
    "motor": "#6cb2f2",
    "load": "#f0945a",
    "model": "#e6e8eb",
    "good": "#63c98d",
    "doubt": "#e5b84c",
    "bad": "#ff8d7a",
}
PRINT = LIGHT | {"ink": "#000000", "faint": "#4a4f57", "line": "#b9bec6", "model": "#000000"}
"""The colours of a page by what they are for; scripts draw with them, too."""
