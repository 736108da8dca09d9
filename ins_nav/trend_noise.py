"""A trend in coloured noise: level and slope of series of block means, with a covariance that is true.

The noise is not assumed but found: a sum of four processes, whose intensities are fitted by restricted maximum
likelihood, so that weights and covariance are those of the data at hand:

- white noise of the sensor,
- random walk (attitude, from the gyros' white noise),
- jolts: differences of something white that bursts (people moving, doors: velocity, where the series is acceleration),
- waves: second differences of something white (surge and sway: position, which goes nowhere).

References
----------
.. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal",
       Biometrika, 1971, vol. 58 (restricted maximum likelihood).
.. [2] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t distribution",
       Journal of the American Statistical Association, 1989, vol. 84.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

Array = NDArray[np.float64]

_STUDENT_FREEDOM = 3.0
"""Degrees of freedom of the jolts' distribution: finite variance, heavy tails."""
_EXPECTATION_ROUNDS = 4
_STARTS = (np.array([0.5, 0.01, 0.29, 0.2]), np.array([1e-3, 1e-3, 1e-3, 0.997]))
"""Shares of the variance from which the likelihood is climbed: a base at rest, a base on waves."""
_SETTLED = 0.5
"""Largest change of the logarithm of a jolt's scale that needs no further round."""
_CONTRADICTION = 5.0
"""Log-likelihood: the data contradicts a value that costs more (99 % by Wilks' theorem)."""
_ACCEL_EXCESS = math.log(10.0)
"""Accelerometers' noise over whole blocks may exceed what their white noise makes (1/f): logarithm, in variance."""
_LOG_RANGE_WHITE, _LOG_RANGE = 14.0, 25.0
"""How far below the whole variance an intensity is sought."""


def trend_basis(time: Array) -> Array:
    """Columns 1 and t, shape (n, 2)."""
    return np.column_stack([np.ones_like(time), time])


@dataclass(frozen=True)
class TrendFit:
    """Trend of d series, and at the end the part of them that is trend and random walk.

    ``level``, ``slope`` and ``end`` have shape (d,); the variances are those of each series.
    """

    level: Array
    slope: Array
    end: Array
    slope_variance: float
    end_variance: float
    end_slope_covariance: float


class TrendNoise:
    """Covariance of a series of block means: four processes with their intensities.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Middles of the blocks, s from the start.
    total : float
        Length of the data, s.
    intensity : ndarray, shape (4,)
        Of white noise, random walk, jolts and waves.
    jolt_variance : ndarray, shape (n + 1,)
        Of each jolt, at the borders of the blocks: its intensity, more where it was far larger than the rest.
    """

    def __init__(self, time: Array, total: float, intensity: Array, jolt_variance: Array) -> None:
        self._x = trend_basis(time)
        self._end = np.array([1.0, total])
        self._walk = intensity[1] * np.minimum.outer(time, time)
        self._walk_end = intensity[1] * time
        self._walk_total = intensity[1] * total
        kernels = _kernels(time, jolt_variance / intensity[2])
        covariance = sum(s * k for s, k in zip(intensity, kernels, strict=True))
        self._factor = linalg.cho_factor(covariance, lower=True)
        self._weighted = linalg.cho_solve(self._factor, self._x)
        self._trend_covariance = np.linalg.inv(self._x.T @ self._weighted)

    @classmethod
    def of(cls, time: Array, total: float, series: Array, limits: Array) -> "TrendNoise":
        """Intensities from d series that share them, by restricted maximum likelihood ([1]_).

        Jolts come in bursts (a door, a person sitting down): they are given the heavy tails of Student's
        distribution, by expectation maximization over the scale of each ([2]_).

        Parameters
        ----------
        time : ndarray, shape (n,)
            Middles of the blocks, s from the start.
        total : float
            Length of the data, s.
        series : ndarray, shape (n, d)
        limits : ndarray, shape (2,)
            White noise and walk as the sensors' fast noise predicts them, infinite where it does not: their values
            unless the data contradicts that, since short data hardly shows the walk; then, for the walk, its upper
            limit.
        """
        scale = np.ones(len(time) + 1)
        free = min(
            (_restricted_maximum_likelihood(time, series, scale, start, limits, ()) for start in _STARTS),
            key=lambda fit: fit[0],
        )
        for fixed in ((0, 1), (1,), ()):
            if any(math.isinf(limits[process]) for process in fixed):
                continue
            likelihood, intensity = (
                _restricted_maximum_likelihood(time, series, scale, free[1], limits, fixed) if fixed else free
            )
            if likelihood - free[0] < _CONTRADICTION:
                break
        for _ in range(_EXPECTATION_ROUNDS):
            energy = cls(time, total, intensity, intensity[2] * scale)._jolt_energy(series, intensity[2] * scale)
            before = scale
            d = series.shape[1]
            scale = (_STUDENT_FREEDOM + d * energy / intensity[2]) / (_STUDENT_FREEDOM + d)
            if np.abs(np.log(scale / before)).max() < _SETTLED:
                break
            _, intensity = _restricted_maximum_likelihood(time, series, scale, intensity, limits, fixed)
        return cls(time, total, intensity, intensity[2] * scale)

    def _jolt_energy(self, series: Array, variance: Array) -> Array:
        """Expected square of each jolt, mean over the series, given them; shape (n + 1,)."""
        gain = _differences(len(series)) * variance
        projected = linalg.cho_solve(self._factor, gain)
        projected -= self._weighted @ (self._trend_covariance @ (self._weighted.T @ gain))
        jolts = projected.T @ series
        return (jolts**2).mean(axis=1) + variance - (gain * projected).sum(axis=0)

    def fit(self, series: Array) -> TrendFit:
        """Generalized least squares for the trend; the end by kriging of the random walk."""
        level, slope = self._trend_covariance @ (self._weighted.T @ series)
        rest = linalg.cho_solve(self._factor, series - self._x @ np.array([level, slope]))
        gain = linalg.cho_solve(self._factor, self._walk_end)
        left = self._end - self._x.T @ gain
        return TrendFit(
            level,
            slope,
            level + slope * self._end[1] + self._walk_end @ rest,
            float(self._trend_covariance[1, 1]),
            float(self._walk_total - self._walk_end @ gain + left @ self._trend_covariance @ left),
            float((left @ self._trend_covariance)[1]),
        )

    def walk_part(self, series: Array, fit: TrendFit) -> Array:
        """What of the series is trend and random walk, shape (n, d); the rest is noise."""
        trend = self._x @ np.array([fit.level, fit.slope])
        return trend + self._walk @ linalg.cho_solve(self._factor, series - trend)


def _differences(n: int) -> Array:
    """From values at the borders of n blocks to their changes over the blocks, shape (n, n + 1)."""
    return np.eye(n, n + 1, k=1) - np.eye(n, n + 1)


def _kernels(time: Array, jolt_scale: Array) -> list[Array]:
    """Covariances per unit intensity: white, random walk, jolts, waves; each shape (n, n)."""
    n = len(time)
    first = _differences(n)
    second = first @ _differences(n + 1)
    walk = np.minimum.outer(time, time)
    return [np.eye(n), walk, (first * jolt_scale) @ first.T, second @ second.T]


def _restricted_maximum_likelihood(
    time: Array,
    series: Array,
    jolt_scale: Array,
    start: Array,
    limits: Array,
    fixed: tuple[int, ...],
) -> tuple[float, Array]:
    """Negative log-likelihood, and the intensities of the four processes that make it least.

    ``start`` is intensities, or shares of the variance where it has the sum 1; those that are ``fixed`` (0 white
    noise, 1 walk) stay at their limits.
    """
    kernels = _kernels(time, jolt_scale)
    x = trend_basis(time)
    base = np.linalg.qr(x)[0]
    residual = series - base @ (base.T @ series)
    d = series.shape[1]
    variance = float((residual**2).mean()) + 1e-20  # a noiseless simulation
    if abs(start.sum() - 1.0) < 1e-9:
        start = start * variance / [np.diag(k).mean() for k in kernels]

    def negative_likelihood(log_intensity: Array) -> tuple[float, Array]:
        intensity = np.exp(log_intensity)
        covariance = sum(s * k for s, k in zip(intensity, kernels, strict=True))
        factor, _ = linalg.lapack.dpotrf(covariance, lower=1)
        inverse, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        weighted = inverse @ x
        information = x.T @ weighted
        projection = inverse - weighted @ np.linalg.solve(information, weighted.T)
        py = projection @ residual
        log_det = 2.0 * np.log(np.diag(factor)).sum() + np.linalg.slogdet(information)[1]
        value = 0.5 * (d * log_det + (residual * py).sum())
        gradient = [
            0.5 * s * (d * (projection * k).sum() - (py * (k @ py)).sum())
            for s, k in zip(intensity, kernels, strict=True)
        ]
        return float(value), np.array(gradient)

    # A floor keeps the matrix regular; a start near it, where the gradient vanishes, would stay there
    unit = np.log([variance / np.diag(k).mean() for k in kernels])
    low = unit - _LOG_RANGE
    high = unit + 4.0
    low[0] = unit[0] - _LOG_RANGE_WHITE
    limit = np.maximum(np.log(limits + 1e-300), low[:2])
    high[:2] = np.minimum(high[:2], limit + [_ACCEL_EXCESS, 0.0])
    for process in fixed:
        low[process] = high[process] = limit[process]
    best = optimize.minimize(
        negative_likelihood,
        np.clip(np.maximum(np.log(start), unit - 9.0), low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
    )
    return float(best.fun), np.exp(best.x)
