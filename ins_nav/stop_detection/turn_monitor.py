"""Turns of a stationary base, detected in its attitude over the last minutes."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from ins_nav.stop_detection.sample_sums import BLOCK
from ins_nav.stop_detection.velocity_filter import Triple, VelocityFilter

_CLIP = 2.0
"""Of the RMS: a random walk ends 1.4 RMS away from its line, one with the beginning of a turn 2.2 and more."""
_LEAST_ON_LINE = 5
"""Values: the scatter of fewer is not estimated."""
_ROUNDING = 1e-8
"""rad: less is no turn."""
_ATTITUDES = 1800
"""Stored blocks, 3 min."""
_LINE = 600
"""Blocks over which the drift of an angle is a line."""
_TURN = math.radians(5.0)
"""Yaw from its mean that is a turn: people and swell yaw by less. And tilt from one stillness to the next."""
_TURN_MEMORY = 200
"""Blocks of that mean: a turn by 5° in them is no drift."""
_TURN_BEGINS = math.radians(1.0)
"""A larger angle certainly belongs to a turn."""
_YAW_SWAY = 0.003
"""rad: yaw of a swaying base, added to twice its observed RMS; sigma of the mean rate is this over the time at rest."""


class TurnMonitor:
    """Detects turns on the spot, and estimates when they began and ended.

    It stores the attitudes of the last minutes.
    """

    def __init__(self) -> None:
        self._track: deque[tuple[int, float, Triple]] = deque(maxlen=_ATTITUDES)
        self._stood = 0
        self._mean = self._variance = self._window = 0.0
        self._up: Triple | None = None

    def append(self, stamp_ns: int, reckoning: VelocityFilter) -> None:
        """Append the attitude after a block."""
        self._track.append((stamp_ns, reckoning.measured_yaw, reckoning.up))

    def stand(self, reckoning: VelocityFilter) -> None:
        """A stop begins."""
        self._stood = 0
        self._mean = self._window = reckoning.yaw
        self._variance = 0.0
        self._up = None

    def turned(self, reckoning: VelocityFilter, sigmas: float) -> bool:
        """Whether yaw has left its mean by more than sway and drift explain; called once a block of a stop."""
        self._stood += 1
        memory = min(self._stood, _TURN_MEMORY)
        off = reckoning.yaw - self._mean
        self._mean += off / memory
        self._variance += (off * off - self._variance) / memory
        return abs(off) > _TURN and abs(off) > _TURN + sigmas * reckoning.yaw_rate_stddev(0.0) * memory * BLOCK

    def learn(self, reckoning: VelocityFilter, blocks: int, sway: float) -> None:
        """Measure the gyro bias about the vertical, with the weight by which these blocks improve the stop's mean rate.

        Parameters
        ----------
        reckoning : VelocityFilter
        blocks : int
            Since the last time.
        sway : float
            Noise of rate over a block, standard deviation, rad/s.
        """
        turn, self._window = reckoning.yaw - self._window, reckoning.yaw
        time, rest = blocks * BLOCK, self._stood * BLOCK
        if rest < time:
            return
        yaw2 = _YAW_SWAY**2 + 4.0 * self._variance
        noise2 = yaw2 / (rest**2 - (rest - time) ** 2) + sway**2 / blocks
        reckoning.update_yaw_rate(turn / time, math.sqrt(noise2))

    def tilted(self, reckoning: VelocityFilter, since_ns: int) -> int:
        """Stamp at which a tilt of the base, which is still now, began, not before that given; 0: no tilt.

        A base that rocks is never still.
        """
        up, was = reckoning.up, self._up
        if was is None or math.dist(up, was) < _TURN:
            self._up = up
            return 0
        stamps, _, ups = self._since(since_ns)
        off = ups - was
        tilt = off @ off[-1] / math.sqrt(off[-1] @ off[-1])
        before = int(np.flatnonzero(tilt < _TURN_BEGINS).max(initial=0)) + 1
        return _last_on_line(stamps[:before], tilt[:before])

    def turn_began(self, reckoning: VelocityFilter, since_ns: int) -> int:
        """Stamp of the last block on the line that yaw follows from a time on; the present one if there is no turn."""
        if abs(reckoning.yaw - self._mean) < _TURN_BEGINS:
            return self._track[-1][0]
        stamps, yaws, _ = self._since(since_ns)
        return _last_on_line(stamps, yaws)

    def turn_ended(self, since_ns: int) -> int:
        """Stamp of the first block, not before that given, from which on yaw follows a line."""
        stamps, yaws, _ = self._since(since_ns)
        return stamps[-_on_line(yaws[::-1])]

    def ends_gently(self, blocks: int, sigmas: float) -> bool:
        """Whether the yaw rate over the last blocks differs from that over as many before by more than scatter."""
        yaws = np.array([self._track[-i][1] for i in range(min(2 * blocks + 1, len(self._track)), 0, -1)])
        steps = np.diff(yaws[1 - len(yaws) % 2 :]).reshape(2, -1)
        before, now = steps.sum(axis=1).tolist()
        scatter = math.sqrt(float(steps.var(axis=1).sum()) * steps.shape[1])
        return bool(abs(now - before) > sigmas * scatter + _ROUNDING)

    def _since(self, stamp_ns: int) -> tuple[tuple[int, ...], NDArray[np.float64], NDArray[np.float64]]:
        stamps, yaws, ups = zip(*(a for a in self._track if a[0] >= stamp_ns), strict=True)
        return stamps, np.array(yaws), np.array(ups)


def _last_on_line(stamps: tuple[int, ...], values: NDArray[np.float64]) -> int:
    """Stamp of the last value on the line of the first."""
    return stamps[-_LINE:][_on_line(values[-_LINE:]) - 1]


def _on_line(values: NDArray[np.float64]) -> int:
    """Number of equally spaced values, from the first on, that are on one line.

    The line is fitted to all, and the values behind the last that is near it are clipped off, until none is: the
    bound falls with what is clipped, down to the scatter of the values on the line.

    Parameters
    ----------
    values : ndarray, shape (n,)
        rad.
    """
    n = len(values)
    while n > _LEAST_ON_LINE:
        place = np.arange(n) - 0.5 * (n - 1)
        level = values[:n] - values[:n].mean()
        residual = np.abs(level - place * (place @ level / (place @ place)))
        bound = _CLIP * math.sqrt(float(residual @ residual) / n) + _ROUNDING
        last = int(np.flatnonzero(residual < bound)[-1]) + 1
        if last == n:
            break
        n = last
    return n
