"""Which cases of a test are its grid: all but the corners, which are spread over its parameters."""

import pytest


@pytest.mark.corners(2)
@pytest.mark.parametrize("a", [0, 1])
@pytest.mark.parametrize("b", ["here", "there"])
def test_corners_lie_opposite_to_each_other_and_the_rest_is_the_grid(
    request: pytest.FixtureRequest, a: int, b: str
) -> None:
    assert (request.node.get_closest_marker("grid") is None) == ((a, b) in [(0, "here"), (1, "there")])
