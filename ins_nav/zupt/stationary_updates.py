"""Stops as measurements for the filter of `delayed`: zero velocity each second, the run-off of yaw each minute.

On settled data only: the ends of a stop are certain. Mean velocity over a second is zero but for what the base sways
(people in a vehicle, its springs, wind). How much that is shows in the scatter of these means about a parabola, for
errors of the solution are smooth: a still base tells of level and heading twenty times more than a busy one.

Either that, or what ZUPT calls measure and zero velocity with them: a matter of policy, for they are the same data.
"""

import bisect
import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ins_nav.config.sections import AidingSection, ImuSection
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.event_log import INFO, EventLog
from ins_nav.mechanization.nav_state import NavState, heading_change
from ins_nav.mechanization.strapdown import Sample
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.calibration import DOUBT_SIGMAS, DOUBT_SPEED, SETTLE_NS
from ins_nav.zupt.measurements import ResidualRate, ZeroVelocity
from ins_nav.zupt.stationary_rates import StationaryRates
from ins_nav.zupt.stop_records import Triple, without
from ins_nav.zupt.zupt_equations import ZuptError

_HOLD = 1.0
"""s: length of a mean velocity."""
_SEGMENT = 60.0
"""s: length of a measurement of yaw's run-off; the rest of a stop counts from 10 s on."""
_LEAST_SEGMENT = 10.0
_MARGIN_NS = 500_000_000
"""ns before the end of a stop, as it shows in velocity, that are no rest."""
_ARRIVAL_NS = 1_000_000_000
"""ns after its beginning that are none."""
_SCATTER = 6, 60
"""Mean velocities, at least and at most, whose scatter is taken: fewer tell nothing, more are no parabola."""
_LEAST_SWAY = 5e-4
"""m/s: no base is believed to be stiller."""
_NEVER_NS = 2**63

Make = Callable[[Solution], Measurement]
"""A measurement of the solution at the settled sample."""


class StationaryUpdates:
    """What the settled samples of stops say.

    Parameters
    ----------
    imu : ImuSection
    aiding : AidingSection
    events : EventLog
    """

    def __init__(self, imu: ImuSection, aiding: AidingSection, events: EventLog) -> None:
        self._events = events
        self._instantaneous = imu.instantaneous
        self._by_zupt = aiding.stops == "zupt"
        self._wanted = aiding.stops != "none"
        self._stddev = aiding.stop_velocity_stddev
        self._accel_stddev = imu.accel_bias_stddev
        self.begin(None)

    def begin(self, stopped_since_ns: int | None) -> None:
        """The filter starts; the stop that lasts, if one does, began then."""
        self._stops: list[list[int]] = [] if stopped_since_ns is None else [[stopped_since_ns, _NEVER_NS]]
        self._calls: list[int] = []
        self._leave()

    def _leave(self) -> None:
        self._segment: StationaryRates | None = None
        self._segment_biases: tuple[Triple, Triple] = ((0.0,) * 3, (0.0,) * 3)
        self._turned = self._time = 0.0
        self._way = [0.0] * 3
        self._moved = [0.0] * 3
        self._means: deque[tuple[float, float]] = deque(maxlen=_SCATTER[1])

    def notice(self, change: Change) -> None:
        """The detector says that a stop has begun or ended."""
        if change.stopped:
            self._stops.append([change.stamp_ns + _ARRIVAL_NS, _NEVER_NS])
        elif self._stops:
            self._stops[-1][1] = change.stamp_ns - _MARGIN_NS

    def call(self, stamp_ns: int) -> None:
        """A ZUPT service was called; what the stop shows is taken where the policy says so."""
        if self._by_zupt:
            bisect.insort(self._calls, stamp_ns)

    def corrected(self, before: NavState, after: NavState) -> None:
        """The solution at the settled sample was: as if it had been so before."""
        self._turned += heading_change(before, after)
        for i in (0, 1, 2):
            self._way[i] += self._time * (after[4 + i] - before[4 + i])
            self._moved[i] += after[4 + i] - before[4 + i]

    def add(
        self,
        stamp_ns: int,
        before: Sample,
        raw: Sample,
        state: NavState,
        biases: tuple[Triple, Triple],
        speed_stddev: float,
    ) -> list[tuple[str, Make]]:
        """Take a settled sample; measurements with their names.

        Parameters
        ----------
        stamp_ns : int
        before, raw : Sample
            The one before and this, biases left in.
        state : NavState
            Solution at the stamp.
        biases : two times 3 floats
            In use, of gyros and accelerometers.
        speed_stddev : float
            Of the solution, m/s.
        """
        if not self._wanted:
            return []
        while len(self._stops) > 1 and self._stops[0][1] < stamp_ns:
            self._stops.pop(0)
        if not any(begin < stamp_ns <= end for begin, end in self._stops):
            return self._end(stamp_ns)
        if self._segment is None:
            self._called(stamp_ns)
            self._begin_segment(state, biases)
            return []
        gyro, accel = self._segment_biases
        self._segment.add(without(before, gyro, accel), without(raw, gyro, accel), self._instantaneous)
        h = raw[0]
        self._time += h
        for i in (0, 1, 2):
            self._way[i] += h * state[4 + i]
        if self._time < _HOLD * (1.0 - 1e-6):
            return []
        x, y = self._way[0] / self._time, self._way[1] / self._time
        if self._doubted(math.hypot(x, y), speed_stddev, stamp_ns):
            return []
        found: list[tuple[str, Make]] = []
        called = self._called(stamp_ns)
        if called or not self._by_zupt:
            found.append(self._hold())
        self._time, self._way = 0.0, [0.0] * 3
        if called or (not self._by_zupt and self._segment.duration >= _SEGMENT):
            found += self._end_segment(stamp_ns)
            self._segment = None  # the next sample begins another
        return found

    def _end(self, stamp_ns: int) -> list[tuple[str, Make]]:
        """The sample is the first after a stop, or a later one."""
        found: list[tuple[str, Make]] = []
        if self._segment is not None:
            # a call made before it was seen that the stop has ended
            called = self._called(stamp_ns + SETTLE_NS)
            if called and self._time >= 0.5 * _HOLD:
                found.append(self._hold())
            if called or not self._by_zupt:
                found += self._end_segment(stamp_ns)
            self._leave()
        return found

    def _doubted(self, speed: float, stddev: float, stamp_ns: int) -> bool:
        """Whether the stop is none, by the speed of the solution: even motion looks like rest. Then it is forgotten."""
        if speed <= DOUBT_SPEED + DOUBT_SIGMAS * stddev:
            return False
        text = f"stop: the IMU seems to rest, but the solution moves at {speed:.1f} m/s: taken for even motion"
        self._events.count("stops doubted", INFO, text, stamp_ns)
        self._stops[0][1] = stamp_ns
        self._leave()
        return True

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

        def make(solution: Solution) -> Measurement:
            mean = solution._replace(state=solution.state._replace(v_x=x, v_y=y, v_z=z))
            return ZeroVelocity().measure(mean, stddev)

        return "zero velocity", make

    def _sway(self) -> float:
        """Sigma of a mean velocity, m/s: the scatter of those of this stop, as if nothing had been corrected."""
        count = len(self._means)
        if count < _SCATTER[0]:
            return self._stddev
        parabola = np.vander(np.linspace(-1.0, 1.0, count), 3)
        _, squares, *_ = np.linalg.lstsq(parabola, np.array(self._means), rcond=None)
        return min(self._stddev, max(_LEAST_SWAY, math.sqrt(float(np.sum(squares)) / (2 * (count - 3)))))

    def _begin_segment(self, state: NavState, biases: tuple[Triple, Triple]) -> None:
        self._segment = StationaryRates(state)
        self._segment_biases = biases
        self._turned = 0.0

    def _end_segment(self, stamp_ns: int) -> list[tuple[str, Make]]:
        """What a time of rest has shown of drift: about the vertical, or where ZUPT was called, about all axes."""
        segment, turned, (bias, _) = self._segment, self._turned, self._segment_biases
        if segment is None or segment.duration < _LEAST_SEGMENT:
            return []
        try:
            result = segment.result(0.0 if not self._by_zupt else self._accel_stddev)
        except ZuptError as error:
            self._events.count("stops not measured", INFO, f"stop: {error}", stamp_ns)
            return []
        seen = result.measurement  # on the axes at its beginning: what heading was corrected by since is no error now
        seen = replace(seen, rate=seen.rate - [seen.horizontal_rate * turned, 0.0, 0.0])
        return [("rest", lambda solution: ResidualRate(vertical=not self._by_zupt).measure(solution, seen, bias))]
