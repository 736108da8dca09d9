"""What the navigator does at stops: zero velocity by itself, ZUPT-1 and ZUPT-2 when asked.

Everything is done some seconds late, on settled data: that the vehicle has begun to move is noticed later than it
happens. A stop is measured, and the state corrected, at the settled time; what came since is run again
(`replay_buffer`). When the end of a stop turns out to be older than the last correction, that is undone.

- *Zero velocity*: the mean velocity over each second of a stop is the error, and so is the way it has gone. At the
  first second the error has grown since velocity was last known, and position with it.
- *ZUPT*: the rates left at the stop (`stationary_rates`) are explained by drifts, and with two positions by the azimuth
  (`zupt_equations`), weighed against what was known before. A stop is always measured as a whole: a second call at the
  same stop replaces the first.

References
----------
.. [1] E. S. Lobusov, A. V. Fomichev, "ZUPT mode for a strapdown INS of a ground vehicle", Vestnik MGTU, 2014, no. 6.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ins_nav.alignment.coarse_alignment import Alignment
from ins_nav.alignment.gravity_cone import GravityCone
from ins_nav.config.configuration import Configuration
from ins_nav.estimation.covariance_propagation import Held
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, SOLUTION_SIZE, TILT
from ins_nav.event_log import WARN, EventLog
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import from_rotation_vector, multiply
from ins_nav.mechanization.earth import RATE
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import ReplayBuffer
from ins_nav.mechanization.strapdown import Sample
from ins_nav.stop_detection.detector import Change, StopDetector
from ins_nav.stop_detection.stop_limits import StopLimits
from ins_nav.zupt.stationary_rates import MIN_DURATION, StationaryRates, StationaryRatesResult
from ins_nav.zupt.stop_records import Stop, StopCorrection, Triple, grown_position, row, without
from ins_nav.zupt.zupt_equations import Calibration, InconsistentError, Prior, ZuptError, rebased, zupt1, zupt2_update

Array = NDArray[np.float64]

SETTLE_NS = 2_200_000_000
"""ns: a start is seldom noticed later (`detector`). Not a whole number of seconds: a measurement is of
whole ones, so a service called when a stop has lasted for whole seconds gives the same a moment later."""
_BATCH_NS = 100_000_000
"""ns of data that settle at a time."""
_HOLD_NS = 1_000_000_000
"""ns between two corrections of velocity."""
_MARGIN = 1.0
"""s before the vehicle is seen to move that are not counted as rest: it moves before that shows in its velocity."""
_ARRIVAL_NS = 1_000_000_000
"""ns after which a vehicle that stopped does not swing on its springs any more."""
DOUBT_SIGMAS, DOUBT_SPEED = 10.0, 2.0
"""A stop is none where the solution is faster than so many sigmas and so many m/s: even motion looks like rest, and
sigmas go with parameters that may not be those of this IMU."""
_LONGEST_REST = 1800.0
"""s: a longer stop is measured anew. The axes of S are followed to the third power of the Earth's turn, and a drift
stays what it is for so long."""
_SAME_STOP = 1.0
"""s by which a stop may seem to have begun after coarse alignment did, and be the same."""
_EXACT = 1e-20
"""rad²: smallest variance of an azimuth; an exact one would make matrices singular."""
_REGULAR = 1e-9
"""Share of a variance that keeps a matrix regular whose parts are fully correlated."""
_EXACT_DRIFT = 1e-24
"""rad²/s²: the same of a drift, 2e-7 °/h."""


class StopCalibration:
    """Watches for stops and corrects at them.

    Parameters
    ----------
    configuration : Configuration
    events : EventLog
        Where events are counted.

    Attributes
    ----------
    detector : StopDetector
    covariance : ndarray, shape (4, 4)
        Of gyro drifts, rad/s, and azimuth, rad, when the latter was last corrected.
    level_variance : float
        At the last calibration, rad²; NaN before.
    calibrations : int
        Corrections of the gyro bias so far.
    held : int
        StopCalibration at which velocity was corrected.
    doubted : int
        StopCalibration that were none, by the speed of the solution.
    passive : bool
        The filter corrects the solution: here stops are only measured.
    accel_bias : 3 floats
        In use, m/s².
    velocity_error : float
        Found at the beginning of the last stop, m/s.
    """

    def __init__(self, configuration: Configuration, events: EventLog) -> None:
        imu, zupt = configuration.imu, configuration.zupt
        self._events = events
        self.detector = StopDetector(StopLimits.of(configuration.stop, imu))
        self._instantaneous = imu.instantaneous
        self._zero_velocity = zupt.zero_velocity
        self._filter_takes = configuration.aiding.stops != "none"
        self._max_rocking = zupt.max_rocking
        self._drift_walk = imu.gyro_bias_walk
        self._accel_stddev = imu.accel_bias_stddev
        self.accel_bias: Triple = imu.accel_bias
        self.passive = False
        self.restart()

    def restart(self) -> None:
        """The stamps have jumped: nothing is known but the noise."""
        self.detector.restart()
        self.calibrations = self.held = self.doubted = 0
        self.velocity_error = math.nan
        self.level_variance = math.nan
        self.covariance: Array = np.zeros((4, 4))
        self.forget()

    def forget(self) -> None:
        """Navigation has ended; the detector goes on."""
        self._stop: Stop | None = None
        self._first: Stop | None = None
        self._settled_ns = 0
        self._turned = np.zeros(3)
        self._removed = 0.0
        self._known_turned = np.zeros(3)
        self._known_ns = self._held_ns = self._calibrated_ns = 0
        self._gyro_variance = 0.0

    # --- the stream

    def begin(
        self,
        alignment: Alignment,
        cone: GravityCone,
        state: NavState,
        stamp_ns: int,
        gyro_bias: Triple,
        gyro_bias_covariance: Array,
        heading_variance: float | None,
    ) -> None:
        """Alignment has ended: from here there is a state. The variance is that of a heading given, rad²."""
        self.forget()
        self._settled_ns = self._known_ns = self._held_ns = self._calibrated_ns = stamp_ns
        self._gyro_variance = alignment.gyro_noise**2
        where = nav_state.geodetic(state)
        k = RATE * math.cos(where.lat)
        drift = gyro_bias_covariance + _EXACT_DRIFT * np.eye(3)
        self.covariance = np.zeros((4, 4))
        self.covariance[:3, :3] = drift
        self.covariance[3, 3] = max(alignment.covariance[2, 2], _EXACT)
        information = np.zeros((4, 4))
        information[:3, :3] = np.linalg.inv(drift)
        if heading_variance is None:  # what was found has absorbed the east drift
            east = np.array(row(state, 0))
            self.covariance[:3, 3] = self.covariance[3, :3] = drift @ east / k
            absorbed = float(east @ drift @ east) / k**2
            self.covariance[3, 3] = absorbed * (1.0 + _REGULAR) + alignment.heading_noise**2 + _EXACT
        else:
            information[3, 3] = 1.0 / max(heading_variance, _EXACT)
        self.level_variance = max(alignment.covariance[0, 0], alignment.covariance[1, 1])
        if not self.detector.stopped:
            return
        self._stop = stop = self._new(stamp_ns, StationaryRates(state), gyro_bias)
        if self.detector.since_ns <= stamp_ns - (cone.time - _SAME_STOP) * 1e9:  # alignment's data is of this stop
            stop.rest, stop.information = StationaryRates(state, cone), information
            turn = cone.time * np.array(row(state, 2))
            stop.turned = stop.turned - turn
            stop.removed -= float(turn @ gyro_bias)
            # a heading found is that of the middle, one given that of the end
            stop.before = -turn if heading_variance is not None else -0.5 * turn

    def detect(self, stamp_ns: int, sample: Sample) -> Change | None:
        """Take a sample as it came from the stream; says when a stop begins or ends."""
        return self.detector.add(stamp_ns, sample)

    def advance(
        self, change: Change | None, history: ReplayBuffer, stamp_ns: int, bias: Triple
    ) -> StopCorrection | None:
        """The history has a new entry; says when the state is to be corrected.

        Parameters
        ----------
        change : Change or None
            What `detect` said of the same sample.
        history : ReplayBuffer
        stamp_ns : int
            Of its newest entry.
        bias : 3 floats
            Of the gyros, in use, rad/s.
        """
        if change is not None:
            if not change.stopped:
                return self._leave(change.stamp_ns, history, bias)
            self._settle(min(change.stamp_ns, stamp_ns), history, bias)
            if self._stop is None:
                start = history.at(self._settled_ns)
                self._stop = self._new(start.stamp_ns, StationaryRates(start.state), bias)
        if stamp_ns - self._settled_ns < SETTLE_NS + _BATCH_NS:
            return None
        self._settle(stamp_ns - SETTLE_NS, history, bias)
        stop = self._stop
        if stop is not None and stop.rest.duration > _LONGEST_REST:
            stop.until = stop.rest.duration
            self._stop = self._new(self._settled_ns, StationaryRates(history.at(self._settled_ns).state), bias)
        return self._hold(_HOLD_NS, history, bias)

    def follow(self, following: bool, covariance: Array | None, history: ReplayBuffer, bias: Triple) -> None:
        """Say whether the filter leads.

        When it does not any more, what it knew last is what is known, and a stop under way begins anew.

        Parameters
        ----------
        following : bool
        covariance : ndarray or None
            Of the errors (`ins_nav.estimation.error_model`), as the filter left them.
        history : ReplayBuffer
        bias : 3 floats
            Of the gyros, in use, rad/s.
        """
        if self.passive and not following and covariance is not None:
            signs = np.array([-1.0, -1.0, -1.0, 1.0])  # drifts are what is true less what is in use
            known = [*range(SOLUTION_SIZE)[GYRO_BIAS], HEADING]
            self.covariance = covariance[np.ix_(known, known)] * np.outer(signs, signs)
            self.covariance += np.diag([_EXACT_DRIFT] * 3 + [_EXACT])
            self.level_variance = covariance.diagonal()[TILT].max()
            self._known_turned = self._turned.copy()
            self._known_ns = self._settled_ns
            self._first = None
            if self._stop is not None:
                start = history.at(self._settled_ns)
                self._stop = self._new(start.stamp_ns, StationaryRates(start.state), bias)
        self.passive = following

    def left(self) -> str:
        """What a call of a service does while the filter leads: nothing, if the stop is fit for it.

        Raises
        ------
        ZuptError
            As of `zupt2`; or the filter takes nothing from stops.
        """
        if not self._filter_takes:
            raise ZuptError(
                "alignment_node's filter leads and takes nothing from stops: aiding.stops is none; set updates or zupt"
            )
        stop, _ = self._measured()
        return f"at rest for {stop.rest.duration:.0f} s, left to alignment_node's filter"

    def _new(self, stamp_ns: int, rest: StationaryRates, bias: Triple) -> Stop:
        """A stop that begins now, on settled data."""
        prior = self._prior(stamp_ns)
        before = self._turned - self._known_turned
        from_start = np.eye(4)
        from_start[3, :3] = -before
        information: Array = np.asarray(from_start.T @ np.linalg.inv(prior) @ from_start, float)
        return Stop(stamp_ns, rest, bias, self._turned.copy(), self._removed, prior, before, information)

    def _prior(self, stamp_ns: int) -> Array:
        """What is known of drifts and azimuth, grown older."""
        age = (stamp_ns - self._known_ns) * 1e-9
        return self.covariance + age * np.diag([self._drift_walk**2] * 3 + [self._gyro_variance])

    def _settle(self, until_ns: int, history: ReplayBuffer, bias: Triple) -> None:
        """Account for what has become certain: S turns; a stop is measured."""
        entries = history.between(self._settled_ns, until_ns)
        if not entries:
            return
        stop = self._stop
        previous = without(history.at(self._settled_ns).raw, stop.bias, self.accel_bias) if stop else None
        x = y = z = 0.0
        for entry in entries:
            h = entry.raw[0]
            ux, uy, uz = row(entry.state, 2)
            x, y, z = x + h * ux, y + h * uy, z + h * uz
            if stop is not None and previous is not None:
                sample = without(entry.raw, stop.bias, self.accel_bias)
                stop.rest.add(previous, sample, self._instantaneous)
                previous = sample
        turn = np.array([x, y, z])
        self._turned = self._turned + turn
        self._removed += float(turn @ np.asarray(bias))
        self._settled_ns = entries[-1].stamp_ns

    def _leave(self, ended_ns: int, history: ReplayBuffer, bias: Triple) -> StopCorrection | None:
        """The stop has ended."""
        stop, correction = self._stop, None
        if stop is None:
            return None
        rest_ns = ended_ns - round(_MARGIN * 1e9)
        if rest_ns > self._settled_ns:
            self._settle(rest_ns, history, bias)
            correction = self._hold(_HOLD_NS // 5, history, bias)
        elif self._zero_velocity and not self.passive and rest_ns < self._held_ns:
            end = history.at(max(rest_ns, self._calibrated_ns))
            self._held_ns = end.stamp_ns
            correction = StopCorrection(end.stamp_ns, end.state, bias)
        stop.until = stop.rest.duration - max(0.0, (self._settled_ns - rest_ns) * 1e-9)
        self._stop = None
        return correction

    def _hold(self, least_ns: int, history: ReplayBuffer, bias: Triple) -> StopCorrection | None:
        """Mean velocity over the settled time since the last correction is zero, if that is long enough."""
        stop = self._stop
        if stop is None:
            return None
        first = self._held_ns < stop.began_ns
        since_ns = stop.began_ns + _ARRIVAL_NS if first else self._held_ns
        entries = history.between(since_ns, self._settled_ns) if self._settled_ns - since_ns >= least_ns else []
        if not entries:
            return None
        vx, vy, vz = (sum(entry.state[i] for entry in entries) / len(entries) for i in (4, 5, 6))
        time = (self._settled_ns - since_ns) * 1e-9
        if first:
            drift_variance = float(np.trace(self.covariance[:3, :3])) / 3.0
            grown, stddev = grown_position(
                (since_ns - self._held_ns) * 1e-9, self._accel_stddev, drift_variance, self._gyro_variance
            )
            time += grown
            self.velocity_error = math.hypot(vx, vy)
            if self.velocity_error > DOUBT_SPEED + DOUBT_SIGMAS * stddev:
                self._stop, self.doubted = None, self.doubted + 1
                self._events.count("stops doubted", WARN, f"stop not used: {self._doubt()}", self._settled_ns)
                return None
            self.held += 1
        self._held_ns = self._settled_ns
        if not self._zero_velocity or self.passive:
            return None
        back = (-vx * time, -vy * time, -vz * time)
        state = nav_state.corrected(entries[-1].state, back, (-vx, -vy, -vz))
        return StopCorrection(self._settled_ns, state, bias, Held((vx, vy, vz), time, first))

    # --- the services

    def zupt1(self, history: ReplayBuffer) -> tuple[str, StopCorrection | None]:
        """First call: this is position 1; second call, after a turn: drifts and azimuth.

        Parameters
        ----------
        history : ReplayBuffer

        Returns
        -------
        str
            What was done.
        StopCorrection or None

        Raises
        ------
        ZuptError
            Why not.
        """
        stop, result = self._measured()
        if self._first is None:
            self._first = stop
            found, _ = zupt2_update(result.measurement, stop.prior, stop.before)
            sigma = math.sqrt(found.covariance[3, 3] + self._gyro_variance)
            return (
                f"position 1 kept after {stop.rest.duration:.0f} s at rest (heading known to "
                f"{math.degrees(sigma):.4f}°): it is measured until the vehicle moves; turn by 90° to 180°, stop, and "
                "call again",
                None,
            )
        first, two = self._first, result.measurement
        try:
            one = first.rest.result(self._accel_stddev, first.until).measurement
        except ZuptError as error:  # it ended earlier than was known when it was kept
            self._first = stop
            raise ZuptError(
                f"position 1 is of no use ({error}): this is position 1 now; turn, stop, call again"
            ) from None
        if first is stop:
            zupt1(one, two)  # refuses: no turn
        of_bias = np.asarray(stop.bias)
        gain = stop.turned + two.azimuth_gain - first.turned
        offset = float(gain @ of_bias) - (stop.removed + float(two.azimuth_gain @ of_bias) - first.removed)
        between = of_bias - np.asarray(first.bias)
        age = (stop.began_ns - first.began_ns) * 1e-9
        noise = one.covariance + age * self._drift_walk**2 * np.eye(3)
        noise[0, 0] += age * self._gyro_variance * one.horizontal_rate**2
        seen = rebased(replace(one, covariance=noise), between, offset)
        seen = replace(seen, azimuth_gain=gain)
        try:
            found = zupt1(seen, two, Prior(-between, offset, first.information))
        except InconsistentError:
            self._first = stop
            raise
        self._first = None
        text = self._sentence(found, stop, True)
        correction = self._apply(found, stop, result, history)
        self._stop = self._new(correction.stamp_ns, StationaryRates(correction.state), correction.gyro_bias)
        self._held_ns = correction.stamp_ns
        return text, correction

    def zupt2(self, history: ReplayBuffer) -> tuple[str, StopCorrection | None]:
        """Drifts, the azimuth trusted; parameters, results and errors as of `zupt1`."""
        stop, result = self._measured()
        found, contradicted = zupt2_update(result.measurement, stop.prior, stop.before)
        name = "walk_deg_per_hour_per_sqrt_hour" if self.calibrations else "stddev_deg_per_hour"
        text = self._sentence(found, stop, False)
        if contradicted:
            text += f"; more than imu.gyro_bias_{name} allows: set it to what the gyros have"
        return text, self._apply(found, stop, result, history)

    def _measured(self) -> tuple[Stop, StationaryRatesResult]:
        """The present stop and what it shows.

        Raises
        ------
        ZuptError
        """
        stop, detector = self._stop, self.detector
        if stop is None and detector.stopped:
            raise ZuptError(f"moving: {self._doubt()}")
        if stop is None or not detector.stopped:
            since = (detector.stamp_ns - detector.since_ns) * 1e-9
            known = f" for {since:.1f} s" if detector.since_ns else ""
            raise ZuptError(
                f"moving{known}: stand still until stopped is true (speed since the last stop "
                f"{detector.speed:.2f} m/s, shaking {detector.shake:.1f} times its limit) and call again"
            )
        if stop.rest.duration < MIN_DURATION:
            unsettled = (detector.stamp_ns - self._settled_ns) * 1e-9
            least = MIN_DURATION + (SETTLE_NS + _BATCH_NS) * 1e-9
            raise ZuptError(
                f"stop too short: {stop.rest.duration + unsettled:.1f} s since it began or ZUPT-1 succeeded, "
                f"at least {least:.1f} s are needed; stand still and call again"
            )
        # a service called a moment later, live, is to see the same
        result = stop.rest.result(self._accel_stddev, math.floor(stop.rest.duration))
        if result.rocking > self._max_rocking:
            raise ZuptError(
                f"rocking too much: {math.degrees(result.rocking):.1f}° RMS, zupt.max_rocking_deg is "
                f"{math.degrees(self._max_rocking):g}; wait until the vehicle is calmer and call again"
            )
        return stop, result

    def _doubt(self) -> str:
        return (
            f"the IMU seems to rest, but the solution moves at {self.velocity_error:.1f} m/s; if the vehicle does "
            "stand, raise imu.gyro_bias_stddev_deg_per_hour and imu.accel_bias_stddev_mg to what the IMU has"
        )

    def _apply(
        self, found: Calibration, stop: Stop, result: StationaryRatesResult, history: ReplayBuffer
    ) -> StopCorrection:
        """The state at the settled time, level, with the azimuth corrected; what is known from now on."""
        entry = history.at(self._settled_ns)
        where = nav_state.geodetic(entry.state)
        q_gb = multiply(from_rotation_vector(0.0, 0.0, -found.azimuth), result.q_gb)
        east, north, up = where.velocity_g
        held = None
        if self._held_ns < stop.began_ns or not self._zero_velocity:  # not corrected yet
            east = north = up = 0.0
            held = Held(where.velocity_g, 0.0, True)
        c, s = math.cos(found.azimuth), math.sin(found.azimuth)
        velocity = (c * east + s * north, c * north - s * east, up)
        state = nav_state.initial_state(where.lat, where.lon, where.height, velocity, q_gb)
        bias = tuple((np.asarray(stop.bias) + found.drift).tolist())
        gain = result.measurement.azimuth_gain
        self._turned = stop.turned + gain
        self._removed = stop.removed + float(gain @ np.asarray(stop.bias)) + found.azimuth
        self._known_turned = self._turned.copy()
        self._known_ns = self._calibrated_ns = self._settled_ns
        self._gyro_variance = result.gyro_noise**2
        self.covariance = found.covariance
        self.covariance[3, 3] += _EXACT
        self.level_variance = result.level_variance
        self.calibrations += 1
        return StopCorrection(entry.stamp_ns, state, bias, held, True)

    def _sentence(self, found: Calibration, stop: Stop, with_azimuth: bool) -> str:
        return replace(found, drift=np.asarray(stop.bias) + found.drift).sentence(with_azimuth)
