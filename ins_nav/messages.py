"""A navigator's solution as standard ROS messages.

Works on any object with the fields of the message: those of rclpy and those of `ins_nav.bags` alike, so that the
live node and `ins_process` publish the same. Messages are filled in place: making them afresh would be most of the
cost of a tick.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav import error_model, strapdown
from ins_nav.aided import AidedNavigator
from ins_nav.aids import BEACON
from ins_nav.attitude import conjugate, multiply
from ins_nav.feedback import Feedback
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
    known = message.position_covariance_type != 0
    navigator.add_fix(
        stamp_of(message),
        message.status.status,
        message.latitude,
        message.longitude,
        message.altitude,
        tuple(message.position_covariance) if known else (),
    )


def feed_gnss_velocity(navigator: AidedNavigator, message: Any) -> None:
    """Give a geometry_msgs/TwistWithCovarianceStamped, east, north, up, to the filter."""
    navigator.add_gnss_velocity(stamp_of(message), *_twist(message))


def feed_log(navigator: AidedNavigator, message: Any) -> None:
    """Give a geometry_msgs/TwistWithCovarianceStamped on the log's axes to the filter."""
    navigator.add_log(stamp_of(message), *_twist(message))


def feed_depth(navigator: AidedNavigator, message: Any) -> None:
    """Give a geometry_msgs/PoseWithCovarianceStamped (``position.z = -depth``) to the filter."""
    pose = message.pose
    navigator.add_depth(stamp_of(message), -pose.pose.position.z, float(pose.covariance[14]))


def feed_pressure(navigator: AidedNavigator, message: Any) -> None:
    """Give a sensor_msgs/FluidPressure to the filter."""
    navigator.add_pressure(stamp_of(message), message.fluid_pressure, message.variance)


def feed_range(navigator: AidedNavigator, beacon: str, message: Any) -> None:
    """Give a sensor_msgs/Range to a beacon to the filter."""
    limits = float(message.min_range), float(message.max_range)
    if not limits[0] < limits[1]:  # not filled in
        limits = 0.0, math.inf
    navigator.add_range(stamp_of(message), beacon, float(message.range), float(message.variance), limits)


def feed_beacon_fix(navigator: AidedNavigator, beacon: str, message: Any) -> None:
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


Feed = Callable[[AidedNavigator, Any], object]
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


def _of(feed: Callable[[AidedNavigator, str, Any], None], beacon: str) -> Feed:
    return lambda navigator, message: feed(navigator, beacon, message)


def _twist(message: Any) -> tuple[tuple[float, float, float], tuple[float, ...]]:
    """Linear velocity and its covariance, row by row."""
    linear, covariance = message.twist.twist.linear, message.twist.covariance
    rows = tuple(float(covariance[6 * i + j]) for i in range(3) for j in range(3))
    return (linear.x, linear.y, linear.z), rows


FEEDBACK = (
    ("stamp", 2),
    ("apply", 2),
    ("state", 12),
    ("gyro_bias", 3),
    ("accel_bias", 3),
    ("aligned", 1),
    ("covariance", 225),
)
"""Parts of a feedback message, with their sizes."""
_UNIT = 1e-6
"""Of a unit quaternion's length."""


def fill_feedback(message: Any, feedback: Feedback) -> None:
    """A std_msgs/Float64MultiArray of one row: stamps as s and ns, the state, biases, a flag, the covariance.

    One message, so that nothing of it can be lost alone; its layout names the parts.
    """
    message.data = [
        *(float(x) for x in divmod(feedback.stamp_ns, _NS)),
        *(float(x) for x in divmod(feedback.apply_ns, _NS)),
        *map(float, feedback.state),
        *feedback.gyro_bias,
        *feedback.accel_bias,
        float(feedback.aligned),
        *feedback.covariance.ravel().tolist(),
    ]


def read_feedback(message: Any) -> Feedback | None:
    """The same read; None where it is not one: sizes, numbers, unit quaternions, variances."""
    data = [float(x) for x in message.data]
    if len(data) != sum(size for _, size in FEEDBACK) or not all(map(math.isfinite, data)):
        return None
    parts, at = {}, 0
    for name, size in FEEDBACK:
        parts[name] = tuple(data[at : at + size])
        at += size
    state, covariance = parts["state"], np.array(parts["covariance"]).reshape(15, 15)
    off = max(abs(math.hypot(*q) - 1.0) for q in (state[0:4], state[7:11]))
    if off > _UNIT or covariance.diagonal().min() < 0.0:
        return None
    stamp, apply = (round(parts[name][0]) * _NS + round(parts[name][1]) for name in ("stamp", "apply"))
    return Feedback(
        stamp,
        apply,
        state,
        parts["gyro_bias"],  # type: ignore[arg-type]
        parts["accel_bias"],  # type: ignore[arg-type]
        covariance,
        parts["aligned"][0] != 0.0,
    )


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
        Whether the solution that is `due` is the first after an alignment, a ZUPT or a feedback.
    """

    def __init__(self, odometry: Any, imu: Any, fix: Any, navigator: Navigator) -> None:
        self.odometry = odometry
        self.imu = imu
        self.fix = fix
        self.first = False
        self._navigator = navigator
        self._changes = 0
        self._filled = -1
        self._began = (0, 0)
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
        fix.position_covariance_type = 3  # COVARIANCE_TYPE_KNOWN

    def due(self) -> bool:
        """Whether the navigator's new solution is to be published; call it once for each."""
        began = self._navigator.restarts, self._navigator.aligned_ns  # a recording that loops has the same stamps
        if began != self._began:
            self._began, self._next_ns = began, 0
        stamp_ns = self._navigator.stamp_ns
        if stamp_ns < self._next_ns:
            return False
        self.first = self._navigator.changes != self._changes
        self._changes = self._navigator.changes
        self._next_ns = max((self._next_ns or stamp_ns) + self._period_ns, stamp_ns + 1)
        return True

    def fill(self) -> None:
        """Fill in the present solution; the navigator must be navigating."""
        navigator = self._navigator
        state, frame = navigator.state, navigator.map
        assert state is not None and frame is not None
        if navigator.accuracy.count != self._filled:
            self._filled = navigator.accuracy.count
            self._fill_covariances(navigator.accuracy.covariance)
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

    def _fill_covariances(self, p: NDArray[np.float64]) -> None:
        """The covariance of the errors, each part on the axes of its message."""
        state, frame = self._navigator.state, self._navigator.map
        assert state is not None and frame is not None
        c, s = error_model.azimuth(state)
        to_g = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.imu.orientation_covariance[:] = (to_g @ p[6:9, 6:9] @ to_g.T).ravel()
        self.fix.position_covariance[:] = (to_g @ p[0:3, 0:3] @ to_g.T).ravel()
        q_mn = multiply(frame.attitude(state), conjugate(state[0:4]))  # type: ignore[arg-type]
        to_m = error_model.rotation_matrix(q_mn)
        parts = p[np.ix_([0, 1, 2, 6, 7, 8], [0, 1, 2, 6, 7, 8])]
        both = np.kron(np.eye(2), to_m)
        self.odometry.pose.covariance[:] = (both @ parts @ both.T).ravel()
        to_b = error_model.rotation_matrix(state[0:4]).T  # type: ignore[arg-type]
        twist = np.zeros((6, 6))
        twist[:3, :3] = to_b @ p[3:6, 3:6] @ to_b.T
        twist[3:, 3:] = p[9:12, 9:12]
        self.odometry.twist.covariance[:] = twist.ravel()
        self.imu.angular_velocity_covariance[:] = p[9:12, 9:12].ravel()
        self.imu.linear_acceleration_covariance[:] = p[12:15, 12:15].ravel()


def fill_bias(message: Any, navigator: Navigator, base_link_frame: str) -> None:
    """The biases in use with their covariances, in a sensor_msgs/Imu (no orientation: covariance[0] is -1)."""
    set_stamp(message, navigator.stamp_ns)
    message.header.frame_id = base_link_frame
    message.orientation_covariance[0] = -1.0
    _set_vector(message.angular_velocity, navigator.gyro_bias)
    _set_vector(message.linear_acceleration, navigator.accel_bias)
    message.angular_velocity_covariance[:] = navigator.gyro_bias_covariance.ravel()
    message.linear_acceleration_covariance[:] = navigator.accel_bias_covariance.ravel()


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
    if navigator.phase in (Phase.FINE, Phase.NAVIGATING):
        sigma = np.sqrt(navigator.accuracy.covariance.diagonal())
        stops = navigator.stops
        values |= _sigmas(sigma, sigma[8])
        values |= {
            "stopped": str(stops.detector.stopped).lower(),
            "stops with zero velocity": str(stops.held),
            "velocity error at the last stop": f"{stops.velocity_error:.3f} m/s",
            "stops doubted": str(stops.doubted),
            "ZUPT calibrations": str(stops.calibrations),
        }
    values |= {kind: str(count) for kind, count in health.counts.items()}
    level, text = _summary(navigator, health, silent_for)
    return level, text, values


def alignment_diagnostics(navigator: AidedNavigator, silent_for: float = 0.0) -> tuple[int, str, dict[str, str]]:
    """The same of the filter: its sigmas, progress of fine alignment, and every aid with its last innovation."""
    stream = navigator.stream
    values = {
        "phase": navigator.phase.value,
        "coarse alignment progress": f"{100.0 * navigator.progress:.0f} %",
        "imu/data_raw received": str(stream.received),
        "imu/data_raw used": str(stream.accepted),
    }
    if navigator.filter is not None:
        p = navigator.filter.p
        sigma = np.sqrt(p.diagonal())
        values |= _sigmas(sigma, navigator.filter.heading_stddev)
        values |= {
            "time left by prediction": f"{navigator.time_left:.0f} s",
            "gyro bias": _with_sigma(navigator.gyro_bias, sigma[9:12], _BIAS_UNIT, 4) + " deg/h",
            "accelerometer bias": _with_sigma(navigator.accel_bias, sigma[12:15], 1.0, 5) + " m/s^2",
        }
    for name, record in navigator.records.items():
        values[f"{name}: accepted, rejected"] = f"{record.accepted}, {record.rejected}"
        if record.last is not None:
            values[f"{name}: innovation"] = _with_sigma(record.last.innovation, record.last.sigma, 1.0, 3)
            values[f"{name}: test ratio"] = f"{record.last.test_ratio:.2f}"
            if record.last.noise_factor > 1.0:
                values[f"{name}: sigma taken larger"] = f"{math.sqrt(record.last.noise_factor):.1f} times"
            if record.accepted:
                age = (navigator.settled_ns - record.accepted_ns) / _NS
                values[f"{name}: last accepted"] = f"{age:.1f} s ago"
        own = navigator.own_states(name)
        if name.startswith(BEACON):
            values[f"{name}: place sigma"] = f"{math.hypot(*(s for _, s in own[:3])):.2f} m"
        elif own:
            values[f"{name}: own states"] = ", ".join(f"{x:.4f} ± {s:.4f}" for x, s in own)
    values |= {kind: str(count) for kind, count in navigator.health.counts.items()}
    level, text = _summary(navigator, navigator.health, silent_for)
    if level == 0 and navigator.phase is Phase.FINE and navigator.filter is not None:
        stddev = math.degrees(navigator.filter.heading_stddev)
        text = f"fine; heading sigma {stddev:.2f}°, {navigator.time_left:.0f} s left"
    missed = navigator.missed()
    if level == 0 and missed:
        level, text = 1, f"{text}; {'; '.join(missed)}"
    return level, text, values


def _sigmas(sigma: NDArray[np.float64], heading: float) -> dict[str, str]:
    """Of the solution, for people; the array as the states of `ins_nav.error_model`."""
    return {
        "position sigma": f"{math.hypot(*sigma[0:2]):.3f} m",
        "height sigma": f"{sigma[2]:.3f} m",
        "velocity sigma": f"{math.hypot(*sigma[3:5]):.4f} m/s",
        "level sigma": f"{math.degrees(max(sigma[6:8])):.5f} deg",
        "heading sigma": f"{math.degrees(heading):.4f} deg",
    }


def _with_sigma(values: Iterable[float], sigmas: Iterable[float], unit: float, digits: int) -> str:
    return ", ".join(f"{x * unit:.{digits}f} ± {s * unit:.{digits}f}" for x, s in zip(values, sigmas, strict=True))


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
