"""Trend in coloured noise: swell is found where there is some, and then the slope's sigma is true."""

import math

import numpy as np
import pytest
from scipy import stats

from ins_nav.alignment.noise_model import TrendNoise, trend_basis

BLOCKS, WHITE, WALK = 120, 1e-5, 2e-7
"""Standard deviations: of a block, rad; of the walk, rad/√s."""


def _sensors(duration: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, two series of sensors' noise, and what is known of it."""
    step = duration / BLOCKS
    walk = np.cumsum(WALK * math.sqrt(step) * rng.standard_normal((BLOCKS, 2)), axis=0)
    time = (np.arange(BLOCKS) + 0.5) * step
    return time, walk + WHITE * rng.standard_normal((BLOCKS, 2)), np.array([WHITE, WALK]) ** 2


def _sea(duration: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """Means of the accelerations of irregular waves (JONSWAP spectrum, 20 sinusoids), over gravity, shape (n, 2)."""
    borders = np.geomspace(0.55, 2.5, 21)
    x = borders[:-1] + rng.uniform(size=20) * np.diff(borders)
    peak = 3.3 ** np.exp(-0.5 * ((x - 1.0) / np.where(x < 1.0, 0.07, 0.09)) ** 2)
    height = np.sqrt(x**-5 * np.exp(-1.25 * x**-4) * peak * np.diff(borders))
    rate = 2.0 * math.pi / period * x
    amplitude = rng.uniform(0.2, 1.0) * height / np.linalg.norm(height) * rate
    phase = rng.uniform(0.0, 2.0 * math.pi, (2, 20))
    ends = np.linspace(0.0, duration, BLOCKS + 1)[:, None, None]
    velocity = (amplitude * np.cos(rate * ends + phase)).sum(axis=2)
    return np.diff(velocity, axis=0) / (duration / BLOCKS * 9.81)


def _slope_stddev(time: np.ndarray) -> float:
    """Of generalized least squares with the sensors' noise known."""
    covariance = WHITE**2 * np.eye(BLOCKS) + WALK**2 * np.minimum.outer(time, time)
    x = trend_basis(time)
    return math.sqrt(np.linalg.inv(x.T @ np.linalg.solve(covariance, x))[1, 1])


def test_no_swell_is_found_in_sensors_noise() -> None:
    for seed in range(5):
        time, series, limits = _sensors(60.0, np.random.default_rng(seed))
        noise = TrendNoise.of(time, 60.0, series, limits)
        fit = noise.fit(series)
        # the noise is known unless the data contradicts it: 1.00 measured
        assert math.sqrt(fit.slope_variance) == pytest.approx(_slope_stddev(time), rel=0.05)
        velocity, _ = noise.velocity(series, fit)
        assert np.abs(velocity).max() < 0.5 * WHITE  # 0.1 measured


@pytest.mark.parametrize(("duration", "period"), [(60.0, 9.0), (60.0, 16.0), (120.0, 20.0)])
def test_sigma_of_the_slope_is_true_on_an_irregular_sea(duration: float, period: float) -> None:
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        time, series, limits = _sensors(duration, rng)
        series += _sea(duration, period, rng)
        fit = TrendNoise.of(time, duration, series, limits).fit(series)
        ratios += list(fit.slope / math.sqrt(fit.slope_variance))
        # least squares are wrong by 1e-5 to 2e-4 rad/s
        assert math.sqrt(fit.slope_variance) < 5e-6
    # chi-square: 1 in 1000; 0.6 to 0.8 measured, since a sea is not quite of the model's shape
    assert np.sqrt(np.mean(np.square(ratios))) < math.sqrt(stats.chi2.ppf(0.999, 20) / 20)
    assert np.abs(ratios).max() < 4.0


def test_sinusoid_is_told_from_the_slope() -> None:
    """1.5 periods of a surge of a metre, with the sensors' noise: the slope is as good as without it, nearly."""
    time, series, limits = _sensors(30.0, np.random.default_rng(0))
    rate = 2.0 * math.pi / 20.0
    ends = np.linspace(0.0, 30.0, BLOCKS + 1)
    velocity = rate * np.column_stack([np.cos(rate * ends), np.cos(rate * ends + 1.0)]) / 9.81 / (30.0 / BLOCKS)
    series += np.diff(velocity, axis=0)
    noise = TrendNoise.of(time, 30.0, series, limits)
    fit = noise.fit(series)
    stddev = math.sqrt(fit.slope_variance)
    assert np.abs(fit.slope).max() < 3.5 * stddev < 3.5 * 20.0 * _slope_stddev(time)
    found, variance = noise.velocity(series, fit)
    # 0.3 m/s; it shows to a few hundredths of a per cent
    assert np.abs(found[-1] - velocity[-1]).max() < 4.0 * math.sqrt(variance) < 0.01 * np.abs(velocity).max()


def test_velocity_of_a_blow() -> None:
    """Two jolts, there and back: velocity between them, none at the end."""
    time, series, limits = _sensors(30.0, np.random.default_rng(1))
    series[60] += [1e-2, 0.0]
    series[61] -= [1e-2, 0.0]
    noise = TrendNoise.of(time, 30.0, series, limits)
    velocity, variance = noise.velocity(series, noise.fit(series))
    assert velocity[61, 0] == pytest.approx(1e-2, rel=0.01)
    assert abs(velocity[-1, 0]) < 4.0 * math.sqrt(variance) + 1e-12


def test_noise_of_a_similar_series_is_found_from_there() -> None:
    """The axes turned between two searches: swell found the first time need not be sought again."""
    rng = np.random.default_rng(3)
    time, series, limits = _sensors(60.0, rng)
    series += _sea(60.0, 9.0, rng)
    first = TrendNoise.of(time, 60.0, series, limits)
    c, s = math.cos(2.0), math.sin(2.0)
    turned = series @ np.array([[c, -s], [s, c]]) + 1e-6 * time[:, None]
    anew, again = (TrendNoise.of(time, 60.0, turned, limits, similar) for similar in (None, first))
    # both climbs end within 1e-4 of the greatest log-likelihood; sigmas differ by 1e-3 then, slopes by 1e-2 of them
    fit, other = anew.fit(turned), again.fit(turned)
    assert other.slope_variance == pytest.approx(fit.slope_variance, rel=0.01)
    np.testing.assert_allclose(other.slope, fit.slope, atol=0.02 * math.sqrt(fit.slope_variance))


def test_sensors_noise_is_the_most_that_the_data_does_not_contradict() -> None:
    """Fast noise that tells the truth is taken for it; 30 times as much is not, for white noise."""
    time, series, limits = _sensors(60.0, np.random.default_rng(0))
    for excess in (1.0, 30.0):
        noise = TrendNoise.of(time, 60.0, series, excess**2 * limits)
        white, walk = np.sqrt(noise.sensor_noise(series, excess**2 * limits)) / [WHITE, WALK]
        # of 240 numbers: one sigma is 4.6 %, and what is not contradicted is two sigmas more
        assert white == pytest.approx(1.0, abs=0.2)
        # a minute shows the walk badly: 16 times as much of it would not be contradicted
        assert 0.999 < walk < 1.001 * excess
