"""Messages of sensors from plain numbers: what a driver would publish."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ins_nav.recordings.bags import header, message, typestore

UNKNOWN = 1e9
"""Variance of what a message has room for and the sensor does not measure."""
_DIAGONAL_KNOWN, _COVARIANCE_UNKNOWN = 2, 0


def nav_sat_fix(
    stamp_ns: int,
    status: int,
    latitude_deg: float,
    longitude_deg: float,
    height: float,
    covariance: Sequence[float] = (),
    frame_id: str = "gnss_link",
) -> Any:
    """sensor_msgs/NavSatFix; covariance on east, north, up, row by row, m², empty: unknown."""
    return typestore().types["sensor_msgs/msg/NavSatFix"](
        header(stamp_ns, frame_id),
        _status(status),
        latitude_deg,
        longitude_deg,
        height,
        np.array(covariance, float) if len(covariance) else np.zeros(9),
        _DIAGONAL_KNOWN if len(covariance) else _COVARIANCE_UNKNOWN,
    )


@functools.cache
def _status(status: int) -> Any:
    return message("sensor_msgs/msg/NavSatStatus", status=status, service=1)


def twist(
    stamp_ns: int, velocity: Sequence[float], covariance: Sequence[float] = (), frame_id: str = "log_link"
) -> Any:
    """geometry_msgs/TwistWithCovarianceStamped of a velocity, m/s, covariance row by row, m²/s², empty: zeros."""
    types = typestore().types
    matrix = np.diag([UNKNOWN] * 6)
    matrix[:3, :3] = np.reshape(covariance, (3, 3)) if len(covariance) else 0.0
    vector = types["geometry_msgs/msg/Vector3"]
    content = types["geometry_msgs/msg/Twist"](vector(*velocity), vector(0.0, 0.0, 0.0))
    with_covariance = types["geometry_msgs/msg/TwistWithCovariance"](content, matrix.ravel())
    return types["geometry_msgs/msg/TwistWithCovarianceStamped"](header(stamp_ns, frame_id), with_covariance)


def depth_pose(stamp_ns: int, depth: float, variance: float = 0.0) -> Any:
    """geometry_msgs/PoseWithCovarianceStamped of a depth, m, down positive, and its variance, m²; 0: unknown."""
    msg = message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(stamp_ns, "water_surface"))
    msg.pose.pose.position.z = -depth
    msg.pose.pose.orientation.w = 1.0
    msg.pose.covariance = np.diag([UNKNOWN, UNKNOWN, variance, UNKNOWN, UNKNOWN, UNKNOWN]).ravel()
    return msg


def fluid_pressure(stamp_ns: int, pressure: float, variance: float = 0.0) -> Any:
    """sensor_msgs/FluidPressure, Pa and Pa²; 0: unknown."""
    return typestore().types["sensor_msgs/msg/FluidPressure"](header(stamp_ns, "pressure_link"), pressure, variance)


def acoustic_range(
    stamp_ns: int, distance: float, variance: float = 0.0, limits: tuple[float, float] = (0.0, math.inf)
) -> Any:
    """sensor_msgs/Range of an acoustic range, m, its variance, m², 0: unknown, and least and greatest range."""
    return message(
        "sensor_msgs/msg/Range",
        header=header(stamp_ns, "range_link"),
        radiation_type=0,  # ULTRASOUND
        field_of_view=2.0 * math.pi,
        min_range=limits[0],
        max_range=limits[1],
        range=distance,
        variance=variance,
    )
