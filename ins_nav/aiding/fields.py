"""Fields of messages that several aids read."""

import math
from typing import Any

from ins_nav.aiding.base import Reading, Unusable
from ins_nav.event_log import WARN
from ins_nav.stamps import stamp_of

_HEIGHTS = -12e3, 1e5
"""m, ellipsoidal: plausible heights."""


def read_fix(message: Any) -> Reading:
    """Latitude, longitude, rad, and ellipsoidal height, m, NaN where it is not finite, of a NavSatFix.

    Raises
    ------
    Unusable
        No fix, or an impossible position.
    """
    if message.status.status < 0:
        raise Unusable("no fix (status < 0)", "no fix")
    lat, lon, height = float(message.latitude), float(message.longitude), float(message.altitude)
    known = math.isfinite(lat) and math.isfinite(lon) and abs(lat) <= 90.0
    if not known or (math.isfinite(height) and not _HEIGHTS[0] <= height <= _HEIGHTS[1]):
        text = f"position ({lat}, {lon}, {height}) rejected: a receiver without a fix must publish status -1"
        raise Unusable(text, "invalid", WARN)
    covariance = tuple(map(float, message.position_covariance)) if message.position_covariance_type != 0 else ()
    place = math.radians(lat), math.radians(lon), height if math.isfinite(height) else math.nan
    return Reading(place, covariance, stamp_of(message))


def read_velocity(message: Any) -> Reading:
    """Linear velocity, m/s, of a TwistWithCovarianceStamped; unchecked."""
    linear, covariance = message.twist.twist.linear, message.twist.covariance
    rows = tuple(float(covariance[6 * i + j]) for i in range(3) for j in range(3))
    return Reading((float(linear.x), float(linear.y), float(linear.z)), rows, stamp_of(message))


def no_measurement(value: tuple[float, ...]) -> Unusable:
    """Error of a value that is no measurement."""
    return Unusable(f"{value} is no measurement: rejected")
