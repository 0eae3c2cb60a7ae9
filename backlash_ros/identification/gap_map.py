"""The gap around the output's turn, from a recording at each of several places, separated from the eccentricity.

Pure computation. At each place the fit gives the gap and its middle: the motor's angle minus the load's. An eccentric
encoder or gear moves the middle once per turn, by -e sin(theta_l + phase), and does not change the gap.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.gap import Gap, measure_gap
from backlash_ros.identification.recording import Recording

_TURN = 2.0 * math.pi
FEWEST_PLACES = 6
"""Smallest number of places; tuned."""
_FEWEST = 0.75
"""Share of the places that must be measured; tuned."""
_RATIO = 0.005
"""Standard deviation of the relative error of ``gear.reduction``."""
_COUNT = 0.3
"""Uncertainty of the middle of the gap beside the noise, in counts of the load's encoder: about that of one reading."""
_SLOPED = 0.75
"""Additional uncertainty: a share of the gap per square radian of the load's travel and per 1/rad of difference between
the gap's slope in the fit and that between the neighbours, since the far flank may be met only at the travel's end."""
_SEEN = 2.0
"""Number of standard uncertainties above which an eccentricity is reported."""


@dataclass(frozen=True)
class GapMap:
    """The gap at each measured place.

    ``places``: readings of the load's encoder there, rad, in rising order; ``gaps`` and standard ``uncertainties``
    there, rad at the output. The error of the load's angle is ``eccentricity`` sin(angle + ``phase``), rad;
    ``eccentricity_uncertainty`` is its standard uncertainty at any phase.
    """

    places: tuple[float, ...]
    gaps: tuple[float, ...]
    uncertainties: tuple[float, ...]
    eccentricity: float
    phase: float
    eccentricity_uncertainty: float

    @property
    def mean(self) -> float:
        """Mean of the gaps, rad."""
        return math.fsum(self.gaps) / len(self.gaps)

    @property
    def smallest(self) -> int:
        """Index of the place with the smallest gap."""
        return self.gaps.index(min(self.gaps))

    @property
    def largest(self) -> int:
        """Index of the place with the largest gap."""
        return self.gaps.index(max(self.gaps))

    @property
    def eccentric(self) -> bool:
        """Whether the eccentricity exceeds its uncertainty."""
        return self.eccentricity > _SEEN * self.eccentricity_uncertainty

    def eccentricity_in_words(self) -> str:
        """Return the eccentricity in words, or the size that would have been seen."""
        unsure = self.eccentricity_uncertainty
        if self.eccentric:
            return f"the load's angle is off by {self.eccentricity:.2g} +- {unsure:.1g} rad once per turn"
        return f"no eccentricity was seen; one of {_SEEN * unsure:.1g} rad would have been"

    def values(self) -> dict[str, float | str]:
        """Return the map by name: numbers to plot, and ``gap_map_rad``, a text with every place and its gap."""
        smallest, largest = self.smallest, self.largest
        pairs = zip(self.places, self.gaps, strict=True)
        return {
            "gap_smallest_rad": self.gaps[smallest],
            "gap_smallest_at_rad": self.places[smallest],
            "gap_mean_rad": self.mean,
            "gap_largest_rad": self.gaps[largest],
            "gap_largest_at_rad": self.places[largest],
            "eccentricity_rad": self.eccentricity,
            "eccentricity_phase_rad": self.phase,
            "eccentricity_uncertainty_rad": self.eccentricity_uncertainty,
            "gap_map_rad": ", ".join(f"{place:.3f}: {gap:.6g}" for place, gap in pairs),
        }

    def __str__(self) -> str:
        """Return the map in words."""
        smallest, largest = self.smallest, self.largest
        return (
            f"the gap is {self.gaps[smallest]:.4g} rad where it is smallest, at {self.places[smallest]:.3g} rad, "
            f"{self.gaps[largest]:.4g} rad where it is largest, at {self.places[largest]:.3g} rad, and "
            f"{self.mean:.4g} rad on average; {self.eccentricity_in_words()}"
        )


class Mapped(NamedTuple):
    """The gap around the turn from recordings: a ``map`` if ``valid``, and the best ``fit``."""

    map: GapMap | None
    reason: str
    fit: Fit | None = None


def incomplete(measured: Sequence[bool], *, closed: bool) -> bool:
    """Return whether more than a quarter of the places, or two neighbours, are missing; ``closed``: a full turn."""
    pairs = zip(measured, [*measured[1:], measured[0] if closed else True], strict=True)
    return sum(measured) < _FEWEST * len(measured) or any(not (here or there) for here, there in pairs)


def map_gaps(drive: Drive, recordings: Sequence[Recording], torque: float, places: int, *, closed: bool) -> Mapped:
    """Return the gap around the turn.

    Parameters
    ----------
    drive, torque : as `measure_gap` takes them
    recordings : of the first places, in their order; each starts with the load at rest at its place
    places : the planned number
    closed : whether the last place is a neighbour of the first
    """
    reached = [k < len(recordings) for k in range(places)]
    if incomplete(reached, closed=closed):
        return Mapped(None, f"only {len(recordings)} of {places} places were reached")
    found = [measure_gap(drive, recording, torque) for recording in recordings]
    measured = [k < len(found) and found[k].valid for k in range(places)]
    told = f"{sum(measured)} of {places} places"
    surest = min((gap for gap in found if gap.valid), key=lambda gap: gap.uncertainty / gap.angle, default=found[0])
    if incomplete(measured, closed=closed):
        k, why = next((k, gap.reason) for k, gap in enumerate(found) if not gap.valid)
        return Mapped(
            None,
            f"only {told} were measured: three quarters are needed, and one of any two neighbours; "
            f"at {recordings[k].load[0]:.3g} rad: {why}",
            surest.fit,
        )
    pairs = [(recording, gap) for recording, gap in zip(recordings, found, strict=True) if gap.valid]
    readings = np.array([recording.load[0] for recording, _ in pairs])
    amplitude, phase, uncertainty = _eccentricity(readings, [gap for _, gap in pairs])
    result = GapMap(
        tuple(float(reading) for reading in readings),
        tuple(gap.angle for _, gap in pairs),
        _uncertainties(readings, pairs, closed=closed),
        amplitude,
        phase,
        uncertainty,
    )
    return Mapped(result, f"{told}: {result}", surest.fit)


def _uncertainties(readings: Array, pairs: Sequence[tuple[Recording, Gap]], *, closed: bool) -> tuple[float, ...]:
    """Return the standard uncertainties, larger where fit and neighbours disagree on the gap's slope."""
    gaps, at = np.array([gap.angle for _, gap in pairs]), readings
    if closed:
        at = np.concatenate(([at[-1] - _TURN], at, [at[0] + _TURN]))
    between = np.gradient(np.pad(gaps, 1, mode="wrap") if closed else gaps, at)
    slopes = (between[1:-1] if closed else between) / gaps
    result = []
    for (recording, gap), slope in zip(pairs, slopes, strict=True):
        own = gap.fit.values.gap_slope if gap.fit is not None else 0.0
        unsure = _SLOPED * abs(own - slope) * float(np.ptp(recording.load)) ** 2 * gap.angle
        result.append(math.hypot(gap.uncertainty, unsure))
    return tuple(result)


def _eccentricity(readings: Array, gaps: Sequence[Gap]) -> tuple[float, float, float]:
    """Return amplitude, phase and standard uncertainty of the load's error once per turn, by least squares.

    A slightly wrong reduction also moves the middle, in proportion to the angle.
    """
    fits = [gap.fit for gap in gaps if gap.fit is not None]
    middles = np.array([fit.values.offset for fit in fits])
    deviations = np.array([math.hypot(math.sqrt(fit.variance("offset")), _COUNT * fit.counts[1]) for fit in fits])
    centre = float(np.mean(readings))
    columns = np.stack([-np.sin(readings), -np.cos(readings), readings - centre, np.ones(readings.size)], axis=1)
    weighed, wanted = columns / deviations[:, None], (middles - np.mean(middles)) / deviations
    matrix = weighed.T @ weighed
    matrix[2, 2] += 1.0 / _RATIO**2
    covariance = np.linalg.inv(matrix)
    a, b, ratio, mean = covariance @ (weighed.T @ wanted)
    left = wanted - weighed @ np.array([a, b, ratio, mean])
    free = max(1, readings.size - columns.shape[1])
    scatter = max(1.0, float(left @ left) / free)
    uncertainty = math.sqrt(scatter * float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return math.hypot(a, b), math.atan2(b, a), uncertainty
