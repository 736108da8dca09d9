"""Position of alignment: by parameters, by a GNSS fix, or from the state file."""

import math
from typing import NamedTuple

from ins_nav.config.sections import InitialSection
from ins_nav.config.state_file import Pose
from ins_nav.estimation.error_model import Vector
from ins_nav.event_log import WARN, EventLog

_ANY_HEIGHT = 1e3
"""m: sigma of an unknown height."""
_REMEMBERED = 10.0
"""m: least sigma of a position from the state file."""


class Place(NamedTuple):
    """A position with its sigmas."""

    lat: float
    lon: float
    """rad."""
    height: float
    """Ellipsoidal, m."""
    stddev: Vector
    """Two horizontal axes and up, m."""
    lever_arm: Vector = (0.0, 0.0, 0.0)
    """From the IMU to that position, base_link's axes, m."""


class InitialPosition:
    """The position of alignment.

    Parameters
    ----------
    initial : InitialSection
    last : Pose or None
        Last pose in the state file.
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
        """Before the first sample, and after a restart: return to the parameters."""
        given = self._initial
        place = Place(given.latitude, given.longitude, given.height, (given.position_stddev,) * 3)
        self._known = None if math.isnan(given.latitude) else place
        self._wanted = self._known is None

    def put(self, place: Place) -> None:
        """Set the position from another source."""
        self._known = place

    def renew(self) -> None:
        """Use the next fix: the base may have moved."""
        self._wanted = True

    def observe(self, place: Place, topic: str, stamp_ns: int) -> None:
        """A position that an aid measures during alignment: the first is used, unless parameters give one.

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
        """The position at the end of alignment; None, with a report, where it is unknown."""
        if self._known is None and self._last is not None:
            last, stddev = self._last, max(_REMEMBERED, self._last.position_stddev)
            lat, lon = math.radians(last.latitude_deg), math.radians(last.longitude_deg)
            self._known = Place(lat, lon, last.height, (stddev,) * 3)
            self._events.report(WARN, "no gnss/fix by the end of alignment: the position in state_file is used")
        if self._known is None:
            self._events.count(
                "waiting for position",
                WARN,
                "alignment has its data but no position: publish gnss/fix or set "
                "initial.latitude_deg, initial.longitude_deg and initial.height",
                stamp_ns,
            )
        return self._known
