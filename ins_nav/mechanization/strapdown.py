"""Strapdown mechanization: angular rate and specific force -> attitude, velocity, position.

The navigation frame n is horizontal, its z axis up, free in azimuth: it does not turn about the vertical
relative to the Earth (the frame Mx of the alignment paper). Nothing here divides by cos(latitude), so the
poles are places like any other. Its azimuth ``chi`` against east-north-up is read off the position matrix.

`step` is the only implementation. It runs compiled by numba: over one sample in a live node, over blocks in a
recording (`fill_states`).

References
----------
.. [1] P. G. Savage, "Strapdown Inertial Navigation Integration Algorithm Design", parts 1 and 2, Journal of
       Guidance, Control, and Dynamics, 1998, vol. 21, no. 1-2.
.. [2] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base: the equations of
       navigation in the free-azimuth frame.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.sections import Vector
from ins_nav.mechanization.attitude import from_rotation_vector, multiply, rotate
from ins_nav.mechanization.compiled import compiled
from ins_nav.mechanization.earth import (
    ECCENTRICITY_SQUARED,
    NO_WATER,
    NORTH_GRAVITY_PER_METRE,
    RATE,
    normal_gravity,
    principal_radii,
)
from ins_nav.mechanization.nav_state import STATE_SIZE, NavState

Sample = tuple[float, float, float, float, float, float, float]
"""(interval, rate x y z, specific force x y z): s, rad/s, m/s²."""
SAMPLE_SIZE = 7


def sample_of(row: NDArray[np.float64]) -> Sample:
    """A row of an array of samples, shape (7,), as plain numbers."""
    h, wx, wy, wz, fx, fy, fz = row.tolist()
    return h, wx, wy, wz, fx, fy, fz


def compensated_increments(
    h: float,
    wx: float,
    wy: float,
    wz: float,
    fx: float,
    fy: float,
    fz: float,
    dwx: float,
    dwy: float,
    dwz: float,
    dfx: float,
    dfy: float,
    dfz: float,
) -> tuple[float, float, float, float, float, float]:
    """Rotation vector of the body and its velocity increment over one interval.

    Rate and specific force are taken as linear in time over the interval: their means are ``w`` and ``f``, they
    change by ``dw`` and ``df``. That gives coning and sculling their two-sample forms ([1]_ part 1 eq. 58 and
    part 2 eq. 19); turning during the interval is exact for constant rate.

    Parameters
    ----------
    h : float
        Interval, s.
    wx, wy, wz, fx, fy, fz : float
        Mean angular rate, rad/s, and specific force, m/s², body axes.
    dwx, dwy, dwz, dfx, dfy, dfz : float
        Their change from the start to the end of the interval.

    Returns
    -------
    rotation : 3 floats
        Rotation vector from the body at the start to the body at the end, rad.
    velocity : 3 floats
        Integral of specific force on the body axes at the start, m/s.
    """
    ax, ay, az = wx * h, wy * h, wz * h
    ux, uy, uz = fx * h, fy * h, fz * h
    c = h * h / 12.0
    angle2 = ax * ax + ay * ay + az * az
    if angle2 < 1e-4:
        k1 = 0.5 - angle2 * (1.0 / 24.0 - angle2 / 720.0)
        k2 = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 / 5040.0)
    else:
        angle = math.sqrt(angle2)
        k1 = (1.0 - math.cos(angle)) / angle2
        k2 = (angle - math.sin(angle)) / (angle2 * angle)
    # a x u, and a x (a x u)
    px, py, pz = ay * uz - az * uy, az * ux - ax * uz, ax * uy - ay * ux
    rx, ry, rz = ay * pz - az * py, az * px - ax * pz, ax * py - ay * px
    return (
        ax + c * (wy * dwz - wz * dwy),
        ay + c * (wz * dwx - wx * dwz),
        az + c * (wx * dwy - wy * dwx),
        ux + k1 * px + k2 * rx + c * (wy * dfz - wz * dfy + fy * dwz - fz * dwy),
        uy + k1 * py + k2 * ry + c * (wz * dfx - wx * dfz + fz * dwx - fx * dwz),
        uz + k1 * pz + k2 * rz + c * (wx * dfy - wy * dfx + fx * dwy - fy * dwx),
    )


def advance(
    state: NavState,
    h: float,
    rotation_x: float,
    rotation_y: float,
    rotation_z: float,
    velocity_x: float,
    velocity_y: float,
    velocity_z: float,
    vertical: bool,
    water_surface: float = NO_WATER,
) -> NavState:
    """Carry a state over one interval with the increments of `compensated_increments`.

    Earth's rate, the transport rate, gravity and the Coriolis term are taken at the middle of the interval.

    Parameters
    ----------
    state : NavState
    h : float
        Interval, s.
    rotation_x, rotation_y, rotation_z : float
        Rotation vector of the body relative to inertial space, rad.
    velocity_x, velocity_y, velocity_z : float
        Velocity increment on the body axes at the start, m/s.
    vertical : bool
        Integrate the vertical channel; otherwise vertical velocity is zero and height stays.
    water_surface : float
        Ellipsoidal height, m: below it is water (`earth.normal_gravity`).

    Returns
    -------
    NavState
    """
    qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height = state
    half = 0.5 * h
    ux, uy, uz = rotate((qx, qy, qz, qw), velocity_x, velocity_y, velocity_z)

    # Earth's axis on n (third row of C_en); its z component is the sine of latitude
    rx = 2.0 * (ex * ez - ey * ew)
    ry = 2.0 * (ey * ez + ex * ew)
    rz = 1.0 - 2.0 * (ex * ex + ey * ey)
    mid_height = height + half * vz
    meridian, prime_vertical = principal_radii(rz)
    r_n = prime_vertical + mid_height
    r_m = meridian + mid_height
    # difference of the two curvatures over cos² of latitude: regular at the pole
    k = ECCENTRICITY_SQUARED * prime_vertical / ((1.0 - ECCENTRICITY_SQUARED * rz * rz) * r_m * r_n)

    # velocity in the middle of the interval, Coriolis still left out
    mx, my = vx + 0.5 * ux, vy + 0.5 * uy
    along = k * (rx * mx + ry * my)
    px, py = mx / r_n + along * rx, my / r_n + along * ry  # rate of the vertical on n; transport rate (-py, px, 0)
    rx, ry, rz = rx - half * px * rz, ry - half * py * rz, rz + half * (px * rx + py * ry)
    ox, oy, oz = RATE * rx, RATE * ry, RATE * rz
    gravity = normal_gravity(rz, mid_height, water_surface)
    north = 2.0 * NORTH_GRAVITY_PER_METRE * mid_height * rz  # times (rx, ry): its horizontal components
    mz = vz + 0.5 * (uz - gravity * h) if vertical else 0.0

    # n turns during the interval: half of that turn applies to the increment
    wx, wy, wz = ox - py, oy + px, oz
    cx, cy, cz = 2.0 * ox - py, 2.0 * oy + px, 2.0 * oz
    # to the first power of the interval the Coriolis acceleration depends on itself: 2 mm in 10 min at 250 m/s
    mx, my, mz = (
        mx + half * (cz * my - cy * mz),
        my + half * (cx * mz - cz * mx),
        mz + half * (cy * mx - cx * my) if vertical else 0.0,
    )
    nvx = vx + ux - half * (wy * uz - wz * uy) + h * (north * rx - cy * mz + cz * my)
    nvy = vy + uy - half * (wz * ux - wx * uz) + h * (north * ry - cz * mx + cx * mz)
    if vertical:
        nvz = vz + uz - half * (wx * uy - wy * ux) + h * (-gravity - cx * my + cy * mx)
    else:
        nvz = 0.0

    # position: trapezoid in velocity
    mx, my = 0.5 * (vx + nvx), 0.5 * (vy + nvy)
    along = k * (rx * mx + ry * my)
    px, py = mx / r_n + along * rx, my / r_n + along * ry
    ax, ay = -half * py, half * px
    aw = 1.0 - 0.5 * (ax * ax + ay * ay)
    nex = ew * ax + ex * aw - ez * ay
    ney = ew * ay + ey * aw + ez * ax
    nez = ez * aw + ex * ay - ey * ax
    new = ew * aw - ex * ax - ey * ay
    scale = 1.5 - 0.5 * (nex * nex + ney * ney + nez * nez + new * new)

    q = multiply((qx, qy, qz, qw), from_rotation_vector(rotation_x, rotation_y, rotation_z))
    qx, qy, qz, qw = multiply(from_rotation_vector(h * (py - ox), -h * (px + oy), -h * oz), q)
    unit = 1.5 - 0.5 * (qx * qx + qy * qy + qz * qz + qw * qw)
    return NavState(
        unit * qx,
        unit * qy,
        unit * qz,
        unit * qw,
        nvx,
        nvy,
        nvz,
        scale * nex,
        scale * ney,
        scale * nez,
        scale * new,
        height + half * (vz + nvz),
    )


def increments(
    previous: Sample, sample: Sample, instantaneous: bool
) -> tuple[float, float, float, float, float, float]:
    """`compensated_increments` of one IMU sample.

    Parameters
    ----------
    previous, sample : Sample
        The previous sample and this one, (h, wx, wy, wz, fx, fy, fz); h is the interval each one ends.
    instantaneous : bool
        Samples are values at their stamps; otherwise means over the intervals they end (increment / interval).
    """
    h0, ax, ay, az, bx, by, bz = previous
    h, wx, wy, wz, fx, fy, fz = sample
    if instantaneous:
        change = 1.0
        mx, my, mz = 0.5 * (ax + wx), 0.5 * (ay + wy), 0.5 * (az + wz)
        nx, ny, nz = 0.5 * (bx + fx), 0.5 * (by + fy), 0.5 * (bz + fz)
    else:
        change = 2.0 * h / (h0 + h)
        mx, my, mz, nx, ny, nz = wx, wy, wz, fx, fy, fz
    return compensated_increments(
        h,
        mx,
        my,
        mz,
        nx,
        ny,
        nz,
        change * (wx - ax),
        change * (wy - ay),
        change * (wz - az),
        change * (fx - bx),
        change * (fy - by),
        change * (fz - bz),
    )


def step(
    state: NavState,
    previous: Sample,
    sample: Sample,
    instantaneous: bool,
    vertical: bool,
    water_surface: float = NO_WATER,
) -> NavState:
    """One IMU sample: increments with coning and sculling, then the navigation equations.

    Parameters
    ----------
    state : NavState
        At the stamp of the previous sample.
    previous, sample, instantaneous
        As in `increments`.
    vertical, water_surface
        As in `advance`.

    Returns
    -------
    NavState
        At the stamp of this sample.
    """
    rx, ry, rz, ux, uy, uz = increments(previous, sample, instantaneous)
    return advance(state, sample[0], rx, ry, rz, ux, uy, uz, vertical, water_surface)


def without_bias(sample: Sample, gyro_bias: Vector, accel_bias: Vector) -> Sample:
    """A sample, biases removed.

    Parameters
    ----------
    sample : Sample
    gyro_bias, accel_bias : 3 floats
        rad/s and m/s².
    """
    h, wx, wy, wz, fx, fy, fz = sample
    gx, gy, gz = gyro_bias
    ax, ay, az = accel_bias
    return h, wx - gx, wy - gy, wz - gz, fx - ax, fy - ay, fz - az


class Compensation(NamedTuple):
    """Errors of the IMU in use, which are removed from samples.

    Attributes
    ----------
    gyro_bias, accel_bias : 3 floats
        rad/s and m/s².
    matrix : ndarray, shape (6, 6), or None
        Multiplies a reading before (`ins_nav.estimation.imu_error.ImuErrors.correction`); None: identity.
    """

    gyro_bias: Vector
    accel_bias: Vector
    matrix: NDArray[np.float64] | None = None


NO_COMPENSATION = Compensation((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _component(row: NDArray[np.float64], wx: float, wy: float, wz: float, fx: float, fy: float, fz: float) -> float:
    return row[0] * wx + row[1] * wy + row[2] * wz + row[3] * fx + row[4] * fy + row[5] * fz  # type: ignore[no-any-return]


def compensated(
    sample: Sample, gyro_bias: Vector, accel_bias: Vector, matrix: NDArray[np.float64] | None = None
) -> Sample:
    """A sample, errors of the IMU removed.

    Parameters
    ----------
    sample : Sample
    gyro_bias, accel_bias, matrix
        As in `Compensation`.
    """
    if matrix is not None:
        h, wx, wy, wz, fx, fy, fz = sample
        sample = (
            h,
            _component(matrix[0], wx, wy, wz, fx, fy, fz),
            _component(matrix[1], wx, wy, wz, fx, fy, fz),
            _component(matrix[2], wx, wy, wz, fx, fy, fz),
            _component(matrix[3], wx, wy, wz, fx, fy, fz),
            _component(matrix[4], wx, wy, wz, fx, fy, fz),
            _component(matrix[5], wx, wy, wz, fx, fy, fz),
        )
    return without_bias(sample, gyro_bias, accel_bias)


def compensated_rows(samples: NDArray[np.float64], compensation: Compensation) -> NDArray[np.float64]:
    """`compensated` for each row of samples, shape (n, 7)."""
    gyro_bias, accel_bias, matrix = compensation
    readings = samples[:, 1:] if matrix is None else samples[:, 1:] @ matrix.T
    return np.column_stack([samples[:, 0], readings - np.array([*gyro_bias, *accel_bias])])


def _fill_states(
    samples: NDArray[np.float64],
    states: NDArray[np.float64],
    first: int,
    until: int,
    gyro_bias: Vector,
    accel_bias: Vector,
    matrix: NDArray[np.float64] | None,
    instantaneous: bool,
    vertical: bool,
    water_surface: float,
) -> None:
    h, wx, wy, wz, fx, fy, fz = samples[first - 1]
    previous = compensated((h, wx, wy, wz, fx, fy, fz), gyro_bias, accel_bias, matrix)
    qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height = states[first - 1]
    state = NavState(qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height)
    for i in range(first, until):
        h, wx, wy, wz, fx, fy, fz = samples[i]
        sample = compensated((h, wx, wy, wz, fx, fy, fz), gyro_bias, accel_bias, matrix)
        state = step(state, previous, sample, instantaneous, vertical, water_surface)
        previous = sample
        for j in range(len(state)):
            states[i, j] = state[j]


def fill_states(
    samples: NDArray[np.float64],
    states: NDArray[np.float64],
    first: int,
    until: int,
    compensation: Compensation,
    instantaneous: bool,
    vertical: bool,
    water_surface: float,
) -> None:
    """Run `step` from the state of the row before ``first`` over the samples up to ``until``, compiled.

    One sample of the live tick, a block, and the samples since a correction are all integrated here.

    Parameters
    ----------
    samples : ndarray, shape (n, 7)
        Interval, angular rate, specific force a row.
    states : ndarray, shape (n, STATE_SIZE)
        At the stamps of the samples; those of the rows from ``first`` to ``until`` are written.
    first, until : int
        ``first`` is at least 1, ``until`` is not included.
    compensation : Compensation
        Of the samples.
    instantaneous, vertical, water_surface
        As in `step`.
    """
    compiled(_fill_states)(samples, states, first, until, *compensation, instantaneous, vertical, water_surface)


def integrate(
    state: NavState,
    previous: Sample,
    samples: NDArray[np.float64],
    compensation: Compensation = NO_COMPENSATION,
    *,
    instantaneous: bool = False,
    vertical: bool = True,
    water_surface: float = NO_WATER,
) -> NDArray[np.float64]:
    """`fill_states` over samples that follow a state.

    Parameters
    ----------
    state : NavState
        At the stamp of ``previous``.
    previous : Sample
        The sample before the first; where there is none, the first itself.
    samples : ndarray, shape (n, 7)
        Interval, angular rate, specific force a row.
    compensation : Compensation
        Of ``previous`` and the samples.
    instantaneous, vertical, water_surface
        As in `step`.

    Returns
    -------
    ndarray, shape (n, STATE_SIZE)
        The state at each sample's stamp.
    """
    rows = np.empty((len(samples) + 1, SAMPLE_SIZE))
    rows[0], rows[1:] = previous, samples
    states = np.empty((len(rows), STATE_SIZE))
    states[0] = state
    fill_states(rows, states, 1, len(rows), compensation, instantaneous, vertical, water_surface)
    return states[1:]


def prepare() -> None:
    """Compile `fill_states`, or load it from the cache, before samples arrive.

    0.5 s with numba's import, several seconds the first time on a machine: a live node cannot wait that long later.
    """
    for matrix in (None, np.eye(6)):
        integrate(
            NavState(*(0.0,) * STATE_SIZE), (0.0,) * 7, np.empty((0, 7)), Compensation(*NO_COMPENSATION[:2], matrix)
        )
