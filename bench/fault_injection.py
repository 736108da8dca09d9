"""Faults of sensors, clocks and drivers as pure functions on recorded messages: `Stream` in, `Stream` out.

Every function changes the messages measured within a `Span` and no others; size and seed are arguments. The instants of
measurement stay: they are the truth that a fault of the clock departs from.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NS = 1_000_000_000
IMU = "imu/data_raw"
GYRO, ACCEL = slice(0, 3), slice(3, 6)
"""Columns of the IMU's values."""
EVERY = slice(None)


class Span(NamedTuple):
    """Times since the start of the recording, s: from ``begin`` until before ``end``."""

    begin: float
    end: float = np.inf

    def __contains__(self, time: object) -> bool:
        return isinstance(time, float) and self.begin <= time < self.end


class Stream(NamedTuple):
    """Messages of one topic, m of them, in the order of measurement."""

    time: Array
    """(m,), true instants of measurement since the start of the recording, s."""
    stamps_ns: NDArray[np.int64]
    """(m,), of the headers."""
    arrival_ns: NDArray[np.int64]
    """(m,), when the message arrives, on the clock of the computer."""
    values: Array
    """(m, k): angular rate and specific force; latitude and longitude, deg, and height; velocity; a number."""
    variances: Array
    """(m, k), as the message gives them."""
    status: NDArray[np.int64]
    """(m,), of a fix; 0 elsewhere."""

    def within(self, span: Span) -> Mask:
        """Messages measured within a span, shape (m,)."""
        inside: Mask = (self.time >= span.begin) & (self.time < span.end)
        return inside

    def rows(self, index: NDArray[np.int64] | Mask) -> "Stream":
        """Some of the messages."""
        return Stream(*(column[index] for column in self))


Recording = Mapping[str, Stream]
"""Messages by topic."""
Change = Callable[[Stream, Span], Stream]


class Fault(NamedTuple):
    """A change of some topics within a span."""

    topics: tuple[str, ...]
    change: Change
    span: Span

    def __call__(self, recording: Recording) -> Recording:
        return {t: self.change(s, self.span) if t in self.topics else s for t, s in recording.items()}


# --- values


def mapped(stream: Stream, span: Span, matrix: ArrayLike, columns: slice = EVERY) -> Stream:
    """Values multiplied by a matrix, shape (k, k), or by a number: units, signs, axes, mounting."""
    values, inside = stream.values.copy(), stream.within(span)
    part = values[inside, columns]
    values[inside, columns] = (
        part
        @ (np.asarray(matrix, float) * np.eye(part.shape[1]) if np.ndim(matrix) == 0 else np.asarray(matrix, float)).T
    )
    return stream._replace(values=values)


def turned(stream: Stream, span: Span, rpy_deg: Sequence[float]) -> Stream:
    """Every three columns as measured on axes turned by roll, pitch, yaw, deg."""
    inverse = Rotation.from_euler("ZYX", list(rpy_deg)[::-1], degrees=True).as_matrix().T
    blocks = stream.values.shape[1] // 3
    return mapped(stream, span, np.kron(np.eye(blocks), inverse))


def offset(stream: Stream, span: Span, size: ArrayLike, rate: ArrayLike = 0.0) -> Stream:
    """A constant added, and a ramp, per second since the begin of the span; numbers or shape (k,)."""
    values, inside = stream.values.copy(), stream.within(span)
    since = stream.time[inside, None] - max(span.begin, 0.0)
    values[inside] += np.asarray(size, float) + since * np.asarray(rate, float)
    return stream._replace(values=values)


def replaced(stream: Stream, span: Span, value: ArrayLike, columns: slice = EVERY) -> Stream:
    """Values replaced by constants."""
    values = stream.values.copy()
    values[stream.within(span), columns] = value
    return stream._replace(values=values)


def frozen(stream: Stream, span: Span, columns: slice = EVERY) -> Stream:
    """Values stay as at the begin of the span."""
    inside = stream.within(span)
    return replaced(stream, span, stream.values[np.argmax(inside), columns], columns) if inside.any() else stream


def clipped(stream: Stream, span: Span, limit: float, columns: slice = EVERY) -> Stream:
    """Saturation at a limit of either sign."""
    values, inside = stream.values.copy(), stream.within(span)
    values[inside, columns] = np.clip(values[inside, columns], -limit, limit)
    return stream._replace(values=values)


def repeated_values(stream: Stream, span: Span, count: int) -> Stream:
    """Each value repeated over so many messages: a sensor slower than its driver."""
    index = np.arange(len(stream.time))
    inside = stream.within(span)
    index[inside] -= (index[inside] - np.argmax(inside)) % count
    return stream._replace(values=stream.values[index])


def noisy(stream: Stream, span: Span, stddev: ArrayLike, seed: int) -> Stream:
    """White noise added."""
    inside = stream.within(span)
    noise = np.random.default_rng(seed).standard_normal((int(inside.sum()), stream.values.shape[1]))
    values = stream.values.copy()
    values[inside] += noise * np.asarray(stddev, float)
    return stream._replace(values=values)


def correlated(stream: Stream, span: Span, stddev: ArrayLike, correlation_time: float, seed: int) -> Stream:
    """A first-order Gauss-Markov error added, stationary from the begin of the span."""
    inside = stream.within(span)
    time = stream.time[inside]
    draws = np.random.default_rng(seed).standard_normal((len(time), stream.values.shape[1]))
    keep = np.exp(-np.diff(time, prepend=time[:1]) / correlation_time)
    error, now = np.empty_like(draws), draws[:1].sum(axis=0)
    for i, factor in enumerate(keep):
        now = now if i == 0 else factor * now + np.sqrt(1.0 - factor**2) * draws[i]
        error[i] = now
    values = stream.values.copy()
    values[inside] += error * np.asarray(stddev, float)
    return stream._replace(values=values)


def spikes(stream: Stream, span: Span, share: float, size: ArrayLike, seed: int) -> Stream:
    """A share of the values is off by up to ``size`` either way."""
    rng = np.random.default_rng(seed)
    wrong = stream.within(span) & (rng.random(len(stream.time)) < share)
    error = rng.uniform(-1.0, 1.0, stream.values.shape) * np.asarray(size, float)
    values = stream.values.copy()
    values[wrong] += error[wrong]
    return stream._replace(values=values)


# --- covariance and status


def with_stddev(stream: Stream, span: Span, stddev: ArrayLike) -> Stream:
    """Covariances that say this; 0: none is given."""
    variances = stream.variances.copy()
    variances[stream.within(span)] = np.square(np.asarray(stddev, float))
    return stream._replace(variances=variances)


def with_status(stream: Stream, span: Span, status: int) -> Stream:
    """Status of fixes."""
    changed = stream.status.copy()
    changed[stream.within(span)] = status
    return stream._replace(status=changed)


# --- messages


def lost(stream: Stream, span: Span) -> Stream:
    """No messages."""
    return stream.rows(~stream.within(span))


def thinned(stream: Stream, span: Span, count: int) -> Stream:
    """The mean of so many samples in the place of each group: the rate of an averaging sensor falls."""
    inside = np.flatnonzero(stream.within(span))
    inside = inside[: len(inside) // count * count]
    last = inside[count - 1 :: count]
    values = stream.values.copy()
    values[last] = stream.values[inside].reshape(len(last), count, -1).mean(axis=1)
    keep = np.ones(len(stream.time), bool)
    keep[np.setdiff1d(inside, last)] = False
    return stream._replace(values=values).rows(keep)


def split(stream: Stream, span: Span, count: int) -> Stream:
    """Each sample as so many of the same value, evenly over the interval that it ends: an averaging sensor, faster."""
    repeats = np.where(stream.within(span), count, 1)
    index = np.repeat(np.arange(len(stream.time)), repeats)
    place = np.arange(len(index)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    interval = np.diff(stream.time, prepend=2.0 * stream.time[0] - stream.time[1])
    early = interval[index] * (1.0 - (place + 1.0) / repeats[index])
    early_ns = np.rint(early * NS).astype(np.int64)
    more = stream.rows(index)
    return more._replace(
        time=more.time - early, stamps_ns=more.stamps_ns - early_ns, arrival_ns=more.arrival_ns - early_ns
    )


def multiplied(stream: Stream, span: Span, count: int) -> Stream:
    """Each message sent so many times, evenly over the interval until the next, with stamps of its own."""
    repeats = np.where(stream.within(span), count, 1)
    index = np.repeat(np.arange(len(stream.time)), repeats)
    within = np.arange(len(index)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    share = within / repeats[index]
    step = np.append(np.diff(stream.time), 0.0)[index] * share
    late = np.rint(step * NS).astype(np.int64)
    more = stream.rows(index)
    return more._replace(time=more.time + step, stamps_ns=more.stamps_ns + late, arrival_ns=more.arrival_ns + late)


# --- clocks


def stamped_late(stream: Stream, span: Span, delay: float, rate: float = 0.0) -> Stream:
    """Stamps late by a constant, s, and by a share of the time since the begin: a step, an offset, a fast clock."""
    since = stream.time - max(span.begin, 0.0)
    late = np.where(stream.within(span), delay + rate * since, 0.0)
    return stream._replace(stamps_ns=stream.stamps_ns + np.rint(late * NS).astype(np.int64))


def jitter(stream: Stream, span: Span, stddev: float, seed: int) -> Stream:
    """Stamps with white noise, s; their order stays."""
    noise = np.random.default_rng(seed).standard_normal(len(stream.time)) * stddev
    stamps = stream.stamps_ns + np.where(stream.within(span), np.rint(noise * NS), 0.0).astype(np.int64)
    return stream._replace(stamps_ns=np.maximum.accumulate(stamps))


def batched(stream: Stream, span: Span, count: int, spacing: float = 1e-4) -> Stream:
    """So many messages come together after the last of them, stamped on arrival, ``spacing`` s apart."""
    inside = np.flatnonzero(stream.within(span))
    inside = inside[: len(inside) // count * count]
    place = np.arange(len(inside)) % count
    last = inside[np.arange(len(inside)) // count * count + count - 1]
    late = np.rint(place * spacing * NS).astype(np.int64)
    stamps, arrival = stream.stamps_ns.copy(), stream.arrival_ns.copy()
    stamps[inside], arrival[inside] = stream.stamps_ns[last] + late, stream.arrival_ns[last] + late
    return stream._replace(stamps_ns=stamps, arrival_ns=arrival)


def delayed(stream: Stream, span: Span, delay: float) -> Stream:
    """Messages arrive later, s; their stamps are right."""
    late = np.where(stream.within(span), round(delay * NS), 0)
    return stream._replace(arrival_ns=stream.arrival_ns + late)
