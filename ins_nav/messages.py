"""A navigator's solution as standard ROS messages.

Works on any object with the fields of the message: those of rclpy and those of `ins_nav.bags` alike, so that the
live node and `ins_process` publish the same. Messages are filled in place: making them afresh would be most of the
cost of a tick.
"""

import math
from typing import Any

from ins_nav import strapdown
from ins_nav.health import ERROR, INFO, Health
from ins_nav.navigator import Navigator, Phase

_NS = 1_000_000_000
SILENCE = 2.0
"""s without a message on imu/data_raw that is an error: 20 intervals of the slowest IMU."""
_BIAS_UNIT = math.degrees(1.0) * 3600.0


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Header stamp from ns since the epoch."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, _NS)


def stamp_of(message: Any) -> int:
    """Header stamp as ns since the epoch."""
    stamp = message.header.stamp
    return stamp.sec * _NS + stamp.nanosec


def _set_vector(vector: Any, values: tuple[float, ...]) -> None:
    vector.x, vector.y, vector.z = values


def _set_quaternion(quaternion: Any, values: tuple[float, ...]) -> None:
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = values


def feed_imu(navigator: Navigator, message: Any) -> bool:
    """Give a sensor_msgs/Imu to the navigator; True when there is a new solution."""
    rate, force = message.angular_velocity, message.linear_acceleration
    return navigator.add_imu(stamp_of(message), rate.x, rate.y, rate.z, force.x, force.y, force.z)


def feed_fix(navigator: Navigator, message: Any) -> None:
    """Give a sensor_msgs/NavSatFix to the navigator."""
    navigator.add_fix(stamp_of(message), message.status.status, message.latitude, message.longitude, message.altitude)


class SolutionMessages:
    """Odometry, Imu and NavSatFix of the navigator's present solution, at the rate of ``publish.rate``.

    Parameters
    ----------
    odometry, imu, fix : messages
        nav_msgs/Odometry, sensor_msgs/Imu and sensor_msgs/NavSatFix, reused at every call.
    navigator : Navigator

    Attributes
    ----------
    first : bool
        Whether the solution that is `due` is the first after an alignment or a ZUPT.
    """

    def __init__(self, odometry: Any, imu: Any, fix: Any, navigator: Navigator) -> None:
        self.odometry = odometry
        self.imu = imu
        self.fix = fix
        self.first = False
        self._navigator = navigator
        self._changes = 0
        rate = float(navigator.parameters["publish.rate"])  # type: ignore[arg-type]
        self._period_ns = round(_NS / rate) if rate else 0
        self._next_ns = 0
        base_link = str(navigator.parameters["base_link_frame"])
        odometry.header.frame_id = str(navigator.parameters["map_frame"])
        odometry.child_frame_id = base_link
        imu.header.frame_id = base_link
        fix.header.frame_id = base_link
        fix.status.status = 0  # STATUS_FIX
        fix.status.service = 0  # SERVICE_UNKNOWN: it is inertial

    def due(self) -> bool:
        """Whether the navigator's new solution is to be published; call it once for each."""
        self.first = self._navigator.changes != self._changes
        if self.first:
            self._changes = self._navigator.changes
            self._next_ns = 0
        stamp_ns = self._navigator.stamp_ns
        if stamp_ns < self._next_ns:
            return False
        self._next_ns = max((self._next_ns or stamp_ns) + self._period_ns, stamp_ns + 1)
        return True

    def fill(self) -> None:
        """Fill in the present solution; the navigator must be navigating."""
        navigator = self._navigator
        state, frame = navigator.state, navigator.map
        assert state is not None and frame is not None
        if self.first:
            self._fill_covariances()
        where = strapdown.geodetic(state)
        rate = navigator.angular_velocity
        earth = strapdown.earth_rate_body(state)
        for message in (self.odometry, self.imu, self.fix):
            set_stamp(message, navigator.stamp_ns)
        pose, twist = self.odometry.pose.pose, self.odometry.twist.twist
        _set_vector(pose.position, frame.position(state))
        _set_quaternion(pose.orientation, frame.attitude(state))
        _set_vector(twist.linear, strapdown.velocity_body(state))
        _set_vector(twist.angular, (rate[0] - earth[0], rate[1] - earth[1], rate[2] - earth[2]))
        _set_quaternion(self.imu.orientation, where.q_gb)
        _set_vector(self.imu.angular_velocity, rate)
        _set_vector(self.imu.linear_acceleration, navigator.specific_force)
        self.fix.latitude = math.degrees(where.lat)
        self.fix.longitude = math.degrees(where.lon)
        self.fix.altitude = where.height

    def _fill_covariances(self) -> None:
        """Attitude as the alignment or a ZUPT left it; position and velocity stay zero, which in ROS means unknown."""
        attitude = self._navigator.attitude_covariance
        self.imu.orientation_covariance[:] = attitude.ravel()
        pose = self.odometry.pose.covariance
        for i in range(3):
            for j in range(3):
                pose[6 * (i + 3) + j + 3] = attitude[i, j]


def fill_bias(message: Any, navigator: Navigator, base_link_frame: str) -> None:
    """The biases in use with their covariances, in a sensor_msgs/Imu (no orientation: covariance[0] is -1)."""
    set_stamp(message, navigator.stamp_ns)
    message.header.frame_id = base_link_frame
    message.orientation_covariance[0] = -1.0
    _set_vector(message.angular_velocity, navigator.gyro_bias)
    _set_vector(message.linear_acceleration, navigator.accel_bias)
    message.angular_velocity_covariance[:] = navigator.gyro_bias_covariance.ravel()
    for i in range(3):
        message.linear_acceleration_covariance[4 * i] = navigator.accel_bias_stddev**2


def silence(seconds: float) -> str:
    """What to say when imu/data_raw has been silent for so many seconds."""
    return f"no messages on imu/data_raw for {seconds:.0f} s: is the driver running?"


def diagnostics(navigator: Navigator, silent_for: float = 0.0) -> tuple[int, str, dict[str, str]]:
    """Level (0 OK, 1 warning, 2 error), one line, and the values of a diagnostic status.

    Parameters
    ----------
    navigator : Navigator
    silent_for : float
        Time since the last message on imu/data_raw, s, where that is known.
    """
    stream, health = navigator.stream, navigator.health
    values = {
        "phase": navigator.phase.value,
        "alignment progress": f"{100.0 * navigator.progress:.0f} %",
        "imu/data_raw received": str(stream.received),
        "imu/data_raw integrated": str(stream.accepted),
        "imu/data_raw rate": "unknown" if math.isnan(stream.nominal) else f"{1.0 / stream.nominal:.1f} Hz",
        "gyro bias": " ".join(f"{x * _BIAS_UNIT:.4f}" for x in navigator.gyro_bias) + " deg/h",
        "accelerometer bias": " ".join(f"{x:.5f}" for x in navigator.accel_bias) + " m/s^2",
    }
    if navigator.phase is Phase.NAVIGATING:
        sigma = [math.degrees(math.sqrt(navigator.attitude_covariance[i, i])) for i in range(3)]
        stops = navigator.stops
        values |= {
            "level sigma at the last alignment or ZUPT": f"{max(sigma[:2]):.5f} deg",
            "heading sigma at the last alignment or ZUPT": f"{sigma[2]:.4f} deg",
            "stopped": str(stops.detector.stopped).lower(),
            "stops with zero velocity": str(stops.held),
            "velocity error at the last stop": f"{stops.velocity_error:.3f} m/s",
            "stops doubted": str(stops.doubted),
            "ZUPT calibrations": str(stops.calibrations),
        }
    values |= {kind: str(count) for kind, count in health.counts.items()}
    level, text = _summary(navigator, health, silent_for)
    return level, text, values


def _summary(navigator: Navigator, health: Health, silent_for: float) -> tuple[int, str]:
    if navigator.stream.received == 0:
        return 1, "no messages on imu/data_raw yet"
    if navigator.stream.accepted == 0:
        return 2, "every message on imu/data_raw was rejected: see the counts"
    if silent_for >= SILENCE:
        return 2, silence(silent_for)
    recent = [report for report in health.recent(navigator.stamp_ns) if report.level != INFO]
    if recent:
        level = 2 if any(report.level == ERROR for report in recent) else 1
        return level, f"{navigator.phase.value}; {recent[-1].text}"
    return 0, navigator.phase.value
