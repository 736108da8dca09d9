"""What the monitors of the IMU (`imu_monitor`) found, for the filters: hidden errors, limits of the noise.

Samples of a frozen or saturated axis hide errors, which are described as random walks of attitude and velocity over a
time. They concern the last seconds: the filter, which runs behind the samples, widens its covariance when it comes to
them.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LENGTH_NS = 12_000_000_000
"""ns: states further back are not corrected any more."""


class HiddenErrors(NamedTuple):
    """Errors over a time.

    Attributes
    ----------
    begin_ns, end_ns : int
    rate, force : ndarray, shape (3,)
        Variance in a second on each axis, of the turn, rad²/s, and of the speed, m²/s³.
    """

    begin_ns: int
    end_ns: int
    rate: Array
    force: Array


class ImuCondition:
    """Hidden errors of the last seconds, on base_link's axes, and limits of the noise.

    Parameters
    ----------
    mounting : ndarray, shape (3, 3)
        From the IMU's axes to base_link's.

    Attributes
    ----------
    count : int
        How many hidden errors there were since the last restart.
    noise_limits : 2 floats
        Upper limits of the white noise of gyros and accelerometers, rad/√s and m/s/√s; infinite: not known.
    """

    def __init__(self, mounting: Array) -> None:
        self._squares = np.square(mounting)
        self._entries: deque[HiddenErrors] = deque()
        self.count = 0
        self.noise_limits = math.inf, math.inf

    def clear(self) -> None:
        """The stamps have jumped."""
        self._entries.clear()
        self.count = 0
        self.noise_limits = math.inf, math.inf

    def add(self, errors: HiddenErrors) -> None:
        """Add errors on the IMU's axes."""
        self._entries.append(errors._replace(rate=self._squares @ errors.rate, force=self._squares @ errors.force))
        self.count += 1
        while self._entries[0].end_ns < errors.end_ns - _LENGTH_NS:
            self._entries.popleft()

    def earliest(self, count: int) -> int:
        """First stamp that those after the first ``count`` concern; there are some."""
        return min(errors.begin_ns for errors in list(self._entries)[-(self.count - count) :])

    def between(self, begin_ns: int, end_ns: int) -> tuple[Array, Array] | None:
        """Variances of turn, rad², and speed, m²/s², on each axis from one stamp to another; None where there are none.

        Returns
        -------
        turn, speed : ndarray, shape (3,)
        """
        if not self._entries:
            return None
        turn, speed = np.zeros(3), np.zeros(3)
        for errors in self._entries:
            time = (min(end_ns, errors.end_ns) - max(begin_ns, errors.begin_ns)) * 1e-9
            if time > 0.0:
                turn += time * errors.rate
                speed += time * errors.force
        return (turn, speed) if turn.any() or speed.any() else None
