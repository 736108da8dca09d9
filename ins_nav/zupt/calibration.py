"""ZUPT-1 and ZUPT-2: the equations of [1]_ solved over whole stops, weighed against the covariance before them.

`ZuptServices` records every stop from its first sample on (`stationary_rates`) and solves `zupt_equations` when a
service is called. The solution is reported; the filter gets the same data as measurements (`stationary_updates`), so
nothing here changes a state. Stops are processed with a delay, so that a departure not yet detected is not used as
standstill. A stop is always measured as a whole: a second call at the same stop replaces the first.

References
----------
.. [1] E. S. Lobusov, A. V. Fomichev, "ZUPT mode for a strapdown INS of a ground vehicle", Vestnik MGTU, 2014, no. 6.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.alignment.gravity_cone import GravityCone
from ins_nav.config.sections import ImuSection, ZuptSection
from ins_nav.estimation.error_model import Vector
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING
from ins_nav.mechanization.nav_state import NavState, heading_change, up_axis
from ins_nav.mechanization.replay_buffer import ReplayBuffer
from ins_nav.mechanization.strapdown import Compensation, compensated, compensated_rows
from ins_nav.stop_detection.detector import Change, StopDetector
from ins_nav.zupt.stationary_rates import MIN_DURATION, StationaryRates, StationaryRatesResult
from ins_nav.zupt.stationary_updates import DOUBT_SIGMAS, DOUBT_SPEED, MARGIN_NS, SETTLE_NS
from ins_nav.zupt.zupt_equations import Calibration, InconsistentError, Prior, ZuptError, rebased, zupt1, zupt2_update

Array = NDArray[np.float64]

_BATCH_NS = 100_000_000
"""ns of data that settle at a time."""
_LONGEST = 1800.0
"""s: a longer stop is measured anew. The axes of S are followed to the third power of the Earth's turn, and a drift
is constant for so long."""
_SAME_STOP = 1.0
"""s by which a stop may seem to begin after coarse alignment did, and be the same."""
_EXACT = 1e-20
"""rad²: smallest variance of an azimuth; an exact one would make matrices singular."""
_EXACT_DRIFT = 1e-24
"""rad²/s²: the same of a drift, 2e-7 °/h."""


class Moment(NamedTuple):
    """The solution when a stop begins.

    Attributes
    ----------
    state : NavState
    gyro_bias, accel_bias : 3 floats
        In use, rad/s and m/s².
    covariance : ndarray, shape (15, 15)
        Of the errors (`ins_nav.estimation.error_model`).
    correction : ndarray, shape (6, 6), or None
        Of the further errors of the IMU in use (`ins_nav.estimation.imu_error`).
    """

    state: NavState
    gyro_bias: Vector
    accel_bias: Vector
    covariance: Array
    correction: Array | None = None


class Answer(NamedTuple):
    """Answer of a service.

    Attributes
    ----------
    text : str
        The result, for a person.
    stamp_ns : int
        Of the last sample used.
    found : Calibration or None
        ZUPT-1 from the two stops alone: absolute drifts, and the error of the solution's heading at the stamp.
    expected : Calibration or None
        The same before the first stop.
    """

    text: str
    stamp_ns: int
    found: Calibration | None = None
    expected: Calibration | None = None


@dataclass
class _Stop:
    """A stop: the present one, or position 1 of ZUPT-1.

    Attributes
    ----------
    began_ns : int
        Stamp of its first sample.
    rest : StationaryRates
    gyro_bias, accel_bias : 3 floats
        Removed from the samples given to ``rest``.
    turned : ndarray, shape (3,)
        Turn of S since alignment, per unit of drift, when it began, s.
    removed : float
        The part of that turn removed by biases and corrections, rad.
    prior : ndarray, shape (4, 4)
        Covariance of drifts and azimuth when the azimuth was last known.
    before : ndarray, shape (3,)
        Turn of S from then to its beginning, per unit of drift, s.
    information : ndarray, shape (4, 4)
        On drifts and the azimuth at its beginning.
    until : float
        Length that is certainly stationary, s; infinite while it lasts.
    """

    began_ns: int
    rest: StationaryRates
    gyro_bias: Vector
    accel_bias: Vector
    turned: Array
    removed: float
    prior: Array
    before: Array
    information: Array
    until: float = math.inf


class ZuptServices:
    """Records stops and solves ZUPT-1 and ZUPT-2.

    Parameters
    ----------
    imu : ImuSection
    zupt : ZuptSection
    detector : StopDetector
        Of the front end.

    Attributes
    ----------
    solved : int
        Calibrations since alignment.
    """

    def __init__(self, imu: ImuSection, zupt: ZuptSection, detector: StopDetector) -> None:
        self._detector = detector
        self._instantaneous = imu.instantaneous
        self._max_rocking = zupt.max_rocking
        self._drift_walk = imu.gyro_bias_walk
        self._accel_stddev = imu.accel_bias_stddev
        self.end()

    def end(self) -> None:
        """Navigation has ended."""
        self._stop: _Stop | None = None
        self._first: _Stop | None = None
        self._settled_ns = 0
        self._turned: Array = np.zeros(3)
        self._removed = 0.0
        self._gyro_variance = 0.0
        self.solved = 0

    def begin(
        self, stamp_ns: int, moment: Moment, cone: GravityCone, heading_given: bool, noise: tuple[float, float]
    ) -> None:
        """Alignment has ended at the stamp; a stop that includes it is recorded from the first sample of alignment.

        Parameters
        ----------
        stamp_ns : int
        moment : Moment
        cone : GravityCone
            The data of alignment.
        heading_given : bool
            Heading was not found by alignment.
        noise : 2 floats
            White noise of gyros and accelerometers, rad/√s and m/s/√s.
        """
        self.end()
        self._settled_ns = stamp_ns
        self._gyro_variance = noise[0] ** 2
        detector = self._detector
        if not detector.stopped:
            return
        self._stop = stop = self._new(stamp_ns, moment)
        if detector.since_ns > stamp_ns - (cone.time - _SAME_STOP) * 1e9:
            return
        stop.rest = StationaryRates(moment.state, cone)
        if not heading_given:  # found from the same data: only the prior of the drifts is independent
            stop.information = np.zeros((4, 4))
            stop.information[:3, :3] = np.linalg.inv(stop.prior[:3, :3])
        turn = cone.time * np.array(up_axis(moment.state))
        stop.turned = stop.turned - turn
        stop.removed -= float(turn @ moment.gyro_bias)
        # a heading found is that of the middle, one given that of the end
        stop.before = -turn if heading_given else -0.5 * turn

    @property
    def due_ns(self) -> int:
        """Stamp of the sample with which a batch settles."""
        return self._settled_ns + SETTLE_NS + _BATCH_NS

    def advance(self, change: Change | None, buffer: ReplayBuffer, stamp_ns: int, moment: Callable[[], Moment]) -> None:
        """Process samples, of which the buffer has the last as its newest entry.

        Parameters
        ----------
        change : Change or None
            A stop begins or ends.
        buffer : ReplayBuffer
        stamp_ns : int
        moment : callable
            Gives the solution in use.
        """
        if change is None and stamp_ns < self.due_ns:
            return
        solution = moment()
        if change is not None and not change.stopped:
            self._leave(change.stamp_ns, buffer, solution)
        elif change is not None:
            self._settle(min(change.stamp_ns, stamp_ns), buffer, solution)
            if self._stop is None:
                self._stop = self._new(self._settled_ns, solution._replace(state=buffer.at(self._settled_ns).state))
        if stamp_ns < self.due_ns:
            return
        self._settle(stamp_ns - SETTLE_NS, buffer, solution)
        stop = self._stop
        if stop is not None and stop.rest.duration > _LONGEST:
            stop.until = stop.rest.duration
            self._stop = self._new(self._settled_ns, solution._replace(state=buffer.at(self._settled_ns).state))

    def corrected(self, before: NavState, after: NavState) -> None:
        """A correction replaced the state; azimuth of S turns by what heading was corrected."""
        self._removed -= heading_change(before, after)

    def _new(self, stamp_ns: int, moment: Moment) -> _Stop:
        known = [HEADING]
        known[:0] = range(GYRO_BIAS.start, GYRO_BIAS.stop)
        signs = np.array([-1.0, -1.0, -1.0, 1.0])  # a drift is true less in use; an azimuth is clockwise
        prior = moment.covariance[np.ix_(known, known)] * np.outer(signs, signs)
        prior = prior + np.diag([_EXACT_DRIFT] * 3 + [_EXACT])
        information: Array = np.asarray(np.linalg.inv(prior), float)
        rest = StationaryRates(moment.state)
        return _Stop(
            stamp_ns,
            rest,
            moment.gyro_bias,
            moment.accel_bias,
            self._turned.copy(),
            self._removed,
            prior,
            np.zeros(3),
            information,
        )

    def _settle(self, until_ns: int, buffer: ReplayBuffer, moment: Moment) -> None:
        """Account for samples that are certain: S turns; a stop is measured."""
        stamps, samples, states = buffer.between(self._settled_ns, until_ns)
        if not len(stamps):
            return
        stop = self._stop
        if stop is not None:
            compensation = Compensation(stop.gyro_bias, stop.accel_bias, moment.correction)
            before = compensated(buffer.at(self._settled_ns).raw, *compensation)
            stop.rest.add_block(before, compensated_rows(samples, compensation), self._instantaneous)
        turn = samples[:, 0] @ np.column_stack(up_axis(NavState._make(states.T)))
        self._turned = self._turned + turn
        self._removed += float(turn @ np.asarray(moment.gyro_bias))
        self._settled_ns = int(stamps[-1])

    def _leave(self, ended_ns: int, buffer: ReplayBuffer, moment: Moment) -> None:
        """The stop has ended."""
        stop = self._stop
        if stop is None:
            return
        rest_ns = ended_ns - MARGIN_NS
        self._settle(rest_ns, buffer, moment)
        stop.until = stop.rest.duration - max(0.0, (self._settled_ns - rest_ns) * 1e-9)
        self._stop = None

    # --- the services

    def zupt1(self, speed: float, speed_stddev: float) -> Answer:
        """First call: record position 1; second call, after a turn: drifts and azimuth ([1]_, (7)-(13)).

        Parameters
        ----------
        speed, speed_stddev : float
            Of the solution, horizontal, m/s.

        Returns
        -------
        Answer

        Raises
        ------
        ZuptError
            The text names the reason.
        """
        stop, result = self._measured(speed, speed_stddev)
        if self._first is None:
            self._first = stop
            found, _ = zupt2_update(result.measurement, stop.prior, stop.before)
            sigma = math.sqrt(found.covariance[3, 3] + self._gyro_variance)
            text = (
                f"position 1 recorded after {stop.rest.duration:.0f} s at rest (heading known to "
                f"{math.degrees(sigma):.4f}°): it is measured until the vehicle moves; turn by 90° to 180°, stop, and "
                "call again"
            )
            return Answer(text, self._settled_ns)
        first, two = self._first, result.measurement
        try:
            one = first.rest.result(self._accel_stddev, first.until).measurement
        except ZuptError as error:  # it ended earlier than the detector knew at the first call
            self._first = stop
            raise ZuptError(
                f"position 1 is of no use ({error}): this is position 1 now; turn, stop, call again"
            ) from None
        if first is stop:
            zupt1(one, two)  # refuses: no turn
        of_bias = np.asarray(stop.gyro_bias)
        gain = stop.turned + two.azimuth_gain - first.turned
        offset = float(gain @ of_bias) - (stop.removed + float(two.azimuth_gain @ of_bias) - first.removed)
        between = of_bias - np.asarray(first.gyro_bias)
        age = (stop.began_ns - first.began_ns) * 1e-9
        noise = one.covariance + age * self._drift_walk**2 * np.eye(3)
        noise[0, 0] += age * self._gyro_variance * one.horizontal_rate**2
        moved = replace(rebased(replace(one, covariance=noise), between, offset), azimuth_gain=gain)
        prior = Prior(-between, offset, first.information)
        try:
            alone, found = zupt1(moved, two), zupt1(moved, two, prior)
        except InconsistentError:
            self._first = stop
            raise
        self._first = None
        self.solved += 1
        # the filter has corrected heading since the stop began; its bias has changed, too
        since = self._removed - stop.removed - float(two.azimuth_gain @ of_bias)
        alone, found, expected = (
            replace(one, drift=of_bias + one.drift, azimuth=one.azimuth - since)
            for one in (alone, found, prior.at(gain))
        )
        return Answer(found.sentence(True), self._settled_ns, alone, expected)

    def zupt2(self, speed: float, speed_stddev: float) -> Answer:
        """Drifts, the azimuth trusted ([1]_, (14)-(15)); parameters, result and errors as of `zupt1`."""
        stop, result = self._measured(speed, speed_stddev)
        found, contradicted = zupt2_update(result.measurement, stop.prior, stop.before)
        self.solved += 1
        text = replace(found, drift=np.asarray(stop.gyro_bias) + found.drift).sentence(False)
        if contradicted:
            text += (
                "; more than imu.gyro_bias_stddev_deg_per_hour (or its random walk since the last stop) allows: set it "
                "to what the gyros have"
            )
        return Answer(text, self._settled_ns)

    def _measured(self, speed: float, speed_stddev: float) -> tuple[_Stop, StationaryRatesResult]:
        """The present stop and its measurement.

        Raises
        ------
        ZuptError
        """
        stop, detector = self._stop, self._detector
        if stop is None or not detector.stopped:
            since = (detector.stamp_ns - detector.since_ns) * 1e-9
            known = f" for {since:.1f} s" if detector.since_ns else ""
            raise ZuptError(
                f"moving{known}: stand still until stopped is true (speed since the last stop "
                f"{detector.speed:.2f} m/s, shaking {detector.shake:.1f} times its limit) and call again"
            )
        if speed > DOUBT_SPEED + DOUBT_SIGMAS * speed_stddev:
            raise ZuptError(
                f"moving: the IMU seems to rest, but the solution moves at {speed:.1f} m/s; if the vehicle does stand, "
                "raise imu.gyro_bias_stddev_deg_per_hour and imu.accel_bias_stddev_mg to what the IMU has"
            )
        if stop.rest.duration < MIN_DURATION:
            unsettled = (detector.stamp_ns - self._settled_ns) * 1e-9
            least = MIN_DURATION + (SETTLE_NS + _BATCH_NS) * 1e-9
            raise ZuptError(
                f"stop too short: {stop.rest.duration + unsettled:.1f} s since it began, at least {least:.1f} s are "
                "needed; stand still and call again"
            )
        # whole seconds: a service called a moment later, live, uses the same data
        result = stop.rest.result(self._accel_stddev, math.floor(stop.rest.duration))
        if result.rocking > self._max_rocking:
            raise ZuptError(
                f"rocking too much: {math.degrees(result.rocking):.1f}° RMS, zupt.max_rocking_deg is "
                f"{math.degrees(self._max_rocking):g}; wait until the vehicle is calmer and call again"
            )
        return stop, result
