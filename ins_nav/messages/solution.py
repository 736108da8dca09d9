"""A navigator's solution as standard ROS messages: the bytes that the live node publishes and `ins_process` writes."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.sections import Vector
from ins_nav.estimation import error_model
from ins_nav.estimation.state_layout import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, POSE, POSITION, VELOCITY
from ins_nav.mechanization.attitude import Quaternion, conjugate, multiply
from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.nav_state import (
    STATE_SIZE,
    MapFrame,
    NavState,
    attitude_in,
    earth_rate_body,
    geodetic,
    position_in,
    velocity_body,
)
from ins_nav.mechanization.replay_buffer import Entries
from ins_nav.mechanization.strapdown import NO_COMPENSATION, SAMPLE_SIZE, Compensation, compensated
from ins_nav.messages.cdr import StampedMessage
from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.stamps import set_stamp

Array = NDArray[np.float64]
ODOMETRY, IMU, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
_STATUS_FIX, _SERVICE_UNKNOWN, _COVARIANCE_TYPE_KNOWN = ("b", 0), ("H", 0), b"\x03"
"""Constants of sensor_msgs/NavSatFix and NavSatStatus; the service is unknown, since it is inertial."""


class SolutionMessages:
    """Odometry, Imu and NavSatFix of the navigator's present solution, at the rate of ``publish.rate``.

    Parameters
    ----------
    navigator : RealtimeNavigator

    Attributes
    ----------
    odometry, imu, fix : StampedMessage
        nav_msgs/Odometry, sensor_msgs/Imu and sensor_msgs/NavSatFix, filled at every call of `fill`.
    first : bool
        Whether the solution that is `due` is the first after an alignment, a ZUPT or a feedback.
    """

    def __init__(self, navigator: RealtimeNavigator) -> None:
        frames = navigator.configuration.frames
        self.odometry = StampedMessage(ODOMETRY, frames.map, frames.base_link, count=85)
        self.imu = StampedMessage(IMU, frames.base_link, count=37)
        self.fix = StampedMessage(
            FIX, frames.base_link, _STATUS_FIX, _SERVICE_UNKNOWN, count=12, end=_COVARIANCE_TYPE_KNOWN
        )
        self.first = False
        self._navigator = navigator
        self._changes = 0
        self._filled = -1
        self._began = (0, 0)
        self._period_ns = navigator.configuration.publish.period_ns
        self._next_ns = 0
        # Compiled, or loaded from the cache, before samples arrive
        for matrix in (None, np.eye(6)):
            compensation = NO_COMPENSATION._replace(matrix=matrix)
            self._write(np.zeros(SAMPLE_SIZE), np.zeros(STATE_SIZE), compensation, MapFrame(0.0, 0.0, 0.0))

    def due(self, stamp_ns: int) -> bool:
        """Whether the navigator's solution of that stamp is to be published; call it once for each."""
        began = self._navigator.restarts, self._navigator.aligned_ns  # a recording that loops has the same stamps
        if began != self._began:
            self._began, self._next_ns = began, 0
        if stamp_ns < self._next_ns:
            return False
        self.first = self._navigator.changes != self._changes
        self._changes = self._navigator.changes
        self._next_ns = max((self._next_ns or stamp_ns) + self._period_ns, stamp_ns + 1)
        return True

    def fill(self, entries: Entries, row: int = -1) -> None:
        """Fill in the solution of a row of the navigator's latest `RealtimeNavigator.entries`."""
        navigator = self._navigator
        frame = navigator.map
        assert frame is not None
        if navigator.accuracy.count != self._filled:
            self._filled = navigator.accuracy.count
            self._fill_covariances(navigator.accuracy.covariance, NavState._make(entries.states[row].tolist()), frame)
        for message in (self.odometry, self.imu, self.fix):
            message.set_stamp(int(entries.stamps[row]))
        self._write(entries.samples[row], entries.states[row], navigator.compensation, frame)

    def _write(self, sample: Array, state: Array, compensation: Compensation, frame: MapFrame) -> None:
        numbers = self.odometry.numbers, self.imu.numbers, self.fix.numbers
        compiled(_write_numbers)(sample, state, *compensation, frame.axes, frame.origin, *numbers)

    def _fill_covariances(self, p: Array, state: NavState, frame: MapFrame) -> None:
        """The covariance of the errors, each part on the axes of its message.

        That of rates and forces is of the biases and of the white noise of a sample.
        """
        c, s = error_model.azimuth(state)
        to_g = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.imu.numbers[4:13] = (to_g @ p[ATTITUDE, ATTITUDE] @ to_g.T).ravel()
        self.fix.numbers[3:12] = (to_g @ p[POSITION, POSITION] @ to_g.T).ravel()
        q_mn = multiply(frame.attitude(state), conjugate(state[0:4]))
        to_m = error_model.rotation_matrix(q_mn)
        parts = p[np.ix_(POSE, POSE)]
        both = np.kron(np.eye(2), to_m)
        self.odometry.numbers[7:43] = (both @ parts @ both.T).ravel()
        to_b = error_model.rotation_matrix(state[0:4]).T
        twist = np.zeros((6, 6))
        twist[:3, :3] = to_b @ p[VELOCITY, VELOCITY] @ to_b.T
        gyro_noise, accel_noise = self._navigator.sample_noise
        rate = p[GYRO_BIAS, GYRO_BIAS] + gyro_noise**2 * np.eye(3)
        force = p[ACCEL_BIAS, ACCEL_BIAS] + accel_noise**2 * np.eye(3)
        twist[3:, 3:] = rate
        self.odometry.numbers[49:85] = twist.ravel()
        self.imu.numbers[16:25] = rate.ravel()
        self.imu.numbers[28:37] = force.ravel()


def _write_numbers(
    raw: Array,
    row: Array,
    gyro_bias: Vector,
    accel_bias: Vector,
    matrix: Array | None,
    axes: Quaternion,
    origin: Vector,
    odometry: Array,
    imu: Array,
    fix: Array,
) -> None:
    """Numbers of the three messages, apart from covariances; axes and origin are those of the map."""
    h, wx, wy, wz, fx, fy, fz = raw
    sample = compensated((h, wx, wy, wz, fx, fy, fz), gyro_bias, accel_bias, matrix)
    qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height = row
    state = NavState(qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height)
    where = geodetic(state)
    position, orientation = position_in(axes, origin, state), attitude_in(axes, state)
    velocity, earth = velocity_body(state), earth_rate_body(state)
    for i in range(3):
        odometry[i] = position[i]
        odometry[43 + i] = velocity[i]
        odometry[46 + i] = sample[1 + i] - earth[i]
        imu[13 + i] = sample[1 + i]
        imu[25 + i] = sample[4 + i]
    for i in range(4):
        odometry[3 + i] = orientation[i]
        imu[i] = where.q_gb[i]
    fix[0] = math.degrees(where.lat)
    fix[1] = math.degrees(where.lon)
    fix[2] = where.height


def fill_bias(message: Any, navigator: RealtimeNavigator, base_link_frame: str) -> None:
    """The biases in use with their covariances, in a sensor_msgs/Imu (no orientation: covariance[0] is -1)."""
    set_stamp(message, navigator.stamp_ns)
    message.header.frame_id = base_link_frame
    message.orientation_covariance[0] = -1.0
    for vector, bias in (
        (message.angular_velocity, navigator.gyro_bias),
        (message.linear_acceleration, navigator.accel_bias),
    ):
        vector.x, vector.y, vector.z = bias
    message.angular_velocity_covariance[:] = navigator.gyro_bias_covariance.ravel()
    message.linear_acceleration_covariance[:] = navigator.accel_bias_covariance.ravel()
