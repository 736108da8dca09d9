"""Where a vehicle is that hardly knows its place, by ranges to one beacon while it moves: a sum of Gaussians.

A range says: somewhere on a circle. A filter that takes it for a straight line believes the wrong side of the circle,
or too little of it, and a second range, some way on, makes it sure of that. So, as long as position is uncertain by
much of the distance, ranges are not given to it; here they are weighed by hypotheses all around the circle, each with a
small covariance of its own ([1]_). Once they have come together in one place, that is a measurement of position. Two
places that are left, to either side of a straight course, stay two.

References
----------
.. [1] D. L. Alspach, H. W. Sorenson, "Nonlinear Bayesian Estimation Using Gaussian Sum Approximations", IEEE
       Transactions on Automatic Control, 1972, vol. 17.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNSURE = 0.2
"""Position is uncertain when its sigma is this share of the distance: the sphere leaves its tangent by a fiftieth of
the distance then."""
_SETTLED = 0.08
"""It is known again when it is this one."""
_AROUND = 360
"""Hypotheses on a circle."""
_OUTLIERS, _SPAN = 0.1, 1000.0
"""Share of ranges that are anything up to so many metres."""
_GATE = 16.0
"""Square of sigmas: a hypothesis takes no range that is further off."""
_LEAST = 1e-7
"""Weight, of the greatest, of a hypothesis that is given up."""
_LOST = 6
"""Ranges in a row that suit no hypothesis: the first one was an outlier, and it begins again."""


class RangeSearch:
    """Hypotheses of the error of position: true less computed, on two horizontal axes.

    Attributes
    ----------
    weights : ndarray, shape (k,)
        Their sum is 1; empty before the first range.
    offsets : ndarray, shape (k, 2)
        m.
    covariances : ndarray, shape (k, 2, 2)
        m².
    """

    def __init__(self) -> None:
        self.weights: Array = np.empty(0)
        self.offsets: Array = np.empty((0, 2))
        self.covariances: Array = np.empty((0, 2, 2))
        self._prior: Array = np.zeros((2, 2))
        self._misfits = 0

    def moved(self, east: float, north: float) -> None:
        """The computed position has been corrected by so much, on the two axes, m."""
        self.offsets = self.offsets - [east, north]

    def add(self, away: Array, distance: float, variance: float, covariance: Array) -> None:
        """Take a range.

        Parameters
        ----------
        away : ndarray, shape (3,)
            From the beacon to the computed position, the third axis up, m.
        distance : float
            m.
        variance : float
            m², with all that may be wrong with the range.
        covariance : ndarray, shape (2, 2)
            Of the computed position, m².
        """
        flat = math.sqrt(max(distance**2 - away[2] ** 2, 0.0))
        if len(self.weights):
            growth = covariance - self._prior  # the way since has errors of its own
            values, vectors = np.linalg.eigh(growth)
            self.covariances = self.covariances + (vectors * np.maximum(values, 0.0)) @ vectors.T
            self._update(away, distance, variance)
        if not len(self.weights) and flat > 0.0:
            self._begin(away, distance, variance, flat, covariance)
        self._prior = covariance

    def _begin(self, away: Array, distance: float, variance: float, flat: float, covariance: Array) -> None:
        angle = np.arange(_AROUND) * (2.0 * math.pi / _AROUND)
        out = np.column_stack([np.cos(angle), np.sin(angle)])
        along = np.column_stack([-out[:, 1], out[:, 0]])
        spacing = 2.0 * math.pi * flat / _AROUND
        self.offsets = flat * out - away[:2]
        radial = variance * (distance / flat) ** 2
        self.covariances = (
            radial * out[:, :, None] * out[:, None, :] + spacing**2 * along[:, :, None] * along[:, None, :]
        )
        square = np.einsum("ki,ij,kj->k", self.offsets, np.linalg.inv(covariance), self.offsets)
        weights = np.exp(-0.5 * (square - square.min()))
        self.weights = weights / weights.sum()
        self._misfits = 0

    def _update(self, away: Array, distance: float, variance: float) -> None:
        place = self.offsets + away[:2]
        length = np.sqrt((place**2).sum(axis=1) + away[2] ** 2)
        h = place / length[:, None]
        seen = np.einsum("kij,kj->ki", self.covariances, h)
        s = np.einsum("ki,ki->k", h, seen) + variance
        residual = distance - length
        square = residual**2 / s
        likelihood = (1.0 - _OUTLIERS) * np.exp(-0.5 * square) / np.sqrt(2.0 * math.pi * s) + _OUTLIERS / _SPAN
        suits = float(self.weights @ (square < _GATE))
        self._misfits = 0 if suits > 0.01 else self._misfits + 1
        if self._misfits >= _LOST:
            self.weights = np.empty(0)
            return
        gain = np.where((square < _GATE)[:, None], seen / s[:, None], 0.0)
        self.offsets = self.offsets + gain * residual[:, None]
        self.covariances = self.covariances - gain[:, :, None] * seen[:, None, :]
        weights = self.weights * likelihood
        kept = weights > _LEAST * weights.max()
        self.weights = weights[kept] / weights[kept].sum()
        self.offsets, self.covariances = self.offsets[kept], self.covariances[kept]

    def settled(self, away: Array) -> tuple[Array, Array] | None:
        """Mean offset and covariance of all hypotheses, once they are close together; None before."""
        if not len(self.weights):
            return None
        mean = self.weights @ self.offsets
        spread = self.offsets - mean
        covariance = np.einsum("k,kij->ij", self.weights, self.covariances)
        covariance = covariance + np.einsum("k,ki,kj->ij", self.weights, spread, spread)
        place = np.array([*(mean + away[:2]), away[2]])
        if float(np.linalg.eigvalsh(covariance)[1]) > _SETTLED**2 * float(place @ place):
            return None
        return mean, covariance


def uncertain(covariance: Array, away: Array) -> bool:
    """Whether a range of such a direction is no straight line for a position of such a covariance, both as in `add`."""
    return float(np.linalg.eigvalsh(covariance)[1]) > UNSURE**2 * float(away @ away)
