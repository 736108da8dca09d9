"""The interval between samples, learnt continuously from the accepted stamps."""

import math
from collections import deque
from statistics import median_high

import numpy as np
from numpy.typing import NDArray

FIRST_GAP = 0.25
"""s: longest interval taken as regular before the nominal one is known (10 Hz with jitter)."""
_LONGEST_PAUSE = 1.0
"""s: longer intervals are gaps, however often they recur."""
_GAP_RATIO = 1.75
"""Intervals this many times the nominal one count as gaps: a lost sample makes 2, jitter seldom over 1.5."""
_LEAST = 25
"""Intervals in a window, at least."""
_FIRST_WINDOW_NS, _WINDOW_NS = 100_000_000, 500_000_000
"""ns: least length of the first window and of the others; a backlog that is published at once ends within the first."""
_WINDOW_MORE_NS = 100_000_000
"""ns by which a window is extended."""
_WINDOWS = 3
"""Windows whose median counts: a single window of stalls changes nothing."""
_LONGEST_SHARE = 0.25
"""Of a window that an interval may take up: longer ones need a longer window, to show whether they recur."""
_ALTERNATING = 0.6
"""Quantile of the intervals that is a regular one, also where shorter and longer ones alternate."""
_CROWDED = 0.5
"""Of the mean interval: shorter ones are those within a batch."""
_SAME = 1.25
"""Ratio of two nominal intervals below which they are the same."""
_MANY = 0.3
"""Share of such intervals that makes batches: half of all in batches of two."""


class SampleInterval:
    """The running median of what windows of intervals show.

    In a window the nominal interval is the mean, gaps apart. Where samples come in batches, with the stamps of their
    arrival, the pause between two batches is no gap. A burst (a backlog, published at once) is left out.

    Attributes
    ----------
    nominal : float
        Interval between samples, s; NaN until known.
    regular : float
        Longest interval that is no gap, s.
    before : float
        Nominal interval before the last change, s; NaN where there was none.
    intervals : list of float
        Of the present window, s. Gaps are added by `add`, regular intervals may be appended.
    due_ns : int
        Stamp from which on the window may end.
    """

    def __init__(self) -> None:
        self.nominal = self.before = math.nan
        self._settled = math.nan
        self.regular = FIRST_GAP
        self.intervals: list[float] = []
        self.due_ns = 0
        self._windows: deque[tuple[float, float]] = deque(maxlen=_WINDOWS)

    @property
    def in_batches(self) -> bool:
        """Whether pauses are much longer than the mean interval."""
        return self.regular > 1.5 * _GAP_RATIO * self.nominal

    def begin_window(self, stamp_ns: int) -> None:
        """Begin a window at this stamp."""
        self.intervals.clear()
        self.due_ns = stamp_ns + (_WINDOW_NS if self._windows else _FIRST_WINDOW_NS)

    def add(self, interval: float) -> None:
        """Add an interval, s, regular or not, to the present window."""
        if interval <= _LONGEST_PAUSE:
            self.intervals.append(interval)

    def learn(self, stamp_ns: int) -> bool:
        """End the window at this stamp, where it is long enough; whether the nominal interval has changed."""
        intervals = self.intervals
        if len(intervals) < _LEAST or max(intervals) > _LONGEST_SHARE * sum(intervals):
            self.due_ns = stamp_ns + _WINDOW_MORE_NS
            return False
        self._windows.append(_usual(np.array(intervals)))
        # the longer of two: a gap that is none bridges and counts what was never lost
        self.nominal, self.regular = map(median_high, zip(*self._windows, strict=True))
        self.begin_window(stamp_ns)
        if not _same(self.nominal, self._windows[-1][0]):  # a window of the one and of the other
            return False
        self.before, self._settled = self._settled, self.nominal
        return not (math.isnan(self.before) or _same(self.nominal, self.before))


def _same(one: float, other: float) -> bool:
    return max(one, other) < _SAME * min(one, other)


def _usual(intervals: NDArray[np.float64]) -> tuple[float, float]:
    """Nominal and longest regular interval of a window, s.

    Parameters
    ----------
    intervals : ndarray, shape (n,)
        s; none is longer than `_LONGEST_SHARE` of their sum.
    """
    ordered = np.sort(intervals)
    n, total = len(ordered), np.cumsum(ordered)
    if np.searchsorted(ordered, _CROWDED * total[-1] / n) < _MANY * n:
        count = np.searchsorted(ordered, _GAP_RATIO * ordered[int(_ALTERNATING * n)], "right")
        nominal = float(total[count - 1] / count)
        return nominal, _GAP_RATIO * nominal
    # half of the time lies in intervals that are not longer
    pause = float(ordered[np.searchsorted(total, 0.5 * total[-1])])
    pauses = intervals > pause / _GAP_RATIO
    if (pauses[1:] & pauses[:-1]).sum() > 0.5 * pauses.sum():  # they follow each other: the rest was a burst
        nominal = float(np.median(intervals[pauses]))
        return nominal, _GAP_RATIO * nominal
    ends = np.flatnonzero(pauses)
    return float(intervals[ends[0] + 1 : ends[-1] + 1].mean()), _GAP_RATIO * pause
