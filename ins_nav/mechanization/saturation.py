"""Saturation: an axis that stops at the largest value of a window, in the middle of fast changes.

Neither the range of the sensor nor its resolution need be known: a quantized sensor that is quiet stays at a value too,
but arrives there by single steps of its resolution.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FALSE_ALARM = 1e-9
"""Probability that independent repeats by quantization look like a limit, a window."""
_LEAST_PROBABILITY = 0.02
"""Of a repeat, at least: that at the largest value of 100 independent samples."""
LEAST_REPEATS = 6
"""At the limit: fewer have a larger probability than `FALSE_ALARM` in any case."""
_STEEP = 4.0
"""Steps of the resolution by which the axis arrives at the extreme and leaves it, in the mean."""
_PEAK, _LEAST_PEAK = 0.25, 0.25
"""Height of what was cut off: of a parabola, in units of its slope at the cut times its width; at least this share of
the extreme."""


class Saturation(NamedTuple):
    """An axis at its limit.

    Attributes
    ----------
    limit : float
        Value at which it stops.
    error : float
        Sigma of the integral of what was cut off, in units of the value times samples.
    share : float
        Of the samples at the limit.
    """

    limit: float
    error: float
    share: float


def saturation(values: Array) -> Saturation | None:
    """Test a window of samples of one axis, shape (n,)."""
    if np.count_nonzero(values[1:] == values[:-1]) < LEAST_REPEATS:
        return None
    for sign in (1.0, -1.0):
        found = _flat(sign * values, sign)
        if found is not None:
            return found
    return None


def _flat(values: Array, sign: float) -> Saturation | None:
    top = float(values.max())
    at = np.concatenate([[False], values == top, [False]])
    begins, ends = np.flatnonzero(at[1:] & ~at[:-1]), np.flatnonzero(~at[1:] & at[:-1])
    widths = ends - begins
    steps = np.abs(np.diff(values))
    repeats = int((widths - 1).sum())
    elsewhere = int((steps == 0.0).sum()) - repeats
    probability = max(_LEAST_PROBABILITY, (elsewhere + 1) / (len(values) - repeats + 1))
    arrangements = math.comb(repeats + len(widths) - 1, repeats)  # of the repeats at their arrivals
    if arrangements * probability**repeats > FALSE_ALARM:
        return None
    flanks = np.concatenate([steps[begins[begins > 0] - 1], steps[ends[ends < len(values)] - 1]])
    if not len(flanks) or flanks.mean() < _STEEP * steps[steps > 0.0].min():
        return None
    heights = np.maximum(_PEAK * flanks.mean() * widths, _LEAST_PEAK * abs(top))
    return Saturation(sign * top, float(heights @ widths), float(widths.sum()) / len(values))
