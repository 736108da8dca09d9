"""Fine alignment and aided navigation: the feedback Kalman filter around the mechanization, some seconds late.

`AidedNavigator` aligns like `Navigator` and then runs its own mechanization a fixed time behind the newest sample:
by then every aid's message has come, whatever way it took, and stops are certain (`ins_nav.stops`). Aids are taken in
the order of their stamps, each at its own stamp; after each the solution is corrected and the estimate is zero again,
the covariance stays ([1]_). The result does not depend on when messages came, as long as they were not later than
that.

What it finds leaves as `Feedback`: a state of the past, which `Navigator.follow` goes on from.

At stops the mean velocity over each second is zero, and yaw runs off by the drift alone, which a minute of rest shows
(`ins_nav.rest`): both are measurements like others. Or, as a matter of policy, ZUPT calls are, and nothing else: one
of the two, for they are the same data.

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base.
"""

import bisect
import heapq
import itertools
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ins_nav import aids, strapdown
from ins_nav.aids import Aid, Observation, Record
from ins_nav.coarse_alignment import Alignment
from ins_nav.error_filter import ErrorFilter, Measurement, Solution
from ins_nav.error_model import COSINE, ErrorModel, SlowState
from ins_nav.health import INFO, WARN
from ins_nav.history import LENGTH_NS
from ins_nav.measurements import RestRate, ZeroVelocity
from ins_nav.navigator import Feedback, Navigator, Phase
from ins_nav.rest import Rest
from ins_nav.stop_detection import Change
from ins_nav.stops import DOUBT_SIGMAS, DOUBT_SPEED, MILLI_G, SETTLE_NS, Triple, without
from ins_nav.zupt import ZuptError

Array = NDArray[np.float64]

_BATCH_NS = 100_000_000
"""ns between two propagations of the covariance, and between two looks at what has become certain."""
_EMIT_NS = 500_000_000
"""ns between two feedbacks at least, where there is news; twice that where there is none."""
_APPLY_NS = 500_000_000
"""ns of data after which a feedback takes effect: the time its way through DDS may take without being seen."""
_AHEAD_NS = 5_000_000_000
"""ns: a stamp further ahead of the IMU's is of another clock."""
_SAME_NS = 1_000_000_000
"""ns by which two alignments may begin apart and be the same."""
_TYPICAL_NOISE = (math.radians(0.1) / 60.0, 1e-3)
"""rad/√s and m/s/√s: of a tactical IMU, where it could not be learnt at rest."""
_HOLD = 1.0
"""s: length of a mean velocity at a stop."""
_SEGMENT = 60.0
"""s: length of a measurement of yaw's run-off; the rest of a stop counts from 10 s on."""
_LEAST_SEGMENT = 10.0
_MARGIN_NS = 500_000_000
"""ns before the end of a stop, as it shows in velocity, that are no rest."""
_ARRIVAL_NS = 1_000_000_000
"""ns after its beginning that are none."""


class AidedNavigator(Navigator):
    """A navigator with the filter; ``state`` and ``settled_ns`` lag behind the samples.

    Parameters
    ----------
    overrides : mapping
        Parameters that differ from `ins_nav.parameters.PARAMETERS`.

    Attributes
    ----------
    settled_ns : int
        Stamp of ``state``.
    filter : ErrorFilter or None
        None until coarse alignment is done.
    records : dict of name to Record
        Of the aids and of stops.

    Raises
    ------
    ParameterError
    """

    def __init__(self, overrides: Mapping[str, object] | None = None) -> None:
        self._aids: dict[str, Aid] = {}
        self._queue: list[Observation] = []
        self._count = itertools.count()
        self.filter: ErrorFilter | None = None
        super().__init__(overrides)
        self._aids = aids.make(self.parameters)
        self._lag_ns = max(SETTLE_NS, round(self._number("aiding.max_delay") * 1e9))
        self._fine_stddev = math.radians(self._number("alignment.fine_heading_deg"))
        self._fine_time = self._number("alignment.fine_duration")
        self._until_aligned = bool(self.parameters["aiding.until_aligned"])
        self._stop_velocity = self._number("aiding.stop_velocity_stddev")
        self._by_zupt = self.parameters["aiding.stops"] == "zupt"
        self._at_stops = self.parameters["aiding.stops"] != "none"

    # --- what comes in

    def _begin(self) -> None:
        super()._begin()
        self._queue.clear()
        self.records: dict[str, Record] = {}
        self._out: list[Feedback] = []
        self._recent: deque[tuple[int, strapdown.Sample]] = deque()

    def _align(self) -> None:
        super()._align()
        self.filter = None
        self._pending: deque[tuple[int, strapdown.Sample]] = deque()
        self._stops: list[list[int]] = []
        self._segment: Rest | None = None
        self._segment_bias: Triple = (0.0, 0.0, 0.0)
        self._segment_accel: Triple = (0.0, 0.0, 0.0)
        self._segment_turned = 0.0
        self._calls: list[int] = []
        self._mean: list[float] = [0.0] * 4
        self.settled_ns = self._filtered_ns = self._emitted_ns = self._began_ns = self._first_ns = 0
        self._taken_ns: dict[str, int] = {}
        self._news = False

    def add_fix(
        self,
        stamp_ns: int,
        status: int,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        covariance: Sequence[float] = (),
    ) -> None:
        """Take a satellite fix: the first place of all, then an aid.

        Parameters
        ----------
        stamp_ns, status, latitude_deg, longitude_deg, height
            As in `Navigator.add_fix`.
        covariance : sequence of float
            East, north, up, row by row, m²; empty: not given.
        """
        super().add_fix(stamp_ns, status, latitude_deg, longitude_deg, height, covariance)
        place = (math.radians(latitude_deg), math.radians(longitude_deg), height)
        if status < 0 or not abs(latitude_deg) <= 90.0 or not math.isfinite(longitude_deg):
            return  # told already
        if math.isfinite(height):
            self._observe(aids.GNSS, stamp_ns, place, covariance, 3)
        else:
            self._unusable(aids.GNSS, stamp_ns, place)

    def add_gnss_velocity(self, stamp_ns: int, velocity: Triple, covariance: Sequence[float] = ()) -> None:
        """Take a velocity on east, north, up, m/s (up may be NaN); covariance row by row, m²/s², or empty."""
        if all(map(math.isfinite, velocity[:2])):
            self._observe(aids.GNSS_VELOCITY, stamp_ns, velocity, covariance, 3)
        else:
            self._unusable(aids.GNSS_VELOCITY, stamp_ns, velocity)

    def add_log(self, stamp_ns: int, velocity: Triple, covariance: Sequence[float] = ()) -> None:
        """Take a velocity on the log's axes, m/s, NaN for an axis not measured; covariance row by row, or empty."""
        if any(map(math.isfinite, velocity)):
            self._observe(aids.LOG, stamp_ns, velocity, covariance, 3)
        else:
            self._unusable(aids.LOG, stamp_ns, velocity)

    def add_depth(self, stamp_ns: int, depth: float, variance: float = 0.0) -> None:
        """Take a depth, m, down positive, and its variance, m²; 0: not given."""
        if math.isfinite(depth):
            self._observe(aids.DEPTH, stamp_ns, (depth,), (variance,), 1)
        else:
            self._unusable(aids.DEPTH, stamp_ns, (depth,))

    def _unusable(self, name: str, stamp_ns: int, value: tuple[float, ...]) -> None:
        topic = aids.TOPICS[name]
        self.health.note(f"{name} unusable", INFO, f"{topic}: {value} says nothing, left out", stamp_ns)

    def _observe(
        self, name: str, stamp_ns: int, value: tuple[float, ...], covariance: Sequence[float], size: int
    ) -> None:
        aid = self._aids.get(name)
        if aid is None or self.stamp_ns == 0:
            return
        stamp_ns -= aid.settings.delay_ns
        topic, queue = aids.TOPICS[name], self._queue
        if self.filter is not None and stamp_ns <= self._began_ns:
            return
        if self.filter is not None and stamp_ns <= self.settled_ns:
            late = (self.stamp_ns - stamp_ns) * 1e-9
            self.health.note(
                f"{name} late",
                WARN,
                f"{topic}: {late:.2f} s behind imu/data_raw, left out: raise aiding.max_delay, or check its clock",
                stamp_ns,
            )
            return
        if stamp_ns - self.stamp_ns > _AHEAD_NS:
            ahead = (stamp_ns - self.stamp_ns) * 1e-9
            self.health.note(
                f"{name} ahead",
                WARN,
                f"{topic}: {ahead:.1f} s ahead of imu/data_raw, left out: both must be stamped by one clock",
                self.stamp_ns,
            )
            return
        missing = [i for i, x in enumerate(value) if not math.isfinite(x)]
        used = aid.settings.covariance(covariance, size, missing)
        heapq.heappush(queue, Observation(stamp_ns, name, value, next(self._count), used))
        while self.filter is None and queue and queue[0].stamp_ns < self.stamp_ns - LENGTH_NS:
            heapq.heappop(queue)  # the filter will begin later

    def own_states(self, name: str) -> list[tuple[float, float]]:
        """Value and sigma of the states that an aid has in the filter."""
        aid = self._aids.get(name)
        if self.filter is None or aid is None or not aid.states:
            return []
        return list(zip(self.filter.own(name).tolist(), self.filter.own_stddev(name).tolist(), strict=True))

    def call_zupt(self, stamp_ns: int) -> None:
        """A ZUPT service was called at this stamp; what the stop shows is taken where the policy says so."""
        if self._by_zupt and self.filter is not None:
            bisect.insort(self._calls, stamp_ns)

    def drain(self) -> list[Feedback]:
        """Feedback not yet taken, oldest first."""
        out, self._out = self._out, []
        return out

    # --- what is done with it

    def _navigate(self, alignment: Alignment, lat: float, lon: float, height: float) -> None:
        super()._navigate(alignment, lat, lon, height)
        velocity = max(alignment.velocity_stddev, 1e-3)
        self._noise = alignment.gyro_noise, alignment.accel_noise
        covariance = np.zeros((15, 15))
        covariance[0:6, 0:6] = np.diag(np.square([*self.position_stddev] + [velocity] * 3))
        covariance[6:15, 6:15] = alignment.joint
        self._filter_from(covariance, self.stamp_ns)
        self._before = self._raw

    def adopt(self, feedback: Feedback, aligned_ns: int) -> bool:
        """Go on from the solution of a navigator that aligned before this one began; whether that was taken.

        Parameters
        ----------
        feedback : Feedback
            Its solution.
        aligned_ns : int
            Stamp at which its alignment ended.
        """
        began_ns = aligned_ns - round(self._duration * 1e9)
        if self.filter is not None or began_ns > self._first_ns - _SAME_NS:
            return False
        recent = list(self._recent)
        stamps = [stamp_ns for stamp_ns, _ in recent]
        if feedback.stamp_ns not in stamps:
            return False  # older than what is known here, or newer, or of a sample that was lost
        now = stamps.index(feedback.stamp_ns)
        self.state, self.gyro_bias, self.accel_bias = feedback.state, feedback.gyro_bias, feedback.accel_bias
        where = strapdown.geodetic(self.state)
        self.map = self.map or strapdown.MapFrame(where.lat, where.lon, where.height)
        self.aligned_ns = aligned_ns
        self.changes += 1
        self._noise = _TYPICAL_NOISE
        self._filter_from(feedback.covariance, feedback.stamp_ns)
        if feedback.aligned:
            self.phase = Phase.NAVIGATING
        self._before = recent[now][1]
        self._pending.extend(recent[now + 1 :])
        self.health.tell(INFO, "goes on from the solution of ins_node")
        return True

    def _filter_from(self, covariance: Array, stamp_ns: int) -> None:
        """Start the filter at the present state; its covariance on n, shape (15, 15)."""
        assert self.state is not None
        deg_per_hour = math.radians(1.0) / 3600.0
        walk = self._number("imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour") * deg_per_hour / 60.0
        accel_walk = self._number("imu.accel_bias_walk_mg_per_sqrt_hour") * MILLI_G / 60.0
        given = self._number("imu.gyro_noise_deg_per_sqrt_hour"), self._number("imu.accel_noise_ug_per_sqrt_hz")
        model = ErrorModel(
            vertical=self._vertical,
            gyro_noise=self._noise[0] if math.isnan(given[0]) else math.radians(given[0]) / 60.0,
            accel_noise=self._noise[1] if math.isnan(given[1]) else given[1] * 1e-3 * MILLI_G,
            gyro_bias=SlowState(self.gyro_bias_stddev, walk),
            accel_bias=SlowState(self.accel_bias_stddev, accel_walk),
            height_walk=self._number("aiding.height_walk"),
        )
        stddev = np.sqrt(covariance.diagonal())
        self.filter = ErrorFilter(
            model,
            stddev[0:3].tolist(),
            stddev[3:6].tolist(),
            covariance[6:9, 6:9],
            {name: aid.states for name, aid in self._aids.items() if aid.states},
        )
        self.filter.p[9:15, 9:15] = covariance[9:15, 9:15]
        cross = covariance[6:9, 9:15].copy()
        cross[2] *= 1.0 - self.filter.x[COSINE]  # of an unknown heading the sine
        self.filter.p[6:9, 9:15], self.filter.p[9:15, 6:9] = cross, cross.T
        self.phase = Phase.FINE
        self._filtered = self.state
        self.settled_ns = self._filtered_ns = self._emitted_ns = self._began_ns = stamp_ns
        while self._queue and self._queue[0].stamp_ns <= stamp_ns:
            heapq.heappop(self._queue)
        if self.stops.detector.stopped:
            self._stops.append([self.stops.detector.since_ns, 2**63])

    def _take(self, stamp_ns: int, from_imu: strapdown.Sample) -> bool:
        self._first_ns = self._first_ns or stamp_ns
        new = super()._take(stamp_ns, from_imu)
        recent = self._recent
        recent.append((stamp_ns, self._raw))
        while recent[0][0] < stamp_ns - LENGTH_NS:
            recent.popleft()
        return new

    def _advance(
        self,
        stamp_ns: int,
        raw: strapdown.Sample,
        previous: strapdown.Sample,
        sample: strapdown.Sample,
        change: Change | None,
    ) -> bool:
        """Keep the sample until it is settled; there is no solution of the present."""
        if change is not None:
            if change.stopped:
                self._stops.append([change.stamp_ns + _ARRIVAL_NS, 2**63])
            elif self._stops:
                self._stops[-1][1] = change.stamp_ns - _MARGIN_NS
        self._pending.append((stamp_ns, raw))
        if stamp_ns - self.settled_ns >= self._lag_ns + _BATCH_NS:
            self._settle(stamp_ns - self._lag_ns)
            self._emit()
        return False

    def _settle(self, until_ns: int) -> None:
        pending, queue = self._pending, self._queue
        while pending and pending[0][0] <= until_ns:
            stamp_ns, raw = pending.popleft()
            while queue and queue[0].stamp_ns <= stamp_ns:
                self._take_aid(heapq.heappop(queue), raw)
            assert self.state is not None
            sample = self._without_bias(raw)
            before = self._without_bias(self._before)
            self.state = strapdown.step(self.state, before, sample, self._instantaneous, self._vertical)
            self.settled_ns = stamp_ns
            self._rest(raw)
            self._before = raw
        self._propagate()
        self._watch()

    def _propagate(self) -> None:
        """Bring the covariance to the present state."""
        if self.settled_ns > self._filtered_ns:
            assert self.filter is not None and self.state is not None
            self.filter.propagate(self._filtered, self.state, (self.settled_ns - self._filtered_ns) * 1e-9)
            self._filtered, self._filtered_ns = self.state, self.settled_ns

    def _solution(self, state: strapdown.State, raw: strapdown.Sample) -> Solution:
        assert self.filter is not None
        return self.filter.solution(state, self._without_bias(raw)[1:4], self.gyro_bias)  # type: ignore[arg-type]

    def _take_aid(self, seen: Observation, raw: strapdown.Sample) -> None:
        """An observation between the settled sample and the next."""
        aid = self._aids[seen.aid]
        if self._until_aligned and self.phase is Phase.NAVIGATING:
            return
        if self._taken_ns.get(seen.aid) == seen.stamp_ns:
            topic = aids.TOPICS[seen.aid]
            self.health.note(f"{seen.aid} repeated", INFO, f"{topic}: a stamp repeated, left out", seen.stamp_ns)
            return
        self._taken_ns[seen.aid] = seen.stamp_ns
        assert self.filter is not None and self.state is not None
        self._propagate()
        after = (seen.stamp_ns - self.settled_ns) * 1e-9
        state = self.state
        if after > 0.0:
            part = (after, *self._without_bias(raw)[1:])
            state = strapdown.step(state, self._without_bias(self._before), part, self._instantaneous, self._vertical)
        own = self.filter.own(seen.aid) if aid.states else np.zeros(0)
        measurement = aid.measure(self._solution(state, raw), own, seen)
        if measurement is not None:
            self._update(seen.aid, seen.stamp_ns, measurement, aid.settings.gate)

    def _update(self, name: str, stamp_ns: int, measurement: Measurement, gate: float) -> None:
        assert self.filter is not None and self.state is not None
        update = self.filter.update(name, stamp_ns, measurement, gate)
        self.records.setdefault(name, Record()).take(update)
        if not update.accepted:
            size = max(map(abs, update.innovation))
            self.health.note(
                f"{name} rejected",
                INFO,
                f"{aids.TOPICS.get(name, name)}: {update.reason}: off by {size:.2f}, test ratio "
                f"{update.test_ratio:.1f}",
                stamp_ns,
            )
            return
        if update.reason:
            self.health.tell(
                WARN,
                f"{aids.TOPICS.get(name, name)}: accepted {update.reason} (test ratio "
                f"{update.test_ratio:.1f}): the solution was wrong by more than its sigma",
            )
        before = self.state
        self.state, gyro, accel = self.filter.feed_back(before, self.gyro_bias, self.accel_bias)  # type: ignore[arg-type]
        self._filtered, self.gyro_bias, self.accel_bias = self.state, gyro, accel
        self._news = True
        self._segment_turned += strapdown.heading_change(before, self.state)
        for i in (1, 2, 3):  # as if it had been so before
            self._mean[i] += self._mean[0] * (self.state[3 + i] - before[3 + i])

    # --- stops

    def _at_rest(self) -> bool:
        while len(self._stops) > 1 and self._stops[0][1] < self.settled_ns:
            self._stops.pop(0)
        return any(begin < self.settled_ns <= end for begin, end in self._stops)

    def _rest(self, raw: strapdown.Sample) -> None:
        """The settled sample, where it is one of a stop."""
        if not self._at_stops:
            return
        if not self._at_rest():
            self._leave(raw)
            return
        assert self.state is not None
        if self._segment is None:
            self._called(self.settled_ns)
            self._begin_segment()
            return
        accel = self._segment_accel
        before, now = (without(x, self._segment_bias, accel) for x in (self._before, raw))
        self._segment.add(before, now, self._instantaneous)
        mean, h = self._mean, raw[0]
        mean[0] += h
        for i in (1, 2, 3):
            mean[i] += h * self.state[3 + i]
        if mean[0] < _HOLD * (1.0 - 1e-6):
            return
        if self._doubted():
            return
        called = self._called(self.settled_ns)
        if called or not self._by_zupt:
            self._hold(raw)
        self._mean = [0.0] * 4
        if called or (not self._by_zupt and self._segment.duration >= _SEGMENT):
            self._end_segment()

    def _leave(self, raw: strapdown.Sample) -> None:
        """The settled sample is the first after a stop, or a later one."""
        if self._segment is not None:
            # a call made before it was seen that the stop has ended
            called = self._called(self.settled_ns + SETTLE_NS)
            if called and self._mean[0] >= 0.5 * _HOLD:
                self._hold(raw)
            if called or not self._by_zupt:
                self._end_segment()
            self._segment = None
        self._mean = [0.0] * 4

    def _doubted(self) -> bool:
        """Whether the stop is none, by the speed of the solution: even motion looks like rest. Then it is forgotten."""
        assert self.filter is not None
        time, x, y, _ = self._mean
        stddev = math.sqrt(self.filter.p[3, 3] + self.filter.p[4, 4])
        speed = math.hypot(x, y) / time
        if speed <= DOUBT_SPEED + DOUBT_SIGMAS * stddev:
            return False
        text = f"stop: the IMU seems to rest, but the solution moves at {speed:.1f} m/s: taken for even motion"
        self.health.note("stops doubted", INFO, text, self.settled_ns)
        self._stops[0][1] = self.settled_ns
        self._segment = None
        self._mean = [0.0] * 4
        return True

    def _called(self, until_ns: int) -> bool:
        """Whether ZUPT was called up to this stamp; such calls are done with."""
        count = bisect.bisect(self._calls, until_ns)
        del self._calls[:count]
        return count > 0

    def _hold(self, raw: strapdown.Sample) -> None:
        """Mean velocity over the last second is zero."""
        assert self.state is not None
        time, *way = self._mean
        self._propagate()
        solution = self._solution((*self.state[:4], *(x / time for x in way), *self.state[7:]), raw)
        self._update("zero velocity", self.settled_ns, ZeroVelocity().measure(solution, self._stop_velocity), 1e-4)

    def _begin_segment(self) -> None:
        assert self.state is not None
        self._segment = Rest(self.state)
        self._segment_bias, self._segment_accel = self.gyro_bias, self.accel_bias  # type: ignore[assignment]
        self._segment_turned = 0.0

    def _end_segment(self) -> None:
        """What a time of rest has shown of drift: about the vertical, or where ZUPT was called, about all axes."""
        segment = self._segment
        if segment is None or segment.duration < _LEAST_SEGMENT:
            return
        try:
            result = segment.result(0.0 if not self._by_zupt else self.accel_bias_stddev)
        except ZuptError as error:
            self.health.note("stops not measured", INFO, f"stop: {error}", self.settled_ns)
            return
        self._propagate()
        assert self.state is not None
        solution = self._solution(self.state, self._before)
        seen = result.measurement  # on the axes at its beginning: what heading was corrected by since is no error now
        seen = replace(seen, rate=seen.rate - [seen.horizontal_rate * self._segment_turned, 0.0, 0.0])
        measurement = RestRate(vertical=not self._by_zupt).measure(solution, seen, self._segment_bias)
        self._update("rest", self.settled_ns, measurement, 1e-4)
        self._begin_segment()

    # --- what goes out

    def _watch(self) -> None:
        """Fine alignment ends."""
        if self.phase is not Phase.FINE or self.filter is None:
            return
        stddev, time = self.filter.heading_stddev, self.fine_time
        if stddev > self._fine_stddev and time < self._fine_time:
            return
        self.phase = Phase.NAVIGATING
        why = "its target" if stddev <= self._fine_stddev else f"alignment.fine_duration ({self._fine_time:g} s)"
        self.health.tell(
            INFO, f"fine alignment ended after {time:.0f} s: heading sigma {math.degrees(stddev):.3f}°, {why} reached"
        )
        self._news = True

    @property
    def fine_time(self) -> float:
        """Time since the first sample of alignment, s."""
        return self._duration + (self.settled_ns - self.aligned_ns) * 1e-9

    @property
    def time_left(self) -> float:
        """Time to the end of fine alignment, s, if sigma goes on falling with the power 3/2 of time."""
        if self.phase is not Phase.FINE or self.filter is None:
            return 0.0
        left = self._fine_time - self.fine_time
        if self._fine_stddev > 0.0:
            ratio = max(1.0, self.filter.heading_stddev / self._fine_stddev)
            left = min(left, self.fine_time * (ratio ** (2.0 / 3.0) - 1.0))
        return max(0.0, left)

    def _emit(self) -> None:
        """Feedback, where it is due."""
        since = self.settled_ns - self._emitted_ns
        if since < (_EMIT_NS if self._news else 2 * _EMIT_NS):
            return
        assert self.filter is not None and self.state is not None
        self._emitted_ns, self._news = self.settled_ns, False
        covariance = self.filter.p[:15, :15].copy()
        covariance[8, 8] = max(covariance[8, 8], self.filter.heading_stddev**2)  # an angle, not its sine
        self._out.append(
            Feedback(
                self.settled_ns,
                self.stamp_ns + _APPLY_NS,
                self.state,
                self.gyro_bias,  # type: ignore[arg-type]
                self.accel_bias,  # type: ignore[arg-type]
                covariance,
                self.phase is Phase.NAVIGATING,
            )
        )
