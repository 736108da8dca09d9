"""Messages of the IMU, as plain numbers for a navigator; those of aids are read by the aids (`ins_nav.aiding`)."""

from typing import Any

from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.stamps import stamp_of


def feed_imu(navigator: RealtimeNavigator, message: Any) -> bool:
    """Give a sensor_msgs/Imu to the navigator; True when there is a new solution."""
    rate, force = message.angular_velocity, message.linear_acceleration
    return navigator.add_imu(stamp_of(message), rate.x, rate.y, rate.z, force.x, force.y, force.z)
