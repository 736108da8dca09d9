"""A navigator's solution as standard ROS messages.

Works on any object with the fields of the message: those of rclpy and those of `ins_nav.recordings.bags` alike, so that
the live node and `ins_process` publish the same. Messages are filled in place: making them afresh would be most of the
cost of a tick.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.estimation import error_model
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, POSE, POSITION, VELOCITY
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import conjugate, multiply
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.stamps import set_stamp


def _set_vector(vector: Any, values: tuple[float, ...]) -> None:
    vector.x, vector.y, vector.z = values


def _set_quaternion(quaternion: Any, values: tuple[float, ...]) -> None:
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = values


class SolutionMessages:
    """Odometry, Imu and NavSatFix of the navigator's present solution, at the rate of ``publish.rate``.

    Parameters
    ----------
    odometry, imu, fix : messages
        nav_msgs/Odometry, sensor_msgs/Imu and sensor_msgs/NavSatFix, reused at every call.
    navigator : RealtimeNavigator

    Attributes
    ----------
    first : bool
        Whether the solution that is `due` is the first after an alignment, a ZUPT or a feedback.
    """

    def __init__(self, odometry: Any, imu: Any, fix: Any, navigator: RealtimeNavigator) -> None:
        self.odometry = odometry
        self.imu = imu
        self.fix = fix
        self.first = False
        self._navigator = navigator
        self._changes = 0
        self._filled = -1
        self._began = (0, 0)
        self._period_ns = navigator.configuration.publish.period_ns
        self._next_ns = 0
        frames = navigator.configuration.frames
        base_link = frames.base_link
        odometry.header.frame_id = frames.map
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
        where = nav_state.geodetic(state)
        rate = navigator.angular_velocity
        earth = nav_state.earth_rate_body(state)
        for message in (self.odometry, self.imu, self.fix):
            set_stamp(message, navigator.stamp_ns)
        pose, twist = self.odometry.pose.pose, self.odometry.twist.twist
        _set_vector(pose.position, frame.position(state))
        _set_quaternion(pose.orientation, frame.attitude(state))
        _set_vector(twist.linear, nav_state.velocity_body(state))
        _set_vector(twist.angular, (rate[0] - earth[0], rate[1] - earth[1], rate[2] - earth[2]))
        _set_quaternion(self.imu.orientation, where.q_gb)
        _set_vector(self.imu.angular_velocity, rate)
        _set_vector(self.imu.linear_acceleration, navigator.specific_force)
        self.fix.latitude = math.degrees(where.lat)
        self.fix.longitude = math.degrees(where.lon)
        self.fix.altitude = where.height

    def _fill_covariances(self, p: NDArray[np.float64]) -> None:
        """The covariance of the errors, each part on the axes of its message.

        That of rates and forces is of the biases and of the white noise of a sample.
        """
        state, frame = self._navigator.state, self._navigator.map
        assert state is not None and frame is not None
        c, s = error_model.azimuth(state)
        to_g = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.imu.orientation_covariance[:] = (to_g @ p[ATTITUDE, ATTITUDE] @ to_g.T).ravel()
        self.fix.position_covariance[:] = (to_g @ p[POSITION, POSITION] @ to_g.T).ravel()
        q_mn = multiply(frame.attitude(state), conjugate(state[0:4]))
        to_m = error_model.rotation_matrix(q_mn)
        parts = p[np.ix_(POSE, POSE)]
        both = np.kron(np.eye(2), to_m)
        self.odometry.pose.covariance[:] = (both @ parts @ both.T).ravel()
        to_b = error_model.rotation_matrix(state[0:4]).T
        twist = np.zeros((6, 6))
        twist[:3, :3] = to_b @ p[VELOCITY, VELOCITY] @ to_b.T
        gyro_noise, accel_noise = self._navigator.sample_noise
        rate = p[GYRO_BIAS, GYRO_BIAS] + gyro_noise**2 * np.eye(3)
        force = p[ACCEL_BIAS, ACCEL_BIAS] + accel_noise**2 * np.eye(3)
        twist[3:, 3:] = rate
        self.odometry.twist.covariance[:] = twist.ravel()
        self.imu.angular_velocity_covariance[:] = rate.ravel()
        self.imu.linear_acceleration_covariance[:] = force.ravel()


def fill_bias(message: Any, navigator: RealtimeNavigator, base_link_frame: str) -> None:
    """The biases in use with their covariances, in a sensor_msgs/Imu (no orientation: covariance[0] is -1)."""
    set_stamp(message, navigator.stamp_ns)
    message.header.frame_id = base_link_frame
    message.orientation_covariance[0] = -1.0
    _set_vector(message.angular_velocity, navigator.gyro_bias)
    _set_vector(message.linear_acceleration, navigator.accel_bias)
    message.angular_velocity_covariance[:] = navigator.gyro_bias_covariance.ravel()
    message.linear_acceleration_covariance[:] = navigator.accel_bias_covariance.ravel()
