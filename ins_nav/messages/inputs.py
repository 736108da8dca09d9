"""Messages of the IMU as plain numbers; those of aids are read by the aids (`ins_nav.aiding`)."""

from typing import Any

from ins_nav.stamps import stamp_of


def read_imu(message: Any) -> tuple[int, float, float, float, float, float, float]:
    """Stamp, ns, angular velocity, rad/s, and specific force, m/s², of a sensor_msgs/Imu."""
    rate, force = message.angular_velocity, message.linear_acceleration
    return stamp_of(message), rate.x, rate.y, rate.z, force.x, force.y, force.z
