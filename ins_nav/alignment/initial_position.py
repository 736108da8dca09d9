"""Where alignment takes place: as parameters say, by a satellite fix, or as it was remembered."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ins_nav.config.sections import InitialSection
from ins_nav.config.state_file import Pose
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.event_log import INFO, WARN, EventLog

_HEIGHTS = -12e3, 1e5
"""m, ellipsoidal: no vehicle is elsewhere."""
_ANY_HEIGHT = 1e3
"""m: sigma of a height that nobody knows."""
_REMEMBERED = 10.0
"""m: least sigma of a place that is only remembered."""


def is_place(latitude_deg: float, longitude_deg: float, height: float) -> bool:
    """Whether a fix can be one; its height, m, need not be known."""
    known = math.isfinite(latitude_deg) and math.isfinite(longitude_deg) and abs(latitude_deg) <= 90.0
    return known and (not math.isfinite(height) or _HEIGHTS[0] <= height <= _HEIGHTS[1])


class Place(NamedTuple):
    """A place with its uncertainty."""

    lat: float
    lon: float
    """rad."""
    height: float
    """Ellipsoidal, m."""
    stddev: Vector
    """Two horizontal axes and up, m."""
    lever_arm: Vector = (0.0, 0.0, 0.0)
    """From the IMU to what is there, base_link's axes, m."""


class InitialPosition:
    """The place of alignment.

    Parameters
    ----------
    initial : InitialSection
    last : Pose or None
        What is remembered of the last start.
    events : EventLog
    fix_covariance : callable
        Covariance to use, shape (3, 3), m², from that of a fix, its size, and the axes not measured.
    lever_arm : 3 floats
        From the IMU to the antenna, base_link's axes, m.
    """

    def __init__(
        self,
        initial: InitialSection,
        last: Pose | None,
        events: EventLog,
        fix_covariance: Callable[[Sequence[float], int, Sequence[int]], Array],
        lever_arm: Vector,
    ) -> None:
        self._initial = initial
        self._fix_covariance = fix_covariance
        self._lever_arm = lever_arm
        self._last = last
        self._events = events
        self.begin()

    def begin(self) -> None:
        """Before the first sample, and after a restart: what the parameters say."""
        given = self._initial
        place = Place(given.latitude, given.longitude, given.height, (given.position_stddev,) * 3)
        self._known = None if math.isnan(given.latitude) else place
        self._wanted = self._known is None

    def put(self, place: Place) -> None:
        """It is here, by another account."""
        self._known = place

    def renew(self) -> None:
        """It may have moved: a newer fix is better."""
        self._wanted = True

    def take_fix(
        self,
        stamp_ns: int,
        status: int,
        latitude_deg: float,
        longitude_deg: float,
        height: float,
        covariance: Sequence[float],
        aligning: bool,
    ) -> None:
        """A satellite fix as in `RealtimeNavigator.add_fix`: the first while aligning, unless parameters give one."""
        if status < 0:
            self._events.count("no fix", INFO, "gnss/fix: no fix (status < 0)", stamp_ns)
            return
        if not is_place(latitude_deg, longitude_deg, height):
            self._events.count(
                "invalid fixes",
                WARN,
                f"gnss/fix: position ({latitude_deg}, {longitude_deg}, {height}) rejected: a receiver "
                "without a fix must say so by status -1",
                stamp_ns,
            )
            return
        if not (aligning and self._wanted):
            return
        self._wanted = False
        missing = [] if math.isfinite(height) else [2]
        east, north, up = np.sqrt(self._fix_covariance(covariance, 3, missing).diagonal()).tolist()
        if missing:
            self._events.count("no height", WARN, "gnss/fix: altitude is not a number, taken as 0 m", stamp_ns)
            height, up = 0.0, _ANY_HEIGHT
        stddev = (max(east, north), max(east, north), up)
        lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
        self._known = Place(lat, lon, height, stddev, self._lever_arm)

    def found(self, stamp_ns: int) -> Place | None:
        """The place, at the end of alignment; None, and told, where nobody knows."""
        if self._known is None and self._last is not None:
            last, stddev = self._last, max(_REMEMBERED, self._last.position_stddev)
            lat, lon = math.radians(last.latitude_deg), math.radians(last.longitude_deg)
            self._known = Place(lat, lon, last.height, (stddev,) * 3)
            self._events.report(WARN, "no gnss/fix by the end of alignment: taken to be where state_file was saved")
        if self._known is None:
            self._events.count(
                "waiting for position",
                WARN,
                "alignment has its data but no position: publish gnss/fix or set "
                "initial.latitude_deg, initial.longitude_deg and initial.height",
                stamp_ns,
            )
        return self._known
