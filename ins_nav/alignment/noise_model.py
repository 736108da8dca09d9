"""A trend in coloured noise: level and slope of series of block means, with a consistent covariance.

The noise is identified from the data: a sum of processes, whose parameters are fitted by restricted maximum likelihood
and determine weights and covariance:

- white noise of the sensor,
- random walk (attitude, from the gyros' white noise),
- jolts: differences of something white that bursts (people moving, doors: velocity, where the series is acceleration),
- waves: second differences of something white (surge and sway: position, which stays bounded),
- swell, where the likelihood supports it: differences of a velocity whose spectrum is a band of Gaussian shape. It is
  correlated for longer than a block, a sinusoid without limit. Modelled as white it would bias level and slope
  without an effect on their sigmas.

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
.. [5] A. R. Gilmour, R. Thompson, B. R. Cullis, "Average information REML: an efficient algorithm for variance
       parameter estimation in linear mixed models", Biometrics, 1995, vol. 51.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]

_STUDENT_FREEDOM = 3.0
"""Degrees of freedom of the jolts' distribution: finite variance, heavy tails."""
_EXPECTATION_ROUNDS = 4
_STARTS = (np.array([0.5, 0.01, 0.29, 0.2]), np.array([1e-3, 1e-3, 1e-3, 0.997]))
"""Shares of the variance at which maximization starts: a base at rest, a base on waves."""
_SETTLED = 0.5
"""Largest change of the logarithm of a jolt's scale that needs no further round."""
_SWELL_GAIN = 15.0
"""Gain of log-likelihood at which swell is accepted. Wilks' theorem requires 8 (three parameters, 1 in 1000); many
frequencies are tried."""
_SWELL_FREQUENCIES, _SWELL_BANDWIDTHS = 16, (0.02, 0.3)
"""Starts of the maximization: number of frequencies, and bandwidths as shares of them."""
_NARROWER = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.1])
"""Factors of a second start for swell: one sea in 25 has a second, greater maximum with a narrower band."""
_QUIET = 1e-3
"""Share of jolts and waves that remain beside swell at the start."""
_LOG_RANGE_SWELL = 12.0
"""Lower bound of the variance of swell: logarithm below the starting value."""
_LINE = 0.003
"""rad: a narrower band than this over the length of the data is a sinusoid."""
_PARAMETER_STDDEV = 2.0
"""Sigma of the logarithm of a parameter that the data does not determine."""
_DOUBTFUL, _BISECTIONS = 2.0, 6
"""Log-likelihood: a value with a smaller loss is plausible (95 % by Wilks' theorem); steps to find the greatest."""
_CONTRADICTION = 5.0
"""Log-likelihood: the data contradicts a value with a greater loss (99 % by Wilks' theorem)."""
_ACCEL_EXCESS = math.log(10.0)
"""Accelerometers' noise over whole blocks may exceed their white noise by this (1/f): logarithm, in variance."""
_DAMPING, _LEAST_DAMPING, _FLAT = 0.1, 0.01, 0.01
"""Of the maximization: first and least damping, as a share of the information; constant added to the information, for
parameters that hardly matter."""
_LONGEST, _STEPS = 3.0, 100
"""Greatest change of a logarithm in a step; most steps."""
_RAISED = 4.0
"""Lower bound of a start that continues another (logarithm below the largest other share): lower, the gradient
vanishes."""
_TOLERANCE = 1e-4
"""Log-likelihood: the maximization ends where a step would gain less."""
_LOG_RANGE_ROUNDING = 28.0
"""Lower bound of white noise: logarithm below the variance of the swell's velocity, whose differences are no more
exact."""
_LOG_RANGE_WHITE, _LOG_RANGE = 14.0, 25.0
"""Lower bound of an intensity: logarithm below the whole variance."""


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
    """

    def __init__(self, time: Array, total: float, parameters: Array, jolt_scale: Array) -> None:
        self._time, self._parameters, self._jolt_scale = time, parameters, jolt_scale
        self._x = trend_basis(time)
        self._end = np.array([1.0, total])
        self._walk_end = parameters[1] * time
        self._walk_total = parameters[1] * total
        covariance = sum(_derivatives(time, parameters, jolt_scale)[:5])
        self._factor = linalg.cho_factor(covariance, lower=True)
        self._weighted = linalg.cho_solve(self._factor, self._x)
        self._trend_covariance = np.linalg.inv(self._x.T @ self._weighted)

    @classmethod
    def of(
        cls, time: Array, total: float, series: Array, limits: Array, similar: "TrendNoise | None" = None
    ) -> "TrendNoise":
        """Parameters from d series that share them, by restricted maximum likelihood ([1]_).

        Jolts come in bursts (a door, a person sitting down) and have the heavy tails of Student's
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
        similar : TrendNoise, optional
            Of much the same series: where there is swell, it need not be sought again.
        """
        scale = np.ones(len(time) + 1)
        likelihood = _Likelihood(time, series, scale)
        if similar is not None and len(similar._parameters) > 4:
            free = likelihood.greatest(similar._parameters, limits)
        else:
            free = min((likelihood.greatest(start, limits) for start in _STARTS), key=lambda fit: fit[0])
            with_swell = likelihood.greatest(likelihood.start_with_swell(free[1]), limits)
            if free[0] - with_swell[0] > _SWELL_GAIN:
                narrower = likelihood.greatest(with_swell[1] * _NARROWER, limits)
                free = min(with_swell, narrower, key=lambda fit: fit[0])
        for fixed in ((0, 1), (1,), ()):
            if any(math.isinf(limits[process]) for process in fixed):
                continue
            least, parameters = likelihood.greatest(free[1], limits, fixed) if fixed else free
            if least - free[0] < _CONTRADICTION:
                break
        for _ in range(_EXPECTATION_ROUNDS):
            energy = cls(time, total, parameters, scale)._jolt_energy(series)
            before = scale
            d = series.shape[1]
            scale = (_STUDENT_FREEDOM + d * energy / parameters[2]) / (_STUDENT_FREEDOM + d)
            if np.abs(np.log(scale / before)).max() < _SETTLED:
                break
            likelihood = _Likelihood(time, series, scale)
            _, parameters = likelihood.greatest(parameters, limits, fixed)
        return cls(time, total, parameters, scale)

    def sensor_noise(self, series: Array, limits: Array) -> Array:
        """Intensities of white noise and walk: the greatest, up to their limits, that the data does not contradict.

        The contribution of vibration and quantization to the sensors' fast noise does not grow as theirs does.
        ``series`` and ``limits`` are those of the fit; without a limit, the parameter itself is returned.
        """
        likelihood = _Likelihood(self._time, series, self._jolt_scale)
        least, parameters = likelihood.greatest(self._parameters, limits)

        def doubtful(process: int, logarithm: float) -> bool:
            tried = limits.copy()
            tried[process] = math.exp(logarithm)
            return likelihood.greatest(parameters, tried, (process,))[0] - least < _DOUBTFUL

        noise = self._parameters[:2].copy()
        for process in (0, 1):
            if math.isinf(limits[process]):
                continue
            high = math.log(limits[process] + 1e-300)
            low = min(high, math.log(parameters[process]))
            if high - low < 1e-6 or doubtful(process, high):
                low = high
            else:
                for _ in range(_BISECTIONS):
                    middle = 0.5 * (low + high)
                    low, high = (middle, high) if doubtful(process, middle) else (low, middle)
            noise[process] = math.exp(low)
        return noise

    def _jolt_energy(self, series: Array) -> Array:
        """Expected square of each jolt, mean over the series, given them; shape (n + 1,)."""
        variance = self._parameters[2] * self._jolt_scale
        gain = _differences(len(series)) * variance
        projected = linalg.cho_solve(self._factor, gain)
        projected -= self._weighted @ (self._trend_covariance @ (self._weighted.T @ gain))
        jolts = projected.T @ series
        energy: Array = (jolts**2).mean(axis=1) + variance - (gain * projected).sum(axis=0)
        return energy

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

        The band's shape is assumed. More samples than two a period determine its edges by that assumption only, not by
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
    walk = np.minimum.outer(time, time)
    shared = jolt_scale[1:-1]  # by two blocks, with opposite signs
    jolts = np.diag(jolt_scale[:-1] + jolt_scale[1:]) - np.diag(shared, 1) - np.diag(shared, -1)
    waves = linalg.toeplitz(np.concatenate([[6.0, -4.0, 1.0], np.zeros(n - 3)]))
    return [np.eye(n), walk, jolts, waves]


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
    differenced: Array = 2.0 * mirrored[..., 1:-1] - mirrored[..., :-2] - mirrored[..., 2:]
    return differenced


def _derivatives(time: Array, parameters: Array, jolt_scale: Array) -> list[Array]:
    """Of the covariance by the logarithms of the parameters; the first five are the parts that it is the sum of."""
    parts = [s * k for s, k in zip(parameters[:4], _kernels(time, jolt_scale), strict=True)]
    if len(parameters) > 4:
        variance, frequency, bandwidth = parameters[4:]
        parts += [variance * linalg.toeplitz(row) for row in _differenced(_swell(time, frequency, bandwidth))]
    return parts


def _without_trend(x: Array, series: Array) -> tuple[Array, float]:
    """Residual of least squares, shape (n, d), and its variance: not zero for a simulation without noise."""
    base = np.linalg.qr(x)[0]
    residual = series - base @ (base.T @ series)
    return residual, float((residual**2).mean()) + 1e-20


class _Likelihood:
    """Restricted likelihood of the parameters, given d series and the scales of the jolts ([1]_)."""

    def __init__(self, time: Array, series: Array, jolt_scale: Array) -> None:
        n = len(time)
        self._time = time
        self._x = trend_basis(time)
        self._residual, self._variance = _without_trend(self._x, series)
        self._lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        self._kernels = np.empty((7, n, n))
        self._kernels[:4] = _kernels(time, jolt_scale)
        self._unit = np.log(self._variance / np.einsum("ijj->i", self._kernels[:4]) * n)

    def greatest(self, start: Array, limits: Array, fixed: tuple[int, ...] = ()) -> tuple[float, Array]:
        """Negative log-likelihood, and the parameters that make it least, with swell where ``start`` has it.

        ``start`` is parameters, or shares of the variance where it has the sum 1; those that are ``fixed`` (0 white
        noise, 1 walk) stay at their limits.
        """
        begin = np.log(start)
        if abs(start.sum() - 1.0) < 1e-9:
            begin += self._unit
        # A floor keeps the matrix regular; a start near it, where the gradient vanishes, would stay there
        low, high = self._unit - _LOG_RANGE, self._unit + 4.0
        low[0] = self._unit[0] - _LOG_RANGE_WHITE
        if len(start) > 4:
            low[0] = max(low[0], begin[4] - _LOG_RANGE_ROUNDING)
        limit = np.maximum(np.log(limits + 1e-300), low[:2])
        high[:2] = np.minimum(high[:2], limit + [_ACCEL_EXCESS, 0.0])
        for process in fixed:
            low[process] = high[process] = limit[process]
        begin[:4] = np.maximum(begin[:4], self._unit + np.max(begin[:4] - self._unit) - _RAISED)
        if len(start) > 4:
            n, span = len(self._time), self._time[-1] - self._time[0]
            low = np.concatenate([low, [begin[4] - _LOG_RANGE_SWELL], np.log([2.0 / span, _LINE / span])])
            high = np.concatenate([high, [begin[4] + 4.0], np.log([math.pi * n / span] * 2)])
        return self._climb(np.clip(begin, low, high), low, high)

    def start_with_swell(self, parameters: Array) -> Array:
        """Starting parameters, the given ones with swell: the best of a grid, shape (7,)."""
        quiet = np.log(parameters * [1.0, 1.0, _QUIET, _QUIET])
        n, span = len(self._time), self._time[-1] - self._time[0]
        highest = math.pi * n / span
        trials: list[Array] = []
        for frequency in np.geomspace(highest / n, 0.9 * highest, _SWELL_FREQUENCIES):
            for share in _SWELL_BANDWIDTHS:
                lags = _differenced(_swell(self._time, frequency, share * frequency)[0])
                swell = [self._variance / lags[0], frequency, share * frequency]
                trials.append(np.concatenate([quiet, np.log(swell)]))
        best = min(trials, key=lambda trial: self._value(trial)[0])
        return np.asarray(np.exp(best))

    def _climb(self, q: Array, low: Array, high: Array) -> tuple[float, Array]:
        """Newton's method within bounds, damped after Marquardt, with the average information ([5]_)."""
        value, factor = self._value(q)
        gradient, information = self._slopes(q, factor)
        damping = _DAMPING
        for _ in range(_STEPS):
            free = ~((q <= low) & (gradient > 0.0) | (q >= high) & (gradient < 0.0))
            damped = information + damping * np.diag(np.diag(information) + _FLAT)
            step = np.zeros_like(q)
            step[free] = -np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
            step = np.clip(q + np.clip(step, -_LONGEST, _LONGEST), low, high) - q
            if np.abs(gradient * step).sum() < _TOLERANCE:
                break
            tried, factor = self._value(q + step)
            promised = float(-step @ (gradient + 0.5 * information @ step))
            gain = (value - tried) / max(1e-30, promised)
            if gain > 0.0:
                q, value = q + step, tried
                gradient, information = self._slopes(q, factor)
            damping *= 0.3 if gain > 0.75 else 1.0 if gain > 0.25 else 5.0
            damping = max(damping, _LEAST_DAMPING)
        return value, np.exp(q)

    def _value(self, q: Array) -> tuple[float, Array]:
        """Negative log-likelihood of logarithms of parameters, and the Cholesky factor of the covariance."""
        n, d = self._residual.shape
        p = np.exp(q)
        if len(q) > 4:
            swell = _differenced(_swell(self._time, p[5], p[6]))
            np.take(swell, self._lag, axis=1, out=self._kernels[4:], mode="clip")  # the default buffers
        covariance = p[:5] @ self._kernels[: len(p[:5])].reshape(-1, n * n)
        factor, failed = linalg.lapack.dpotrf(covariance.reshape(n, n), lower=1)
        if failed:
            return math.inf, factor
        whitened, _ = linalg.lapack.dtrtrs(factor, np.column_stack([self._x, self._residual]), lower=1)
        products = whitened.T @ whitened
        by_trend, cross = products[:2, :2], products[:2, 2:]
        squares = np.trace(products[2:, 2:]) - (cross * np.linalg.solve(by_trend, cross)).sum()
        log_det = 2.0 * np.log(np.diag(factor)).sum() + np.linalg.slogdet(by_trend)[1]
        return float(0.5 * (d * log_det + squares)), factor

    def _slopes(self, q: Array, factor: Array) -> tuple[Array, Array]:
        """Gradient and average information there; the kernels must be those of the last `_value`."""
        n, d = self._residual.shape
        kernels = self._kernels[: len(q)]
        scale = np.exp(q[[0, 1, 2, 3, 4, 4, 4][: len(q)]])  # the last three are derivatives of the swell
        lower, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = lower + lower.T
        inverse.flat[:: n + 1] *= 0.5
        weighted = inverse @ self._x
        projection = inverse - weighted @ np.linalg.solve(self._x.T @ weighted, weighted.T)
        py = projection @ self._residual
        gradient = 0.5 * scale * (kernels.reshape(-1, n * n) @ (d * projection - py @ py.T).ravel())
        changes = scale[:, None, None] * (kernels @ py)
        information = 0.5 * np.einsum("iad,jad->ij", changes, projection @ changes)
        return gradient, information
