"""Values that repeat: by quantization, by samples published several times, or since a sensor is frozen.

A quantized axis at rest repeats its value with some probability. It is learnt from the stream by the level of fast
noise that the other sensors show: where they shake as before, an axis repeats as before. A run of n repeats of
probability p has probability p^n, and is a fault where that is below `FALSE_ALARM`.
"""

import math
from typing import NamedTuple

from ins_nav.mechanization.sample_noise import Triads
from ins_nav.mechanization.window_statistics import EVERY_AXIS, WindowStatistics

FALSE_ALARM = 1e-9
"""Probability of a run of repeats by quantization, a run."""
_LEAST_RUN = 10
"""Samples of the shortest run of the sample as a whole that is tested; one axis is tested over whole windows."""
_LEAST_PROBABILITY = 0.02
"""Of a repeat: that of an axis without quantization, which hardly ever repeats."""
_WINDOWS = 3
"""Windows of a level of noise from which the probability at that level is known."""
_ALIVE, _CONSTANT_SAMPLES = 0.05, 100
"""An axis that never changed in so many samples is constant, where both others of its triad repeat more rarely."""
_HELD_SHARE, _HELD_TOGETHER, _HELD_CHANGES = 0.3, 0.9, 5
"""A triad is held: its share of repeats, the share of its changes in which all three axes change, their least number.
Independent axes that repeat as often change together in 1 of 20 changes."""
_HELD_WINDOWS = 3


class Run(NamedTuple):
    """A part of a run of repeated values, on one axis or on all.

    Attributes
    ----------
    axis : int
        0 to 5; `EVERY_AXIS`: all.
    length : int
        Samples of the run so far.
    new : int
        Those that no part before contains.
    end : int
        Number of samples of the present window after the part.
    """

    axis: int
    length: int
    new: int
    end: int


class _Axis:
    """Probability of a repeat by level of noise, and the present run."""

    def __init__(self) -> None:
        self._length = 0
        self._evidence = 0.0
        self._reported = 0
        self._share: dict[int, tuple[int, float]] = {}
        self._pending: tuple[int, float] | None = None

    def test(self, name: int, window: WindowStatistics, level: int | None) -> Run | None:
        """Follow the present run over a window; the part of it that is a fault.

        Without a level nothing is learnt or decided. Where the window is not of repeats as a whole, its level may be
        that of another time than the run's: only whole windows are evidence.
        """
        if window.trail[name] == window.samples:
            self._length += window.samples
            if level is not None:
                self._evidence += window.samples * math.log(self._probability(level))
            return self._whole(name, window, level)
        ended, reported = self._length + window.lead[name], self._reported
        self._length, self._evidence, self._reported = window.trail[name], 0.0, 0
        if reported:
            self._pending = None
            return Run(name, ended, ended - reported, window.samples - window.lead[name])
        self._learn(level, window.repeats[name] / window.samples)
        return None

    def _whole(self, name: int, window: WindowStatistics, level: int | None) -> Run | None:
        if self._evidence >= math.log(FALSE_ALARM):
            self._learn(level, 1.0)
            return None
        self._pending = None
        new, self._reported = self._length - self._reported, self._length
        return Run(name, self._length, new, 0)

    def test_within(self, name: int, window: WindowStatistics) -> Run | None:
        """The longest run within a window, where it is a fault; levels do not matter."""
        length = window.longest[name]
        certain = length * math.log(self._probability(0)) < math.log(FALSE_ALARM)
        if length < _LEAST_RUN or not certain:
            return None
        self._pending = None
        return Run(name, length, length, window.samples - window.longest_end[name])

    def _probability(self, level: int) -> float:
        """Of a repeat at a level; 1 where it is not known."""
        near = [self._share[at] for at in range(level - 1, level + 2) if at in self._share]
        if sum(windows for windows, _ in near) < _WINDOWS:  # an axis repeats less where there is more noise
            lower = [at for at, (windows, _) in self._share.items() if at < level and windows >= _WINDOWS]
            if not lower:
                return 1.0
            near.append(self._share[max(lower)])
        return max(_LEAST_PROBABILITY, *(share for _, share in near))

    def _learn(self, level: int | None, share: float) -> None:
        """Learn the share of repeats in a window, once the next has shown that no fault began in it."""
        if self._pending is not None:
            at, seen = self._pending
            windows, most = self._share.get(at, (0, 0.0))
            self._share[at] = windows + 1, max(most, seen)
        self._pending = None if level is None else (level, share)


class RepeatedValues:
    """Tests windows of samples.

    Attributes
    ----------
    runs : list of Run
        Of the last window: faults.
    constant : list of int
        Axes that have never changed, while the others of their triad have.
    held : list of int
        How many samples repeat each value of the gyros, and of the accelerometers; 1: none.
    """

    def __init__(self) -> None:
        self._axes = [_Axis() for _ in range(EVERY_AXIS + 1)]
        self._samples = 0
        self._repeats = [0] * EVERY_AXIS
        self._held_windows = [0, 0]
        self.runs: list[Run] = []
        self.constant: list[int] = []
        self.held = [1, 1]

    def add(self, window: WindowStatistics, interval: float, noise: Triads) -> None:
        """Test a window.

        Parameters
        ----------
        window : WindowStatistics
        interval : float
            Between samples, s.
        noise : 2 floats
            Fast noise of gyros and accelerometers in the window (`sample_noise`).
        """
        every = self._axes[EVERY_AXIS]
        whole = every.test(EVERY_AXIS, window, 0) or every.test_within(EVERY_AXIS, window)
        found = [whole]
        for axis in range(EVERY_AXIS):
            other = noise[1 - axis // 3]
            level = None if whole or other == 0.0 else math.frexp(other)[1]  # without noise nothing is known
            run = self._axes[axis].test(axis, window, level)
            if whole is None:
                found.append(run)
            self._repeats[axis] += window.repeats[axis]
        self.runs = [run for run in found if run is not None]
        self._samples += window.samples
        self.constant = self._constant_axes()
        for triad in (0, 1):
            self.held[triad] = self._times(triad, window)

    def _constant_axes(self) -> list[int]:
        total, repeats = self._samples, self._repeats
        if total < _CONSTANT_SAMPLES or max(repeats) < total:
            return []
        others = [[3 * (i // 3) + (i + k) % 3 for k in (1, 2)] for i in range(EVERY_AXIS)]
        return [i for i in range(6) if repeats[i] == total and max(repeats[k] for k in others[i]) < _ALIVE * total]

    def _times(self, triad: int, window: WindowStatistics) -> int:
        """How many samples repeat each value of a triad."""
        changes, count = window.changes[triad], window.samples
        held = count - changes > _HELD_SHARE * count and changes >= _HELD_CHANGES
        held = held and window.joint[triad] > _HELD_TOGETHER * changes
        self._held_windows[triad] = self._held_windows[triad] + 1 if held else 0
        return round(count / changes) if self._held_windows[triad] >= _HELD_WINDOWS else 1
