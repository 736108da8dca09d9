"""Position by ranges to beacons from a moving vehicle with a large position sigma: a sum of Gaussians.

A range is a circle. A linear filter that uses it as a straight line becomes certain of a wrong place. While the sigma
of position is a large part of the distance, the filter therefore uses no single range; ranges weigh hypotheses all
around the circle of the first one, each with a small covariance ([1]_). Ranges to all beacons weigh the same ones.
Errors common to all ranges to a beacon, an offset and the error of the beacon's position, are states of each
hypothesis, so that many ranges do not average them.

The hypotheses are the likelihood of the ranges alone. `RangeSearch.settled` multiplies it by the filter's present
position; once the product is one place, the likelihood near it is a measurement for the filter. It does not
contain the filter's position, which the update would count twice otherwise. Two positions to either side of a straight
course remain two.

References
----------
.. [1] D. L. Alspach, H. W. Sorenson, "Nonlinear Bayesian Estimation Using Gaussian Sum Approximations", IEEE
       Transactions on Automatic Control, 1972, vol. 17.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNSURE = 0.2
"""Position is uncertain when its sigma is this share of the distance: the sphere leaves its tangent by a fiftieth of
the distance then."""
_SETTLED = 0.08
"""Position is certain again when its sigma is this share."""
_ELSEWHERE = 3.0, 1e-4
"""Sigmas of that size, and the weight beyond them at which there is a second place."""
_AROUND = 360
"""Hypotheses on a circle."""
_OUTLIERS, _SPAN = 0.1, 1000.0
"""Share of ranges that are anything up to so many metres."""
_GATE = 16.0
"""Square of sigmas: a hypothesis is not updated by a range that is further off."""
_LEAST = 1e-12
"""Weight, of the greatest, below which a hypothesis is discarded."""
_DOUBT, _CONFIRMED, _LOST = 2.0, 1.0, 6.0
"""Whether the first range, on which all hypotheses lie, was an outlier: at the start, at most where a place is found,
and where the search restarts. A later range to that beacon adds 1 where no hypothesis fits it, else subtracts 0.5."""
_RANGES = 8
"""Least number of ranges that determine a position."""
_SILENT = 20
"""Ranges to other beacons after which the first beacon is out of reach: the search begins again."""
_UNKNOWN = 1e-9
"""Information, of the greatest, below which the ranges do not observe a direction."""
_OF_BEACON = 3
"""States of a beacon in a hypothesis: error of its place, two horizontal axes, and offset of its ranges."""


@dataclass(frozen=True)
class BeaconErrors:
    """Errors common to all ranges to one beacon.

    Attributes
    ----------
    place : ndarray, shape (2, 2)
        Covariance of the beacon's computed place on the horizontal axes, m².
    offset : float
        Variance of the offset of its ranges, m².
    names : tuple of str
        Aids whose states in the filter these errors are.
    columns : ndarray, shape (3, k)
        Of these states, on the place, two axes, and on the offset.
    """

    place: Array
    offset: float
    names: tuple[str, ...]
    columns: Array


class Likelihood(NamedTuple):
    """Linear measurements ``z = rows s + noise`` of s: errors of position and of each beacon, true less computed.

    Attributes
    ----------
    z : ndarray, shape (m,)
    position : ndarray, shape (m, 2)
        Columns of position.
    beacons : tuple of (BeaconErrors, ndarray of shape (m, 3))
        Columns of each beacon's place, two axes, and of the offset of its ranges.
    variance : ndarray, shape (m,)
        Of the noise, which is independent.
    """

    z: Array
    position: Array
    beacons: tuple[tuple[BeaconErrors, Array], ...]
    variance: Array


class RangeSearch:
    """Hypotheses of the errors of position and of beacons: true less computed, m, on two horizontal axes.

    Attributes
    ----------
    weights : ndarray, shape (k,)
        Their sum is 1; empty before the first range.
    means : ndarray, shape (k, n)
        Position, then three states a beacon.
    covariances : ndarray, shape (k, n, n)
        m².
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Discard all ranges."""
        self.weights: Array = np.empty(0)
        self.means: Array = np.empty((0, 2))
        self.covariances: Array = np.empty((0, 2, 2))
        self._beacons: dict[str, BeaconErrors] = {}
        self._position: Array = np.zeros((2, 2))
        self._doubt = _DOUBT
        self._count = self._others = 0

    def __contains__(self, beacon: str) -> bool:
        return beacon in self._beacons

    def moved(self, x: float, y: float) -> None:
        """Shift all hypotheses by a correction of the computed position along the two axes, m."""
        self.means[:, :2] -= [x, y]

    def add(
        self, beacon: str, away: Array, distance: float, variance: float, position: Array, errors: BeaconErrors
    ) -> None:
        """Add a range.

        Parameters
        ----------
        beacon : str
            Its name.
        away : ndarray, shape (3,)
            From the beacon to the computed position, the third axis up, m.
        distance : float
            m, the known offset removed.
        variance : float
            Of its noise, m².
        position : ndarray, shape (2, 2)
            Covariance of the computed position, m².
        errors : BeaconErrors
        """
        if len(self.weights):
            self._grow(slice(0, 2), position - self._position)  # the way since has errors of its own
            if beacon not in self._beacons:
                self._append(errors)
            else:
                self._grow(self._slice(beacon), errors.place - self._beacons[beacon].place)
            self._beacons[beacon] = errors
            self._update(beacon, away, distance, variance)
        flat = math.sqrt(max(distance**2 - away[2] ** 2, 0.0))
        if not len(self.weights) and flat > 0.0:
            self._begin(away, distance, variance, flat, errors)
            self._beacons = {beacon: errors}
        self._position = position

    def _slice(self, beacon: str) -> slice:
        """Of the beacon's place."""
        begin = 2 + _OF_BEACON * list(self._beacons).index(beacon)
        return slice(begin, begin + 2)

    def _grow(self, states: slice, growth: Array) -> None:
        values, vectors = np.linalg.eigh(growth)
        self.covariances[:, states, states] += (vectors * np.maximum(values, 0.0)) @ vectors.T

    def _append(self, errors: BeaconErrors) -> None:
        count, size = self.means.shape
        self.means = np.hstack([self.means, np.zeros((count, _OF_BEACON))])
        covariances = np.zeros((count, size + _OF_BEACON, size + _OF_BEACON))
        covariances[:, :size, :size] = self.covariances
        covariances[:, size : size + 2, size : size + 2] = errors.place
        covariances[:, size + 2, size + 2] = errors.offset
        self.covariances = covariances

    def _begin(self, away: Array, distance: float, variance: float, flat: float, errors: BeaconErrors) -> None:
        angle = np.arange(_AROUND) * (2.0 * math.pi / _AROUND)
        out = np.column_stack([np.cos(angle), np.sin(angle)])
        along = np.column_stack([-out[:, 1], out[:, 0]])
        self.means = np.zeros((_AROUND, 2 + _OF_BEACON))
        self.means[:, :2] = flat * out - away[:2]
        # from place and offset of the beacon, noise of the range, and what lies between two hypotheses, to the states
        sources = np.zeros((_AROUND, 2 + _OF_BEACON, 5))
        sources[:, :2, 0:2] = sources[:, 2:4, 0:2] = np.eye(2)
        sources[:, :2, 2] = sources[:, :2, 3] = -distance / flat * out
        sources[:, 4, 2] = 1.0
        sources[:, :2, 4] = along
        covariance = np.zeros((5, 5))
        covariance[:2, :2] = errors.place
        covariance[2, 2], covariance[3, 3] = errors.offset, variance
        covariance[4, 4] = (2.0 * math.pi * flat / _AROUND) ** 2
        self.covariances = sources @ covariance @ sources.transpose(0, 2, 1)
        self.weights = np.full(_AROUND, 1.0 / _AROUND)
        self._doubt = _DOUBT
        self._count, self._others = 1, 0

    def _update(self, beacon: str, away: Array, distance: float, variance: float) -> None:
        place = self._slice(beacon)
        flat = away[:2] + self.means[:, :2] - self.means[:, place]
        length = np.sqrt((flat**2).sum(axis=1) + away[2] ** 2)
        h = np.zeros_like(self.means)
        h[:, :2] = flat / length[:, None]
        h[:, place] = -h[:, :2]
        h[:, place.stop] = 1.0
        ph = np.einsum("kij,kj->ki", self.covariances, h)
        s = np.einsum("ki,ki->k", h, ph) + variance
        residual = distance - length - self.means[:, place.stop]
        square = residual**2 / s
        likelihood = (1.0 - _OUTLIERS) * np.exp(-0.5 * square) / np.sqrt(2.0 * math.pi * s) + _OUTLIERS / _SPAN
        self._count += 1
        self._others += 1
        if beacon == next(iter(self._beacons)):
            self._others = 0
            suits = float(self.weights @ (square < _GATE)) > 0.01
            self._doubt = max(0.0, self._doubt - 0.5) if suits else self._doubt + 1.0
        if self._doubt >= _LOST or self._others >= _SILENT:
            self.restart()
            return
        gain = np.where((square < _GATE)[:, None], ph / s[:, None], 0.0)
        self.means = self.means + gain * residual[:, None]
        self.covariances = self.covariances - gain[:, :, None] * ph[:, None, :]
        weights = self.weights * likelihood
        kept = weights > _LEAST * weights.max()
        self.weights = weights[kept] / weights[kept].sum()
        self.means, self.covariances = self.means[kept], self.covariances[kept]

    def settled(self, away: Array, position: Array) -> Likelihood | None:
        """The ranges as a measurement, once they and the computed position determine one place; None before.

        Parameters
        ----------
        away : ndarray, shape (3,)
            From the beacon of the last range to the computed position, m: the scale of what is close together.
        position : ndarray, shape (2, 2)
            Covariance of the computed position, m².
        """
        if self._count < _RANGES or self._doubt > _CONFIRMED:
            return None
        weights, means, covariances = self._times(position)
        mean = weights @ means
        spread = means - mean
        covariance = np.einsum("k,kij->ij", weights, covariances) + np.einsum("k,ki,kj->ij", weights, spread, spread)
        near = _SETTLED * float(np.linalg.norm(away + [*mean[:2], 0.0]))
        elsewhere = float(weights @ (np.hypot(spread[:, 0], spread[:, 1]) > _ELSEWHERE[0] * near))
        if float(np.linalg.eigvalsh(covariance[:2, :2])[1]) > near**2 or elsewhere > _ELSEWHERE[1]:
            return None
        prior = np.zeros_like(covariance)
        prior[:2, :2] = position
        for name, errors in self._beacons.items():
            states = self._slice(name)
            prior[states, states], prior[states.stop, states.stop] = errors.place, errors.offset
        known = np.flatnonzero(prior.diagonal() > 0.0)  # a moored beacon's place has no error
        block = np.ix_(known, known)
        posterior = np.linalg.inv(covariance[block])
        values, vectors = np.linalg.eigh(posterior - np.linalg.inv(prior[block]))
        observed = values > _UNKNOWN * values[-1]
        rows = np.zeros((int(observed.sum()), len(mean)))
        rows[:, known] = vectors[:, observed].T
        z = vectors[:, observed].T @ posterior @ mean[known] / values[observed]
        columns = np.split(rows[:, 2:], len(self._beacons), axis=1)
        beacons = tuple(zip(self._beacons.values(), columns, strict=True))
        return Likelihood(z, rows[:, :2], beacons, 1.0 / values[observed])

    def _times(self, position: Array) -> tuple[Array, Array, Array]:
        """Weights, means and covariances of the hypotheses times the computed position, which has that covariance."""
        s = self.covariances[:, :2, :2] + position
        gain = np.linalg.solve(s, self.covariances[:, :2, :]).transpose(0, 2, 1)
        means = self.means - np.einsum("kij,kj->ki", gain, self.means[:, :2])
        covariances = self.covariances - gain @ self.covariances[:, :2, :]
        square = np.einsum("ki,ki->k", self.means[:, :2], np.linalg.solve(s, self.means[:, :2, None])[:, :, 0])
        weights = self.weights * np.exp(-0.5 * (square - square.min())) / np.sqrt(np.linalg.det(s))
        return weights / weights.sum(), means, covariances


def uncertain(covariance: Array, away: Array) -> bool:
    """Whether a place with that covariance, shape (2, 2), m², is too uncertain for a linear range in that direction."""
    return float(np.linalg.eigvalsh(covariance)[1]) > UNSURE**2 * float(away @ away)
