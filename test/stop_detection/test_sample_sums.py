"""Sums over 0.1 s: their values, and the detector over blocks of samples against one sample at a time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ins_nav.simulation.scenarios import simulate
from ins_nav.stop_detection.detector import Change, StopDetector
from ins_nav.stop_detection.sample_sums import EMPTY, add_sample, completes

STEP_NS = 20_000_000


@pytest.fixture(scope="module")
def drive() -> np.ndarray:
    """Samples of a stop of 20 s, 30 s of driving, a stop of 20 s and a start, at 50 Hz."""
    route = {"first_stop": 20.0, "drive_time": 30.0, "second_stop": 20.0, "duration": 70.0}
    simulation = simulate("zupt1_two_positions", 1, rate=50.0, **route)
    values = np.hstack([simulation.angular_velocity, simulation.linear_acceleration])
    return np.column_stack([np.full(len(values), STEP_NS * 1e-9), values])


def test_the_sums_of_constant_rate_and_force() -> None:
    """Turned back to the start of the block: to first order, so to the square of a small angle."""
    rate, force, h, sums = 0.1, 2.0, 0.0025, EMPTY
    count = 0
    while not completes(sums[0], h):
        sums = add_sample(sums, (h, 0.0, 0.0, rate, force, 0.0, 9.8))
        count += 1
    assert count == 40
    time, _, _, turn, vx, vy, vz, sx, _, _ = sums
    assert (time, turn) == (pytest.approx(0.1), pytest.approx(0.01))
    assert vx == pytest.approx(force * math.sin(0.01) / rate, rel=1e-4)
    assert vy == pytest.approx(force * (1.0 - math.cos(0.01)) / rate, rel=1e-4)
    assert vz == pytest.approx(0.98)
    assert sx == pytest.approx(0.5 * force * 0.1**2, rel=1e-4)


_RARE = st.sampled_from([0.0, -0.1, 0.15, 0.5, 3.0, math.nan])


@settings(max_examples=20, deadline=None)  # the first example compiles
@given(st.integers(1, 4000), st.dictionaries(st.integers(0, 3499), _RARE, max_size=4))
def test_a_block_is_sample_after_sample(drive: np.ndarray, size: int, rare: dict[int, float]) -> None:
    """With gaps, short and long, and invalid intervals: equal to the last bit."""
    samples = drive.copy()
    for row, interval in rare.items():
        samples[row, 0] = interval
    stamps = np.arange(1, len(samples) + 1) * STEP_NS
    one, other = StopDetector(), StopDetector()
    expected = [one.add(at, tuple(row)) for at, row in zip(stamps.tolist(), samples.tolist(), strict=True)]  # type: ignore[arg-type]
    found: list[Change | None] = []
    longest, i = STEP_NS * 1e-9, 0
    while i < len(samples):
        due = np.flatnonzero(
            (stamps[i:] >= other.due_ns(longest)) | ~(samples[i:, 0] > 0.0) | (samples[i:, 0] > longest)
        )
        count = min(size, int(due[0]) if len(due) else len(samples) - i)
        if count:
            other.add_run(int(stamps[i + count - 1]), samples[i : i + count])
        else:
            found.append(other.add(int(stamps[i]), tuple(samples[i].tolist())))
            count = 1
        i += count
    changes = [change for change in found if change is not None]
    assert changes == [change for change in expected if change is not None]
    for name in ("stopped", "since_ns", "stamp_ns", "rest_ns", "shake", "noise", "speed", "speed_stddev"):
        assert getattr(other, name) == getattr(one, name)
    if not rare:
        assert [change.stopped for change in changes] == [True, False, True, False]
