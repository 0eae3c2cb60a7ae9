"""Tests for a gap between motor and load. One encoder behind it rarely shows it: a gap is stated only if it predicts.

A fit with one more parameter is never worse on its own data. So the runs are divided, and each part is predicted by
fits to the others, without and with a gap (cross-validation: Ljung, System Identification, 2nd ed., ch. 16).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from output_error import ServoFit, fit_servo, mean_errors, refit
from position_servo import ServoRun

FOLDS = 4
LEAST_GAIN = 0.1
"""Share by which a gap must reduce the error of runs that were not fitted, to be stated."""
_SURE = 0.2
"""Largest standard uncertainty, as a share of the gap."""
_NOTHING = 1e-6
"""Smaller errors, rad, are rounding."""
_GAPS = (2e-3, 8e-3, 3e-2)
"""Where the search for a gap starts, rad."""


@dataclass(frozen=True)
class ServoGap:
    """The gap at the output: ``angle`` and standard ``uncertainty``, rad, 0 unless valid; ``reason`` says why.

    ``without`` and ``beside`` are mean absolute errors of runs that were not fitted, rad, without and with a gap;
    ``fit`` is the one with a gap, to all runs.
    """

    angle: float
    uncertainty: float
    valid: bool
    reason: str
    without: float
    beside: float
    fit: ServoFit


def judge_gap(runs: Sequence[ServoRun], fit: ServoFit) -> ServoGap:
    """Fit a gap in addition, and state it if it improves the prediction of runs that were not fitted.

    The runs are divided into `FOLDS`, every fourth in one; each is judged by fits to the others, without and with a
    gap. The mean absolute error must fall by `LEAST_GAIN`, and by two of its standard errors between runs.

    Raises
    ------
    ValueError
        If there are fewer runs than folds, a load has no inertia, or nothing but a gap was fitted.
    """
    if len(runs) < FOLDS:
        raise ValueError(f"runs must be >= {FOLDS} recordings to judge a gap, got {len(runs)}")
    for run in runs:
        if run.load_inertia <= 0:
            raise ValueError(f"run.load_inertia must be > 0 kg m^2 beyond a gap, got {run.load_inertia!r}")
    free = (*(name for name in fit.free if name != "backlash_angle"), "backlash_angle")
    if len(free) < 2:
        raise ValueError(f"fit.free must have a parameter other than the gap, got {list(fit.free)}")
    rigid = replace(fit.servo, backlash_angle=0.0)
    starts = [refit(runs, replace(rigid, backlash_angle=gap), free) for gap in _GAPS]
    whole = fit_servo(runs, min(starts, key=lambda found: found[1])[0], free)
    without, beside, gaps = np.empty(len(runs)), np.empty(len(runs)), []
    for fold in range(FOLDS):
        kept = [run for k, run in enumerate(runs) if k % FOLDS != fold]
        left = [run for k, run in enumerate(runs) if k % FOLDS == fold]
        without[fold::FOLDS] = mean_errors(refit(kept, rigid, free[:-1])[0], left)
        found = refit(kept, whole.servo, free)[0]
        beside[fold::FOLDS] = mean_errors(found, left)
        gaps.append(found.backlash_angle)
    before, after = max(float(np.mean(without)), _NOTHING), float(np.mean(beside))
    gain = 1.0 - after / before
    doubt = float(np.std(without - beside, ddof=1)) / math.sqrt(len(runs)) / before
    angle, uncertainty = whole.servo.backlash_angle, whole.uncertainty["backlash_angle"]
    uncertainty = max(uncertainty, float(np.std(gaps, ddof=1)))
    reason = (
        f"with a gap the mean error of runs that were not fitted goes from {before:.4g} to {after:.4g} rad, "
        f"{-100 * gain:+.1f} % with a standard error of {100 * doubt:.1f} %"
    )
    valid = False
    if gain < LEAST_GAIN:
        reason += f"; to state a gap, it must fall by at least {100 * LEAST_GAIN:.0f} %"
    elif gain < 2.0 * doubt:
        reason += "; that may be chance"
    elif not uncertainty <= _SURE * angle:
        reason += (
            f", but it is {angle:.2g} rad with a standard uncertainty of {uncertainty:.2g} rad: too large to be used"
        )
    else:
        valid = True
    stated = (angle, uncertainty) if valid else (0.0, 0.0)
    return ServoGap(*stated, valid, reason, before, after, whole)
