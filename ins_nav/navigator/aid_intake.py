"""What aids say on its way to the filter: checked, one stamp after the other, none of them lost without a word."""

import heapq
import itertools
import math
from collections.abc import Sequence

from ins_nav.aiding import aids
from ins_nav.aiding.aids import Aid, BeaconFix, Observation
from ins_nav.alignment.initial_position import is_place
from ins_nav.event_log import INFO, WARN
from ins_nav.mechanization.replay_buffer import LENGTH_NS
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.zupt.stop_records import Triple

_AHEAD_NS = 5_000_000_000
"""ns: a stamp further ahead of the IMU's is of another clock."""
_LOST = -32.768
"""m/s: of a log in PD0, on an axis without bottom."""
_LATE = 30.0
"""s by which a beacon's fix may be late, and nothing is wrong."""
_USELESS = 300.0
"""m, one sigma of a beacon's way since its fix, that leave nothing of what it says."""


class AidIntake(RealtimeNavigator):
    """A navigator that takes the messages of aids; what is done with them is the matter of `ins_nav.navigator.delayed`.

    Attributes
    ----------
    settled_ns : int
        Up to here the filter has come: what is stamped so is too late; 0 before it has begun.
    heard : set of str
        Aids of which something has come since alignment began.
    """

    def _begin(self) -> None:
        self._max_log_speed = float(self.configuration.values["log.max_speed"])  # type: ignore[arg-type]
        self._aids: dict[str, Aid] = aids.make(self.configuration.values)
        self._queue: list[Observation] = []
        self._count = itertools.count()
        self._beacon_fixes: dict[str, Observation] = {}
        self._told_places: dict[str, tuple[Triple, bool]] = {}
        super()._begin()

    def _align(self) -> None:
        super()._align()
        self.settled_ns = self._began_ns = 0
        self.heard: set[str] = set()
        for aid in self._aids.values():
            if isinstance(aid, BeaconFix):
                aid.beacon.restart()

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
            As in `RealtimeNavigator.add_fix`.
        covariance : sequence of float
            East, north, up, row by row, m²; empty: not given.
        """
        super().add_fix(stamp_ns, status, latitude_deg, longitude_deg, height, covariance)
        place = math.radians(latitude_deg), math.radians(longitude_deg), height if math.isfinite(height) else math.nan
        if status < 0 or not is_place(latitude_deg, longitude_deg, height):
            return  # told already
        self._observe(aids.GNSS, stamp_ns, place, covariance, 3)

    def add_gnss_velocity(self, stamp_ns: int, velocity: Triple, covariance: Sequence[float] = ()) -> None:
        """Take a velocity on east, north, up, m/s (up may be NaN); covariance row by row, m²/s², or empty."""
        if all(map(math.isfinite, velocity[:2])):
            self._observe(aids.GNSS_VELOCITY, stamp_ns, velocity, covariance, 3)
        else:
            self._unusable(aids.GNSS_VELOCITY, stamp_ns, velocity)

    def add_log(self, stamp_ns: int, velocity: Triple, covariance: Sequence[float] = ()) -> None:
        """Take a velocity on the log's axes, m/s, NaN for an axis not measured; covariance row by row, or empty.

        What logs say that have lost the bottom is left out: -32.768 (format PD0), or exact zeros forward and across.
        """
        velocity = tuple(math.nan if abs(x - _LOST) < 1e-6 else x for x in velocity)  # type: ignore[assignment]
        known = [abs(x) for x in velocity if math.isfinite(x)]
        if known and velocity[:2] != (0.0, 0.0) and max(known) <= self._max_log_speed:
            self._observe(aids.LOG, stamp_ns, velocity, covariance, 3)
        else:
            self._unusable(aids.LOG, stamp_ns, velocity)

    def add_depth(self, stamp_ns: int, depth: float, variance: float = 0.0) -> None:
        """Take a depth, m, down positive, and its variance, m²; 0: not given."""
        if math.isfinite(depth):
            self._observe(aids.DEPTH, stamp_ns, (depth,), (variance,), 1)
        else:
            self._unusable(aids.DEPTH, stamp_ns, (depth,))

    def add_pressure(self, stamp_ns: int, pressure: float, variance: float = 0.0) -> None:
        """Take an absolute pressure under water, Pa, and its variance, Pa²; 0: not given."""
        if math.isfinite(pressure) and pressure > 0.0:
            self._observe(aids.PRESSURE, stamp_ns, (pressure,), (variance,), 1)
        else:
            self._unusable(aids.PRESSURE, stamp_ns, (pressure,))

    def add_range(
        self,
        stamp_ns: int,
        beacon: str,
        distance: float,
        variance: float = 0.0,
        limits: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        """Take a slant range to a beacon, m, its variance, m² (0: not given), and least and greatest range."""
        name = aids.range_name(beacon)
        aid = self._aids.get(name)
        if math.isfinite(distance) and distance > 0.0 and limits[0] <= distance <= limits[1]:
            if isinstance(aid, aids.Range) and aid.two_way:
                stamp_ns -= round(1e9 * aid.travel_time(distance))  # its half
            self._observe(name, stamp_ns, (distance,), (variance,), 1)
        else:
            self._unusable(name, stamp_ns, (distance,))

    def add_beacon_fix(
        self,
        stamp_ns: int,
        beacon: str,
        status: int,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        covariance: Sequence[float] = (),
    ) -> None:
        """Take a fix of a beacon that floats, as in `RealtimeNavigator.add_fix`.

        Of one that has moved before, the same place once more is no news, whatever its stamp.
        """
        name = aids.fix_name(beacon)
        place = math.radians(latitude_deg), math.radians(longitude_deg), height
        if not (status >= 0 and math.isfinite(height) and is_place(latitude_deg, longitude_deg, height)):
            self._unusable(name, stamp_ns, place)
            return
        last, moves = self._told_places.get(name, (place, False))
        if moves and place == last:
            text = f"{aids.topic(name)}: the place told before, under a new stamp: left out"
            self.events.count(f"{name} repeated", INFO, text, stamp_ns)
            return
        self._told_places[name] = place, moves or place != last
        self._observe(name, stamp_ns, place, covariance, 3)

    def _unusable(self, name: str, stamp_ns: int, value: tuple[float, ...]) -> None:
        self.heard.add(name)
        text = f"{aids.topic(name)}: {value} says nothing, left out"
        self.events.count(f"{name} unusable", INFO, text, stamp_ns)

    def _observe(
        self, name: str, stamp_ns: int, value: tuple[float, ...], covariance: Sequence[float], size: int
    ) -> None:
        aid = self._aids.get(name)
        if aid is None or (self.stamp_ns == 0 and not isinstance(aid, BeaconFix)):
            return
        self.heard.add(name)
        stamp_ns -= aid.settings.delay_ns
        if stamp_ns <= self.settled_ns and not self._is_of_use(name, aid, stamp_ns):
            return
        if self.stamp_ns and stamp_ns - self.stamp_ns > _AHEAD_NS:
            ahead = (stamp_ns - self.stamp_ns) * 1e-9
            self.events.count(
                f"{name} ahead",
                WARN,
                f"{aids.topic(name)}: {ahead:.1f} s ahead of imu/data_raw, left out: both must be stamped by one clock",
                self.stamp_ns,
            )
            return
        missing = [i for i, x in enumerate(value) if not math.isfinite(x)]
        used = aid.settings.covariance(covariance, size, missing)
        seen = Observation(stamp_ns, name, value, next(self._count), used)
        if isinstance(aid, BeaconFix):
            self._beacon_fixes[name] = max(seen, self._beacon_fixes.get(name, seen))
            if self.stamp_ns == 0:
                return
        heapq.heappush(self._queue, seen)
        if not self.settled_ns:  # the filter will begin later
            self._forget(self.stamp_ns - LENGTH_NS)

    def _is_of_use(self, name: str, aid: Aid, stamp_ns: int) -> bool:
        """Whether an observation of before the filter's state is; of where a beacon was, unless that is long ago."""
        late = (self.stamp_ns - stamp_ns) * 1e-9
        text, level = f"{aids.topic(name)}: {late:.2f} s behind imu/data_raw, ", WARN
        if isinstance(aid, BeaconFix):
            of_use = name not in self._beacon_fixes or aid.beacon.way_stddev(late) < _USELESS
            if of_use and late < _LATE:
                level = INFO
            text += "taken for where the beacon was then" if of_use else "left out: check its clock"
        else:
            of_use = False
            text += "left out: raise aiding.max_delay, or check its clock"
        if stamp_ns > self._began_ns or (level == WARN and isinstance(aid, BeaconFix)):
            self.events.count(f"{name} late", level, text, self.stamp_ns)
        return of_use

    def _forget(self, until_ns: int) -> None:
        """Observations up to a stamp are of no use."""
        while self._queue and self._queue[0].stamp_ns <= until_ns:
            heapq.heappop(self._queue)

    def _recall(self) -> None:
        """Let the filter, which begins now, take where each beacon was last."""
        for seen in self._beacon_fixes.values():
            if seen.stamp_ns <= self.settled_ns:  # the others are in the queue
                heapq.heappush(self._queue, seen)
