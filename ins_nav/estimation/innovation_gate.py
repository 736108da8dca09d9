"""Innovation gate: normalized squared innovations, their limits, and the noise that they show.

A measurement within the gate has a normalized squared innovation below a chi-square limit. What rejected measurements
mean is decided by `ins_nav.estimation.fault_hypotheses`.
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
_COUNT = 15, 41
"""Least and greatest number of measurements for the estimate of an aid's noise."""
_EXCESS = 4.0
"""Sigmas of the median within which the excess of an aid's noise is chance."""


class NoiseEstimate(NamedTuple):
    """Variance of an aid's noise over the given one, from its last innovations; immutable.

    Attributes
    ----------
    squares : tuple of float
        Normalized squares of the last innovations over the expected median.
    """

    squares: tuple[float, ...] = ()

    def factor(self, size: int) -> float:
        """Estimated variance over the given one; 1 where the excess may be chance."""
        if len(self.squares) < _COUNT[0]:
            return 1.0
        ratio = sorted(self.squares)[len(self.squares) // 2]
        return ratio if ratio > 1.0 + _EXCESS * _median_stddev(size, len(self.squares)) else 1.0

    def including(self, square: float, size: int) -> "NoiseEstimate":
        """With the normalized square of one more innovation of that size."""
        return NoiseEstimate((*self.squares, square / median(size))[-_COUNT[1] :])


@functools.cache
def limit(size: int, probability: float) -> float:
    """Quantile of chi-square that is exceeded with the probability."""
    return float(chi2.isf(probability, size))


@functools.cache
def median(size: int) -> float:
    """Median of chi-square."""
    return float(chi2.median(size))


def square(residual: Array, covariance: Array) -> float:
    """Squared Mahalanobis distance; infinite, never negative, where it overflows."""
    scale = max(1.0, float(np.abs(residual).max()))
    unit = residual / scale
    return float(unit @ np.linalg.solve(covariance, unit)) * scale * scale


@functools.cache
def _median_stddev(size: int, count: int) -> float:
    """Relative sigma of the median of so many chi-square variables, by the density at the median."""
    return float(1.0 / (2.0 * chi2.pdf(median(size), size) * median(size) * math.sqrt(count)))
