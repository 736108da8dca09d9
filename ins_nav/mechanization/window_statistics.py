"""Statistics of a window of IMU samples in one pass: the input of all monitors (`imu_monitor`)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization.compiled import compiled

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

COARSE = 4
"""Samples in the means whose second differences are the second measure of noise: vibration and quantization are less
in it."""
EVERY_AXIS = 6
"""Index of the sample as a whole, after the six axes."""


class WindowStatistics(NamedTuple):
    """Of the samples of a window.

    Attributes
    ----------
    samples : int
        Their number.
    mean, low, high : list of 6 floats
        rad/s and m/s².
    fine, coarse : list of 6 floats
        Mean square of second differences of samples, and of means of `COARSE` samples, over 6: variance of white noise
        in one of them.
    step : list of 6 floats
        Mean square of first differences.
    repeats, lead, trail, longest, longest_end : list of 7 ints
        Of each axis, and of the sample as a whole: how often a value equals the one before; the length of the runs of
        repeats at the beginning and at the end, and of the longest; number of samples up to the end of the longest.
    changes, joint : list of 2 ints
        Of gyros and accelerometers: in how many samples any axis changes, and in how many all three do.
    """

    samples: int
    mean: list[float]
    low: list[float]
    high: list[float]
    fine: list[float]
    coarse: list[float]
    step: list[float]
    repeats: list[int]
    lead: list[int]
    trail: list[int]
    longest: list[int]
    longest_end: list[int]
    changes: list[int]
    joint: list[int]


def _pass(values: Array, axes: Array, runs: Counts, triads: Counts) -> None:
    """Fill the rows of `WindowStatistics`: mean to step, repeats to longest_end, changes to joint."""
    count = len(values)
    for j in range(EVERY_AXIS):
        total = fine = coarse = steps = 0.0
        low = high = values[1, j]
        block, one, other = 0.0, 0.0, 0.0
        blocks = 0
        for i in range(1, count):
            value, before = values[i, j], values[i - 1, j]
            total += value
            low = min(low, value)
            high = max(high, value)
            steps += (value - before) * (value - before)
            _count(i, value == before, runs, j)
            if i >= 2:
                second = value - 2.0 * before + values[i - 2, j]
                fine += second * second
            block += value
            if i % COARSE == 0:
                block /= COARSE
                blocks += 1
                if blocks >= 3:
                    second = block - 2.0 * one + other
                    coarse += second * second
                other, one, block = one, block, 0.0
        axes[0, j], axes[1, j], axes[2, j] = total / (count - 1), low, high
        axes[3, j] = fine / (6.0 * (count - 2))
        axes[4, j] = coarse / (6.0 * (blocks - 2))
        axes[5, j] = steps / (count - 1)
    for i in range(1, count):
        changed = 0
        for triad in range(2):
            some = 0
            for j in range(3 * triad, 3 * triad + 3):
                if values[i, j] != values[i - 1, j]:
                    some += 1
            changed += some
            if some > 0:
                triads[0, triad] += 1
            if some == 3:
                triads[1, triad] += 1
        _count(i, changed == 0, runs, EVERY_AXIS)


def _count(i: int, same: bool, runs: Counts, axis: int) -> None:
    """Count a repeat at sample i, from 1."""
    if not same:
        runs[2, axis] = 0
        return
    runs[0, axis] += 1
    runs[2, axis] += 1
    if runs[2, axis] == i:
        runs[1, axis] = i
    if runs[2, axis] > runs[3, axis]:
        runs[3, axis], runs[4, axis] = runs[2, axis], i


def window_statistics(values: Array) -> WindowStatistics:
    """Statistics of a window; compiled.

    Parameters
    ----------
    values : ndarray, shape (n + 1, 6)
        Angular rate, rad/s, and specific force, m/s², of the last sample before the window and of its n samples, at
        least 12.
    """
    axes = np.empty((6, EVERY_AXIS))
    runs, triads = np.zeros((5, EVERY_AXIS + 1), dtype=np.int64), np.zeros((2, 2), dtype=np.int64)
    compiled(_pass)(values, axes, runs, triads)
    rows: list[Any] = [*axes.tolist(), *runs.tolist(), *triads.tolist()]
    return WindowStatistics(len(values) - 1, *rows)
