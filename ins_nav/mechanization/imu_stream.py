"""The IMU's stream: turns stamped samples, good and bad, into intervals that can be integrated.

Bad input never reaches the state: it is counted, and told in a line that names the topic, the value and the
remedy. A jump of the stamps (back, or far ahead) is believed only when the next sample goes on from it, so one
wrong stamp costs one sample and a looped bag restarts cleanly.
"""

import math
from statistics import median

from ins_nav.config.sections import ImuSection
from ins_nav.event_log import ERROR, WARN, EventLog
from ins_nav.mechanization.strapdown import Sample

TOPIC = "imu/data_raw"
_LEARN = 25
"""Intervals whose median is the nominal one."""
_FIRST_GAP = 0.25
"""s: longest interval taken as regular before the nominal one is known (10 Hz with jitter)."""
_GAP_RATIO = 1.75
"""Intervals this many times the nominal one count as gaps: a lost sample makes 2, jitter seldom over 1.5."""
_RESTART_BACK = 1.0
"""s: a stamp further back than this is a restart (a looped bag), a nearer one is out of order."""

Restart = float
"""Seconds by which the stamps jumped: what came before is over."""


class ImuStream:
    """Checks stamps and values.

    Parameters
    ----------
    events : EventLog
        Where events are counted.
    imu : ImuSection
    """

    def __init__(self, events: EventLog, imu: ImuSection) -> None:
        self._events = events
        self._max_rate2 = imu.max_angular_velocity**2
        self._max_force2 = imu.max_linear_acceleration**2
        self._max_gap = imu.max_gap
        self._instantaneous = imu.instantaneous
        self._stamp = 0
        self._last: tuple[float, ...] | None = None
        self._pending: tuple[int, tuple[float, ...]] | None = None
        self._intervals: list[float] = []
        self.regular = _FIRST_GAP
        """Longest interval that is no gap, s."""
        self.nominal = math.nan
        """Interval between samples, s: the median of the first ones."""
        self.received = 0
        self.accepted = 0

    def accept(
        self, stamp_ns: int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float
    ) -> tuple[tuple[int, Sample | Restart], ...]:
        """Check one message.

        Parameters
        ----------
        stamp_ns : int
        wx, wy, wz, fx, fy, fz : float
            Angular rate, rad/s, and specific force, m/s².

        Returns
        -------
        tuple of (stamp, Sample or Restart)
            What to do now, in order: nearly always one sample, none for a rejected one. A sample that follows a
            `Restart`, or is the first, has the interval 0.
        """
        self.received += 1
        rate2 = wx * wx + wy * wy + wz * wz
        force2 = fx * fx + fy * fy + fz * fz
        if not (rate2 <= self._max_rate2 and force2 <= self._max_force2):
            self._reject_values(stamp_ns, (wx, wy, wz, fx, fy, fz))
            return ()
        h = (stamp_ns - self._stamp) * 1e-9
        values = (wx, wy, wz, fx, fy, fz)
        if 0.0 < h <= self.regular and self._pending is None and self._last is not None:
            return (self._take(stamp_ns, h, values),)
        return self._irregular(stamp_ns, h, values)

    def _take(self, stamp_ns: int, h: float, values: tuple[float, ...]) -> tuple[int, Sample]:
        self._stamp = stamp_ns
        self._last = values
        self.accepted += 1
        if len(self._intervals) < _LEARN and h > 0.0:
            self._intervals.append(h)
            if len(self._intervals) == _LEARN:
                self.nominal = median(self._intervals)
                self.regular = _GAP_RATIO * self.nominal
        return stamp_ns, (h, *values)  # type: ignore[return-value]

    def _irregular(
        self, stamp_ns: int, h: float, values: tuple[float, ...]
    ) -> tuple[tuple[int, Sample | Restart], ...]:
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
            return (self._take(stamp_ns, 0.0, values),)
        if self._pending is not None:
            pending_stamp, pending_values = self._pending
            follows = (stamp_ns - pending_stamp) * 1e-9
            if 0.0 < follows <= max(self.regular, _FIRST_GAP):
                self._pending = None
                return (*self._jump(pending_stamp, pending_values), self._take(stamp_ns, follows, values))
            if 0.0 < h <= max(self.regular, _FIRST_GAP):
                self._pending = None
                self._events.count(
                    "stamp outliers",
                    WARN,
                    f"{TOPIC}: one stamp jumped by "
                    f"{(pending_stamp - self._stamp) * 1e-9:+.3f} s, sample rejected: check the driver's clock",
                    stamp_ns,
                )
                return self._irregular(stamp_ns, h, values) if h > self.regular else (self._take(stamp_ns, h, values),)
            if not -_RESTART_BACK < h <= 0.0:  # a third place: neither goes on from the other
                self._events.count(
                    "stamp outliers",
                    WARN,
                    f"{TOPIC}: stamps jump at every message ({h:+.3f} s now), samples rejected: check the driver's "
                    f"clock; a rate below {1.0 / _FIRST_GAP:g} Hz is too slow",
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
        if 0.0 < h <= max(self.regular, _FIRST_GAP):
            return (self._bridge(stamp_ns, h, values),)
        self._pending = (stamp_ns, values)
        return ()

    def _jump(self, stamp_ns: int, values: tuple[float, ...]) -> tuple[tuple[int, Sample | Restart], ...]:
        """A jump that the next sample confirmed."""
        h = (stamp_ns - self._stamp) * 1e-9
        if 0.0 < h <= self._max_gap:
            return (self._bridge(stamp_ns, h, values),)
        way = "back" if h < 0.0 else f"ahead, more than imu.max_gap ({self._max_gap:g} s)"
        self._events.count("restarts", WARN, f"{TOPIC}: stamps jumped by {h:+.3f} s ({way}): starting again", stamp_ns)
        self._intervals.clear()
        self.regular = _FIRST_GAP
        return (stamp_ns, h), self._take(stamp_ns, 0.0, values)

    def _bridge(self, stamp_ns: int, h: float, values: tuple[float, ...]) -> tuple[int, Sample]:
        """A gap: the last sample stands for its own interval, the time before it for the mean of its neighbours."""
        assert self._last is not None
        regular = self.nominal if not math.isnan(self.nominal) else h
        lost = round(h / regular) - 1
        if lost > 0:
            self._events.count(
                "gaps" if h <= _FIRST_GAP else "long gaps",
                WARN,
                f"{TOPIC}: gap of {h:.3f} s, about {lost} samples lost, bridged by interpolation: "
                "check the QoS depth, the network and the driver",
                stamp_ns,
            )
            self._events.counts["samples lost"] = self._events.counts.get("samples lost", 0) + lost
        # values at the stamps need no mean: the straight line between them is what `step` takes
        share = 0.0 if self._instantaneous else 0.5 * max(0.0, h - regular) / h
        last = self._last
        taken, _ = self._take(stamp_ns, h, values)
        mean = tuple(share * a + (1.0 - share) * b for a, b in zip(last, values, strict=True))
        return taken, (h, *mean)  # type: ignore[return-value]

    def _reject_values(self, stamp_ns: int, values: tuple[float, ...]) -> None:
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
        self._events.count(
            "force out of range",
            ERROR,
            f"{TOPIC}: linear acceleration {force:.1f} m/s^2 is over "
            f"imu.max_linear_acceleration ({math.sqrt(self._max_force2):g}), sample rejected: check its unit",
            stamp_ns,
        )
