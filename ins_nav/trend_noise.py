"""A trend in coloured noise: level and slope of series of block means, with a covariance that is true.

The noise is not assumed but found: a sum of processes, whose parameters are fitted by restricted maximum likelihood, so
that weights and covariance are those of the data at hand:

- white noise of the sensor,
- random walk (attitude, from the gyros' white noise),
- jolts: differences of something white that bursts (people moving, doors: velocity, where the series is acceleration),
- waves: second differences of something white (surge and sway: position, which goes nowhere),
- swell, where the data shows it: differences of a velocity whose spectrum is a band of Gaussian shape. It remembers
  for longer than a block, a sinusoid for ever. Taken for white it would pass into level and slope unseen; known for
  what it is, it is told from them.

References
----------
.. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal",
       Biometrika, 1971, vol. 58 (restricted maximum likelihood).
.. [2] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t distribution",
       Journal of the American Statistical Association, 1989, vol. 84.
.. [3] A. G. Wilson, R. P. Adams, "Gaussian process kernels for pattern discovery and extrapolation", Proceedings of
       the 30th International Conference on Machine Learning, 2013 (the covariance of such a band).
.. [4] R. N. Kackar, D. A. Harville, "Approximations for standard errors of estimators of fixed and random effects in
       mixed linear models", Journal of the American Statistical Association, 1984, vol. 79.
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
_SWELL_GAIN = 15.0
"""Log-likelihood that swell must gain to be believed. Wilks' theorem asks for 8 (three parameters, 1 in 1000); many
frequencies are tried."""
_SWELL_FREQUENCIES, _SWELL_BANDWIDTHS = 16, (0.02, 0.3)
"""Where the climb may begin: how many frequencies, and shares of them."""
_QUIET = 1e-3
"""Share of jolts and waves that swell is supposed to leave, there."""
_LOG_RANGE_SWELL = 12.0
"""How far below its first variance that of swell is sought."""
_LINE = 0.003
"""rad: a narrower band than this over the length of the data is a sinusoid."""
_PARAMETER_STDDEV = 2.0
"""Of the logarithm of a parameter that the data says nothing of."""
_DOUBTFUL, _BISECTIONS = 2.0, 6
"""Log-likelihood: a value that costs less may be true (95 % by Wilks' theorem); steps to find the greatest."""
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
    """Covariance of a series of block means: processes with their parameters.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Middles of the blocks, s from the start.
    total : float
        Length of the data, s.
    parameters : ndarray, shape (4,) or (7,)
        Intensities of white noise, random walk, jolts and waves; of swell, where there is any, variance of velocity
        (in units of the series times a block), frequency and bandwidth, rad/s.
    jolt_scale : ndarray, shape (n + 1,)
        Variance of each jolt, at the borders of the blocks, over their intensity: more than 1 where one was far
        larger than the rest.

    Attributes
    ----------
    sensor_noise : ndarray, shape (2,)
        Intensities of white noise and walk; from `of`, the most that they may be: what vibration and quantization
        add to the sensors' fast noise does not grow as theirs does.
    """

    def __init__(self, time: Array, total: float, parameters: Array, jolt_scale: Array) -> None:
        self._time, self._parameters, self._jolt_scale = time, parameters, jolt_scale
        self.sensor_noise: Array = parameters[:2].copy()
        self._x = trend_basis(time)
        self._end = np.array([1.0, total])
        self._walk_end = parameters[1] * time
        self._walk_total = parameters[1] * total
        covariance = sum(_derivatives(time, parameters, jolt_scale)[:5])
        self._factor = linalg.cho_factor(covariance, lower=True)
        self._weighted = linalg.cho_solve(self._factor, self._x)
        self._trend_covariance = np.linalg.inv(self._x.T @ self._weighted)

    @classmethod
    def of(cls, time: Array, total: float, series: Array, limits: Array) -> "TrendNoise":
        """Parameters from d series that share them, by restricted maximum likelihood ([1]_).

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
        with_swell = _restricted_maximum_likelihood(
            time, series, scale, _start_with_swell(time, series, free[1]), limits, ()
        )
        if free[0] - with_swell[0] > _SWELL_GAIN:
            free = with_swell
        for fixed in ((0, 1), (1,), ()):
            if any(math.isinf(limits[process]) for process in fixed):
                continue
            likelihood, parameters = (
                _restricted_maximum_likelihood(time, series, scale, free[1], limits, fixed) if fixed else free
            )
            if likelihood - free[0] < _CONTRADICTION:
                break
        for _ in range(_EXPECTATION_ROUNDS):
            energy = cls(time, total, parameters, scale)._jolt_energy(series)
            before = scale
            d = series.shape[1]
            scale = (_STUDENT_FREEDOM + d * energy / parameters[2]) / (_STUDENT_FREEDOM + d)
            if np.abs(np.log(scale / before)).max() < _SETTLED:
                break
            _, parameters = _restricted_maximum_likelihood(time, series, scale, parameters, limits, fixed)
        noise = cls(time, total, parameters, scale)
        for process in (0, 1):
            if not math.isinf(limits[process]):
                noise.sensor_noise[process] = _greatest(process, time, series, scale, free[1], limits)
        return noise

    def _jolt_energy(self, series: Array) -> Array:
        """Expected square of each jolt, mean over the series, given them; shape (n + 1,)."""
        variance = self._parameters[2] * self._jolt_scale
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
        slope_variance = self._trend_covariance[1, 1]
        end_variance = self._walk_total - self._walk_end @ gain + left @ self._trend_covariance @ left
        cross = (left @ self._trend_covariance)[1]
        if len(self._parameters) > 4:
            weights = self._weighted @ self._trend_covariance @ np.column_stack([[0.0, 1.0], left])
            weights[:, 1] += gain
            more = self._by_parameters(weights, series)
            slope_variance, cross, end_variance = (
                slope_variance + more[0, 0],
                cross + more[0, 1],
                end_variance + more[1, 1],
            )
        return TrendFit(
            level,
            slope,
            level + slope * self._end[1] + self._walk_end @ rest,
            float(slope_variance),
            float(end_variance),
            float(cross),
        )

    def _by_parameters(self, weights: Array, series: Array) -> Array:
        """Covariance that slope and end have from the parameters' own errors ([4]_), shape (2, 2).

        The band's shape is assumed. More samples than two a period tell its edges by that assumption only, not by
        what waves there were: they count for no more than two.
        """
        n, d = series.shape
        inverse = linalg.cho_solve(self._factor, np.eye(n))
        projection = inverse - self._weighted @ self._trend_covariance @ self._weighted.T
        derivatives = _derivatives(self._time, self._parameters, self._jolt_scale)
        py = projection @ series
        change = np.array([weights.T @ (k @ py) for k in derivatives])
        change[1, 1] -= self._walk_end @ py
        scaled = [projection @ k for k in derivatives]
        information = 0.5 * d * np.array([[np.vdot(a, b.T) for b in scaled] for a in scaled])
        highest = self._parameters[5] + 2.0 * self._parameters[6]
        counting = min(1.0, highest * (self._time[-1] - self._time[0]) / (math.pi * n))
        covariance = np.linalg.inv(counting * information + np.eye(len(scaled)) / _PARAMETER_STDDEV**2)
        return np.asarray(np.einsum("iad,ij,jbd->ab", change, covariance, change) / d)

    def velocity(self, series: Array, fit: TrendFit) -> tuple[Array, float]:
        """Motion in a series of accelerations: velocity of jolts, waves and swell by kriging.

        Returns
        -------
        velocity : ndarray, shape (n + 1, d)
            At the borders of the blocks, in units of the series times a block.
        variance : float
            Of the last.
        """
        p = self._parameters
        second = _differences(len(self._time) + 1)
        covariance = np.diag(p[2] * self._jolt_scale) + p[3] * second @ second.T
        if len(p) > 4:
            covariance += p[4] * linalg.toeplitz(_swell(self._time, p[5], p[6])[0])
        shown = _differences(len(self._time)) @ covariance
        velocity = shown.T @ linalg.cho_solve(self._factor, series - self._x @ np.array([fit.level, fit.slope]))
        weights = linalg.cho_solve(self._factor, shown[:, -1])
        by_trend = self._x.T @ weights
        variance = covariance[-1, -1] - shown[:, -1] @ weights + by_trend @ self._trend_covariance @ by_trend
        return velocity, float(variance)


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


def _swell(time: Array, frequency: float, bandwidth: float) -> Array:
    """Covariance of velocity at the borders of the blocks, of variance 1; shape (3, n + 1), by lag ([3]_).

    The rows below are its derivatives by the logarithms of frequency and bandwidth.
    """
    n = len(time)
    lag = np.arange(n + 1) * (time[-1] - time[0]) / (n - 1)
    angle, spread = frequency * lag, (bandwidth * lag) ** 2
    decay = np.exp(-0.5 * spread)
    covariance = decay * np.cos(angle)
    return np.array([covariance, -angle * decay * np.sin(angle), -spread * covariance])


def _differenced(covariance: Array) -> Array:
    """From covariances by lag, shape (..., n + 1), to those of the differences, shape (..., n)."""
    mirrored = np.concatenate([covariance[..., 1:2], covariance], axis=-1)
    return 2.0 * mirrored[..., 1:-1] - mirrored[..., :-2] - mirrored[..., 2:]


def _derivatives(time: Array, parameters: Array, jolt_scale: Array) -> list[Array]:
    """Of the covariance by the logarithms of the parameters; the first five are the parts that it is the sum of."""
    parts = [s * k for s, k in zip(parameters[:4], _kernels(time, jolt_scale), strict=True)]
    if len(parameters) > 4:
        variance, frequency, bandwidth = parameters[4:]
        parts += [variance * linalg.toeplitz(row) for row in _differenced(_swell(time, frequency, bandwidth))]
    return parts


def _start_with_swell(time: Array, series: Array, parameters: Array) -> Array:
    """Parameters to climb the likelihood from, those given with swell: the best of a grid, shape (7,)."""
    n, d = series.shape
    quiet = parameters * [1.0, 1.0, _QUIET, _QUIET]
    x = trend_basis(time)
    residual, variance = _without_trend(x, series)
    rest = sum(_derivatives(time, quiet, np.ones(n + 1))) + 1e-9 * variance * np.eye(n)
    highest = math.pi * n / (time[-1] - time[0])
    trials = []
    for frequency in np.geomspace(highest / n, 0.9 * highest, _SWELL_FREQUENCIES):
        for share in _SWELL_BANDWIDTHS:
            lags = _differenced(_swell(time, frequency, share * frequency)[0])
            swell = [variance / lags[0], frequency, share * frequency]
            factor, _ = linalg.lapack.dpotrf(rest + linalg.toeplitz(swell[0] * lags), lower=1)
            whitened = linalg.solve_triangular(factor, np.column_stack([x, residual]), lower=True)
            q, r = np.linalg.qr(whitened[:, :2])
            left = whitened[:, 2:] - q @ (q.T @ whitened[:, 2:])
            log_det = np.log(np.diag(factor)).sum() + np.log(np.abs(np.diag(r))).sum()
            trials.append((d * log_det + 0.5 * (left**2).sum(), *swell))
    return np.concatenate([quiet, min(trials)[1:]])


def _greatest(process: int, time: Array, series: Array, jolt_scale: Array, parameters: Array, limits: Array) -> float:
    """The most that white noise (0) or walk (1) may be, up to its limit, that the data does not contradict."""

    def likelihood(logarithm: float) -> float:
        tried = limits.copy()
        tried[process] = math.exp(logarithm)
        return _restricted_maximum_likelihood(time, series, jolt_scale, parameters, tried, (process,))[0]

    high = math.log(limits[process] + 1e-300)
    low = min(high, math.log(parameters[process]))
    best = likelihood(low)
    if likelihood(high) - best < _DOUBTFUL:
        return math.exp(high)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if likelihood(middle) - best < _DOUBTFUL:
            low = middle
        else:
            high = middle
    return math.exp(low)


def _without_trend(x: Array, series: Array) -> tuple[Array, float]:
    """Residual of least squares, shape (n, d), and its variance: not zero for a simulation without noise."""
    base = np.linalg.qr(x)[0]
    residual = series - base @ (base.T @ series)
    return residual, float((residual**2).mean()) + 1e-20


def _restricted_maximum_likelihood(
    time: Array,
    series: Array,
    jolt_scale: Array,
    start: Array,
    limits: Array,
    fixed: tuple[int, ...],
) -> tuple[float, Array]:
    """Negative log-likelihood, and the parameters that make it least, with swell where ``start`` has it.

    ``start`` is parameters, or shares of the variance where it has the sum 1; those that are ``fixed`` (0 white
    noise, 1 walk) stay at their limits.
    """
    kernels = _kernels(time, jolt_scale)
    x = trend_basis(time)
    n, d = series.shape
    residual, variance = _without_trend(x, series)
    if abs(start.sum() - 1.0) < 1e-9:
        start = start * variance / [np.diag(k).mean() for k in kernels]

    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))

    def negative_likelihood(log_parameters: Array) -> tuple[float, Array]:
        p = np.exp(log_parameters)
        covariance = sum(s * k for s, k in zip(p[:4], kernels, strict=True))
        if len(p) > 4:
            swell = p[4] * _differenced(_swell(time, p[5], p[6]))
            covariance += swell[0][lag]
        factor, _ = linalg.lapack.dpotrf(covariance, lower=1)
        inverse, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        weighted = inverse @ x
        information = x.T @ weighted
        projection = inverse - weighted @ np.linalg.solve(information, weighted.T)
        py = projection @ residual
        log_det = 2.0 * np.log(np.diag(factor)).sum() + np.linalg.slogdet(information)[1]
        value = 0.5 * (d * log_det + (residual * py).sum())
        by_covariance = 0.5 * (d * projection - py @ py.T)
        gradient = [s * np.vdot(by_covariance, k) for s, k in zip(p[:4], kernels, strict=True)]
        if len(p) > 4:
            gradient += (swell @ np.bincount(lag.ravel(), by_covariance.ravel())).tolist()
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
    begin = np.log(start)
    begin[:4] = np.maximum(begin[:4], unit - 9.0)
    if len(start) > 4:
        span = time[-1] - time[0]
        low = np.concatenate([low, [begin[4] - _LOG_RANGE_SWELL], np.log([2.0 / span, _LINE / span])])
        high = np.concatenate([high, [begin[4] + 4.0], np.log([math.pi * n / span] * 2)])
    best = optimize.minimize(
        negative_likelihood,
        np.clip(begin, low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
    )
    return float(best.fun), np.exp(best.x)
