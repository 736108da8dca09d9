"""Errors of the strapdown solution: definition, dynamics, correction.

Error state, computed less true, on the axes n of the computed solution (free azimuth, z up)::

    position       dp     along n, m
    velocity       dv     v_computed - R v_true, m/s
    attitude       phi    rot_nb_computed = R rot_nb_true
    gyro bias             in use less true, body, rad/s
    accel bias            in use less true, body, m/s²
    cosine         kappa  1 - cos(heading error)
    errors of the IMU     in use less true (scale factors, misalignments ...), optional blocks
    states of aids        in use less true (log scale, range bias ...)

`ins_nav.estimation.state_layout` has their indices.

R is the turn by the tilt (phi_x, phi_y) after a turn about the vertical by the heading error gamma;
``phi_z = sin(gamma)`` and ``kappa = 1 - cos(gamma)``. Two facts follow:

* Velocity error is defined on axes turned with the attitude error. Then specific force leaves the equations (its part
  ``R rot_nb f`` is common to both): tilt acts through gravity alone, heading not at all. So surge and
  rocking do not enter, and an interval is described by the states at its ends. Velocity on body
  axes is wrong by ``rot_bn dv``, whatever the heading error.
* Sine and cosine of the heading error enter linearly, through Earth's rate and through travel. So any heading error,
  180° too, is a linear problem ([3]_). Once heading is known to a few degrees, kappa is fixed at zero (variance zero)
  and phi_z is the angle: the usual linear model.

With u Earth's rate, w = J v the transport rate, theta = J dp the turn from the true vertical to the computed, z up,
C = rot_nb, d the errors of the sensors, all on n::

    dp' = dv + phi x v - (dh / R) v_horizontal  + kappa v_horizontal
    dv' = g phi x z - (2 u + w) x dv + ((theta + phi) x u) x v + (2 g / R) dh z + C d_f - (C d_w) x v
                                                - kappa u_horizontal x v
    phi' = phi x (u + w) + theta x u + (theta x w)_z z - J (dv + phi x v - (dh / R) v) + C d_w
                                                - kappa u_horizontal

Attitude is relative to the local vertical of the computed position (`strapdown.corrected`): a correction of position
alone, however large, does not change level and heading.

An optional block acts through the columns of the biases (`ins_nav.estimation.imu_error`), with the mean reading of the
IMU between the two states, computed from them (`mean_reading`).

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base: the 7 states.
.. [2] A. Barrau, S. Bonnabel, "The Invariant Extended Kalman Filter as a Stable Observer", IEEE Transactions on
       Automatic Control, 2017, vol. 62, no. 4: errors on turned axes have dynamics free of the trajectory.
.. [3] B. M. Scherzinger, "Inertial Navigator Error Models for Large Heading Uncertainty", IEEE PLANS, 1996.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ins_nav.estimation.imu_error import ImuErrors
from ins_nav.estimation.slow_state import ABSENT, SlowState
from ins_nav.estimation.state_layout import (
    ACCEL_BIAS,
    ATTITUDE,
    BIASES,
    COSINE,
    GYRO_BIAS,
    HEADING,
    HEIGHT,
    NAVIGATION,
    POSITION,
    SIZE,
    SOLUTION,
    TILT,
    VELOCITY,
    VERTICAL_VELOCITY,
)
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import Quaternion, conjugate, from_rotation_vector, multiply, rotate
from ins_nav.mechanization.earth import (
    ECCENTRICITY_SQUARED,
    NO_WATER,
    NORTH_GRAVITY_PER_METRE,
    RATE,
    SEMI_MAJOR_AXIS,
    WATER_GRADIENT,
    normal_gravity,
    principal_radii,
)
from ins_nav.mechanization.nav_state import NavState

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

_EXCESS = (2.0, 20.0)
"""Variance of the white noise of gyros and accelerometers over its upper limit, beyond which it was learnt of something
else: the limit is good to 20 %, and 1/f noise of accelerometers adds up to ten times as much."""


class ErrorModel:
    """Growth of the errors between two states.

    Parameters
    ----------
    vertical : bool
        The mechanization integrates its vertical channel. Otherwise vertical velocity is exact (zero), and height is
        a random walk of its own, which GNSS or depth may correct.
    gyro_noise : float
        Angle random walk, rad/√s.
    accel_noise : float
        Velocity random walk, m/s/√s.
    gyro_bias, accel_bias : SlowState
        Each axis, rad/s and m/s².
    height_walk : float
        Intensity, m/√s, of the random walk of height where there is no vertical channel.
    water_surface : float
        Ellipsoidal height, m: below it gravity is that in water.
    imu_errors : ImuErrors, optional
        Further errors of the IMU; default: none.

    Attributes
    ----------
    white_noise : 2 floats
        ``gyro_noise`` and ``accel_noise``.
    size : int
        Number of states, without those of aids.
    slow : tuple of SlowState
        Biases, then the states of ``imu_errors``.
    slow_rows : ndarray of int
        Their indices.
    solution_rows : ndarray of int
        Of all states but the cosine: those of a solution's published covariance.
    """

    def __init__(
        self,
        *,
        vertical: bool,
        gyro_noise: float,
        accel_noise: float,
        gyro_bias: SlowState = ABSENT,
        accel_bias: SlowState = ABSENT,
        height_walk: float = 0.0,
        water_surface: float = NO_WATER,
        imu_errors: ImuErrors | None = None,
    ) -> None:
        self._water_surface = water_surface
        self.vertical = vertical
        self.imu_errors = ImuErrors() if imu_errors is None else imu_errors
        self.size = size = SIZE + self.imu_errors.size
        self.slow = (gyro_bias,) * 3 + (accel_bias,) * 3 + self.imu_errors.states
        self.slow_rows = np.r_[BIASES, SIZE:size]
        self.solution_rows = np.r_[SOLUTION, SIZE:size]
        self._intensity: Array = np.zeros((size, size))
        diagonal = np.einsum("ii->i", self._intensity)
        diagonal[HEIGHT] = 0.0 if vertical else height_walk**2
        self._set_noise(gyro_noise, accel_noise)
        diagonal[self.slow_rows] = [s.walk**2 for s in self.slow]
        self._slow_rates: Array = np.zeros((size, size))
        np.einsum("ii->i", self._slow_rates)[self.slow_rows] = [-1.0 / s.correlation_time for s in self.slow]

    def _set_noise(self, gyro: float, accel: float) -> None:
        self.white_noise = gyro, accel
        self._gyro_intensity = gyro**2
        diagonal = np.einsum("ii->i", self._intensity)
        diagonal[VELOCITY] = accel**2
        diagonal[ATTITUDE] = gyro**2
        if not self.vertical:
            diagonal[VERTICAL_VELOCITY] = 0.0

    def limit_noise(self, gyro: float, accel: float) -> None:
        """Reduce white noise that was learnt too large, of motion or vibration.

        Parameters
        ----------
        gyro, accel : float
            Upper limits that samples have shown (`ins_nav.mechanization.sample_noise`), rad/√s and m/s/√s.
        """
        limited = [
            min(noise, math.sqrt(excess) * limit)
            for noise, limit, excess in zip(self.white_noise, (gyro, accel), _EXCESS, strict=True)
        ]
        if limited != list(self.white_noise):
            self._set_noise(*limited)

    def transition(self, before: NavState, after: NavState, duration: float, travels: bool = True) -> Array:
        """Transition matrix from one state to a later one, shape (size, size).

        Series to the second power of the rates at the mean of both ends. Nothing in it changes faster than the base
        turns: rocking by 5° in 5 s changes the columns of the biases by 1e-5 within 0.1 s.

        Parameters
        ----------
        before, after : NavState
        duration : float
            s; 0.1 is good, and 0.5 where the body turns by less than 0.1 rad in it.
        travels : bool
            The carrier travels; otherwise velocity is an error of the solution, and heading does not act through it
            (`ErrorFilter`).
        """
        rates = _rates(before, after, self.vertical, travels, self._water_surface)
        a = self._slow_rates * duration
        a[NAVIGATION, :SIZE] = duration * rates
        if self.imu_errors.size:
            columns = self.imu_errors.columns(mean_reading(before, after, duration, self._water_surface))
            a[NAVIGATION, SIZE:] = duration * (rates[:, BIASES] @ columns)
        phi: Array = a @ a
        phi *= 0.5
        phi += a
        np.einsum("ii->i", phi)[:] += 1.0
        return phi

    def noise(self, before: NavState, after: NavState, duration: float) -> Array:
        """Covariance of the process noise over the interval, applied at its middle, shape (size, size)."""
        x, y, z = (0.5 * (a + b) for a, b in zip(before[4:7], after[4:7], strict=True))
        # the turn of the velocity error's axes: gyro noise enters it as v x noise
        lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        if not self.vertical:
            lever[2] = 0.0
        turned = self._gyro_intensity * lever
        q = self._intensity.copy()
        q[VELOCITY, VELOCITY] += turned @ lever.T
        q[VELOCITY, ATTITUDE] = turned
        q[ATTITUDE, VELOCITY] = turned.T
        q *= duration
        return q

    def apply(
        self, x: Array, state: NavState, gyro_bias: Vector, accel_bias: Vector
    ) -> tuple[NavState, Vector, Vector]:
        """Subtract the errors ``x`` from a solution.

        Position changes by ``-dp``, attitude becomes ``R' rot_nb``, velocity ``R' (v - dv)`` (R' is R transposed), each
        bias loses its error. Rotations are finite.

        Parameters
        ----------
        x : ndarray, shape (size,) or longer
            Errors.
        state : NavState
        gyro_bias, accel_bias : 3 floats
            In use, rad/s and m/s², body.

        Returns
        -------
        state : NavState
        gyro_bias, accel_bias : 3 floats
        """
        dx, dy, dz = x[POSITION].tolist()
        du, dv, dw = x[VELOCITY].tolist()
        g1, g2, g3 = x[GYRO_BIAS].tolist()
        a1, a2, a3 = x[ACCEL_BIAS].tolist()
        back = conjugate(error_rotation(x))
        vx, vy, vz = state[4:7]
        nx, ny, nz = rotate(back, vx - du, vy - dv, vz - dw)
        moved = nav_state.corrected(state, (-dx, -dy, -dz), (nx - vx, ny - vy, nz - vz if self.vertical else 0.0))
        q = multiply(back, moved[0:4])
        return (
            NavState(*q, *moved[4:]),
            (gyro_bias[0] - g1, gyro_bias[1] - g2, gyro_bias[2] - g3),
            (accel_bias[0] - a1, accel_bias[1] - a2, accel_bias[2] - a3),
        )


def _rates(before: NavState, after: NavState, vertical: bool, travels: bool, water_surface: float) -> Array:
    """Rows of position, velocity and attitude of the system matrix, 1/s, shape (9, SIZE)."""
    (r1, r2, r3), (a, b, c) = _axis_and_curvature(after)
    g = normal_gravity(r3, after[11], water_surface)
    u1, u2, u3 = RATE * r1, RATE * r2, RATE * r3
    v1, v2, v3 = 0.5 * (before[4] + after[4]), 0.5 * (before[5] + after[5]), 0.5 * (before[6] + after[6])
    w1, w2 = u1 - b * v1 - c * v2, u2 + a * v1 + b * v2  # of n in inertial space; its vertical component is u3
    x1, x2 = u1 + w1, u2 + w2  # Coriolis: 2 u + w; vertical 2 u3
    along = u1 * v1 + u2 * v2 + u3 * v3
    m11, m12, m13 = u1 * v1 - along, u1 * v2, u1 * v3  # (a x u) x v as a matrix times a
    m21, m22, m23 = u2 * v1, u2 * v2 - along, u2 * v3
    m31, m32, m33 = u3 * v1, u3 * v2, u3 * v3 - along
    c11, c12, c13, c21, c22, c23, c31, c32, c33 = _mean_rotation(before[0:4], after[0:4])
    t = 1.0 if travels else 0.0
    s = 1.0 if vertical else 0.0
    i = 1.0 / SEMI_MAJOR_AXIS
    gradient = 2.0 * g * i - (WATER_GRADIENT if after[11] < water_surface else 0.0)
    # fmt: off
    rows = np.array((
        # position: 3, velocity: 3, attitude: 3, gyro bias: 3, accel bias: 3, cosine
        0.0, 0.0, -v1 * i,  1.0, 0.0, 0.0,  0.0, v3, -t * v2,  0.0, 0.0, 0.0,  0.0, 0.0, 0.0,  t * v1,
        0.0, 0.0, -v2 * i,  0.0, 1.0, 0.0,  -v3, 0.0, t * v1,  0.0, 0.0, 0.0,  0.0, 0.0, 0.0,  t * v2,
        0.0, 0.0, 0.0,  0.0, 0.0, s,  s * v2, -s * v1, 0.0,  0.0, 0.0, 0.0,  0.0, 0.0, 0.0,  0.0,

        m12 * a - m11 * b, m12 * b - m11 * c, 0.0,  0.0, 2.0 * u3, -x2 * s,  m11, m12 + g, m13,
        c21 * v3 - c31 * v2, c22 * v3 - c32 * v2, c23 * v3 - c33 * v2,  -c11, -c12, -c13,  -t * u2 * v3,
        m22 * a - m21 * b, m22 * b - m21 * c, 0.0,  -2.0 * u3, 0.0, x1 * s,  m21 - g, m22, m23,
        c31 * v1 - c11 * v3, c32 * v1 - c12 * v3, c33 * v1 - c13 * v3,  -c21, -c22, -c23,  t * u1 * v3,
        m32 * a - m31 * b, m32 * b - m31 * c, gradient,  x2, -x1, 0.0,  m31, m32, m33,
        c11 * v2 - c21 * v1, c12 * v2 - c22 * v1, c13 * v2 - c23 * v1,  -c31, -c32, -c33,  t * (u2 * v1 - u1 * v2),

        u3 * a, u3 * b, (w1 - u1) * i,  b, c, 0.0,  -c * v3, u3 + b * v3, -w2 - b * v2 + c * v1,
        -c11, -c12, -c13,  0.0, 0.0, 0.0,  -u1,
        u3 * b, u3 * c, (w2 - u2) * i,  -a, -b, 0.0,  b * v3 - u3, -a * v3, w1 + a * v2 - b * v1,
        -c21, -c22, -c23,  0.0, 0.0, 0.0,  -u2,
        -b * w2 - a * w1, -c * w2 - b * w1, 0.0,  0.0, 0.0, 0.0,  w2, -w1, 0.0,
        -c31, -c32, -c33,  0.0, 0.0, 0.0,  0.0,
    )).reshape(-1, SIZE)
    # fmt: on
    if not vertical:
        rows[VERTICAL_VELOCITY] = 0.0
    return rows


def _axis_and_curvature(state: NavState) -> tuple[Vector, Vector]:
    """Earth's axis on n, and the curvature of the ellipsoid there.

    The curvature is the turn of the vertical a metre, 1/m: p = A v with the symmetric matrix A = ((a, b), (b, c)), and
    transport rate J v = (-p2, p1, 0).
    """
    ex, ey, ez, ew, height = state[7:]
    r1 = 2.0 * (ex * ez - ey * ew)
    r2 = 2.0 * (ey * ez + ex * ew)
    r3 = 1.0 - 2.0 * (ex * ex + ey * ey)
    meridian, prime_vertical = principal_radii(r3)
    r_n, r_m = prime_vertical + height, meridian + height
    k = ECCENTRICITY_SQUARED * prime_vertical / ((1.0 - ECCENTRICITY_SQUARED * r3 * r3) * r_m * r_n)
    return (r1, r2, r3), (1.0 / r_n + k * r1 * r1, k * r1 * r2, 1.0 / r_n + k * r2 * r2)


def mean_reading(before: NavState, after: NavState, duration: float, water_surface: float = NO_WATER) -> Array:
    """Mean angular rate and specific force between two states of the mechanization, body, shape (6,).

    Of the body in inertial space, rad/s and m/s². Where the vertical channel is not integrated, specific force is that
    of a base without vertical acceleration.

    Parameters
    ----------
    before, after : NavState
        With no correction between them.
    duration : float
        s.
    water_surface : float
        As of `ErrorModel`.
    """
    axis, (a, b, c) = _axis_and_curvature(after)
    earth: Array = RATE * np.array(axis)
    velocity = 0.5 * np.add(before[4:7], after[4:7])
    transport = np.array([-b * velocity[0] - c * velocity[1], a * velocity[0] + b * velocity[1], 0.0])
    x, y, z, w = multiply(conjugate(before[0:4]), after[0:4])
    half = math.hypot(x, y, z)
    turn = 2.0 * math.atan2(half, abs(w)) / half if half > 0.0 else 2.0
    rot_bn: Array = np.array(_mean_rotation(before[0:4], after[0:4])).reshape(3, 3).T
    rate = np.multiply((x, y, z), math.copysign(turn, w) / duration) + rot_bn @ (earth + transport)
    force = np.subtract(after[4:7], before[4:7]) / duration + np.cross(2.0 * earth + transport, velocity)
    height, sin_lat = after[11], axis[2]
    north = 2.0 * NORTH_GRAVITY_PER_METRE * height * sin_lat  # times the axis: as in `strapdown.advance`
    force -= [north * axis[0], north * axis[1], -normal_gravity(sin_lat, height, water_surface)]
    return np.concatenate([rate, rot_bn @ force])


def _mean_rotation(p: Quaternion, q: Quaternion) -> tuple[float, ...]:
    """Mean of two rotation matrices, row after row."""
    ax, ay, az, aw = p
    bx, by, bz, bw = q
    xx, yy, zz = ax * ax + bx * bx, ay * ay + by * by, az * az + bz * bz
    xy, xz, yz = ax * ay + bx * by, ax * az + bx * bz, ay * az + by * bz
    wx, wy, wz = aw * ax + bw * bx, aw * ay + bw * by, aw * az + bw * bz
    return 1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy


def rotation_matrix(q: Quaternion) -> Array:
    """Matrix of a quaternion, shape (3, 3)."""
    return np.array(_mean_rotation(q, q)).reshape(3, 3)


def azimuth(state: NavState) -> tuple[float, float]:
    """Cosine and sine of the turn of vectors from n to east-north-up (`strapdown.geodetic`)."""
    ex, ey, ez, ew = state[7:11]
    c, s = ey * ez + ex * ew, ex * ez - ey * ew
    norm = math.hypot(c, s)
    return (c / norm, s / norm) if norm > 0.0 else (1.0, 0.0)


def error_rotation(x: Array) -> Quaternion:
    """The turn R of an error state: heading, then tilt; exact for any heading error."""
    gamma = math.atan2(x[HEADING], 1.0 - x[COSINE])
    turn = (0.0, 0.0, math.sin(0.5 * gamma), math.cos(0.5 * gamma))
    tilt_x, tilt_y = x[TILT].tolist()
    return multiply(from_rotation_vector(tilt_x, tilt_y, 0.0), turn)
