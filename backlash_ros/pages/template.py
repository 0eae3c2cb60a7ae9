"""Pages from their templates, the files ``*.j2`` beside this one: every text in HTML is escaped."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_eval_context, select_autoescape
from jinja2.nodes import EvalContext
from markupsafe import Markup

from backlash_ros.foundation.markup import text_of
from backlash_ros.simulation.colours import DARK, LIGHT, PRINT


def _package() -> str:
    """Return name and version of this package; the version is ``unknown`` if it is not installed."""
    try:
        return f"backlash_ros {version('backlash_ros')}"
    except PackageNotFoundError:
        return "backlash_ros unknown"


@pass_eval_context
def _escaped(context: EvalContext, value: Any) -> Any:
    """Return a value for HTML, without control characters, which a file name may have; markup stays as it is."""
    return value if isinstance(value, Markup) or not context.autoescape else Markup(text_of(str(value)))  # noqa: S704 - escaped


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=select_autoescape(["html.j2"]),
    finalize=_escaped,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_TEMPLATES.globals |= {"palettes": {"light": LIGHT, "dark": DARK, "print": PRINT}, "package": _package()}


def render(template: str, **values: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template : its path in this folder; in one that ends with ``.html.j2`` each value is escaped, unless it is a Markup
    values : what the template names
    """
    return _TEMPLATES.get_template(template).render(**values)
