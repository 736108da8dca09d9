"""The navigation state: attitude, velocity, position, and what a user reads off them.

The navigation frame n is horizontal, its z axis up, free in azimuth: see `ins_nav.mechanization.strapdown`.

References
----------
.. [2] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base: the equations of
       navigation in the free-azimuth frame.
"""

import math
from typing import NamedTuple

from scipy.spatial.transform import Rotation

from ins_nav.mechanization import attitude
from ins_nav.mechanization.attitude import Quaternion, from_rotation_vector, multiply, rotate
from ins_nav.mechanization.earth import (
    ECCENTRICITY_SQUARED,
    RATE,
    enu_axes,
    geodetic_to_ecef,
    principal_radii,
)


class NavState(NamedTuple):
    """Attitude, velocity and position of the body.

    Slices are the quaternions and the velocity: ``state[0:4]``, ``state[4:7]``, ``state[7:11]``.

    Attributes
    ----------
    q_nb_x, q_nb_y, q_nb_z, q_nb_w : float
        Body (FLU) to n.
    v_x, v_y, v_z : float
        Velocity relative to the Earth on n, m/s.
    q_en_x, q_en_y, q_en_z, q_en_w : float
        n to Earth-fixed axes: position and azimuth of the frame in one.
    height : float
        Above the ellipsoid, m.
    """

    q_nb_x: float
    q_nb_y: float
    q_nb_z: float
    q_nb_w: float
    v_x: float
    v_y: float
    v_z: float
    q_en_x: float
    q_en_y: float
    q_en_z: float
    q_en_w: float
    height: float


STATE_SIZE = len(NavState._fields)


def initial_state(
    lat: float,
    lon: float,
    height: float,
    velocity_g: tuple[float, float, float],
    q_gb: Quaternion,
) -> NavState:
    """State from what a user knows; n starts as east-north-up.

    Parameters
    ----------
    lat, lon : float
        Geodetic, rad.
    height : float
        Ellipsoidal, m.
    velocity_g : 3 floats
        East, north, up, m/s.
    q_gb : Quaternion
        Body to east-north-up.
    """
    q_en = Rotation.from_matrix(enu_axes(lat, lon)).as_quat()
    return NavState(*map(float, (*q_gb, *velocity_g, *q_en, height)))


def corrected(
    state: NavState,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> NavState:
    """A state with corrections on the axes of n added.

    Parameters
    ----------
    state : NavState
    position : 3 floats
        Two along the horizontal axes, one up, m. n goes along without turning about the vertical; attitude relative
        to n stays.
    velocity : 3 floats
        m/s.
    rotation : 3 floats
        Rotation vector by which the body turns relative to n, rad.
    """
    ex, ey, ez, ew, height = state[7:]
    rx = 2.0 * (ex * ez - ey * ew)
    ry = 2.0 * (ey * ez + ex * ew)
    rz = 1.0 - 2.0 * (ex * ex + ey * ey)
    meridian, prime_vertical = principal_radii(rz)
    r_n, r_m = prime_vertical + height, meridian + height
    k = ECCENTRICITY_SQUARED * prime_vertical / ((1.0 - ECCENTRICITY_SQUARED * rz * rz) * r_m * r_n)
    dx, dy, dz = position
    along = k * (rx * dx + ry * dy)
    turn = from_rotation_vector(-(dy / r_n + along * ry), dx / r_n + along * rx, 0.0)
    q_en = attitude.normalized(multiply((ex, ey, ez, ew), turn))
    q_nb = attitude.normalized(multiply(from_rotation_vector(*rotation), state[0:4]))
    vx, vy, vz = state[4:7]
    return NavState(*q_nb, vx + velocity[0], vy + velocity[1], vz + velocity[2], *q_en, height + dz)


def up_axis(state: NavState) -> tuple[float, float, float]:
    """The vertical on the body's axes."""
    x, y, z, w = state[0:4]
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def heading_change(before: NavState, after: NavState) -> float:
    """Turn of the body about the vertical from one solution to another of the same instant, rad, left positive."""
    yaw = (attitude.to_euler(geodetic(state).q_gb)[2] for state in (before, after))
    return math.remainder(-next(yaw) + next(yaw), 2.0 * math.pi)


class Geodetic(NamedTuple):
    """A state in the user's terms: geodetic position, rad and m; east-north-up velocity, m/s; body to ENU."""

    lat: float
    lon: float
    height: float
    velocity_g: tuple[float, float, float]
    q_gb: Quaternion


def geodetic(state: NavState) -> Geodetic:
    """Position, velocity and attitude on east-north-up axes ([2]_: λ, φ and χ from B_xη).

    At a pole longitude is a convention; it and the azimuth of the axes are consistent with each other.
    """
    qx, qy, qz, qw, vx, vy, vz, ex, ey, ez, ew, height = state
    ux = 2.0 * (ex * ez + ey * ew)  # the vertical on Earth-fixed axes: third column of C_en
    uy = 2.0 * (ey * ez - ex * ew)
    uz = 1.0 - 2.0 * (ex * ex + ey * ey)
    cos_lat = math.hypot(ux, uy)
    chi = math.atan2(ex * ez - ey * ew, ey * ez + ex * ew)
    c, s = math.cos(chi), math.sin(chi)
    turn = (0.0, 0.0, math.sin(0.5 * chi), math.cos(0.5 * chi))
    return Geodetic(
        math.atan2(uz, cos_lat),
        math.atan2(uy, ux),
        height,
        (c * vx - s * vy, s * vx + c * vy, vz),
        multiply(turn, (qx, qy, qz, qw)),
    )


def position_ecef(state: NavState) -> tuple[float, float, float]:
    """Earth-fixed Cartesian position, m."""
    ex, ey, ez, ew, height = state[7:]
    uz = 1.0 - 2.0 * (ex * ex + ey * ey)
    _, prime_vertical = principal_radii(uz)
    r = prime_vertical + height
    return (
        r * 2.0 * (ex * ez + ey * ew),
        r * 2.0 * (ey * ez - ex * ew),
        (r - ECCENTRICITY_SQUARED * prime_vertical) * uz,
    )


def position_in(axes: Quaternion, origin: tuple[float, float, float], state: NavState) -> tuple[float, float, float]:
    """`MapFrame.position` in a map with these axes and this origin."""
    x, y, z = position_ecef(state)
    return rotate(axes, x - origin[0], y - origin[1], z - origin[2])


def attitude_in(axes: Quaternion, state: NavState) -> Quaternion:
    """`MapFrame.attitude` in a map with these axes."""
    return multiply(multiply(axes, state[7:11]), state[0:4])


class MapFrame:
    """The ``map`` frame (REP-105): the east-north-up tangent plane at an origin.

    Parameters
    ----------
    lat, lon : float
        Origin, rad.
    height : float
        Origin, m above the ellipsoid.

    Attributes
    ----------
    origin : 3 floats
        Earth-fixed, m.
    axes : Quaternion
        Earth-fixed axes to those of the map.
    """

    def __init__(self, lat: float, lon: float, height: float) -> None:
        axes = enu_axes(lat, lon)
        x, y, z = map(float, geodetic_to_ecef(lat, lon, height))
        self.origin = x, y, z
        x, y, z, w = Rotation.from_matrix(axes.T).as_quat().tolist()
        self.axes: Quaternion = (x, y, z, w)

    def position(self, state: NavState) -> tuple[float, float, float]:
        """Position of a state in the map, m."""
        return position_in(self.axes, self.origin, state)

    def attitude(self, state: NavState) -> Quaternion:
        """Body to map of a state."""
        return attitude_in(self.axes, state)


def velocity_body(state: NavState) -> tuple[float, float, float]:
    """Velocity relative to the Earth on body axes, m/s."""
    qx, qy, qz, qw, vx, vy, vz = state[0:7]
    return rotate((-qx, -qy, -qz, qw), vx, vy, vz)


def earth_rate_body(state: NavState) -> tuple[float, float, float]:
    """Earth's rate on body axes, rad/s."""
    qx, qy, qz, qw, _, _, _, ex, ey, ez, ew, _ = state
    axis = (2.0 * (ex * ez - ey * ew), 2.0 * (ey * ez + ex * ew), 1.0 - 2.0 * (ex * ex + ey * ey))
    return rotate((-qx, -qy, -qz, qw), RATE * axis[0], RATE * axis[1], RATE * axis[2])
