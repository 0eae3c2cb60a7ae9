"""Questions with a default, a unit and an explanation, and who answers them: a person, a pipe or a file."""

import math
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from backlash_ros.foundation.quantity import Quantity

EXPLAIN, BACK = "?", "<"
"""The answers that ask what is meant, and that go back to the question before."""
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)", re.ASCII)
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "arcmin": math.pi / 10800.0}
INERTIAS = {"kg m^2": 1.0, "kg cm^2": 1e-4, "g m^2": 1e-3, "g cm^2": 1e-7}
_OTHERWISE = {"degree": "deg", "degrees": "deg"}
"""Other names of units."""
_Told = TypeVar("_Told")
Units = Mapping[str, float | Callable[[float], float]]
"""Factor to SI units, or function, by name."""


class NoAnswerError(ValueError):
    """There is no answer to a question; the text says to which, and what to do."""


@dataclass(frozen=True)
class Number:
    """A question for a number.

    Parameters
    ----------
    key : names it in files of answers
    text : what is asked, without its unit
    bound : of the number, in SI units
    default : in SI units; None: a number need not be given
    units : factor to SI units, or a function, by name; the default is shown in the first, and an answer without a unit
        is in SI units, if the first is
    explained : what is meant, and where to find it
    assumed : whether the default is a guess, which is shown and has two digits
    """

    key: str
    text: str
    bound: Quantity
    default: float | None
    units: Units = field(default_factory=dict)
    explained: str = ""
    assumed: bool = False

    @property
    def _known(self) -> Units:
        return self.units or {self.bound.unit: 1.0}

    @property
    def prompt(self) -> str:
        """What is shown: the question, its units, and the default in the first of them."""
        first, factor = next(iter(self._known.items()))
        assert isinstance(factor, (int, float))
        default = "none" if self.default is None else f"{self.default / factor:.6g} {first}".rstrip()
        default += ", assumed" if self.assumed else ""
        units = ", ".join(filter(None, self._known))
        return f"{self.text}{f' ({units})' if units else ''} [{default}]: "

    def read(self, text: str) -> float | None:
        """Return the number in an answer, in SI units; ValueError says what is wrong with it."""
        if not text or (self.default is None and text.lower() == "none"):
            return self.default
        known = {_folded(name): factor for name, factor in self._known.items()}
        found = _NUMBER.fullmatch(text)
        unit = _folded(found[2]) if found else ""
        if unit == ":1" and not self.bound.unit:  # a ratio
            unit = ""
        if found is None or (unit and unit not in known):
            units = " or ".join(filter(None, self._known))
            remedy = ", with a point" if "," in text else ""
            raise ValueError(f"{self.key} must be a number{f' in {units}' if units else ''}{remedy}, got {text[:40]!r}")
        number, factor = float(found[1]), known[unit] if unit else next(iter(self._known.values()))
        if not unit and number and factor != 1.0:  # a parameter of the same name is in SI units
            raise ValueError(f"{self.key} must have a unit, {' or '.join(self._known)}, got {text[:40]!r}")
        if callable(factor):
            if not number > 0.0:
                raise ValueError(f"{self.key} must be > 0 {found[2].strip()}, got {text[:40]!r}")
            value = factor(number)
        else:
            value = factor * number
        self.bound.check(self.key, value)
        return value


def _folded(unit: str) -> str:
    unit = re.sub(r"[ ^*.]", "", unit)
    return _OTHERWISE.get(unit, unit)


@dataclass(frozen=True)
class Choice:
    """A question for one of some names; ``options``: what each means. A name's number, from 1 on, answers as well.

    ``unknown``: what to do about a name that is none of them.
    """

    key: str
    text: str
    options: Mapping[str, str]
    default: str
    explained: str = ""
    unknown: str = ""

    @property
    def prompt(self) -> str:
        """What is shown."""
        lines = [f"  {k:2d}  {name:{max(map(len, self.options))}}  {text}" for k, (name, text) in self._numbered]
        return "\n".join([f"{self.text}:", *(line.rstrip() for line in lines), f"[{self.default}]: "])

    @property
    def _numbered(self) -> enumerate[tuple[str, str]]:
        return enumerate(self.options.items(), 1)

    def read(self, text: str) -> str:
        """Return the name that is meant; ValueError if none is, or several are."""
        if not text:
            return self.default
        if text.isascii() and text.isdigit() and len(text) < 4 and 1 <= int(text) <= len(self.options):
            return list(self.options)[int(text) - 1]
        meant = [name for name in self.options if text.lower() in name.lower()]
        found = [name for name in meant if text.lower() == name.lower()] or meant
        if len(found) != 1:
            why = f", which {len(found)} names have" if found else self.unknown
            last = len(self.options)
            raise ValueError(
                f"{self.key} must be a number from 1 to {last} or a part of one name, got {text[:40]!r}{why}"
            )
        return found[0]


class Asker(Protocol):
    """Who finds the answers: a terminal or pipe, or a file."""

    def __call__(self, question: Number | Choice) -> Any:
        """Return what a question's ``read`` makes of its answer; NoAnswerError if there is none."""
        ...


class _GoBackError(Exception):
    """The question before is to be asked again."""


class Terminal:
    """Asks a person, or takes the lines of a pipe; asks again after what cannot be used. ``say`` prints a line."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._answers, self._repeated = list[str](), 0

    def ask(self, all_of: Callable[[Asker], _Told]) -> _Told:
        """Return what ``all_of`` makes of the answers; it begins anew, with the answers so far, where one goes back."""
        while True:
            self._repeated = 0
            try:
                return all_of(self)
            except _GoBackError:
                self._answers.pop()

    def __call__(self, question: Number | Choice) -> Any:
        """Ask; `EXPLAIN` explains, an empty line is the default, `BACK` goes back."""
        if self._repeated < len(self._answers):
            self._repeated += 1
            return question.read(self._answers[self._repeated - 1])
        while True:
            try:
                answer = input(question.prompt).strip()
            except (EOFError, RuntimeError):  # the second where there is no input at all
                self._say("")
                raise NoAnswerError(
                    f"the input ended before the answer to {question.key}: nothing is written; an empty line takes a "
                    "default, and --answers reads answers from a file"
                ) from None
            except UnicodeDecodeError:
                raise NoAnswerError(f"the answer to {question.key} must be text in UTF-8: nothing is written") from None
            if not sys.stdin.isatty():  # shows what a pipe answers
                self._say(answer)
            if answer == EXPLAIN:
                self._say(f"  {question.key}: {question.explained or question.text}")
                continue
            if answer == BACK and not self._answers:
                self._say("  this is the first question")
                continue
            if answer == BACK:
                raise _GoBackError
            try:
                value = question.read(answer)
            except ValueError as error:
                self._say(f"  {error}; {EXPLAIN} explains")
                continue
            self._answers.append(answer)
            self._repeated += 1
            return value


class Answers:
    """Takes answers by key; what is not there has its default. `refuse_unused` tells which were not asked for."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._given, self._asked = dict(given), list[str]()

    def __call__(self, question: Number | Choice) -> Any:
        """Return the answer; ValueError if it cannot be used."""
        self._asked.append(question.key)
        value = self._given.get(question.key)
        if value is None:
            return question.read("")
        if isinstance(value, (list, dict, bool)):
            raise ValueError(f"{question.key} must be a number or text, got {value!r}")
        return question.read(repr(value) if isinstance(value, float) else str(value).strip())

    def refuse_unused(self) -> None:
        """Raise ValueError if there are answers to questions that were not asked."""
        if unused := sorted(set(map(str, self._given)) - set(self._asked)):
            raise ValueError(f"{unused[0]} was not asked for; the questions were {', '.join(self._asked)}")
