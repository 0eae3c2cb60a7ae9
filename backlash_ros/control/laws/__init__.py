"""The control laws by name. A law is one file here, or anywhere, with a table ``LAWS`` of its names."""

from functools import lru_cache

from backlash_ros.control.law import ControlLaw, NamedLaw
from backlash_ros.control.settings import ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.registry import Registry

LAWS: Registry[NamedLaw] = Registry(__name__, __path__, "LAWS", first="two_region")
"""Every law by the name that the parameter ``law`` takes; the paper's laws lead every table."""


def lacks(settings: ServoSettings) -> str:
    """Return what must happen before the chosen law acts, in words; empty if it acts already.

    Raises
    ------
    ValueError
        For a name that is not in `LAWS`.
    """
    if not LAWS.choose("law", settings.law).identified:
        return ""
    lacking = []
    if settings.backlash_angle == 0.0:
        lacking.append("the backlash is learned")
    if not settings.identified:
        lacking.append("the drive is identified")
    return " and ".join(lacking)


@lru_cache(maxsize=16)
def design_law(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design the law that ``settings`` names, with its parameters there or else their defaults.

    The over-damped law replaces a law that `lacks` something: slower, and quiet with any load. Results are cached, so
    that a law designed to validate a request is not designed again between two samples.

    Raises
    ------
    ValueError
        For a name that is not in `LAWS`, for another law's parameters, or if the law cannot be designed.
    """
    law = LAWS.choose("law", settings.law)
    parameters = dict(settings.law_parameters).get(settings.law, law.parameters)
    if type(parameters) is not type(law.parameters):
        raise ValueError(
            f"laws.{settings.law} needs parameters of type {type(law.parameters).__name__}, "
            f"got {type(parameters).__name__}"
        )
    if lacks(settings):
        law, parameters = LAWS["overdamped"], LAWS["overdamped"].parameters
    return law.design(drive, settings, parameters)
