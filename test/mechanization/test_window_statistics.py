"""One pass gives what numpy gives in many."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ins_nav.mechanization.window_statistics import COARSE, EVERY_AXIS, window_statistics


def _longest(same: np.ndarray) -> int:
    return max((len(list(run)) for equal, run in itertools.groupby(same.tolist()) if equal), default=0)


@settings(deadline=None)  # the first example compiles
@given(st.integers(12, 120), st.floats(0.1, 30.0), st.integers(0, 2**32))
def test_against_numpy(samples: int, steps: float, seed: int) -> None:
    """Quantized in so many steps a sigma: from hardly a change to hardly a repeat."""
    values = np.rint(steps * np.random.default_rng(seed).standard_normal((samples + 1, 6)))
    window = window_statistics(values)
    inside = values[1:]
    assert window.samples == samples
    assert window.mean == pytest.approx(inside.mean(axis=0), abs=1e-12)
    assert window.low == inside.min(axis=0).tolist() and window.high == inside.max(axis=0).tolist()
    assert window.fine == pytest.approx((np.diff(values, 2, axis=0) ** 2).mean(axis=0) / 6.0)
    means = inside[: samples // COARSE * COARSE].reshape(-1, COARSE, 6).mean(axis=1)
    assert window.coarse == pytest.approx((np.diff(means, 2, axis=0) ** 2).mean(axis=0) / 6.0)
    assert window.step == pytest.approx((np.diff(values, axis=0) ** 2).mean(axis=0))
    same = inside == values[:-1]
    same = np.column_stack([same, same.all(axis=1)])
    assert window.repeats == same.sum(axis=0).tolist()
    assert window.longest == [_longest(column) for column in same.T]
    assert window.lead == [int(np.argmin(np.append(column, False))) for column in same.T]
    assert window.trail == [int(np.argmin(np.append(column[::-1], False))) for column in same.T]
    changed = ~same[:, :EVERY_AXIS].reshape(samples, 2, 3)
    assert window.changes == changed.any(axis=2).sum(axis=0).tolist()
    assert window.joint == changed.all(axis=2).sum(axis=0).tolist()


def test_where_the_longest_run_ends() -> None:
    values = np.arange(120.0).reshape(20, 6)
    values[5:11] = values[5]
    values[15:17] = values[15]
    window = window_statistics(values)
    assert (window.longest[EVERY_AXIS], window.longest_end[EVERY_AXIS]) == (5, 10)
