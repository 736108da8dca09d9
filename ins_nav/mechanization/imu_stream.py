"""The IMU's stream: turns stamped samples, good and bad, into intervals that can be integrated.

Bad input never reaches the state: it is counted, and reported in a line that names the topic, the value and the
remedy. A jump of the stamps (back, or far ahead) is accepted only when the next sample continues from it, so one
wrong stamp costs one sample and a looped bag restarts cleanly.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.sections import ImuSection
from ins_nav.event_log import ERROR, INFO, WARN, EventLog
from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.sample_interval import FIRST_GAP, SampleInterval
from ins_nav.mechanization.strapdown import SAMPLE_SIZE, Sample

TOPIC = "imu/data_raw"
_RESTART_BACK = 1.0
"""s: a stamp further back than this is a restart (a looped bag), a nearer one is out of order."""
_NEVER = -(2**63)
"""ns: before any stamp."""

Values = tuple[float, float, float, float, float, float]
"""Angular rate, rad/s, and specific force, m/s²."""
Restart = float
"""Seconds by which the stamps jumped: what came before is over."""
Outcome = tuple[tuple[int, Sample | Restart], ...]
"""Stamped, in order."""


def regular_interval(
    stamp_ns: int,
    last_ns: int,
    until_ns: int,
    regular: float,
    max_rate2: float,
    max_force2: float,
    wx: float,
    wy: float,
    wz: float,
    fx: float,
    fy: float,
    fz: float,
) -> float:
    """The interval that a regular sample ends, s; 0 for any other sample.

    Parameters
    ----------
    stamp_ns, last_ns : int
        Of the sample and of the last accepted one.
    until_ns : int
        Regular samples have earlier stamps.
    regular : float
        Longest interval that is no gap, s.
    max_rate2, max_force2 : float
        Squares of the largest credible angular rate, rad/s, and specific force, m/s².
    wx, wy, wz, fx, fy, fz : float
        rad/s and m/s²; not necessarily finite.
    """
    h = (stamp_ns - last_ns) * 1e-9
    if (
        0.0 < h <= regular
        and stamp_ns < until_ns
        and wx * wx + wy * wy + wz * wz <= max_rate2
        and 0.0 < fx * fx + fy * fy + fz * fz <= max_force2
    ):
        return h
    return 0.0


def _regular_run(
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    last_ns: int,
    until_ns: int,
    regular: float,
    max_rate2: float,
    max_force2: float,
    samples: NDArray[np.float64],
) -> int:
    """Write the samples that come before the first irregular one; the number of them."""
    for i in range(len(stamps)):
        wx, wy, wz, fx, fy, fz = values[i]
        h = regular_interval(stamps[i], last_ns, until_ns, regular, max_rate2, max_force2, wx, wy, wz, fx, fy, fz)
        if h == 0.0:
            return i
        sample = h, wx, wy, wz, fx, fy, fz
        for j in range(len(sample)):
            samples[i, j] = sample[j]
        last_ns = stamps[i]
    return len(stamps)


class ImuStream:
    """Checks stamps and values.

    Parameters
    ----------
    events : EventLog
        Where events are counted.
    imu : ImuSection

    Attributes
    ----------
    received, accepted : int
        Number of messages.
    """

    def __init__(self, events: EventLog, imu: ImuSection) -> None:
        self._events = events
        self._max_rate2 = imu.max_angular_velocity**2
        self._max_force2 = imu.max_linear_acceleration**2
        self._max_gap = imu.max_gap
        self._instantaneous = imu.instantaneous
        self._stamp = 0
        self._until_ns = _NEVER
        self._last: Values | None = None
        self._pending: tuple[int, Values] | None = None
        self._interval = SampleInterval()
        self.received = 0
        self.accepted = 0

    @property
    def nominal(self) -> float:
        """Interval between samples, s; NaN until known."""
        return self._interval.nominal

    @property
    def regular(self) -> float:
        """Longest interval that is no gap, s."""
        return self._interval.regular

    def accept(self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> Outcome:
        """Check one message.

        Parameters
        ----------
        stamp_ns : int
        wx, wy, wz, fx, fy, fz : float
            Angular rate, rad/s, and specific force, m/s².

        Returns
        -------
        tuple of (stamp, Sample or Restart)
            Nearly always one sample, none for a rejected one. A sample that follows a `Restart`, or is the first, has
            the interval 0.
        """
        self.received += 1
        interval = self._interval
        h = regular_interval(
            stamp_ns,
            self._stamp,
            self._until_ns,
            interval.regular,
            self._max_rate2,
            self._max_force2,
            wx,
            wy,
            wz,
            fx,
            fy,
            fz,
        )
        if h == 0.0:
            return self._examine(stamp_ns, (wx, wy, wz, fx, fy, fz))
        self._stamp = stamp_ns
        self._last = wx, wy, wz, fx, fy, fz
        self.accepted += 1
        interval.intervals.append(h)
        return ((stamp_ns, (h, wx, wy, wz, fx, fy, fz)),)

    def accept_run(self, stamps: NDArray[np.int64], values: NDArray[np.float64], until_ns: int) -> NDArray[np.float64]:
        """Check the first of a block of messages, up to an irregular one, as `accept` would one by one; compiled.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            ns.
        values : ndarray, shape (n, 6)
            Angular rate, rad/s, and specific force, m/s².
        until_ns : int
            Only messages with earlier stamps are checked.

        Returns
        -------
        ndarray, shape (m, 7)
            Samples of the first m messages, a `Sample` a row. The next message is for `accept`.
        """
        samples = np.empty((len(stamps), SAMPLE_SIZE))
        limits = self._interval.regular, self._max_rate2, self._max_force2
        count = compiled(_regular_run)(stamps, values, self._stamp, min(until_ns, self._until_ns), *limits, samples)
        samples = samples[:count]
        if count:
            self.received += count
            self.accepted += count
            self._interval.intervals.extend(samples[:, 0].tolist())
            self._stamp = int(stamps[count - 1])
            wx, wy, wz, fx, fy, fz = values[count - 1].tolist()
            self._last = wx, wy, wz, fx, fy, fz
        return samples

    def _examine(self, stamp_ns: int, values: Values) -> Outcome:
        """A sample that `regular_interval` does not accept."""
        wx, wy, wz, fx, fy, fz = values
        rate2, force2 = wx * wx + wy * wy + wz * wz, fx * fx + fy * fy + fz * fz
        if not (rate2 <= self._max_rate2 and 0.0 < force2 <= self._max_force2):
            self._reject_values(stamp_ns, values)
            return ()
        outcome = self._irregular(stamp_ns, (stamp_ns - self._stamp) * 1e-9, values)
        waits = self._pending is not None or self._last is None
        self._until_ns = _NEVER if waits else self._interval.due_ns
        return outcome

    def _accepted(self, stamp_ns: int, h: float, values: Values) -> tuple[int, Sample]:
        interval = self._interval
        self._stamp = stamp_ns
        self._last = values
        self.accepted += 1
        if h == 0.0:
            interval.begin_window(stamp_ns)
        else:
            interval.add(h)
        if stamp_ns >= interval.due_ns:
            self._learn(stamp_ns)
        return stamp_ns, (h, *values)

    def _learn(self, stamp_ns: int) -> None:
        interval = self._interval
        if interval.learn(stamp_ns):
            now, before = 1e3 * interval.nominal, 1e3 * interval.before
            text = f"{TOPIC}: the interval between samples is {now:.3g} ms now, {before:.3g} ms before"
            self._events.count("interval changes", INFO, text, stamp_ns)
        if interval.in_batches:
            self._events.count(
                "batches",
                WARN,
                f"{TOPIC}: stamps come in batches, {1.0 / interval.nominal:.3g} Hz in the mean: the driver must stamp "
                "a sample with the time of its measurement, not of its arrival",
                stamp_ns,
            )

    def _irregular(self, stamp_ns: int, h: float, values: Values) -> Outcome:
        if stamp_ns <= 0:
            self._events.count(
                "zero stamps",
                ERROR,
                f"{TOPIC}: header.stamp is {stamp_ns} ns, sample rejected: the driver must "
                "stamp its messages with the time of the sample",
                stamp_ns,
            )
            return ()
        if self._last is None:
            return (self._accepted(stamp_ns, 0.0, values),)
        if self._pending is not None:
            pending_stamp, pending_values = self._pending
            follows = (stamp_ns - pending_stamp) * 1e-9
            if 0.0 < follows <= max(self.regular, FIRST_GAP):
                self._pending = None
                return (*self._jump(pending_stamp, pending_values), self._accepted(stamp_ns, follows, values))
            if 0.0 < h <= max(self.regular, FIRST_GAP):
                self._pending = None
                self._events.count(
                    "stamp outliers",
                    WARN,
                    f"{TOPIC}: one stamp jumped by "
                    f"{(pending_stamp - self._stamp) * 1e-9:+.3f} s, sample rejected: check the driver's clock",
                    stamp_ns,
                )
                return (self._continue(stamp_ns, h, values),)
            if not -_RESTART_BACK < h <= 0.0:  # a third place: neither goes on from the other
                self._events.count(
                    "stamp outliers",
                    WARN,
                    f"{TOPIC}: stamps jump at every message ({h:+.3f} s now), samples rejected: check the driver's "
                    f"clock; a rate below {1.0 / FIRST_GAP:g} Hz is too slow",
                    stamp_ns,
                )
        if h == 0.0:
            self._events.count(
                "repeated stamps",
                WARN,
                f"{TOPIC}: stamp {stamp_ns} ns repeated, sample rejected: is the topic published twice?",
                stamp_ns,
            )
            return ()
        if -_RESTART_BACK < h < 0.0:
            self._events.count(
                "backward stamps",
                WARN,
                f"{TOPIC}: stamp goes back by {-h:.6f} s, sample rejected: messages must "
                "come in order, from one publisher",
                stamp_ns,
            )
            return ()
        if 0.0 < h <= max(self.regular, FIRST_GAP):
            return (self._continue(stamp_ns, h, values),)
        self._pending = (stamp_ns, values)
        return ()

    def _continue(self, stamp_ns: int, h: float, values: Values) -> tuple[int, Sample]:
        return (self._accepted if h <= self.regular else self._bridge)(stamp_ns, h, values)

    def _jump(self, stamp_ns: int, values: Values) -> Outcome:
        """A jump that the next sample confirmed."""
        h = (stamp_ns - self._stamp) * 1e-9
        if 0.0 < h <= self._max_gap:
            return (self._bridge(stamp_ns, h, values),)
        way = "back" if h < 0.0 else f"ahead, more than imu.max_gap ({self._max_gap:g} s)"
        self._events.count("restarts", WARN, f"{TOPIC}: stamps jumped by {h:+.3f} s ({way}): starting again", stamp_ns)
        self._interval = SampleInterval()
        return (stamp_ns, h), self._accepted(stamp_ns, 0.0, values)

    def _bridge(self, stamp_ns: int, h: float, values: Values) -> tuple[int, Sample]:
        """A gap: the last sample stands for its own interval, the time before it for the mean of its neighbours."""
        assert self._last is not None
        regular = self.nominal if not math.isnan(self.nominal) else h
        lost = round(h / regular) - 1
        if lost > 0:
            self._events.count(
                "gaps" if h <= FIRST_GAP else "long gaps",
                WARN,
                f"{TOPIC}: gap of {h:.3f} s, about {lost} samples lost, bridged by interpolation: "
                "check the QoS depth, the network and the driver",
                stamp_ns,
            )
            self._events.counts["samples lost"] = self._events.counts.get("samples lost", 0) + lost
        # values at the stamps need no mean: the straight line between them is what `step` takes
        share = 0.0 if self._instantaneous else 0.5 * max(0.0, h - regular) / h
        last = self._last
        self._accepted(stamp_ns, h, values)
        wx, wy, wz, fx, fy, fz = (share * a + (1.0 - share) * b for a, b in zip(last, values, strict=True))
        return stamp_ns, (h, wx, wy, wz, fx, fy, fz)

    def _reject_values(self, stamp_ns: int, values: Values) -> None:
        names = ("angular_velocity.x", ".y", ".z", "linear_acceleration.x", ".y", ".z")
        if not all(math.isfinite(value) for value in values):
            bad = next(i for i, value in enumerate(values) if not math.isfinite(value))
            name = names[bad] if bad % 3 == 0 else names[bad - bad % 3][:-2] + names[bad]
            self._events.count(
                "not finite",
                ERROR,
                f"{TOPIC}: {name} is {values[bad]}, sample rejected: the driver must not publish invalid samples",
                stamp_ns,
            )
            return
        rate = math.sqrt(sum(x * x for x in values[:3]))
        if rate * rate > self._max_rate2:
            self._events.count(
                "rate out of range",
                ERROR,
                f"{TOPIC}: angular velocity {rate:.1f} rad/s is over "
                f"imu.max_angular_velocity ({math.sqrt(self._max_rate2):g}), sample rejected: is it in deg/s? "
                "publish rad/s",
                stamp_ns,
            )
            return
        force = math.sqrt(sum(x * x for x in values[3:]))
        if force == 0.0:
            self._events.count(
                "zero force",
                ERROR,
                f"{TOPIC}: linear_acceleration is exactly 0, sample rejected: the driver must publish angular velocity "
                "and linear acceleration in one message, with gravity's reaction in the latter",
                stamp_ns,
            )
            return
        self._events.count(
            "force out of range",
            ERROR,
            f"{TOPIC}: linear acceleration {force:.1f} m/s^2 is over "
            f"imu.max_linear_acceleration ({math.sqrt(self._max_force2):g}), sample rejected: check its unit",
            stamp_ns,
        )
