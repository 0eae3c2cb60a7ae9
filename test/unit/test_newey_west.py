"""The covariance of sums of what resembles its neighbours."""

import numpy as np
import pytest

from backlash_ros.identification.newey_west import newey_west


@pytest.mark.parametrize("bandwidth", [1, 2, 7, 40, 60])
def test_it_is_the_double_sum_over_all_pairs(bandwidth: int) -> None:
    scores = np.random.default_rng(1).normal(size=(40, 3))
    direct = np.zeros((3, 3))
    for i, one in enumerate(scores):
        for j, other in enumerate(scores):
            direct += max(0.0, 1.0 - abs(i - j) / bandwidth) * np.outer(one, other)
    found = newey_west(scores, bandwidth)
    assert found == pytest.approx(direct, rel=1e-9, abs=1e-9)
    assert np.min(np.linalg.eigvalsh(found)) > -1e-9


def test_samples_that_all_come_twice_are_not_taken_for_twice_as_many() -> None:
    scores = np.random.default_rng(2).normal(size=(4000, 1))
    twice = np.repeat(scores, 2, axis=0)
    truth = 4.0 * float(np.sum(scores**2))
    assert float(newey_west(twice, 1)[0, 0]) == pytest.approx(0.5 * truth)
    assert float(newey_west(twice, 20)[0, 0]) == pytest.approx(truth, rel=0.1)
