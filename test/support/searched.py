"""Property tests that search few examples for every change, and many in the grid."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import settings

Test = Callable[..., None]


def searched(few: int, many: int, given: Callable[[Test], Test]) -> Callable[[Test], Test]:
    """Run what `hypothesis.given` makes of a test with ``few`` examples, and in the grid with ``many``."""

    def decorate(claim: Test) -> Test:
        def test(examples: int, **fixtures: Any) -> None:
            settings(max_examples=examples, deadline=None)(given(claim))(**fixtures)

        asked = inspect.signature(given(claim)).parameters.values()
        count = inspect.Parameter("examples", inspect.Parameter.KEYWORD_ONLY)
        test.__signature__ = inspect.Signature([*asked, count])  # type: ignore[attr-defined]
        test.__name__, test.__doc__, test.__module__ = claim.__name__, claim.__doc__, claim.__module__
        test.pytestmark = getattr(claim, "pytestmark", [])  # type: ignore[attr-defined]
        return pytest.mark.parametrize("examples", [few, pytest.param(many, marks=pytest.mark.grid)])(test)

    return decorate
