"""Numbers as a certificate shows them: rounded to two digits of their uncertainty, in SI and in gear makers' units."""

import math

from backlash_ros.identification.recordings.findings import Finding

_ARCMIN = 60.0 * 180.0 / math.pi
GEAR_UNITS = {
    "rad": (_ARCMIN, "arcmin"),
    "rad/(N m)": (_ARCMIN, "arcmin/(N m)"),
    "N m/rad": (1.0 / _ARCMIN, "N m/arcmin"),
    "kg m^2": (1e4, "kg cm^2"),
}
"""Factor of a unit to that of gear makers' catalogues, and its name there."""
_IN_CATALOGUES = {"b", "b min", "b mean", "b max", "b at rest", "lost motion", "wind-up", "J_l"}
_IN_CATALOGUES |= {"stiffness", "stiffness -", "stiffness +", "k out -", "k out +", "k back -", "k back +"}
_IN_CATALOGUES |= {"lost motion 0", "lost motion T", "lost motion T, C", "width"}
_FIXED = -9, 15
"""Powers of ten of the last digit between which a number is written without an exponent."""
_SUPERSCRIPT = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
_MINUS = "\u2212"


def _place(uncertainty: float) -> int:
    """Return the power of ten of the second digit of a rounded uncertainty."""
    return int(f"{uncertainty:.1e}".split("e")[1]) - 1


def _written(value: float, place: int) -> str:
    rounded = round(value, -place)
    if rounded == 0.0:
        return "0"
    return f"{rounded:.{max(-place, 0)}f}".replace("-", _MINUS)


def rounded(value: float, uncertainty: float) -> tuple[str, str, str]:
    """Return value and uncertainty to two digits of the uncertainty, and a power of ten, mostly empty.

    >>> rounded(0.0042452, 2.23e-05)
    ('0.004245', '0.000022', '')
    """
    if abs(value) < 1e-3 * uncertainty:
        value = 0.0
    if not uncertainty > 0.0:
        return f"{value:.6g}".replace("-", _MINUS), "0", ""
    place = _place(uncertainty)
    if _FIXED[0] <= place <= _FIXED[1]:
        return _written(value, place), _written(uncertainty, place), ""
    power = math.floor(math.log10(max(abs(value), uncertainty)))
    scale, last = 10.0**-power, place - power
    exponent = f" \u00d7 10{str(power).translate(_SUPERSCRIPT)}"
    return _written(value * scale, last), _written(uncertainty * scale, last), exponent


def shown(value: float, uncertainty: float, unit: str) -> str:
    """Return value, standard uncertainty and unit in one line.

    >>> shown(-0.01388, 0.0005, "N m")
    '\u22120.01388 \u00b1 0.00050 N m'
    """
    number, sure, power = rounded(value, uncertainty)
    pair = f"({number} \u00b1 {sure}){power}" if power else f"{number} \u00b1 {sure}"
    return f"{pair} {unit_text(unit)}".rstrip()


def unit_text(unit: str) -> str:
    """Return a unit with superscript squares."""
    return unit.replace("^2", "\u00b2")


def in_si(row: Finding) -> str:
    """Return the value of a row in SI units."""
    return shown(row.value, row.uncertainty, row.unit)


def in_gear_units(row: Finding) -> str:
    """Return the value of a row in gear makers' units; empty if their catalogues do not have it."""
    if row.symbol not in _IN_CATALOGUES:
        return ""
    factor, unit = GEAR_UNITS[row.unit]
    return shown(factor * row.value, factor * row.uncertainty, unit)


def counted(number: int, noun: str) -> str:
    """Return a number of things.

    >>> counted(1, "step"), counted(2, "step")
    ('1 step', '2 steps')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def brief(value: float, digits: int = 3) -> str:
    """Return a number with a few digits."""
    return f"{value:.{digits}g}".replace("-", _MINUS) if math.isfinite(value) else "none"
