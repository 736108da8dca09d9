"""Injected faults change what they claim, within their span, and nothing else."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from bench import fault_injection as inject
from bench.fault_injection import ACCEL, GYRO, NS, Fault, Span, Stream

RATE, COUNT = 50.0, 1000
SPAN = Span(5.0, 12.0)


def stream(columns: int = 6, seed: int = 0) -> Stream:
    time = np.arange(1, COUNT + 1) / RATE
    stamps = 1_700_000_000 * NS + np.rint(time * NS).astype(np.int64)
    values = np.random.default_rng(seed).standard_normal((COUNT, columns))
    return Stream(time, stamps, stamps, values, np.ones((COUNT, columns)), np.zeros(COUNT, np.int64))


CHANGES: dict[str, tuple[Callable[[Stream, Span], Stream], set[str], slice]] = {
    "mapped": (partial(inject.mapped, matrix=-1.0, columns=ACCEL), {"values"}, ACCEL),
    "turned": (partial(inject.turned, rpy_deg=(10.0, 20.0, 30.0)), {"values"}, inject.EVERY),
    "offset": (partial(inject.offset, size=1.0, rate=0.1), {"values"}, inject.EVERY),
    "replaced": (partial(inject.replaced, value=0.0, columns=GYRO), {"values"}, GYRO),
    "frozen": (partial(inject.frozen, columns=slice(2, 3)), {"values"}, slice(2, 3)),
    "clipped": (partial(inject.clipped, limit=0.5, columns=GYRO), {"values"}, GYRO),
    "repeated": (partial(inject.repeated_values, count=4), {"values"}, inject.EVERY),
    "noisy": (partial(inject.noisy, stddev=1.0, seed=1), {"values"}, inject.EVERY),
    "correlated": (partial(inject.correlated, stddev=1.0, correlation_time=2.0, seed=1), {"values"}, inject.EVERY),
    "spikes": (partial(inject.spikes, share=0.5, size=9.0, seed=1), {"values"}, inject.EVERY),
    "stddev": (partial(inject.with_stddev, stddev=0.0), {"variances"}, inject.EVERY),
    "status": (partial(inject.with_status, status=-1), {"status"}, inject.EVERY),
    "late": (partial(inject.stamped_late, delay=0.15, rate=1e-3), {"stamps_ns"}, inject.EVERY),
    "jitter": (partial(inject.jitter, stddev=1e-3, seed=1), {"stamps_ns"}, inject.EVERY),
    "batched": (partial(inject.batched, count=10), {"stamps_ns", "arrival_ns"}, inject.EVERY),
    "delayed": (partial(inject.delayed, delay=1.0), {"arrival_ns"}, inject.EVERY),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_fault_changes_what_it_claims_and_nothing_else(name: str) -> None:
    change, fields, columns = CHANGES[name]
    before, pristine = stream(), stream()
    after = change(before, SPAN)
    inside = before.within(SPAN)
    for field in Stream._fields:
        old, new = getattr(pristine, field), getattr(after, field)
        assert np.array_equal(getattr(before, field), old), "the argument stays"
        assert np.array_equal(old[~inside], new[~inside])
        assert np.array_equal(old, new) != (field in fields)
    others = np.delete(np.arange(6), np.arange(6)[columns])
    assert np.array_equal(after.values[:, others], before.values[:, others])


@pytest.mark.parametrize("name", ["noisy", "correlated", "spikes", "jitter"])
def test_a_seed_gives_the_same_draws(name: str) -> None:
    change, (field, *_), _ = CHANGES[name]
    once, again, other = (getattr(f(stream(), SPAN), field) for f in (change, change, partial(change, seed=2)))
    assert np.array_equal(once, again)
    assert not np.array_equal(once, other)


def test_axes_turned_to_the_left_see_forward_motion_to_the_right() -> None:
    forward = stream()._replace(values=np.tile([1.0, 0.0, 0.0, 0.0, 0.0, 1.0], (COUNT, 1)))
    after = inject.turned(forward, SPAN, (0.0, 0.0, 90.0)).values[after_begin()]
    np.testing.assert_allclose(after, [0.0, -1.0, 0.0, 0.0, 0.0, 1.0], atol=1e-12)


def after_begin() -> int:
    return int(np.argmax(stream().within(SPAN)))


def test_a_frozen_value_is_that_of_the_first_message() -> None:
    after = inject.frozen(stream(), SPAN)
    inside = after.within(SPAN)
    assert (after.values[inside] == stream().values[after_begin()]).all()


def test_values_repeat_in_groups_from_the_begin() -> None:
    values = inject.repeated_values(stream(), SPAN, 4).values[stream().within(SPAN)]
    groups = values[: len(values) // 4 * 4].reshape(-1, 4, 6)
    assert (groups == groups[:, :1]).all()
    assert len(np.unique(groups[:, 0, 0])) == len(groups)


def test_a_ramp_begins_at_zero() -> None:
    error = inject.offset(stream(), SPAN, 0.0, 0.5).values - stream().values
    time = stream().time
    np.testing.assert_allclose(error[:, 0], np.where(stream().within(SPAN), 0.5 * (time - SPAN.begin), 0.0), atol=1e-12)


def test_a_correlated_error_has_its_size_and_its_correlation() -> None:
    whole = Span(0.0)
    error = inject.correlated(stream(400), whole, 3.0, 2.0, 1).values - stream(400).values
    # 400 independent series: the means are right to some percent
    np.testing.assert_allclose(np.sqrt(np.mean(error**2)), 3.0, rtol=0.05)
    lag = round(2.0 * RATE)
    np.testing.assert_allclose(np.mean(error[lag:] * error[:-lag]) / 9.0, np.exp(-1.0), atol=0.05)


def test_lost_messages_leave_the_others() -> None:
    after = inject.lost(stream(), SPAN)
    kept = stream().rows(~stream().within(SPAN))
    assert all(np.array_equal(a, b) for a, b in zip(after, kept, strict=True))


def test_a_halved_rate_keeps_increments() -> None:
    before, after = stream(), inject.thinned(stream(), SPAN, 2)
    inside, left = before.within(SPAN), after.within(SPAN)
    assert left.sum() == inside.sum() // 2
    np.testing.assert_allclose(2.0 * after.values[left].sum(axis=0), before.values[inside].sum(axis=0))
    assert np.array_equal(before.rows(~inside).values, after.rows(~left).values)
    # averaged over intervals that end at the stamp
    np.testing.assert_allclose(np.diff(after.stamps_ns[left]), 2.0 / RATE * NS)


def test_a_doubled_rate_keeps_increments() -> None:
    before, after = stream(), inject.split(stream(), SPAN, 2)
    inside = before.within(SPAN)
    first = int(np.argmax(inside))
    doubled = slice(first, first + 2 * int(inside.sum()))
    np.testing.assert_allclose(np.diff(after.stamps_ns[first - 1 : doubled.stop]), 0.5 / RATE * NS, atol=1)
    np.testing.assert_allclose(0.5 * after.values[doubled].sum(axis=0), before.values[inside].sum(axis=0))
    assert np.array_equal(after.stamps_ns[doubled][1::2], before.stamps_ns[inside])
    assert len(after.time) == COUNT + inside.sum()


def test_more_messages_have_stamps_between() -> None:
    after = inject.multiplied(stream(), SPAN, 3)
    left = after.within(SPAN)
    assert left.sum() == 3 * stream().within(SPAN).sum()
    np.testing.assert_allclose(np.diff(after.stamps_ns[left]), NS / RATE / 3.0, atol=1)
    assert np.array_equal(after.rows(~left).values, stream().rows(~stream().within(SPAN)).values)


def test_a_fast_clock_gains_its_share() -> None:
    late = (inject.stamped_late(stream(), Span(5.0), 0.0, 1e-3).stamps_ns - stream().stamps_ns) / NS
    np.testing.assert_allclose(late[-1], 1e-3 * (20.0 - 5.0), atol=1e-9)


def test_a_batch_arrives_with_its_last_sample_in_order() -> None:
    after = inject.batched(stream(), SPAN, 10)
    first = after_begin()
    batch = slice(first, first + 10)
    assert (after.arrival_ns[batch] >= stream().arrival_ns[first + 9]).all()
    assert (np.diff(after.stamps_ns[batch]) == round(1e-4 * NS)).all()


def test_a_fault_leaves_other_topics_alone() -> None:
    recording = {"log": stream(3), "depth": stream(1)}
    after = Fault(("log",), inject.lost, SPAN)(recording)
    assert after["depth"] is recording["depth"]
    assert len(after["log"].time) < COUNT
