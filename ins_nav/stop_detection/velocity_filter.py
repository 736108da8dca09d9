"""Velocity and yaw since the last rest, dead reckoned from the IMU alone, with their covariance.

A small error-state Kalman filter for the stop detector. It needs no position, latitude or heading, and propagates over
blocks of some tens of samples.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization.attitude import Quaternion, conjugate, from_rotation_vector, multiply, normalized, rotate

Triple = tuple[float, float, float]
LONG_BLOCK = 0.2
"""s: in a longer block samples were lost."""
_GRAVITY = 9.81
_SPEED_PRIOR = 30.0
"""m/s: standard deviation of the carrier's speed before any measurement."""
_SPEED_PRIOR_CORRELATION = 30.0
"""s: the time over which that speed stays the same."""
_TILT_PRIOR = 0.3
"""rad: the initial level is the direction of a specific force that may be that of a curve."""
_GYRO_BIAS_PRIOR = 5e-3
"""rad/s, 1000 °/h."""
_ACCEL_BIAS_PRIOR = 0.05
"""m/s², 5 mg."""
_EARTH_RATE_PRIOR = 5e-5
"""rad/s: horizontal components of the Earth's rate, of unknown direction."""
_ALLAN_MINIMUM = 100.0
"""s: where the random walk of a bias overtakes the sensor's white noise (the usual minimum of Allan deviation)."""
_SCALE_ERROR = 2e-3
"""Scale factors and misalignments of MEMS sensors."""
_LOST_ACCELERATION = 3.0
"""m/s²: acceleration that lost samples may have contained."""
_GATE = 13.8
"""Squared distance of 0.1 % of normal pairs."""
_ABSURD_SPEED = 5.0 * _SPEED_PRIOR
"""m/s: no vehicle's; reached by a filter with a wrong gyro bias after a minute or two."""
_TILTED = math.sin(math.radians(15.0)) ** 2
"""Yaw is counted from an attitude that is at most twice this angle away: near 180° it would be undefined."""
_IDENTITY: NDArray[np.float64] = np.eye(12)
_H_V = _IDENTITY[:2]
_V, _TILT, _GYRO, _EARTH, _ACCEL = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 9), slice(9, 12)


class VelocityFilter:
    """Horizontal velocity by a small error-state Kalman filter on level axes that are free in azimuth.

    States: velocity (2), tilt (2), gyro biases (3, body), the Earth's horizontal rate (2, level axes: it stays
    where it is when the body turns), accelerometer biases (3, body). Arrays are replaced, never changed in place: a
    shallow copy keeps the state.

    Attributes
    ----------
    velocity : 2 floats
        At the end of the last block, m/s.
    mean_velocity : 2 floats
        Over the last block, m/s.
    mean_integral : 3 floats
        The same of the integral of acceleration, to which no correction of the velocity is added, m/s: for changes.
    yaw : float
        Turn about the vertical since the start, rad. That of the attitude, not the integral of the rate about the
        vertical, which grows with every circle of a base that rocks in roll and pitch.
    measured_yaw : float
        The same without compensation of gyro biases: a straight line at rest, rad.
    """

    def __init__(self) -> None:
        self.velocity = (0.0, 0.0)
        self.mean_velocity = (0.0, 0.0)
        self.mean_integral = (0.0, 0.0, 0.0)
        self.yaw = self.measured_yaw = 0.0
        self._integral = (0.0, 0.0, 0.0)
        self._q: Quaternion | None = None
        self._reference: Quaternion = (0.0, 0.0, 0.0, 1.0)
        self._reference_yaw = 0.0
        self._gyro = np.zeros(3)
        self._earth = np.zeros(2)
        self._accel = np.zeros(3)
        self._rotation = np.eye(3)
        self._p = np.diag(
            np.square(
                [_SPEED_PRIOR] * 2
                + [_TILT_PRIOR] * 2
                + [_GYRO_BIAS_PRIOR] * 3
                + [_EARTH_RATE_PRIOR] * 2
                + [_ACCEL_BIAS_PRIOR] * 3
            )
        )

    @property
    def speed(self) -> float:
        """Horizontal, m/s."""
        return math.hypot(*self.velocity)

    @property
    def speed_stddev(self) -> float:
        """Of the less certain component, m/s."""
        return math.sqrt(max(self._p[0, 0], self._p[1, 1]))

    @property
    def absurd(self) -> bool:
        """Whether the velocity has diverged."""
        return self.speed > _ABSURD_SPEED

    @property
    def up(self) -> Triple:
        """The vertical on the body's axes, at the beginning of the last block."""
        x, y, z = self._rotation[2].tolist()
        return x, y, z

    def yaw_rate_stddev(self, sway: float) -> float:
        """Of the rate about the vertical at rest, rad/s."""
        up = self._rotation[2]
        return math.sqrt(float(up @ self._p[_GYRO, _GYRO] @ up) + _EARTH_RATE_PRIOR**2 + sway**2)

    def lose_track(self) -> None:
        """Reset velocity and attitude to unknown."""
        self.velocity = (0.0, 0.0)
        self._q = None
        self._p = self._p.copy()
        self._p[:4, :] = self._p[:, :4] = 0.0
        self._p[:4, :4] = np.diag(np.square([_SPEED_PRIOR] * 2 + [_TILT_PRIOR] * 2))

    def doubt_velocity(self, stddev: float) -> None:
        """Add an error of unknown direction, m/s."""
        self._p = self._p + np.diag([stddev**2] * 2 + [0.0] * 10)

    def doubt_tilt(self, stddev: float) -> None:
        """Add an error of unknown direction, rad."""
        self._p = self._p + np.diag([0.0] * 2 + [stddev**2] * 2 + [0.0] * 8)

    def propagate(self, time: float, turn: Triple, velocity: Triple, mean: Triple, gyro: float, accel: float) -> None:
        """Propagate the state over a block.

        Parameters
        ----------
        time : float
            Its length, s.
        turn, velocity : 3 floats
            Integrals of rate, and of specific force on the body's axes at the block's start.
        mean : 3 floats
            Mean of the second as it grew.
        gyro, accel : float
            Standard deviation of the block's mean rate and specific force, rad/s and m/s².
        """
        if self._q is None:
            self._q = self._reference = _level(*velocity)
            self._reference_yaw = self.yaw
        rotation = self._rotation = _matrix(self._q)
        rx, ry, rz = (self._gyro + self._earth @ rotation[:2]).tolist()
        bx, by, bz = self._accel.tolist()
        dv = (velocity[0] - bx * time, velocity[1] - by * time, velocity[2] - bz * time)
        dx, dy, dz = rotate(self._q, *dv)
        if time > LONG_BLOCK:  # the acceleration in the lost samples is unknown
            self.doubt_velocity(time * _LOST_ACCELERATION)
        mx, my, mz = rotate(self._q, mean[0] - 0.5 * bx * time, mean[1] - 0.5 * by * time, mean[2] - 0.5 * bz * time)
        dz_level, mz_level = dz - _GRAVITY * time, mz - 0.5 * _GRAVITY * time
        (vx, vy), (x, y, z) = self.velocity, self._integral
        self.mean_velocity = vx + mx, vy + my
        self.mean_integral = x + mx, y + my, z + mz_level
        self.velocity = vx + dx, vy + dy
        self._integral = x + dx, y + dy, z + dz_level
        tx, ty, tz = turn[0] - rx * time, turn[1] - ry * time, turn[2] - rz * time
        self._q = normalized(multiply(self._q, from_rotation_vector(tx, ty, tz)))
        before = self.yaw
        self._count_yaw()
        ux, uy, uz = rotation[2].tolist()
        self.measured_yaw += self.yaw - before + (ux * rx + uy * ry + uz * rz) * time
        f = _IDENTITY.copy()
        f[0, 3], f[1, 2] = dz, -dz
        f[_V, _ACCEL] = f[_TILT, _GYRO] = -time * rotation[:2]
        f[2, 7] = f[3, 8] = -time
        p = f @ self._p @ f.T
        scale2 = _SCALE_ERROR**2
        qv, qt = (accel * time) ** 2, (gyro * time) ** 2
        v = qv + scale2 * math.hypot(dx, dy)
        t = qt + scale2 * math.sqrt(tx * tx + ty * ty + tz * tz)
        b, a = qt / _ALLAN_MINIMUM**2, qv / _ALLAN_MINIMUM**2
        p.ravel()[::13] += np.array((v, v, t, t, b, b, b, 0.0, 0.0, a, a, a))
        self._p = p
        # no carrier moves at 100 m/s: keeps the level bounded in a long drive
        if p[0, 0] > _SPEED_PRIOR**2 or p[1, 1] > _SPEED_PRIOR**2:
            self._update(_H_V, -np.array(self.velocity), _SPEED_PRIOR**2 * _SPEED_PRIOR_CORRELATION / time)

    def _count_yaw(self) -> None:
        """The part of the turn from the reference that is about the vertical, without jumps by 360°."""
        assert self._q is not None
        x, y, z, w = multiply(self._q, conjugate(self._reference))
        self.yaw += math.remainder(self._reference_yaw + 2.0 * math.atan2(z, w) - self.yaw, 2.0 * math.pi)
        if x * x + y * y > _TILTED:
            self._reference, self._reference_yaw = self._q, self.yaw

    def rate_offset(self, mean: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean rate less the expected rate at rest, rad/s, and the variance of the latter."""
        variance = self._p.diagonal()[_GYRO] + _EARTH_RATE_PRIOR**2
        return mean - self._gyro - self._earth @ self._rotation[:2], variance

    def rest_distance(self, acceleration: NDArray[np.float64], speed_noise2: float, accel_noise2: float) -> float:
        """Squared Mahalanobis distance of velocity and mean acceleration, m/s², from zero."""
        h = np.vstack([_H_V, self._acceleration_of()])
        s = h @ self._p @ h.T
        s.flat[::5] += [speed_noise2, speed_noise2, accel_noise2, accel_noise2]
        z = np.array([*self.velocity, *acceleration])
        return float(z @ np.linalg.solve(s, z))

    def coast(self, acceleration: NDArray[np.float64], noise: float, gate: float) -> bool:
        """Update with zero acceleration: the base moves evenly or stands, tilt and biases explain the reckoned one.

        Parameters
        ----------
        acceleration : ndarray, shape (2,)
            Mean as reckoned, m/s².
        noise : float
            Standard deviation of the true one, m/s².
        gate : float
            Squared Mahalanobis distance above which the acceleration is real; no update then.

        Returns
        -------
        bool
            Whether it agrees with zero.
        """
        h = self._acceleration_of()
        s = h @ self._p @ h.T
        s.flat[::3] += noise**2
        if float(acceleration @ np.linalg.solve(s, acceleration)) > gate:
            return False
        self._update(h, -acceleration, noise**2)
        return True

    def _acceleration_of(self) -> NDArray[np.float64]:
        """Jacobian of the reckoned acceleration, shape (2, 12)."""
        h = np.zeros((2, 12))
        h[0, 3], h[1, 2] = _GRAVITY, -_GRAVITY
        h[:, _ACCEL] = -self._rotation[:2]
        return h

    def rest(self, speed_noise: float) -> None:
        """Update with zero velocity.

        A velocity that contradicts it is rejected: the base is jolted, or about to move. The mean rate is not used as a
        measurement of gyro biases, since the base may rock; velocity observes those of the horizontal axes.
        """
        vx, vy = self.velocity
        limit = _GATE * (speed_noise**2 + max(self._p[0, 0], self._p[1, 1]))
        if vx * vx + vy * vy < limit:
            self._update(_H_V, np.array([-vx, -vy]), speed_noise**2)

    def update_yaw_rate(self, rate: float, noise: float) -> None:
        """Update with the mean yaw rate of a stationary base, rad/s: that of the gyro biases."""
        h = np.zeros((1, 12))
        h[0, _GYRO] = self._rotation[2]
        self._update(h, np.array([rate]), noise**2)

    def _update(self, h: NDArray[np.float64], residual: NDArray[np.float64], variance: float) -> None:
        assert self._q is not None
        ph = self._p @ h.T
        gain = ph @ _inverse(h @ ph, variance)
        dx = gain @ residual
        p = self._p - gain @ ph.T
        self._p = 0.5 * (p + p.T)
        vx, vy, px, py = dx[:4].tolist()
        self.velocity = self.velocity[0] + vx, self.velocity[1] + vy
        self._q = multiply(from_rotation_vector(px, py, 0.0), self._q)
        self._gyro = self._gyro + dx[_GYRO]
        self._earth = self._earth + dx[_EARTH]
        self._accel = self._accel + dx[_ACCEL]


def _inverse(s: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Inverse of ``s`` with ``variance`` on its diagonal, shape (1, 1) or (2, 2)."""
    if len(s) == 1:
        inverse: NDArray[np.float64] = 1.0 / (s + variance)
        return inverse
    (a, b), (c, d) = s.tolist()
    a, d = a + variance, d + variance
    determinant = a * d - b * c
    return np.array(((d / determinant, -b / determinant), (-c / determinant, a / determinant)))


def _level(x: float, y: float, z: float) -> Quaternion:
    """Body to level axes, from the assumed direction up."""
    norm = math.sqrt(x * x + y * y + z * z)
    if z < -0.999 * norm:  # upside down: half a turn about x
        return 1.0, 0.0, 0.0, 0.0
    return normalized((y, -x, 0.0, norm + z))


def _matrix(q: Quaternion) -> NDArray[np.float64]:
    x, y, z, w = q
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
    )
