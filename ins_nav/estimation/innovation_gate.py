"""What an aid's measurements have been like: which are believed, and how far.

A good measurement is within the gate: its normalized square is below what chance exceeds rarely. Of those outside,
`Track` tells single outliers from an aid that has something to say against the filter, and it learns how much more
noise there is than an aid admits.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

GATE = 1e-4
"""Probability with which a good measurement is rejected."""
PATIENCE = 60.0
"""s without an accepted measurement of an aid, after which its agreement with itself counts for more than the gate."""
AGREEING = 8
"""Rejected measurements in a row that must agree with each other then."""

_GROWN = 5.0
"""So many times its sigma of before, what an aid measures is not known any more: patience has an end then, too."""
_SEEN = 15, 41
"""Measurements of an aid, at least and at most, by which its noise is judged."""
_FAR = 4.0
"""A test ratio above it is a jump, not a filter that has left: twice as far as the gate is wide."""
_EXCESS = 4.0
"""Sigmas of a median: by less than that an aid's noise may exceed what it says by chance."""
_LONG_NS = 2**62
"""ns: longer than anybody waits."""


class Track(NamedTuple):
    """History of an aid; what is added makes another.

    A row of `AGREEING` rejected measurements that lie on a straight line is believed

    - when it began near the gate (the filter has drifted), as soon as the filter has become unsure, or after patience;
    - when it began far away (one of the two has jumped), after patience only; and until then not at all, even if the
      filter becomes so unsure that it lies within the gate.

    Attributes
    ----------
    accepted_ns : int or None
        Stamp of the last measurement accepted; None: none was.
    rejected : tuple of (stamp, innovation)
        The last few rejected since.
    variance : float
        Predicted, of what it measures (its trace), when one was last accepted.
    drifts : bool
        They began with one just outside the gate: no jump, but a filter that has lost its way.
    squares : tuple of float
        Normalized squares of the last innovations a degree of freedom, over the median that they should have.
    """

    accepted_ns: int | None = None
    rejected: tuple[tuple[int, Array], ...] = ()
    variance: float = math.inf
    drifts: bool = False
    squares: tuple[float, ...] = ()

    def noise_factor(self, size: int) -> float:
        """By how much an aid's variance is larger than it says; 1 where that may be chance."""
        if len(self.squares) < _SEEN[0]:
            return 1.0
        ratio = sorted(self.squares)[len(self.squares) // 2]
        return ratio if ratio > 1.0 + _EXCESS * _median_stddev(size, len(self.squares)) else 1.0

    def seen(self, square: float, size: int) -> "Track":
        """One more normalized square, of an innovation of that size, by which noise is judged."""
        return self._replace(squares=(*self.squares, square / median(size))[-_SEEN[1] :])

    def rejecting(self, stamp_ns: int, innovation: Array, ratio: float) -> "Track":
        """One more rejected, with its test ratio."""
        drifts = self.drifts if self.rejected else ratio < _FAR
        return self._replace(rejected=(*self.rejected, (stamp_ns, innovation))[-AGREEING:], drifts=drifts)

    def accepting(self, stamp_ns: int, variance: float) -> "Track":
        """One accepted, after which what it measures is that certain."""
        return Track(stamp_ns, (), variance, False, self.squares)

    def goes_on(self, innovation: Array, r: Array) -> bool:
        """Whether a measurement says what a row of rejected ones has said, far from the filter at once.

        Such a one does not become right because the filter is less certain meanwhile.
        """
        if self.drifts or not self._is_row(len(innovation)):
            return False
        count = len(self.rejected)
        away = innovation - np.mean([z for _, z in self.rejected], axis=0)
        square = float(away @ np.linalg.solve((1.0 + 1.0 / count) * r, away))
        return square < limit(len(innovation), GATE)

    def stands_alone(self, r: Array, variance: float, patience: float) -> bool:
        """Whether an aid was out for its patience, and what it says lies on a straight line.

        Parameters
        ----------
        r : ndarray, shape (m, m)
            Covariance of its noise.
        variance : float
            Predicted at present, of what it measures (its trace).
        patience : float
            s; 0: never; infinite: never, where one of the two has jumped.
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
        # three sigma, and for those who think too well of themselves a tenth of the jump
        return float(np.einsum("ij,jk,ik->", scatter, inverse, scatter)) / values.size < max(9.0, 0.01 * jump)

    def _is_row(self, size: int) -> bool:
        return len(self.rejected) == AGREEING and all(len(z) == size for _, z in self.rejected)


@functools.cache
def limit(size: int, probability: float) -> float:
    """Chi-square that is exceeded with the probability."""
    return float(chi2.isf(probability, size))


@functools.cache
def median(size: int) -> float:
    """Of chi-square."""
    return float(chi2.median(size))


@functools.cache
def _median_stddev(size: int, count: int) -> float:
    """Of the median of so many chi-squares over what it should be, by the density there."""
    return float(1.0 / (2.0 * chi2.pdf(median(size), size) * median(size) * math.sqrt(count)))


def line(points: tuple[tuple[int, Array], ...]) -> tuple[Array, float, Array]:
    """Straight line through measurements: its slope a second, variance of that for unit noise, deviations from it."""
    time = np.array([(stamp - points[0][0]) * 1e-9 for stamp, _ in points])
    values = np.array([z for _, z in points])
    time -= time.mean()
    deviations = values - values.mean(axis=0)
    total = float(time @ time)
    if total == 0.0:
        return np.zeros(values.shape[1]), math.inf, deviations
    slope = time @ deviations / total
    return slope, 1.0 / total, deviations - np.outer(time, slope)
