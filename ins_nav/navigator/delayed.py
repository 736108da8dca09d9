"""The filter: fine alignment and aided navigation behind the newest sample by a fixed delay.

`DelayedNavigator` integrates samples when they are settled: by then the message of every aid has arrived, whatever its
way, and stops are certain (`ins_nav.zupt.stationary_updates`). Observations are processed in the order of their stamps,
each at its own stamp; after each the solution is corrected and the error estimate is zero again, the covariance stays
([1]_). The result does not depend on the order of arrival.

A corrected state leaves as a `Correction`, from which `ins_nav.navigator.realtime` re-integrates the samples since.

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.aiding.aid_queue import AidQueue
from ins_nav.aiding.base import Aid, Observation, OwnStates, Record, Unusable
from ins_nav.alignment.fine_alignment import FineAlignment
from ins_nav.config.parameters import Value
from ins_nav.estimation import covariance_propagation
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Vector
from ins_nav.estimation.filter_bank import FilterBank
from ins_nav.estimation.innovation_gate import GATE
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import BIASES, HEADING
from ins_nav.event_log import INFO, WARN, EventLog
from ins_nav.mechanization import strapdown
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.strapdown import NO_COMPENSATION, Compensation, Sample, compensated, sample_of, without_bias
from ins_nav.navigator.correction import NEVER_NS, Correction
from ins_nav.navigator.front_end import Aligned, Biases, FrontEnd, Phase
from ins_nav.navigator.update_report import report_contradictions, report_update
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.measurements import StopCalibration
from ins_nav.zupt.stationary_updates import SETTLE_NS, StationaryUpdates

Array = NDArray[np.float64]

_BATCH_NS = 100_000_000
"""ns of samples that are integrated, and over which the covariance is propagated, at a time."""
_EMIT_NS = 500_000_000
"""ns between two corrections at least, after an accepted measurement; twice that without one."""
_SAME_NS = 1_000_000_000
"""ns by which two alignments may begin apart and be the same."""
_ALONE_NS = 60_000_000_000
"""ns without an accepted message of an aid, after which nothing but stops measures velocity."""
_TYPICAL_NOISE = (math.radians(0.1) / 60.0, 1e-3)
"""rad/√s and m/s/√s: of a tactical IMU, where it was not estimated at rest."""


class DelayedNavigator:
    """The filter, with a mechanization of its own; ``state`` lags behind the samples.

    Parameters
    ----------
    front_end : FrontEnd
    aids : mapping of name to Aid
        Sources of measurements; without any, stops alone are measured, and corrections leave only after a measurement.

    Attributes
    ----------
    state : NavState or None
        At ``settled_ns``; None without a filter.
    settled_ns : int
        Stamp of ``state``; 0 before there is one: older observations are too late.
    gyro_bias, accel_bias : 3 floats
        In use, rad/s and m/s².
    filter : ErrorFilter or None
        None until coarse alignment is done, and while suspended.
    records : dict of name to Record
        Of the aids and of stops.
    """

    def __init__(self, front_end: FrontEnd, aids: Mapping[str, Aid[Any]]) -> None:
        self.front_end = front_end
        known = front_end.configuration
        self._lag_ns = max(SETTLE_NS, known.aiding.max_delay_ns)
        self._apply_ns = known.aiding.feedback_time_ns
        self._fine = FineAlignment(known.alignment)
        self._until_aligned = known.aiding.until_aligned
        self._aids = dict(aids)
        self._aid_queue = AidQueue(self._aids, front_end.events)
        self._stationary = StationaryUpdates(known.imu, known.zupt, known.aiding, front_end.events)
        self._calibrated: dict[str, list[tuple[float, float]]] = {}
        self._noise = _TYPICAL_NOISE
        self._restarts = -1
        self.filter: ErrorFilter | None = None
        self.state: NavState | None = None
        self.records: dict[str, Record] = {}
        self.end()
        front_end.listeners.append(self)

    # --- what the front end calls

    def end(self) -> None:
        """Alignment starts again."""
        restarted = self.front_end.restarts != self._restarts
        self._restarts = self.front_end.restarts
        for aid in [] if restarted else self._accepted_aids():  # how units are mounted stays
            self._calibrated[aid.name] = self.own_states(aid.name)[: aid.CALIBRATED]
        if restarted:
            self._calibrated.clear()
        self.filter = self.state = None
        self.settled_ns = self._began_ns = 0
        self.gyro_bias, self.accel_bias, _ = self.front_end.biases
        self._aid_queue.restart()
        self.records = {}
        self._out: list[Correction] = []
        self._last_ns: dict[str, int] = {}
        self._last_value: dict[str, tuple[float, ...]] = {}
        self._filtered_ns = self._emitted_ns = self._aided_ns = 0
        self._aligned = False
        self._fine_before = 0.0
        self._news = False

    def begin(self, aligned: Aligned) -> None:
        """Start the filter from the first solution."""
        self.gyro_bias, self.accel_bias, _ = aligned.biases
        self._noise = aligned.noise
        self._fine_before = self.front_end.duration
        self._start(aligned.stamp_ns, aligned.state, aligned.raw, aligned.covariance, not self._aids, ())
        detector = self.front_end.detector
        if detector.stopped and detector.since_ns <= aligned.stamp_ns - aligned.cone.time * 1e9 + _SAME_NS:
            heading = float(aligned.covariance[HEADING, HEADING]) if aligned.heading_given else math.inf
            self._stationary.include(aligned.state, aligned.biases, aligned.cone, heading)

    @property
    def due_ns(self) -> int:
        """See `front_end.Listener`: a batch of samples is settled."""
        return NEVER_NS if self.filter is None else self.settled_ns + self._lag_ns + _BATCH_NS

    def advance(self, stamp_ns: int, count: int, change: Change | None) -> None:
        """Process the samples that are settled now; see `front_end.Listener`."""
        if self.filter is None:
            return
        if change is not None:
            self._stationary.change(change)
        if stamp_ns >= self.due_ns:
            self._settle(stamp_ns - self._lag_ns)
            self._emit()

    # --- what else comes in

    def add(self, topic: str, message: Any) -> Observation | None:
        """Add a message of an aid; also returned where the filter does not use it.

        Parameters
        ----------
        topic : str
        message : message
            Of one of the aid's types (`ins_nav.aiding.base.Aid.MESSAGE_TYPES`).
        """
        return self._aid_queue.add(topic, message, self.front_end.stamp_ns, self.settled_ns)

    @property
    def solution(self) -> tuple[NavState, Biases, Array] | tuple[None, None, None]:
        """State, biases and covariance, shape (15, 15), at ``settled_ns``; None each without a filter."""
        if self.filter is None or self.state is None:
            return None, None, None
        covariance = covariance_propagation.covariance_of(self.filter)
        return self.state, Biases(self.gyro_bias, self.accel_bias, covariance[BIASES, BIASES]), covariance

    def call_zupt(self, stamp_ns: int) -> None:
        """A ZUPT service was called at this stamp: without zero velocity updates, the stop is measured now."""
        if self.filter is not None:
            self._stationary.call(stamp_ns)

    def calibrate(self, calibration: StopCalibration) -> None:
        """ZUPT-1 was solved: a measurement of the solution at a stamp that is not settled yet."""
        if self.filter is not None:
            self._stationary.calibrate(calibration)

    def adopt(self, solution: Correction, aligned_ns: int) -> bool:
        """Start from the solution of another process that aligned before this one began; False where it is not used.

        Parameters
        ----------
        solution : Correction
        aligned_ns : int
            Stamp at which its alignment ended.
        """
        front_end = self.front_end
        began_ns = aligned_ns - round(front_end.duration * 1e9)
        if self.filter is not None or began_ns > front_end.first_ns - _SAME_NS or not self.resume(solution):
            return False
        front_end.adopt(solution.state, aligned_ns)
        self._fine_before = (aligned_ns - solution.stamp_ns) * 1e-9
        self.events.report(INFO, "starts from the solution of ins_node")
        return True

    def resume(self, solution: Correction) -> bool:
        """Start from a solution of the last seconds; False where there is no sample of its stamp."""
        recent = self.front_end.recent
        row = recent.count(solution.stamp_ns) - 1
        if row < recent.oldest or recent.stamps[row] != solution.stamp_ns:
            return False
        self.gyro_bias, self.accel_bias = solution.gyro_bias, solution.accel_bias
        raw, errors = sample_of(recent.arrays[0][row]), solution.imu_errors
        self._start(solution.stamp_ns, solution.state, raw, solution.covariance, solution.aligned, errors)
        return True

    def suspend(self) -> None:
        """Stop the filter: another process leads, until `resume`."""
        self.filter = self.state = None
        self.settled_ns = 0
        self._out.clear()

    def drain(self) -> list[Correction]:
        """Corrections since the last call, oldest first."""
        out, self._out = self._out, []
        return out

    # --- the filter

    def _start(
        self, stamp_ns: int, state: NavState, raw: Sample, covariance: Array, aligned: bool, errors: tuple[float, ...]
    ) -> None:
        """Start the filter; its covariance on n (`covariance_propagation.covariance_of`), errors of the IMU in use."""
        known = self.front_end.configuration
        model = covariance_propagation.error_model(known, self._noise)
        own = {name: aid.states for name, aid in self._aids.items() if aid.states and aid.parameters.enabled}
        for name in self._calibrated.keys() & own.keys():
            found = self._calibrated[name]
            kept = [replace(s, value=x, stddev=stddev) for s, (x, stddev) in zip(own[name], found, strict=False)]
            own[name] = (*kept, *own[name][len(kept) :])
        self.filter = covariance_propagation.filter_of(model, covariance, own)
        self.bank = FilterBank(self.filter)
        size = model.imu_errors.size
        self._imu_errors_before = np.array(errors) if len(errors) == size else np.zeros(size)
        self._correction = model.imu_errors.correction(self._imu_errors_before)
        self.state = self._filtered = state
        self._before = raw
        self._aligned = aligned
        self.settled_ns = self._filtered_ns = self._emitted_ns = self._began_ns = stamp_ns
        self._aid_queue.begin(stamp_ns)
        detector = self.front_end.detector
        self._stationary.begin(detector.since_ns if detector.stopped else None)

    def _settle(self, until_ns: int) -> None:
        """Integrate the samples up to a stamp, with the observations between them."""
        front_end, queue, recent = self.front_end, self._aid_queue, self.front_end.recent
        row, until = recent.count(self.settled_ns), recent.count(until_ns)
        gaps = row + np.flatnonzero(recent.arrays[0][row:until, 0] > front_end.longest_interval)
        while row < until:
            end = min(until, recent.count(queue.next_ns - 1), *gaps[gaps >= row][:1])
            if end <= row:
                self._observe_until(row, row in gaps)
            if end <= row or self._stationary.is_active(int(recent.stamps[row])):
                end = row + 1
            self._integrate(row, end)
            row = end
        self._propagate()
        self._end_fine_alignment()

    def _observe_until(self, row: int, is_gap: bool) -> None:
        """Process the observations up to the sample of a row; before each the uncertainty of the gap it lies in."""
        recent = self.front_end.recent
        stamp_ns, raw = int(recent.stamps[row]), sample_of(recent.arrays[0][row])
        following = sample_of(recent.arrays[0][row + 1]) if row + 1 < recent.size else None
        errors = self.front_end.gap_errors(self._before, raw) if is_gap else None
        widened_ns = self.settled_ns
        for observation in self._aid_queue.until(stamp_ns):
            if errors is not None:
                self._widen(errors, (observation.stamp_ns - widened_ns) * 1e-9, raw[0])
                widened_ns = max(widened_ns, observation.stamp_ns)
            self._observe(observation, raw, following)
        if errors is not None:
            self._widen(errors, (stamp_ns - widened_ns) * 1e-9, raw[0])

    def _integrate(self, row: int, end: int) -> None:
        """Integrate the samples of these rows, without a correction between them."""
        assert self.state is not None
        front_end, before, recent = self.front_end, self._before, self.front_end.recent
        states = strapdown.integrate(
            self.state,
            before,
            recent.arrays[0][row:end],
            Compensation(self.gyro_bias, self.accel_bias, self._correction),
            instantaneous=front_end.instantaneous,
            vertical=front_end.vertical,
            water_surface=front_end.water_surface,
        )
        self.settled_ns, self._before = int(recent.stamps[end - 1]), sample_of(recent.arrays[0][end - 1])
        self.state = NavState._make(states[-1].tolist())
        if end == row + 1:
            self._measure_stop(before, self._before)

    def _widen(self, errors: tuple[Array, Array], time: float, gap: float) -> None:
        """Widen by the errors (`FrontEnd.gap_errors`) of a part of a gap, s: they grow as a random walk."""
        if time > 0.0:
            assert self.filter is not None and self.state is not None
            self._propagate()
            turn, speed = (np.square(error) * (time / gap) for error in errors)
            covariance_propagation.widen(self.bank, self.state, turn, speed, time)

    def _propagate(self) -> None:
        """Propagate the covariance to the present state."""
        if self.settled_ns > self._filtered_ns:
            assert self.filter is not None and self.state is not None
            stamps = self._filtered_ns, self.settled_ns
            covariance_propagation.propagate(self.bank, self.front_end.condition, self._filtered, self.state, *stamps)
            self._filtered, self._filtered_ns = self.state, self.settled_ns

    def _rate(self, after: float, raw: Sample, following: Sample | None) -> Vector:
        """Angular rate so long after the settled sample, s, of which ``raw`` is the next: means are of the middles."""
        first, second, share = self._before, raw, after / raw[0]
        if not self.front_end.instantaneous:
            share += 0.5
            if share > 1.0 and following is not None:
                first, second, share = raw, following, share - 1.0
        one, other = (self._corrected(sample)[1:4] for sample in (first, second))
        x, y, z = (a + min(share, 1.0) * (b - a) for a, b in zip(one, other, strict=True))
        return x, y, z

    def _corrected(self, raw: Sample) -> Sample:
        """A sample without the errors in use."""
        return compensated(raw, self.gyro_bias, self.accel_bias, self._correction)

    def _observe(self, observation: Observation, raw: Sample, following: Sample | None) -> None:
        """Process an observation between the settled sample and the next."""
        aid, front_end = self._aids[observation.aid], self.front_end
        if self._until_aligned and self.phase is Phase.NAVIGATING:
            return
        if self._last_ns.get(aid.name) == observation.stamp_ns:
            text = f"{aid.topic}: a stamp repeated, rejected"
            self.events.count(f"{aid.name} repeated", INFO, text, observation.stamp_ns)
            return
        self._last_ns[aid.name] = observation.stamp_ns
        assert self.filter is not None and self.state is not None
        self._propagate()
        after = (observation.stamp_ns - self.settled_ns) * 1e-9
        state = self.state
        if after > 0.0:
            part = (after, *self._corrected(raw)[1:])
            before = self._corrected(self._before)
            state = strapdown.step(
                state, before, part, front_end.instantaneous, front_end.vertical, front_end.water_surface
            )
        now_ns = max(observation.stamp_ns, self.settled_ns)
        names = (aid.name, aid.shares)
        own = OwnStates(self.filter.own(*names), self.filter.own_covariance(*names))
        solution = self.filter.solution(state, self._rate(max(0.0, after), raw, following), self.gyro_bias, now_ns)
        try:
            measurement = aid.measure(solution, own, observation)
        except Unusable as reason:
            text = f"{aid.topic}: {reason}"
            self.events.count(f"{aid.name} {reason.kind}", reason.level, text, observation.stamp_ns)
            return
        if measurement is not None:
            if self._last_value.get(aid.name) == observation.value:  # a frozen sensor is no evidence
                measurement = measurement._replace(valid_within=0.0)
            self._last_value[aid.name] = observation.value
            accepted = self._update(aid.name, now_ns, measurement, aid.parameters.gate)
            if accepted and measurement.direct is not None:
                self._aided_ns = now_ns

    def _measure_stop(self, before: Sample, raw: Sample) -> None:
        """Process the settled sample as one of a stop, where it is one."""
        before, raw = (compensated(sample, *NO_COMPENSATION[:2], self._correction) for sample in (before, raw))
        assert self.filter is not None and self.state is not None
        biases = self.gyro_bias, self.accel_bias
        for name, measure in self._stationary.add(self.settled_ns, before, raw, self.state, biases, self.filter.p):
            self._propagate()
            rate = without_bias(raw, *biases)[1:4]
            measurement, gate = measure(self.filter.solution(self.state, rate, self.gyro_bias), self.filter.p)
            if gate and self.settled_ns - self._aided_ns > _ALONE_NS and self.filter.admit(measurement):
                text = f"{name}: the solution was wrong by more than its sigma, which is widened"
                self.events.count("stops contradict the filter", WARN, text, self.settled_ns)
            self._update(name, self.settled_ns, measurement, gate)

    def _update(self, name: str, stamp_ns: int, measurement: Measurement, gate: float = GATE) -> bool:
        """Update the filter, correct the solution; whether the measurement was accepted."""
        aid = self._aids.get(name)  # none for a measurement at a stop
        source, topic = ("stops", name) if aid is None else (name, aid.topic)
        update, verdict = self.bank.update(source, name, stamp_ns, measurement, gate)
        self.records.setdefault(name, Record()).count(update)
        report_update(self.events, self.bank, topic, source, update, verdict)
        if update.accepted or verdict.replaced:
            self._feed_back()
        return update.accepted

    def _feed_back(self) -> None:
        assert self.filter is not None and self.state is not None
        before, bias = self.state, self.gyro_bias
        self.state, self.gyro_bias, self.accel_bias = self.filter.feed_back(before, bias, self.accel_bias)
        self.bank.follow()
        self._correction = self.filter.model.imu_errors.correction(self.imu_errors)
        self._filtered = self.state
        self._news = True
        self._stationary.corrected(before, self.state, np.subtract(self.gyro_bias, bias))
        for other in self._aids.values():
            other.corrected(before, self.state)

    # --- what goes out

    def _end_fine_alignment(self) -> None:
        if self._aligned or self.filter is None:
            return
        stddev, time = self.filter.heading_stddev, self.fine_time
        reason = self._fine.end(stddev, time)
        if reason:
            self._aligned = self._news = True
            text = f"fine alignment ended after {time:.0f} s: heading sigma {math.degrees(stddev):.3f}°, {reason}"
            self.events.report(INFO, text)

    def _emit(self) -> None:
        """Let a correction leave, when it is due."""
        since = self.settled_ns - self._emitted_ns
        if since < (_EMIT_NS if self._news else 2 * _EMIT_NS) or not (self._news or self._aids):
            return
        assert self.filter is not None and self.state is not None
        report_contradictions(self.events, self.bank, self.settled_ns)
        self._emitted_ns, self._news = self.settled_ns, False
        apply_ns, biases = self.front_end.stamp_ns + self._apply_ns, (self.gyro_bias, self.accel_bias)
        covariance = covariance_propagation.covariance_of(self.filter)
        values = self.state, *biases, covariance, self._aligned, self.imu_errors
        self._out.append(Correction(self.settled_ns, apply_ns, *values))

    @property
    def imu_errors(self) -> tuple[float, ...]:
        """Further errors of the IMU in use (`ins_nav.estimation.imu_error`); empty without a filter."""
        return () if self.filter is None else tuple((self._imu_errors_before + self.filter.imu_errors).tolist())

    @property
    def events(self) -> EventLog:
        """Of the front end."""
        return self.front_end.events

    @property
    def phase(self) -> Phase:
        """Present phase."""
        return Phase.FINE if self.filter is not None and not self._aligned else self.front_end.phase

    @property
    def fine_time(self) -> float:
        """Time since the first sample of alignment, or since an unfinished one was adopted, s."""
        return self._fine_before + (self.settled_ns - self.front_end.aligned_ns) * 1e-9

    @property
    def time_left(self) -> float:
        """Predicted time to the end of fine alignment, s."""
        if self.phase is not Phase.FINE or self.filter is None:
            return 0.0
        return self._fine.time_left(self.filter.heading_stddev, self.fine_time)

    def _accepted_aids(self) -> list[Aid[Any]]:
        """Those of which a measurement was accepted since alignment, and which calibrate their unit."""
        aids = self._aids.items() if self.filter is not None else ()
        return [aid for name, aid in aids if aid.CALIBRATED and self._record(name).accepted]

    def _record(self, name: str) -> Record:
        return self.records.get(name, Record())

    def own_states(self, name: str) -> list[tuple[float, float]]:
        """Value and sigma of the states that an aid has in the filter."""
        aid = self._aids.get(name)
        if self.filter is None or aid is None or not aid.states:
            return []
        return list(zip(self.filter.own(name).tolist(), self.filter.own_stddev(name).tolist(), strict=True))

    @property
    def calibration(self) -> dict[str, Value]:
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
        heard = self._aid_queue.heard
        found = ((a, self._record(a.name).fault(a, a.name in heard, self.settled_ns, self._began_ns)) for a in enabled)
        return [f"{aid.topic}: {text}" for aid, text in found if text]
