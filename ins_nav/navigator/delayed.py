"""Fine alignment and aided navigation: the feedback Kalman filter around the mechanization, some seconds late.

`DelayedNavigator` aligns like `RealtimeNavigator` and then runs its own mechanization a fixed time behind the newest
sample: by then every aid's message has come, whatever way it took, and stops are certain (`calibration`). Aids are
taken in the order of their stamps, each at its own stamp; after each the solution is corrected and the estimate is zero
again, the covariance stays ([1]_). The result does not depend on when messages came, as long as they were not later
than that.

What it finds leaves as `Correction`: a state of the past, which `RealtimeNavigator.follow` goes on from.

At stops the mean velocity over each second is zero, and yaw runs off by the drift alone: measurements like others
(`ins_nav.zupt.stationary_updates`).

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.aiding.aid_queue import AidQueue
from ins_nav.aiding.base import Aid, Observation, OwnStates, Record, Unusable
from ins_nav.aiding.registry import create_aids
from ins_nav.alignment.coarse_alignment import Alignment
from ins_nav.alignment.initial_position import Place
from ins_nav.config.parameters import Value
from ins_nav.estimation import covariance_propagation
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.innovation_gate import GATE, PATIENCE
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import HORIZONTAL_VELOCITY
from ins_nav.event_log import INFO, WARN
from ins_nav.mechanization import nav_state, strapdown
from ins_nav.mechanization.replay_buffer import LENGTH_NS
from ins_nav.navigator.correction import Correction
from ins_nav.navigator.realtime import Phase, RealtimeNavigator
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.calibration import SETTLE_NS
from ins_nav.zupt.stationary_updates import StationaryUpdates
from ins_nav.zupt.stop_records import Triple

Array = NDArray[np.float64]

_BATCH_NS = 100_000_000
"""ns between two propagations of the covariance, and between two looks at what has become certain."""
_EMIT_NS = 500_000_000
"""ns between two feedbacks at least, where there is news; twice that where there is none."""
_MISSED = 30.0
"""s without an accepted message of an aid that are worth a warning."""
_SAME_NS = 1_000_000_000
"""ns by which two alignments may begin apart and be the same."""
_TYPICAL_NOISE = (math.radians(0.1) / 60.0, 1e-3)
"""rad/√s and m/s/√s: of a tactical IMU, where it could not be learnt at rest."""


class DelayedNavigator(RealtimeNavigator):
    """A navigator with the filter; ``state`` and ``settled_ns`` lag behind the samples.

    Parameters
    ----------
    overrides : mapping
        Parameters that differ from their defaults, by full name.

    Attributes
    ----------
    settled_ns : int
        Stamp of ``state``; 0 before there is one: older observations are too late.
    filter : ErrorFilter or None
        None until coarse alignment is done.
    records : dict of name to Record
        Of the aids and of stops.

    Raises
    ------
    ParameterError
    """

    def __init__(self, overrides: Mapping[str, object] | None = None) -> None:
        self.filter: ErrorFilter | None = None
        super().__init__(overrides)
        aiding, alignment = self.configuration.aiding, self.configuration.alignment
        self._lag_ns = max(SETTLE_NS, aiding.max_delay_ns)
        self._apply_ns = aiding.feedback_time_ns
        self._fine_stddev = alignment.fine_heading
        self._fine_time = alignment.fine_duration
        self._until_aligned = aiding.until_aligned
        self._stops = StationaryUpdates(self.configuration.imu, aiding, self.events)

    def _begin(self) -> None:
        self.filter = None
        self._aids: dict[str, Aid[Any]] = create_aids(self.configuration.values)
        self._aid_queue = AidQueue(self._aids, self.events)
        self._calibrated: dict[str, list[tuple[float, float]]] = {}
        super()._begin()
        self._out: list[Correction] = []
        self._placed = False
        self._recent: deque[tuple[int, strapdown.Sample]] = deque()

    def _align(self) -> None:
        super()._align()
        for aid in self._accepted_aids():  # how units are mounted stays
            self._calibrated[aid.name] = self.own_states(aid.name)[: aid.CALIBRATED]
        self.filter = None
        self.settled_ns = self._began_ns = 0
        self._aid_queue.restart()
        self.records: dict[str, Record] = {}
        self._pending: deque[tuple[int, strapdown.Sample]] = deque()
        self._filtered_ns = self._emitted_ns = self._first_ns = 0
        self._taken_ns: dict[str, int] = {}
        self._fine_before = 0.0
        self._news = False

    def add(self, topic: str, message: Any) -> None:
        """Add a message of an aid: for the place to align at, as in `RealtimeNavigator.add`, and for the filter."""
        observation = self._aid_queue.add(topic, message, self.stamp_ns, self.settled_ns)
        if topic in self.position_aids:
            self._align_at(self.position_aids[topic], observation)

    def _accepted_aids(self) -> list[Aid[Any]]:
        """Those of which a measurement was accepted since alignment, and which calibrate their unit."""
        if self.filter is None:
            return []
        return [aid for name, aid in self._aids.items() if aid.CALIBRATED and self._record(name).accepted]

    def _record(self, name: str) -> Record:
        return self.records.get(name, Record())

    def own_states(self, name: str) -> list[tuple[float, float]]:
        """Value and sigma of the states that an aid has in the filter."""
        aid = self._aids.get(name)
        if self.filter is None or aid is None or not aid.states:
            return []
        return list(zip(self.filter.own(name).tolist(), self.filter.own_stddev(name).tolist(), strict=True))

    @property
    def found_calibration(self) -> dict[str, Value]:
        """Parameters that aids have calibrated, of those which had a measurement accepted."""
        found: dict[str, Value] = {}
        for aid in self._accepted_aids():
            found |= aid.calibration(self.own_states(aid.name))
        return found

    def status(self, name: str) -> dict[str, str]:
        """Own states of an aid, for diagnostics."""
        return self._aids[name].status(self.own_states(name)) if name in self._aids else {}

    def missed(self) -> list[str]:
        """Aids that have had nothing accepted for a while, with the reason; not those whose silence is no fault."""
        if self.filter is None or (self._until_aligned and self.phase is Phase.NAVIGATING):
            return []
        enabled = [aid for aid in self._aids.values() if aid.parameters.enabled]
        found = ((aid, self._missed(aid)) for aid in enabled)
        return [f"{aid.topic}: {text}" for aid, text in found if text]

    def _missed(self, aid: Aid[Any]) -> str:
        record, heard = self._record(aid.name), aid.name in self._aid_queue.heard
        taken_ns = record.last.stamp_ns if record.last is not None else 0
        silent, out = ((self.settled_ns - max(ns, self._began_ns)) * 1e-9 for ns in (taken_ns, record.accepted_ns))
        usual = max(_MISSED, 5.0 * record.interval)
        if silent > usual and heard and not aid.MAY_BE_SILENT:
            return f"nothing usable for {silent:.0f} s"
        if silent > usual and not heard and aid.EXPECTED:
            return "never heard"
        if record.last is not None and silent <= usual < out:
            return f"{record.last.reason} for {out:.0f} s: check its sigma, lever arm and clock"
        return ""

    def call_zupt(self, stamp_ns: int) -> None:
        """A ZUPT service was called at this stamp; what the stop shows is taken where the policy says so."""
        if self.filter is not None:
            self._stops.call(stamp_ns)

    def _known(self) -> Array:
        return super()._known() if self.filter is None else covariance_propagation.covariance_of(self.filter)

    def drain(self) -> list[Correction]:
        """Correction not yet taken, oldest first."""
        out, self._out = self._out, []
        return out

    # --- what is done with it

    def _navigate(self, alignment: Alignment, place: Place) -> None:
        super()._navigate(alignment, place)
        self._noise = alignment.gyro_noise, alignment.accel_noise
        self._fine_before = self._duration
        self._filter_from(self.accuracy.covariance, self.stamp_ns)
        self._before = self._raw

    def adopt(self, feedback: Correction, aligned_ns: int) -> bool:
        """Go on from the solution of a navigator that aligned before this one began; whether that was taken.

        Parameters
        ----------
        feedback : Correction
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
        self._placed = True  # before
        where = nav_state.geodetic(self.state)
        self.map = self.map or nav_state.MapFrame(where.lat, where.lon, where.height)
        self.aligned_ns = aligned_ns
        self.changes += 1
        self._noise = _TYPICAL_NOISE
        self._filter_from(feedback.covariance, feedback.stamp_ns)
        if feedback.aligned:
            self.phase = Phase.NAVIGATING
        else:
            self._fine_before = (aligned_ns - feedback.stamp_ns) * 1e-9
        self._before = recent[now][1]
        self._pending.extend(recent[now + 1 :])
        self.events.report(INFO, "goes on from the solution of ins_node")
        return True

    def _filter_from(self, covariance: Array, stamp_ns: int) -> None:
        """Start the filter at the present state; its covariance on n."""
        model = covariance_propagation.error_model(self.configuration, self._noise)
        own = {name: aid.states for name, aid in self._aids.items() if aid.states and aid.parameters.enabled}
        for name in self._calibrated.keys() & own.keys():
            found = self._calibrated[name]
            kept = [replace(s, value=x, stddev=stddev) for s, (x, stddev) in zip(own[name], found, strict=False)]
            own[name] = (*kept, *own[name][len(kept) :])
        self.filter = covariance_propagation.filter_of(model, covariance, own)
        self.phase = Phase.FINE
        self._filtered = self.state
        self.settled_ns = self._filtered_ns = self._emitted_ns = self._began_ns = stamp_ns
        self._aid_queue.begin(stamp_ns)
        detector = self.stops.detector
        self._stops.begin(detector.since_ns if detector.stopped else None)

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
            self._stops.notice(change)
        self._pending.append((stamp_ns, raw))
        if stamp_ns - self.settled_ns >= self._lag_ns + _BATCH_NS:
            self._settle(stamp_ns - self._lag_ns)
            self._emit()
        return False

    def _settle(self, until_ns: int) -> None:
        pending = self._pending
        while pending and pending[0][0] <= until_ns:
            stamp_ns, raw = pending.popleft()
            for observation in self._aid_queue.until(stamp_ns):
                self._take_aid(observation, raw)
            assert self.state is not None
            sample = self._without_bias(raw)
            before = self._without_bias(self._before)
            self.state = strapdown.step(self.state, before, sample, self._instantaneous, self._vertical)
            self.settled_ns = stamp_ns
            if self._is_long_gap(raw):
                self._bridged(raw)
            self._rest(raw)
            self._before = raw
        self._propagate()
        self._watch()

    def _bridged(self, raw: strapdown.Sample) -> None:
        """What a gap may have hidden: as much as rates and forces change within its length at other times."""
        assert self.filter is not None
        self._propagate()
        samples = np.array([sample for _, sample in self._recent])
        whole = samples[samples[:, 0] <= self.stream.regular, 1:]
        lag = min(max(1, round(raw[0] / float(np.median(samples[:, 0])))), len(whole) // 2)
        changes = np.abs(np.vstack([whole[lag:] - whole[: len(whole) - lag], np.subtract(raw, self._before)[None, 1:]]))
        turn, speed = (0.5 * raw[0] * float(changes[:, i : i + 3].max()) for i in (0, 3))
        self.filter.disturb(turn, speed, raw[0] * speed)

    def _propagate(self) -> None:
        """Bring the covariance to the present state."""
        if self.settled_ns > self._filtered_ns:
            assert self.filter is not None and self.state is not None and self._filtered is not None
            self.filter.propagate(self._filtered, self.state, (self.settled_ns - self._filtered_ns) * 1e-9)
            self._filtered, self._filtered_ns = self.state, self.settled_ns

    def _solution(self, state: nav_state.NavState, raw: strapdown.Sample) -> Solution:
        assert self.filter is not None
        return self.filter.solution(state, self._without_bias(raw)[1:4], self.gyro_bias)  # type: ignore[arg-type]

    def _rate(self, after: float, raw: strapdown.Sample) -> Triple:
        """Angular rate so long after the settled sample, s, of which ``raw`` is the next: means are of the middles."""
        first, second, share = self._before, raw, after / raw[0]
        if not self._instantaneous:
            share += 0.5
            if share > 1.0 and self._pending:
                first, second, share = raw, self._pending[0][1], share - 1.0
        x, y, z = (a + min(share, 1.0) * (b - a) for a, b in zip(first[1:4], second[1:4], strict=True))
        gx, gy, gz = self.gyro_bias
        return x - gx, y - gy, z - gz

    def _take_aid(self, observation: Observation, raw: strapdown.Sample) -> None:
        """An observation between the settled sample and the next."""
        aid = self._aids[observation.aid]
        if self._until_aligned and self.phase is Phase.NAVIGATING:
            return
        if self._taken_ns.get(aid.name) == observation.stamp_ns:
            text = f"{aid.topic}: a stamp repeated, rejected"
            self.events.count(f"{aid.name} repeated", INFO, text, observation.stamp_ns)
            return
        self._taken_ns[aid.name] = observation.stamp_ns
        assert self.filter is not None and self.state is not None
        self._propagate()
        after = (observation.stamp_ns - self.settled_ns) * 1e-9
        state = self.state
        if after > 0.0:
            part = (after, *self._without_bias(raw)[1:])
            state = strapdown.step(state, self._without_bias(self._before), part, self._instantaneous, self._vertical)
        now_ns = max(observation.stamp_ns, self.settled_ns)
        names = (aid.name, aid.shares)
        own = OwnStates(self.filter.own(*names), self.filter.own_covariance(*names))
        solution = self.filter.solution(state, self._rate(max(0.0, after), raw), self.gyro_bias, now_ns)
        try:
            measurement = aid.measure(solution, own, observation)
        except Unusable as reason:
            text = f"{aid.topic}: {reason}"
            self.events.count(f"{aid.name} {reason.kind}", reason.level, text, observation.stamp_ns)
            return
        if measurement is not None:
            patience = aid.patience(observation, self._record(aid.name).accepted > 0, self._placed)
            self._update(aid.name, now_ns, measurement, aid.parameters.gate, patience)
            self._placed = self._placed or (aid.GIVES_POSITION and self._record(aid.name).accepted > 0)

    def _update(
        self, name: str, stamp_ns: int, measurement: Measurement, gate: float = GATE, patience: float = PATIENCE
    ) -> None:
        assert self.filter is not None and self.state is not None
        update = self.filter.update(name, stamp_ns, measurement, gate, patience)
        self.records.setdefault(name, Record()).count(update)
        aid = self._aids.get(name)  # none for a measurement at a stop
        topic = name if aid is None else aid.topic
        if not update.accepted:
            size = max(map(abs, update.innovation))
            self.events.count(
                f"{name} rejected",
                INFO,
                f"{topic}: {update.reason}: off by {size:.2f}, test ratio {update.test_ratio:.1f}",
                stamp_ns,
            )
            return
        if update.reason:
            text = f"{topic}: accepted {update.reason} (test ratio {update.test_ratio:.1f}): "
            if measurement.direct is not None:
                text += "the solution was wrong by more than its sigma"
            elif aid is not None:
                text += aid.CHANGED
            self.events.report(WARN, text)
        before = self.state
        self.state, gyro, accel = self.filter.feed_back(before, self.gyro_bias, self.accel_bias)  # type: ignore[arg-type]
        self._filtered, self.gyro_bias, self.accel_bias = self.state, gyro, accel
        self._news = True
        self._stops.corrected(before, self.state)  # type: ignore[arg-type]
        for other in self._aids.values():
            other.corrected(before, self.state)

    def _rest(self, raw: strapdown.Sample) -> None:
        """The settled sample, where it is one of a stop."""
        assert self.filter is not None and self.state is not None
        speed_stddev = math.sqrt(self.filter.p.diagonal()[HORIZONTAL_VELOCITY].sum())
        biases = self.gyro_bias, self.accel_bias
        measured = self._stops.add(self.settled_ns, self._before, raw, self.state, biases, speed_stddev)  # type: ignore[arg-type]
        for name, measure in measured:
            self._propagate()
            self._update(name, self.settled_ns, measure(self._solution(self.state, raw)))

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
        self.events.report(
            INFO, f"fine alignment ended after {time:.0f} s: heading sigma {math.degrees(stddev):.3f}°, {why} reached"
        )
        self._news = True

    @property
    def fine_time(self) -> float:
        """Time since the first sample of alignment, or since it was taken up unfinished, s."""
        return self._fine_before + (self.settled_ns - self.aligned_ns) * 1e-9

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
        """Correction, where it is due."""
        since = self.settled_ns - self._emitted_ns
        if since < (_EMIT_NS if self._news else 2 * _EMIT_NS):
            return
        assert self.filter is not None and self.state is not None
        self._emitted_ns, self._news = self.settled_ns, False
        self._out.append(
            Correction(
                self.settled_ns,
                self.stamp_ns + self._apply_ns,
                self.state,
                self.gyro_bias,  # type: ignore[arg-type]
                self.accel_bias,  # type: ignore[arg-type]
                self._known(),
                self.phase is Phase.NAVIGATING,
            )
        )
