"""Fast noise: growth and loss are found, a carrier that departs is none; the limit of white noise."""

import math

import numpy as np
import pytest

from ins_nav.mechanization.sample_noise import SampleNoise, growth_limit
from ins_nav.mechanization.window_statistics import window_statistics

GYRO, ACCEL = 1e-3, 1e-2
H = 0.01


class Fed:
    """Seconds of white noise."""

    def __init__(self, samples: int = 100) -> None:
        self.noise = SampleNoise()
        self._rng = np.random.default_rng(0)
        self._samples = samples

    def add(self, seconds: int, gyro: float = 1.0, accel: float = 1.0, moving: bool = False) -> list[float]:
        """So many windows; the ratios of the gyros."""
        scale = np.r_[np.full(3, gyro * GYRO), np.full(3, accel * ACCEL)]
        ratios = []
        for _ in range(seconds):
            values = scale * self._rng.standard_normal((self._samples + 1, 6))
            self.noise.add(window_statistics(values), H, moving)
            ratios.append(self.noise.gyro.ratio)
        return ratios


@pytest.mark.parametrize("times", [5.0, 10.0, 100.0])
def test_noise_that_grows_at_rest(times: float) -> None:
    fed = Fed()
    assert fed.add(30) == [1.0] * 30
    ratios = fed.add(20, gyro=times)
    # over the largest of 30 windows, some 1.2 times the mean
    assert ratios[:2] == [1.0] * 2 and all(0.6 * times < ratio < 1.2 * times for ratio in ratios[2:])
    assert fed.noise.gyro.excess == pytest.approx(times**2 * GYRO**2 * H, rel=0.5)
    assert (fed.noise.accel.ratio, fed.noise.accel.excess) == (1.0, 0.0)
    assert fed.add(5) == [1.0] * 5


def test_two_windows_of_motion_before_it_is_detected() -> None:
    fed = Fed()
    fed.add(30)
    assert fed.add(2, gyro=50.0, accel=50.0) + fed.add(40, gyro=50.0, accel=50.0, moving=True) == [1.0] * 42
    assert fed.add(20) == [1.0] * 20


def test_noise_that_grows_in_motion() -> None:
    fed = Fed()
    fed.add(10)
    fed.add(40, gyro=10.0, accel=30.0, moving=True)
    assert fed.add(10, gyro=40.0, accel=30.0, moving=True) == [1.0] * 10  # another road
    assert fed.add(3, gyro=400.0, accel=30.0, moving=True)[2] > 5.0


def test_a_carrier_that_stops_has_not_lost_its_noise() -> None:
    fed = Fed()
    assert fed.add(30, gyro=50.0, accel=50.0, moving=True) + fed.add(10) == [1.0] * 40


def test_noise_that_vanishes() -> None:
    fed = Fed()
    fed.add(30)
    assert fed.add(1, gyro=0.2) == [1.0]
    assert fed.add(1, gyro=0.01)[0] < 0.1


def test_nothing_is_known_of_a_noise_free_imu() -> None:
    fed = Fed()
    fed.add(30, gyro=0.0, accel=0.0)
    assert fed.add(30) == [1.0] * 30


@pytest.mark.parametrize("samples", [12, 25, 100])
def test_false_alarms(samples: int) -> None:
    """In 20,000 windows of white noise no axis grows beyond the limit; 1e-6 is stated."""
    rng = np.random.default_rng(1)
    second = np.diff(rng.standard_normal((20_000, samples, 1)), 2, axis=1)
    variances = (second**2).mean(axis=(1, 2)) / 6.0
    assert variances.max() < growth_limit(samples)
    fed = Fed(samples)
    assert fed.add(500) == [1.0] * 500


def test_the_limit_of_white_noise() -> None:
    """Learnt in motion it is too large; rest makes it right."""
    fed = Fed()
    fed.add(12, gyro=30.0, accel=30.0, moving=True)
    assert math.sqrt(fed.noise.gyro.limit) == pytest.approx(30.0 * GYRO * math.sqrt(H), rel=0.15)
    fed.add(60)
    fed.add(60, gyro=30.0, accel=30.0, moving=True)
    assert math.sqrt(fed.noise.gyro.limit) == pytest.approx(GYRO * math.sqrt(H), rel=0.15)
    assert math.sqrt(fed.noise.accel.limit) == pytest.approx(ACCEL * math.sqrt(H), rel=0.15)


@pytest.mark.parametrize("samples", [12, 20, 100])
def test_the_limit_stays_above_the_noise(samples: int) -> None:
    """The least of an hour: an upper limit by two sigmas each time is 10 % too low at most."""
    fed = Fed(samples)
    fed.add(3600)
    assert 0.9 < math.sqrt(fed.noise.gyro.limit) / (GYRO * math.sqrt(H)) < 1.2
