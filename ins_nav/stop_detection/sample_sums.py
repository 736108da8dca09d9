"""Samples summed over blocks of 0.1 s: the stop detector uses single samples in them only."""

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.strapdown import Sample

BLOCK = 0.1
"""s: ten means a second resolve a body's motion on its springs (1 to 2 Hz), and average an engine's."""
LONGEST_GAP = 1.0
"""s: over a longer gap a stop is not certain any more. A car gains 3 m/s in it."""

Sums = tuple[float, float, float, float, float, float, float, float, float, float]
"""Time, s; integral of rate, rad; integral of specific force on the body's axes at the block's start, m/s; integral of
that, m."""
EMPTY: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def add_sample(sums: Sums, sample: Sample) -> Sums:
    """The sums with one more sample.

    Specific force is turned back to the body at the block's start, to first order: a block turns by some hundredths of
    a radian.
    """
    time, tx, ty, tz, vx, vy, vz, sx, sy, sz = sums
    h, wx, wy, wz, fx, fy, fz = sample
    half = 0.5 * h
    mx, my, mz = tx + half * wx, ty + half * wy, tz + half * wz
    nx = vx + h * (fx + my * fz - mz * fy)
    ny = vy + h * (fy + mz * fx - mx * fz)
    nz = vz + h * (fz + mx * fy - my * fx)
    return (
        time + h,
        mx + half * wx,
        my + half * wy,
        mz + half * wz,
        nx,
        ny,
        nz,
        sx + half * (vx + nx),
        sy + half * (vy + ny),
        sz + half * (vz + nz),
    )


def is_gap(h: float) -> bool:
    """Whether an interval, s, is too long to be summed."""
    return not 0.0 < h <= LONGEST_GAP


def completes(time: float, h: float) -> bool:
    """Whether a block is complete with its last interval, all in s: within half an interval of its length."""
    return time >= BLOCK - 0.5 * h


def _add_samples(sums: Sums, samples: NDArray[np.float64]) -> Sums:
    for i in range(len(samples)):
        h, wx, wy, wz, fx, fy, fz = samples[i]
        sums = add_sample(sums, (h, wx, wy, wz, fx, fy, fz))
    return sums


def add_samples(sums: Sums, samples: NDArray[np.float64]) -> Sums:
    """`add_sample` for each row of samples, shape (n, 7); compiled."""
    result: Sums = compiled(_add_samples)(sums, samples)
    return result
