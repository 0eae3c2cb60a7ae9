"""One step of the implicit method for a drive with effects: RODAS4P, as in `motion.implicit`, with any Jacobian.

The Jacobian comes from differences of the equations of motion: an error of it costs accuracy in proportion to the
step, which the error of the step shows.
"""

import math
from functools import cache

import numpy as np

from backlash_ros.drivetrain.constants import PlantConstants
from backlash_ros.drivetrain.contact import Contact
from backlash_ros.drivetrain.effects.equations import Derivative, real_equations
from backlash_ros.drivetrain.effects.explicit import weights_of
from backlash_ros.drivetrain.effects.state import WHOLE
from backlash_ros.drivetrain.motion.dynamics import Acting
from backlash_ros.drivetrain.motion.explicit import Step
from backlash_ros.drivetrain.motion.implicit import COUPLINGS, GAMMA, STAGES
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array

_CHANGE = 1e-7
"""By which a state is changed for the Jacobian, as a share of what its errors are judged by."""


@compiled
def factorize(matrix: Array, order: Array) -> None:
    """Replace a matrix, shape (N, N), by its triangular factors; ``order``, shape (N,): of its rows."""
    count = matrix.shape[0]
    for k in range(count):
        order[k] = k
    for k in range(count):
        best = k
        for row in range(k + 1, count):
            if abs(matrix[row, k]) > abs(matrix[best, k]):
                best = row
        if best != k:
            order[k], order[best] = order[best], order[k]
            for column in range(count):
                matrix[k, column], matrix[best, column] = matrix[best, column], matrix[k, column]
        for row in range(k + 1, count):
            matrix[row, k] /= matrix[k, k]
            for column in range(k + 1, count):
                matrix[row, column] -= matrix[row, k] * matrix[k, column]


@compiled
def solve(factors: Array, order: Array, right: Array, out: Array) -> None:
    """Write into ``out`` the solution for a right side, both of shape (N,), with what `factorize` has left."""
    count = factors.shape[0]
    for row in range(count):
        value = right[int(order[row])]
        for column in range(row):
            value -= factors[row, column] * out[column]
        out[row] = value
    for row in range(count - 1, -1, -1):
        value = out[row]
        for column in range(row + 1, count):
            value -= factors[row, column] * out[column]
        out[row] = value / factors[row, row]


_derivative: Derivative = unbound


def _step(
    plant: PlantConstants,
    state: Array,
    h: float,
    acting: Acting,
    tolerance: float,
    account: bool,
    out: Array,
) -> tuple[float, float]:
    """Take a step of ``h`` seconds from ``state`` to ``out``, both of shape (WHOLE,): as `explicit`."""
    stages, residual, weights = np.empty((6, WHOLE)), np.empty(WHOLE), np.empty(WHOLE)
    matrix, order, around = np.empty((WHOLE, WHOLE)), np.empty(WHOLE), np.empty(WHOLE)
    weights_of(plant, state, False, weights)
    force = _derivative(plant, state, acting, residual)
    g = 1.0 / (h * GAMMA)
    for k in range(WHOLE):
        out[k] = state[k]
    for k in range(WHOLE):
        for row in range(WHOLE):
            matrix[row, k] = 0.0
        if weights[k] > 0.0:
            change = _CHANGE / weights[k]
            out[k] = state[k] + change
            _derivative(plant, out, acting, around)
            for row in range(WHOLE):
                matrix[row, k] = (residual[row] - around[row]) / change
            out[k] = state[k]
        matrix[k, k] += g
    factorize(matrix, order)
    for j in range(6):
        for k in range(WHOLE):
            value = state[k]
            for m in range(j):
                value += STAGES[j, m] * stages[m, k]
            out[k] = value
        _derivative(plant, out, acting, residual)
        for k in range(WHOLE):
            for m in range(j):
                residual[k] += COUPLINGS[j, m] / h * stages[m, k]
        solve(matrix, order, residual, stages[j])
    for k in range(WHOLE):
        out[k] += stages[5, k]
    weights_of(plant, out, account, weights)
    error = 0.0
    for k in range(WHOLE):
        if not math.isfinite(out[k]):
            return math.inf, force
        error = max(error, abs(stages[5, k]) * weights[k])
    return error / tolerance, force


@cache
def real_implicit(law: type[Contact]) -> Step:
    """Return `_step` compiled for a contact law."""
    return specialize(_step, _derivative=real_equations(law).derivative)  # type: ignore[arg-type]
