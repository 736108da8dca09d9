"""Messages of the IMU and of aids, as plain numbers for a navigator."""

import math
from collections.abc import Callable, Iterable
from typing import Any

from ins_nav.messages.stamps import stamp_of
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.realtime import RealtimeNavigator


def feed_imu(navigator: RealtimeNavigator, message: Any) -> bool:
    """Give a sensor_msgs/Imu to the navigator; True when there is a new solution."""
    rate, force = message.angular_velocity, message.linear_acceleration
    return navigator.add_imu(stamp_of(message), rate.x, rate.y, rate.z, force.x, force.y, force.z)


def feed_fix(navigator: RealtimeNavigator, message: Any) -> None:
    """Give a sensor_msgs/NavSatFix to the navigator."""
    known = message.position_covariance_type != 0
    navigator.add_fix(
        stamp_of(message),
        message.status.status,
        message.latitude,
        message.longitude,
        message.altitude,
        tuple(message.position_covariance) if known else (),
    )


def feed_gnss_velocity(navigator: DelayedNavigator, message: Any) -> None:
    """Give a geometry_msgs/TwistWithCovarianceStamped, east, north, up, to the filter."""
    navigator.add_gnss_velocity(stamp_of(message), *_twist(message))


def feed_log(navigator: DelayedNavigator, message: Any) -> None:
    """Give a geometry_msgs/TwistWithCovarianceStamped on the log's axes to the filter."""
    navigator.add_log(stamp_of(message), *_twist(message))


def feed_depth(navigator: DelayedNavigator, message: Any) -> None:
    """Give a geometry_msgs/PoseWithCovarianceStamped (``position.z = -depth``) to the filter."""
    pose = message.pose
    navigator.add_depth(stamp_of(message), -pose.pose.position.z, float(pose.covariance[14]))


def feed_pressure(navigator: DelayedNavigator, message: Any) -> None:
    """Give a sensor_msgs/FluidPressure to the filter."""
    navigator.add_pressure(stamp_of(message), message.fluid_pressure, message.variance)


def feed_range(navigator: DelayedNavigator, beacon: str, message: Any) -> None:
    """Give a sensor_msgs/Range to a beacon to the filter."""
    limits = float(message.min_range), float(message.max_range)
    if not limits[0] < limits[1]:  # not filled in
        limits = 0.0, math.inf
    navigator.add_range(stamp_of(message), beacon, float(message.range), float(message.variance), limits)


def feed_beacon_fix(navigator: DelayedNavigator, beacon: str, message: Any) -> None:
    """Give a sensor_msgs/NavSatFix of a beacon that floats to the filter."""
    known = message.position_covariance_type != 0
    navigator.add_beacon_fix(
        stamp_of(message),
        beacon,
        message.status.status,
        message.latitude,
        message.longitude,
        message.altitude,
        tuple(message.position_covariance) if known else (),
    )


Feed = Callable[[DelayedNavigator, Any], object]
_STAMPED = "WithCovarianceStamped"
AIDS: dict[str, tuple[str, Feed]] = {
    "gnss/fix": ("sensor_msgs/msg/NavSatFix", feed_fix),
    "gnss/velocity": (f"geometry_msgs/msg/Twist{_STAMPED}", feed_gnss_velocity),
    "log": (f"geometry_msgs/msg/Twist{_STAMPED}", feed_log),
    "depth": (f"geometry_msgs/msg/Pose{_STAMPED}", feed_depth),
    "pressure": ("sensor_msgs/msg/FluidPressure", feed_pressure),
}
"""Topics of aids, but for those of beacons: types, and what gives a message to the filter."""


def aid_topics(beacons: Iterable[str]) -> dict[str, tuple[str, Feed]]:
    """The same with those of beacons."""
    every = dict(AIDS)
    for beacon in beacons:
        every[f"range/{beacon}"] = "sensor_msgs/msg/Range", _of(feed_range, beacon)
        every[f"beacon/{beacon}/fix"] = "sensor_msgs/msg/NavSatFix", _of(feed_beacon_fix, beacon)
    return every


def _of(feed: Callable[[DelayedNavigator, str, Any], None], beacon: str) -> Feed:
    return lambda navigator, message: feed(navigator, beacon, message)


def _twist(message: Any) -> tuple[tuple[float, float, float], tuple[float, ...]]:
    """Linear velocity and its covariance, row by row."""
    linear, covariance = message.twist.twist.linear, message.twist.covariance
    rows = tuple(float(covariance[6 * i + j]) for i in range(3) for j in range(3))
    return (linear.x, linear.y, linear.z), rows
