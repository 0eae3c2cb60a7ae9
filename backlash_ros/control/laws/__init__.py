"""The control laws by name. A law is one file here with a table ``LAWS`` of its names, found by itself."""

from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules

from backlash_ros.control.law import ControlLaw, NamedLaw
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive

_FIRST = "two_region"  # the paper's laws lead every table

LAWS: dict[str, NamedLaw] = {
    name: law
    for module in sorted(iter_modules(__path__), key=lambda module: (module.name != _FIRST, module.name))
    for name, law in import_module(f"{__name__}.{module.name}").LAWS.items()
}
"""Every law by the name that the parameter ``law`` takes."""


@lru_cache(maxsize=16)
def design_law(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design the law that ``settings`` names; ValueError for a name that is not in `LAWS`.

    Remembered, so that what was designed to validate a request is not designed again between two samples.
    """
    if settings.law not in LAWS:
        raise ValueError(f"law must be one of {sorted(LAWS)}, got {settings.law!r}")
    return LAWS[settings.law].design(drive, settings)
