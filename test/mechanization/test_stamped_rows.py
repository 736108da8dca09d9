"""Rows of the last seconds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ins_nav.mechanization.stamped_rows import LENGTH_NS, StampedRows


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([500_000, 2_500_000, 20_000_000]), st.lists(st.integers(1, 3000), min_size=1, max_size=6))
def test_blocks_are_row_after_row(step_ns: int, sizes: list[int]) -> None:
    """At 2000, 400 and 50 Hz, beyond the first capacity; the last 12 s are complete."""
    one, other = StampedRows(2), StampedRows(2)
    stamps = np.arange(1, sum(sizes) + 1) * step_ns
    rows = np.column_stack([stamps * 1e-9, -stamps * 1e-9])
    for stamp, row in zip(stamps.tolist(), rows.tolist(), strict=True):
        one.append(stamp, tuple(row))
    at = 0
    for size in sizes:
        other.extend(stamps[at : at + size], rows[at : at + size])
        at += size
    expected = stamps > stamps[-1] - LENGTH_NS - 1
    for found in (one, other):
        assert np.array_equal(found.stamps[found.oldest : found.size], stamps[expected])
        assert np.array_equal(found.arrays[0][found.oldest : found.size], rows[expected])


def test_rows_of_all_arrays_stay_together() -> None:
    found = StampedRows(1)
    second = found.add_array(3)
    for i in range(10_000):
        found.append(i * 2_500_000, (float(i),))
        found.arrays[second][found.size - 1] = (i, i + 1, i + 2)
    row = found.count(9_000 * 2_500_000) - 1
    assert found.arrays[0][row] == pytest.approx([9_000.0])
    assert found.arrays[second][row] == pytest.approx([9_000.0, 9_001.0, 9_002.0])
    found.clear()
    assert found.count(10**18) == found.oldest == 0
