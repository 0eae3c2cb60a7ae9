"""The control laws by name. A law is one file here, or anywhere, with a table ``LAWS`` of its names."""

from functools import lru_cache

from backlash_ros.control.law import ControlLaw, NamedLaw
from backlash_ros.control.settings import AUTO, BOTH, ServoSettings
from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.registry import Registry

LAWS: Registry[NamedLaw] = Registry(__name__, __path__, "LAWS", first="two_region")
"""Every law by the name that the parameter ``law`` takes, besides `AUTO`; the paper's laws lead every table."""
BEST, UNTIL_THEN = "planned", "two_region"
"""What `AUTO` stands for: the first if it lacks nothing and can be designed, else the second."""
_QUIET = "overdamped"
"""The law that acts while another one lacks something: slower, and quiet with any load."""


def lacks(settings: ServoSettings) -> str:
    """Return what must happen before the chosen law acts, `BEST` for `AUTO`, in words; empty if it acts already.

    Raises
    ------
    ValueError
        For a name that is neither in `LAWS` nor `AUTO`.
    """
    if settings.law != AUTO and not LAWS.choose("law", settings.law, AUTO).identified:
        return ""
    lacking = []
    if settings.backlash_angle == 0.0:
        lacking.append("the backlash is learned")
    if not settings.identified:
        lacking.append("the drive is identified")
    return " and ".join(lacking)


def lacks_encoder(settings: ServoSettings) -> bool:
    """Return whether the chosen law needs both encoders, and one is missing; ValueError for an unknown law."""
    if settings.law == AUTO or settings.encoders == BOTH:
        return False
    law = LAWS.choose("law", settings.law, AUTO)
    return law.both_encoders and not law.one_encoder


@lru_cache(maxsize=16)
def best_refusal(drive: Drive, settings: ServoSettings) -> str:
    """Return why `BEST` cannot be designed, though it lacks nothing; else an empty text. Cached like `design_law`."""
    if not lacks(best := settings.with_law(BEST)):
        try:
            design_law(drive, best)
        except ValueError as error:
            return str(error)
    return ""


def law_of(drive: Drive, settings: ServoSettings) -> str:
    """Return the name of the law that acts: the chosen one, or what stands in for it, or what `AUTO` stands for.

    Raises
    ------
    ValueError
        For a name that is neither in `LAWS` nor `AUTO`.
    """
    if settings.law == AUTO:
        return UNTIL_THEN if lacks(settings) or best_refusal(drive, settings) else BEST
    return _QUIET if lacks_encoder(settings) or lacks(settings) else settings.law


@lru_cache(maxsize=16)
def design_law(drive: Drive, settings: ServoSettings) -> ControlLaw:
    """Design the law that acts by `law_of`, with its parameters in ``settings`` or else their defaults.

    Results are cached, so that a law designed to validate a request is not designed again between two samples.

    Raises
    ------
    ValueError
        For a name that is neither in `LAWS` nor `AUTO`, for another law's parameters, or if the law cannot be designed.
    """
    own = dict(settings.law_parameters)
    for name, parameters in own.items():
        right = type(LAWS.choose("law", name, AUTO).parameters)
        if type(parameters) is not right:
            raise ValueError(f"laws.{name} needs parameters of type {right.__name__}, got {type(parameters).__name__}")
    name = law_of(drive, settings)
    law = LAWS[name]
    return law.design(drive, settings, own.get(name, law.parameters))
