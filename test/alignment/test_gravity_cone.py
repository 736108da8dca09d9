"""Specific force gathered on the axes of the first sample: rocking averages out, a turn changes nothing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ins_nav.alignment import gravity_cone
from ins_nav.alignment.gravity_cone import BLOCKS, GravityCone, cone_path
from ins_nav.mechanization.earth import RATE
from ins_nav.mechanization.strapdown import Sample

G = 9.81
H = 0.01


def _turning(rate: float, count: int) -> np.ndarray:
    """Samples of a body that turns about its x axis, level at first, at a rate in rad/s, with gravity alone."""
    roll = rate * H * (np.arange(count) + 0.5)
    zero = np.zeros(count)
    return np.column_stack(
        [np.full(count, H), np.full(count, rate), zero, zero, zero, G * np.sin(roll), G * np.cos(roll)]
    )


def _fed(samples: np.ndarray, duration: float = 10.0) -> GravityCone:
    cone = GravityCone(duration)
    previous = tuple(samples[0].tolist())
    for row in samples.tolist():
        cone.add(previous, tuple(row), False)
        previous = tuple(row)
    return cone


def test_the_vertical_stays_where_it_is_while_the_body_turns() -> None:
    cone = _fed(_turning(0.3, 1000))
    blocks = cone.blocks()
    assert len(cone) == len(blocks.time) == 111  # of 9 samples: the first whole number over 10 s / 120
    # a mean over an interval is G sinc(0.0015), 4e-6 of G less
    assert blocks.force == pytest.approx(np.tile([0.0, 0.0, G], (111, 1)), abs=1e-4)
    assert cone.q_b0b[0] == pytest.approx(math.sin(0.5 * 0.3 * 10.0), abs=1e-9)
    assert cone.rest_time == pytest.approx(0.01) and cone.rest[2] == pytest.approx(0.01 * G, rel=1e-5)
    assert blocks.apparent_speed() < 1e-4


def test_a_longer_time_joins_blocks() -> None:
    """Twice 120 blocks are 120 of twice the length, with the same mean and the same ends."""
    samples = _turning(0.3, 3000)
    long, whole = _fed(samples, 10.0), _fed(samples, 100.0)
    assert BLOCKS <= len(long) < 2 * BLOCKS
    assert long.blocks().length == pytest.approx(0.18, rel=0.02)
    assert long.time == whole.time == pytest.approx(30.0)
    assert long.q_b0b == whole.q_b0b


def test_rates_in_degrees() -> None:
    samples = _turning(0.3, 1000)
    samples[:, 1:4] = np.degrees(samples[:, 1:4])
    cone = _fed(samples)
    assert cone.blocks().apparent_speed() > 1.0
    assert cone.in_degrees().apparent_speed() < 1e-4
    assert cone.mean_size() == pytest.approx(G)


def test_the_path_of_the_vertical() -> None:
    """After a quarter of a sidereal day at the equator it points where east was; at a pole it stays."""
    quarter = np.array([0.5 * math.pi / RATE])
    assert cone_path(0.0, quarter)[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert cone_path(0.5 * math.pi, quarter)[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


@settings(max_examples=25, deadline=None)  # the first example compiles
@given(st.integers(1, 1500), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_block_is_sample_after_sample(size: int, instantaneous: bool, seed: int) -> None:
    """Over irregular intervals, through joined blocks, with the limits of what is kept for the noise."""
    rng = np.random.default_rng(seed)
    count = 1500
    samples = np.c_[rng.uniform(0.005, 0.1, count), rng.normal(0.0, 0.3, (count, 3)), rng.normal(0.0, 5.0, (count, 3))]
    one, other = GravityCone(20.0), GravityCone(20.0)
    before: Sample = tuple(samples[0].tolist())
    previous, completed = before, []
    for i, row in enumerate(samples.tolist()):
        if one.add(previous, tuple(row), instantaneous):
            completed.append(i)
        previous = tuple(row)
    at, ends = 0, []
    while at < count:
        until = min(at + size, count)
        added, complete = other.add_block(before, samples[at:until], instantaneous)
        at += added
        before = tuple(samples[at - 1].tolist())
        if complete:
            ends.append(at - 1)
    assert ends == completed
    assert (other.time, len(other), other.complete) == (one.time, len(one), one.complete)
    # the compiler may order additions differently: rounding only
    for a, b in ((other.q_b0b, one.q_b0b), (other.rest, one.rest), (other.blocks().force, one.blocks().force)):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11)
    assert np.array_equal(other.noise_limits(G), one.noise_limits(G))
    assert other.in_degrees().apparent_speed() == pytest.approx(one.in_degrees().apparent_speed(), rel=1e-9)


def test_samples_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gravity_cone, "MAX_SAMPLES", 700)
    samples = _turning(0.3, 1000)
    one, other = _fed(samples), GravityCone(10.0)
    at, previous = 0, tuple(samples[0].tolist())
    while at < len(samples):
        at += other.add_block(previous, samples[at:], False)[0]
        previous = tuple(samples[at - 1].tolist())
    assert not one.complete and not other.complete
    assert other.mean_size() == one.mean_size()
