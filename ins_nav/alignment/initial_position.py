"""Where alignment takes place: as parameters say, by a satellite fix, or as it was remembered."""

import math
from typing import NamedTuple

from ins_nav.config.sections import InitialSection
from ins_nav.config.state_file import Pose
from ins_nav.estimation.error_model import Vector
from ins_nav.event_log import WARN, EventLog

_ANY_HEIGHT = 1e3
"""m: sigma of a height that nobody knows."""
_REMEMBERED = 10.0
"""m: least sigma of a place that is only remembered."""


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
    """

    def __init__(
        self,
        initial: InitialSection,
        last: Pose | None,
        events: EventLog,
    ) -> None:
        self._initial = initial
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

    def observe(self, place: Place, topic: str, stamp_ns: int) -> None:
        """A place that an aid measures while aligning: the first is used, unless parameters give one.

        Parameters
        ----------
        place : Place
            Its height is NaN where it is not measured.
        topic : str
            Of the aid.
        stamp_ns : int
        """
        if not self._wanted:
            return
        self._wanted = False
        if math.isnan(place.height):
            self._events.count("no height", WARN, f"{topic}: altitude is not a number, 0 m is used", stamp_ns)
            place = place._replace(height=0.0, stddev=(*place.stddev[:2], _ANY_HEIGHT))
        self._known = place

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
