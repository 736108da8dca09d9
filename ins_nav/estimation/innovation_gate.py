"""Innovation gate: consistency of an aid's measurements with the filter and with each other.

A measurement within the gate has a normalized squared innovation below a chi-square limit. For those outside, `Track`
distinguishes outliers from a series that contradicts the filter consistently; it also estimates by how much an aid's
noise exceeds the given variance.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

GATE = 1e-4
"""Probability of rejecting a consistent measurement."""
PATIENCE = 60.0
"""s without an accepted measurement of an aid, after which a consistent series overrides the gate."""
AGREEING = 8
"""Rejected measurements in a row that form such a series."""

_GROWN = 5.0
"""Growth of the sigma of the measured states after which a consistent series overrides the gate without time-out."""
_SQUARES = 15, 41
"""Least and greatest number of measurements for the estimate of an aid's noise."""
_FAR = 4.0
"""A greater test ratio is a jump, not a filter that diverges: twice the width of the gate."""
_EXCESS = 4.0
"""Sigmas of the median within which the excess of an aid's noise is chance."""
_LONG_NS = 2**62
"""ns: longer than any time-out."""


class Track(NamedTuple):
    """History of an aid's measurements; immutable.

    A series of `AGREEING` rejected measurements on a straight line overrides the gate

    - when it began near the gate (the filter diverges), once the filter's sigma has grown, or after the time-out;
    - when it began far away (one of the two has jumped), after the time-out only; until then its continuation is
      rejected even within the gate, which widens with the filter's sigma.

    Attributes
    ----------
    accepted_ns : int or None
        Stamp of the last accepted measurement; None before the first.
    rejected : tuple of (stamp, innovation)
        The last few rejected ones since.
    variance : float
        Predicted variance of the measured states (trace) at the last accepted one.
    drifts : bool
        The series began just outside the gate: the filter diverges, no jump.
    squares : tuple of float
        Normalized squares of the last innovations over the expected median.
    """

    accepted_ns: int | None = None
    rejected: tuple[tuple[int, Array], ...] = ()
    variance: float = math.inf
    drifts: bool = False
    squares: tuple[float, ...] = ()

    def noise_factor(self, size: int) -> float:
        """Estimated variance of an aid's noise over the given one; 1 where the excess may be chance."""
        if len(self.squares) < _SQUARES[0]:
            return 1.0
        ratio = sorted(self.squares)[len(self.squares) // 2]
        return ratio if ratio > 1.0 + _EXCESS * _median_stddev(size, len(self.squares)) else 1.0

    def with_square(self, square: float, size: int) -> "Track":
        """With the normalized square of one more innovation of that size."""
        return self._replace(squares=(*self.squares, square / median(size))[-_SQUARES[1] :])

    def rejecting(self, stamp_ns: int, innovation: Array, ratio: float) -> "Track":
        """With one more rejected measurement and its test ratio."""
        drifts = self.drifts if self.rejected else ratio < _FAR
        return self._replace(rejected=(*self.rejected, (stamp_ns, innovation))[-AGREEING:], drifts=drifts)

    def accepting(self, stamp_ns: int, variance: float) -> "Track":
        """With one accepted measurement, after which the measured states have that variance."""
        return Track(stamp_ns, (), variance, False, self.squares)

    def repeats(self, innovation: Array, r: Array) -> bool:
        """Whether a measurement repeats a series of rejected ones that began with a jump.

        The growth of the filter's sigma does not make such a measurement acceptable.
        """
        if self.drifts or not self._is_row(len(innovation)):
            return False
        count = len(self.rejected)
        away = innovation - np.mean([z for _, z in self.rejected], axis=0)
        square = float(away @ np.linalg.solve((1.0 + 1.0 / count) * r, away))
        return square < limit(len(innovation), GATE)

    def is_consistent(self, r: Array, variance: float, patience: float) -> bool:
        """Whether the time-out has expired and the rejected measurements lie on a straight line.

        Parameters
        ----------
        r : ndarray, shape (m, m)
            Covariance of its noise.
        variance : float
            Predicted variance of the measured states (trace).
        patience : float
            s, the time-out; 0: never; infinite: only where the filter diverges.
        """
        if patience <= 0.0 or not self._is_row(len(r)):
            return False
        unsure = self.drifts and variance > _GROWN**2 * self.variance
        since_ns = self.rejected[-1][0] - (self.accepted_ns or -_LONG_NS)
        if not unsure and (math.isinf(patience) or since_ns * 1e-9 < patience):
            return False
        values = np.array([z for _, z in self.rejected])
        _, _, scatter = line(self.rejected)
        inverse = np.linalg.inv(r)
        jump = float(np.einsum("ij,jk,ik->", values, inverse, values)) / values.size
        # three sigma, or a tenth of the jump for an aid with too small a variance
        return float(np.einsum("ij,jk,ik->", scatter, inverse, scatter)) / values.size < max(9.0, 0.01 * jump)

    def _is_row(self, size: int) -> bool:
        return len(self.rejected) == AGREEING and all(len(z) == size for _, z in self.rejected)


@functools.cache
def limit(size: int, probability: float) -> float:
    """Quantile of chi-square that is exceeded with the probability."""
    return float(chi2.isf(probability, size))


@functools.cache
def median(size: int) -> float:
    """Median of chi-square."""
    return float(chi2.median(size))


@functools.cache
def _median_stddev(size: int, count: int) -> float:
    """Relative sigma of the median of so many chi-square variables, by the density at the median."""
    return float(1.0 / (2.0 * chi2.pdf(median(size), size) * median(size) * math.sqrt(count)))


def line(points: tuple[tuple[int, Array], ...]) -> tuple[Array, float, Array]:
    """Straight line through measurements: slope per second, its variance for unit noise, deviations from the line."""
    time = np.array([(stamp - points[0][0]) * 1e-9 for stamp, _ in points])
    values = np.array([z for _, z in points])
    time -= time.mean()
    deviations = values - values.mean(axis=0)
    total = float(time @ time)
    if total == 0.0:
        return np.zeros(values.shape[1]), math.inf, deviations
    slope = time @ deviations / total
    return slope, 1.0 / total, deviations - np.outer(time, slope)
