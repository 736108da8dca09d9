"""Stops as measurements for the filter: zero velocity each second, the run-off of yaw each minute, ZUPT when called.

On settled data only: the ends of a stop are certain. Mean velocity over a second is zero but for what the base sways
(people in a vehicle, its springs, wind). How much that is shows in the scatter of these means about a parabola, for
errors of the solution are smooth: level and heading are twenty times better known on a still base than on a busy one.

A ZUPT call measures the residual rates of the whole stop. Zero velocity and an earlier call are of the same data: what
the filter has learnt of these rates since the stop began is left out of the information (`without_known`).
"""

import bisect
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ins_nav.alignment.gravity_cone import GravityCone
from ins_nav.config.sections import AidingSection, ImuSection, ZuptSection
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.innovation_gate import GATE
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, HORIZONTAL_VELOCITY, SIZE
from ins_nav.event_log import INFO, EventLog
from ins_nav.mechanization.nav_state import NavState, heading_change, up_axis
from ins_nav.mechanization.strapdown import Sample, without_bias
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.measurements import ResidualRate, StopCalibration, ZeroVelocity, without_known
from ins_nav.zupt.stationary_rates import StationaryRates
from ins_nav.zupt.zupt_equations import ZuptError, rebased

SETTLE_NS = 2_200_000_000
"""ns: a departure is seldom detected later (`ins_nav.stop_detection`). Not a whole number of seconds: a measurement is
of whole ones, so a service called when a stop has lasted for whole seconds gives the same a moment later."""
DOUBT_SIGMAS, DOUBT_SPEED = 10.0, 2.0
"""A stop is none where the solution is faster than so many sigmas and so many m/s: even motion looks like rest, and
sigmas go with parameters that may not be those of this IMU."""
_HOLD = 1.0
"""s: length of a mean velocity."""
_SEGMENT = 60.0
"""s: length of a measurement of yaw's run-off; the rest of a stop counts from 10 s on."""
_LEAST_SEGMENT = 10.0
_LONGEST = 1800.0
"""s: a longer stop is measured anew, as by `ins_nav.zupt.calibration`."""
MARGIN_NS = 1_000_000_000
"""ns before the detected end of a stop that are not used: the vehicle moves before its velocity shows it."""
_ARRIVAL_NS = 1_000_000_000
"""ns after its beginning that are none."""
_SCATTER = 6, 60
"""Mean velocities, at least and at most, of the scatter: fewer do not determine it, more are no parabola."""
_LEAST_SWAY = 5e-4
"""m/s: least sway of a base."""
_CARRIER_SPEED = 30.0
"""m/s: each component of the velocity of a carrier that moves, standard deviation."""
_LATE_NS = 500_000_000
"""ns by which a call may come after whole seconds of a stop, and be of these: live it comes a moment later."""
_ODDS = math.log(1e3)
"""Logarithm of the odds of rest, or of motion, that decide."""
_NEVER_NS = 2**63

Make = Callable[[Solution, Array], tuple[Measurement, float]]
"""Makes a measurement and its gate from the solution at the settled sample and the filter's covariance."""


@dataclass
class _Interval:
    """A stop.

    Attributes
    ----------
    begin_ns, end_ns : int
        Stamps between which samples are stationary.
    speed_stddev, stillness : float
        As of `Change`.
    """

    begin_ns: int
    end_ns: int
    speed_stddev: float = 0.0
    stillness: float = 0.0


@dataclass
class _Record:
    """Residual rates of a stop, or of a part of it.

    Attributes
    ----------
    rates : StationaryRates
    biases : two times 3 floats
        Of gyros and accelerometers, removed from the samples.
    covariance : ndarray, shape (n, n)
        Of the filter when it began.
    turned : float
        By how much corrections have turned the heading that it began with, rad.
    """

    rates: StationaryRates
    biases: tuple[Vector, Vector]
    covariance: Array
    turned: float = 0.0

    def add(self, before: Sample, raw: Sample, instantaneous: bool) -> None:
        """Add a sample; biases are removed here."""
        self.rates.add(without_bias(before, *self.biases), without_bias(raw, *self.biases), instantaneous)

    def turn(self, before: NavState, after: NavState, gyro_bias: Array) -> float:
        """By how much a correction turns the heading that it began with, rad; the change of bias, shape (3,), rad/s.

        What heading has run off by the bias since then was no error at the beginning.
        """
        return heading_change(before, after) + self.rates.duration * float(np.dot(up_axis(before), gyro_bias))


class StationaryUpdates:
    """Measurements from the settled samples of stops.

    Parameters
    ----------
    imu : ImuSection
    zupt : ZuptSection
    aiding : AidingSection
    events : EventLog
    """

    def __init__(self, imu: ImuSection, zupt: ZuptSection, aiding: AidingSection, events: EventLog) -> None:
        self._events = events
        self._instantaneous = imu.instantaneous
        self._on_call = not zupt.zero_velocity
        self._stddev = aiding.stop_velocity_stddev
        self._accel_stddev = imu.accel_bias_stddev
        self.begin(None)

    def begin(self, stopped_since_ns: int | None) -> None:
        """The filter starts; the stop that lasts, if one does, began then."""
        self._stops: list[_Interval] = [] if stopped_since_ns is None else [_Interval(stopped_since_ns, _NEVER_NS)]
        self._calls: list[int] = []
        self._calibrations: list[StopCalibration] = []
        self._leave()

    def _leave(self) -> None:
        self._whole: _Record | None = None
        self._segment: _Record | None = None
        self._is_called = False
        self._time = 0.0
        self._way = [0.0] * 3
        self._moved = [0.0] * 3
        self._means: deque[tuple[float, float]] = deque(maxlen=_SCATTER[1])

    def include(
        self, state: NavState, biases: tuple[Vector, Vector, Array], cone: GravityCone, heading_variance: float
    ) -> None:
        """The stop that lasts since before alignment is measured from the first sample of alignment on.

        Parameters
        ----------
        state : NavState
            At the end of alignment.
        biases : two times 3 floats; ndarray, shape (6, 6)
            Of gyros and accelerometers, removed during alignment, and their covariance before.
        cone : GravityCone
            The data of alignment.
        heading_variance : float
            Before alignment, rad²; infinite where alignment found heading.
        """
        covariance: Array = np.zeros((SIZE, SIZE))
        covariance[GYRO_BIAS, GYRO_BIAS] = biases[2][:3, :3]
        covariance[HEADING, HEADING] = min(heading_variance, math.pi**2 / 3.0)
        self._whole = _Record(StationaryRates(state, cone.copy()), biases[:2], covariance)

    def change(self, change: Change) -> None:
        """A stop begins or ends."""
        if change.stopped:
            begin_ns = change.stamp_ns + _ARRIVAL_NS
            self._stops.append(_Interval(begin_ns, _NEVER_NS, change.speed_stddev, change.stillness))
        elif self._stops:
            self._stops[-1].end_ns = change.stamp_ns - MARGIN_NS

    def is_active(self, stamp_ns: int) -> bool:
        """Whether a settled sample of that stamp is one of a stop, or the first after one, or a calibration is due."""
        return (
            self._whole is not None
            or bool(self._calibrations)
            or any(stop.begin_ns < stamp_ns <= stop.end_ns for stop in self._stops)
        )

    def call(self, stamp_ns: int) -> None:
        """A ZUPT service was called: the stop as a whole is measured, and again when it ends."""
        bisect.insort(self._calls, stamp_ns)

    def calibrate(self, calibration: StopCalibration) -> None:
        """ZUPT-1 was solved: the solution is measured at the calibration's stamp."""
        self._calibrations.append(calibration)

    def corrected(self, before: NavState, after: NavState, gyro_bias: Array) -> None:
        """A correction replaced the state of the settled sample and changed the gyro bias, rad/s, shape (3,)."""
        for record in self._records:
            record.turned += record.turn(before, after, gyro_bias)
        for i in (0, 1, 2):
            self._way[i] += self._time * (after[4 + i] - before[4 + i])
            self._moved[i] += after[4 + i] - before[4 + i]

    def add(
        self,
        stamp_ns: int,
        before: Sample,
        raw: Sample,
        state: NavState,
        biases: tuple[Vector, Vector],
        covariance: Array,
    ) -> list[tuple[str, Make]]:
        """Add a settled sample; measurements with their names.

        Parameters
        ----------
        stamp_ns : int
        before, raw : Sample
            The one before and this, biases left in.
        state : NavState
            Solution at the stamp.
        biases : two times 3 floats
            In use, of gyros and accelerometers.
        covariance : ndarray, shape (n, n)
            Of the filter.
        """
        due = [one for one in self._calibrations if one.stamp_ns <= stamp_ns]
        self._calibrations = self._calibrations[len(due) :]
        found = self._add(stamp_ns, before, raw, state, biases, covariance)
        return [*found, *(("zupt1", one.new) for one in due)]

    def _add(
        self,
        stamp_ns: int,
        before: Sample,
        raw: Sample,
        state: NavState,
        biases: tuple[Vector, Vector],
        covariance: Array,
    ) -> list[tuple[str, Make]]:
        while len(self._stops) > 1 and self._stops[0].end_ns < stamp_ns:
            self._stops.pop(0)
        if not any(stop.begin_ns < stamp_ns <= stop.end_ns for stop in self._stops):
            return self._end(stamp_ns, state, biases)
        for record in self._records:
            record.add(before, raw, self._instantaneous)
        if self._segment is None and not self._on_call:
            self._segment = _Record(StationaryRates(state), biases, covariance)
        if self._whole is None:
            self._called(stamp_ns)
            self._whole = _Record(StationaryRates(state), biases, covariance)
            return []
        h = raw[0]
        self._time += h
        for i in (0, 1, 2):
            self._way[i] += h * state[4 + i]
        if self._time < _HOLD * (1.0 - 1e-6):
            return []
        x, y = self._way[0] / self._time, self._way[1] / self._time
        speed_stddev = math.sqrt(covariance.diagonal()[HORIZONTAL_VELOCITY].sum())
        if not self._is_usable(math.hypot(x, y), speed_stddev, stamp_ns):
            return []
        found: list[tuple[str, Make]] = []
        called = self._called(stamp_ns + _LATE_NS)
        if called or not self._on_call:
            found.append(self._hold())
        self._time, self._way = 0.0, [0.0] * 3
        is_long = self._whole.rates.duration > _LONGEST
        if called or (is_long and self._is_called):
            self._is_called = True
            found += self._measure(self._whole, stamp_ns, state, biases[0], False)
            self._segment = None  # the next sample begins another
        elif self._segment is not None and self._segment.rates.duration >= _SEGMENT:
            found += self._measure(self._segment, stamp_ns, state, biases[0], True)
            self._segment = None
        if is_long:
            self._whole = None
        return found

    def _end(self, stamp_ns: int, state: NavState, biases: tuple[Vector, Vector]) -> list[tuple[str, Make]]:
        """The sample is the first after a stop, or a later one."""
        found: list[tuple[str, Make]] = []
        if self._whole is not None:
            # a call may have come before the end of the stop was detected
            called = self._called(stamp_ns + SETTLE_NS)
            if called and self._time >= 0.5 * _HOLD:
                found.append(self._hold())
            if called or self._is_called:
                found += self._measure(self._whole, stamp_ns, state, biases[0], False)
            elif self._segment is not None and self._segment.rates.duration >= _LEAST_SEGMENT:
                found += self._measure(self._segment, stamp_ns, state, biases[0], True)
            self._leave()
        return found

    @property
    def _records(self) -> list[_Record]:
        return [record for record in (self._whole, self._segment) if record is not None]

    def _is_usable(self, speed: float, stddev: float, stamp_ns: int) -> bool:
        """Whether the carrier rests, by the speed of the solution and its sigma, m/s; a stop that is none ends.

        Even motion looks like rest. A detector that is certain, by the velocity that it reckoned and by stillness, is
        overruled only by a speed far beyond its sigma. Otherwise (after a gap, or a long drive of a carrier that seldom
        shakes) the speed of the solution decides with stillness: the stop is used when the odds of rest are high, and
        waits for a more certain speed until then.
        """
        stop = self._stops[0]
        if stop.stillness + self._odds(stop.speed_stddev) > _ODDS:
            usable = speed <= DOUBT_SPEED + DOUBT_SIGMAS * stddev
            ended = not usable
        else:
            odds = stop.stillness + self._odds(math.sqrt(0.5) * stddev, speed)
            usable, ended = odds > _ODDS, odds < -_ODDS
        if ended:
            text = f"stop: the IMU seems to rest, but the solution moves at {speed:.1f} m/s: it is even motion"
            self._events.count("stops doubted", INFO, text, stamp_ns)
            self._stops[0].end_ns = stamp_ns
        if not usable:
            self._leave()
        return usable

    def _odds(self, stddev: float, speed: float = 0.0) -> float:
        """Logarithm of the odds of rest by a speed and the sigma of each component, m/s."""
        variance = stddev**2 + self._stddev**2
        return math.log(1.0 + _CARRIER_SPEED**2 / variance) - speed**2 / (2.0 * variance)

    def _called(self, until_ns: int) -> bool:
        """Whether ZUPT was called up to this stamp; such calls are done with."""
        count = bisect.bisect(self._calls, until_ns)
        del self._calls[:count]
        return count > 0

    def _hold(self) -> tuple[str, Make]:
        """Mean velocity over the last second is zero."""
        x, y, z = (way / self._time for way in self._way)
        self._means.append((x - self._moved[0], y - self._moved[1]))
        stddev = self._sway()

        def make(solution: Solution, _now: Array) -> tuple[Measurement, float]:
            mean = solution._replace(state=solution.state._replace(v_x=x, v_y=y, v_z=z))
            return ZeroVelocity().measure(mean, stddev), GATE

        return "zero velocity", make

    def _sway(self) -> float:
        """Sigma of a mean velocity, m/s: the scatter of those of this stop, as if nothing had been corrected."""
        count = len(self._means)
        if count < _SCATTER[0]:
            return self._stddev
        parabola = np.vander(np.linspace(-1.0, 1.0, count), 3)
        _, squares, *_ = np.linalg.lstsq(parabola, np.array(self._means), rcond=None)
        return min(self._stddev, max(_LEAST_SWAY, math.sqrt(float(np.sum(squares)) / (2 * (count - 3)))))

    def _measure(
        self, record: _Record, stamp_ns: int, state: NavState, gyro_bias: Vector, vertical: bool
    ) -> list[tuple[str, Make]]:
        """Residual rates of a record, about the vertical or about all axes."""
        try:
            result = record.rates.result(0.0 if vertical else self._accel_stddev)
        except ZuptError as error:
            self._events.count("stops not measured", INFO, f"stop: {error}", stamp_ns)
            return []
        m, turned, bias = result.measurement, record.turned, record.biases[0]

        def make(solution: Solution, now: Array) -> tuple[Measurement, float]:
            # the axes of the beginning, turned by the corrections of heading since then
            since = record.turn(state, solution.state, np.subtract(solution.gyro_bias, gyro_bias))
            stop = rebased(m, np.zeros(3), turned + since)
            measurement = ResidualRate(vertical).measure(solution, stop, bias)
            if vertical:
                return measurement, GATE
            corrected = stop.rot_sb @ np.subtract(solution.gyro_bias, bias)
            corrected[0] += m.horizontal_rate * (turned + since)
            return without_known(measurement, record.covariance, now, measurement.innovation + corrected)

        return [("rest", make)]
