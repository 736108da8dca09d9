"""Fast noise of an IMU: from second differences of its samples, in which motion hardly appears.

Vibration and quantization only add to what is found, so it is an upper limit of the sensors' white noise. Its level is
compared with the largest so far, at rest and in motion apart: a carrier in motion shakes.
"""

import functools
import math
from collections import deque

from scipy import stats

from ins_nav.mechanization.window_statistics import COARSE, WindowStatistics

Triads = tuple[float, float]
"""A value of the gyros and one of the accelerometers."""

FALSE_ALARM = 1e-6
"""Probability that steady white noise grows beyond the limit, a window and axis; all three axes must."""
_REST_GROWTH, _MOTION_GROWTH = 9.0, 25.0
"""Growth of the variance that is no fault: people and engines at rest, other roads in motion."""
_VANISHED = 0.01
"""Of the least variance at rest so far: the sensor does not measure any more."""
_REST_WINDOWS, _MOTION_WINDOWS = 5, 30
"""Windows from which the level at rest, and in motion, is known."""
_PERSISTENT = 3
"""Windows of growth that are a fault: the first ones may be the departure of a carrier that seems to stand yet."""
_LIMIT_WINDOWS = 10
"""Windows whose mean is an upper limit of white noise."""
_CONFIDENCE = 4.0
"""Over the root of the number of samples: two sigmas of a mean square, as in `GravityCone.noise_limits`."""
_COARSE_SAMPLES = 8 * COARSE
"""Samples in a window that has enough means of `COARSE`."""
_FREEDOM = 1.94
"""Second differences of white noise have the information of so many times fewer independent ones: their correlations
are -2/3 and 1/6, and 1 + 2 (4/9 + 1/36) is 1.94."""


@functools.lru_cache(maxsize=64)
def growth_limit(samples: int) -> float:
    """Ratio of the variance in a window to that in `_REST_WINDOWS` that white noise exceeds with `FALSE_ALARM`."""
    freedom = (samples - 2) / _FREEDOM
    return float(stats.f.isf(FALSE_ALARM, freedom, _REST_WINDOWS * freedom))


class TriadNoise:
    """Level of three gyros or three accelerometers.

    Attributes
    ----------
    excess : float
        Variance in a second by which the noise of the last window exceeds the level so far; 0: it does not.
    ratio : float
        Noise of the last window over the level so far, in sigma, where that is a fault; 1: it is none.
    limit : float
        Upper limit of the white noise of the sensors, variance in a second: the least mean of some windows with noise.
    """

    def __init__(self) -> None:
        self._levels = [[0.0] * 3, [0.0] * 3]
        self._windows = [0, 0]
        self._least = [math.inf] * 3
        self._recent: deque[tuple[float, float]] = deque(maxlen=_LIMIT_WINDOWS)
        self._grown = 0
        self.limit = math.inf
        self.excess = 0.0
        self.ratio = 1.0

    def add(self, fine: list[float], coarse: list[float], samples: int, moving: bool) -> None:
        """Compare the variances of a window, of samples and of means of samples, with those so far.

        Parameters
        ----------
        fine, coarse : 3 floats
            Variance in a second.
        samples : int
            In the window.
        moving : bool
        """
        level, enough = self._levels[moving], (_REST_WINDOWS, _MOTION_WINDOWS)[moving]
        growth = max(growth_limit(samples), (_REST_GROWTH, _MOTION_GROWTH)[moving])
        known = self._windows[moving] >= enough and min(level) > 0.0  # nothing is known of a noise-free IMU
        self.ratio, self.excess = 1.0, 0.0
        if known and all(now > growth * most for now, most in zip(fine, level, strict=True)):
            self._grown += 1
            if self._grown >= _PERSISTENT:
                self.ratio = math.sqrt(sum(fine) / sum(level))
                self.excess = (sum(fine) - sum(level)) / 3.0
            return
        self._grown = 0
        least = self._least
        if self._windows[False] >= _REST_WINDOWS and all(
            0.0 < now < _VANISHED * before for now, before in zip(fine, least, strict=True)
        ):
            self.ratio = math.sqrt(sum(fine) / sum(least))
            return
        self._levels[moving] = list(map(max, level, fine))
        self._windows[moving] += 1
        if not moving:
            self._least = list(map(min, least, fine))
        self._recent.append((sum(fine) / 3.0, sum(coarse) / 3.0))
        if len(self._recent) == _LIMIT_WINDOWS:
            means = [sum(variances) / _LIMIT_WINDOWS for variances in zip(*self._recent, strict=True)]
            counts = [_LIMIT_WINDOWS * samples, _LIMIT_WINDOWS * samples // COARSE]
            if samples < _COARSE_SAMPLES:
                counts.pop()
            mean = min(x * (1.0 + _CONFIDENCE / math.sqrt(n)) for x, n in zip(means, counts, strict=False))
            self.limit = min(self.limit, mean if mean > 0.0 else math.inf)


class SampleNoise:
    """Gyros and accelerometers.

    Attributes
    ----------
    gyro, accel : TriadNoise
    level : Triads
        Root mean square of the noise of a sample in the last window.
    """

    def __init__(self) -> None:
        self.gyro, self.accel = TriadNoise(), TriadNoise()
        self.level: Triads = 0.0, 0.0

    def add(self, window: WindowStatistics, interval: float, moving: bool) -> None:
        """Measure a window.

        Parameters
        ----------
        window : WindowStatistics
        interval : float
            Between samples, s.
        moving : bool
            The carrier does not stand.
        """
        fine = [interval * x for x in window.fine]
        coarse = [COARSE * interval * x for x in window.coarse]
        self.gyro.add(fine[:3], coarse[:3], window.samples, moving)
        self.accel.add(fine[3:], coarse[3:], window.samples, moving)
        self.level = math.sqrt(sum(window.fine[:3])), math.sqrt(sum(window.fine[3:]))
