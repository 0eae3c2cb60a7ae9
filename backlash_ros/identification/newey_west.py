"""The covariance of a sum whose terms are correlated with their neighbours (Newey & West 1987)."""

import numpy as np

from backlash_ros.foundation.record import Array


def newey_west(scores: Array, bandwidth: int) -> Array:
    """Return the covariance of the sum of ``scores``, with weights that fall to 0 over a bandwidth.

    Parameters
    ----------
    scores : each sample's part of a gradient, of mean 0, evenly in time; shape (N, P)
    bandwidth : number of samples beyond which they are uncorrelated; 1 if all are

    Returns
    -------
    shape (P, P), positive semidefinite: the sum over i and j of max(0, 1 - abs(i - j)/bandwidth) scores_i scores_j'

    Examples
    --------
    >>> newey_west(np.array([[1.0], [2.0]]), 2)
    array([[7.]])
    """
    total = scores.T @ scores
    for lag in range(1, min(bandwidth, len(scores))):
        part = (1.0 - lag / bandwidth) * scores[lag:].T @ scores[:-lag]
        total += part + part.T
    return np.asarray(total)
