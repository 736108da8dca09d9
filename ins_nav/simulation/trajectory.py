"""A motion laid on the rotating ellipsoid: true position, velocity and attitude, and readings of ideal sensors.

Everything is in closed form, from derivatives of the motion; only the sensors' output over a sampling interval is
integrated. A trajectory is therefore an oracle for the mechanization, independent of it.

The plane of `ins_nav.simulation.motion` is wrapped on a graticule whose equator goes through the origin to the
east: ``phi = y / (R_M + h)`` and ``lam = x / (R_N + h)`` are the latitude and longitude on it of the geodetic
normal, with the radii and height of the origin. This graticule is regular for thousands of kilometres around the
origin, at the real poles too. Off the origin the scale differs from 1 slowly (1e-5 at 10 km): a speed of 10 m/s
is then 10.0001 m/s. That shifts the truth, not its consistency.

Frames: e Earth-fixed, n true east-north-up, g east-north-up of the graticule, b body. The derivation works on
the axes of g, which turns against e at ``w = (-phi', lam' cos(phi), lam' sin(phi))``; with the unit vectors
u (normal) and k (Earth's axis), ``s = u k`` the sine of latitude and N the radius of the prime vertical::

    r = (N + h) u - e² N s k,   du/dt = w × u,   f = r'' + 2 Ω k × r' - gravity
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import earth
from ins_nav.simulation.motion import Array, Motion

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_CHUNK = 20_000
"""Samples processed at once: an hour at 400 Hz then fits into some hundred megabytes."""


@dataclass(frozen=True)
class Origin:
    """Point at which the plane touches: geodetic latitude and longitude, rad, ellipsoidal height, m."""

    lat: float
    lon: float
    height: float


@dataclass(frozen=True, kw_only=True)
class States:
    """True states at m instants, and readings of ideal sensors at them."""

    time: Array
    """(m,), s."""
    lat: Array
    """(m,), rad."""
    lon: Array
    """(m,), rad, in (-pi, pi]."""
    height: Array
    """(m,), above the ellipsoid, m."""
    velocity_n: Array
    """(m, 3), relative to Earth, east-north-up, m/s."""
    q_nb: Array
    """(m, 4), x y z w, body to true east-north-up."""
    position_e: Array
    """(m, 3), Earth-fixed, m."""
    velocity_e: Array
    """(m, 3), relative to Earth, on Earth-fixed axes, m/s."""
    q_eb: Array
    """(m, 4), body to Earth-fixed axes; unlike q_nb regular at the poles."""
    rate: Array
    """(m, 3), of the body in inertial space, on body axes, rad/s."""
    specific_force: Array
    """(m, 3), on body axes, m/s²."""


@dataclass(frozen=True, kw_only=True)
class Trajectory(States):
    """States at n + 1 instants, and the increments of the n sampling intervals between them."""

    origin: Origin
    delta_theta: Array
    """(n, 3), integral of the rate over the interval, rad."""
    delta_velocity: Array
    """(n, 3), integral of the specific force, on the turning body axes, over the interval, m/s."""

    @property
    def interval(self) -> float:
        """Sampling interval, s."""
        return float(self.time[-1]) / (len(self.time) - 1)


class EarthMotion:
    """A motion on the Earth: states and ideal readings at any time.

    Parameters
    ----------
    motion : Motion
        On the plane.
    origin : Origin
        Where the plane touches; z = 0 is its height.
    water_surface : float
        Ellipsoidal height, m: below it gravity is that in water.
    """

    def __init__(self, motion: Motion, origin: Origin, water_surface: float = earth.NO_WATER) -> None:
        self.motion = motion
        self.water_surface = water_surface
        self.origin = origin
        self._sin_lat, self._cos_lat = math.sin(origin.lat), math.cos(origin.lat)
        meridian, prime_vertical = earth.principal_radii(self._sin_lat)
        self._radii = np.array([[prime_vertical + origin.height], [meridian + origin.height]])
        self._rot_e0 = earth.enu_axes(origin.lat, origin.lon)

    def readings(self, t: Array) -> tuple[Array, Array]:
        """Angular rate in inertial space, rad/s, and specific force, m/s², on body axes at times t: two (n, 3)."""
        point = _Point(self, t)
        return point.rate.T, point.specific_force.T

    def states(self, t: Array) -> States:
        """States at times t, s, shape (n,)."""
        p = _Point(self, t)
        sl, cl, sp, cp = p.trig
        zero = np.zeros_like(sl)
        axes_g = np.array([[cl, zero, -sl], [-sp * sl, cp, -sp * cl], [cp * sl, sp, cp * cl]])
        axes_e = np.einsum("ij,ajn->ain", self._rot_e0, axes_g)  # east, north, up of g on the axes of e
        normal = axes_e[2]
        position = (p.prime_vertical + p.height) * normal
        position[2] -= earth.ECCENTRICITY_SQUARED * p.prime_vertical * p.axis[2]
        # north of g to true north, counter-clockwise
        convergence = np.arctan2(-p.axis[0], p.axis[1])
        sc, cc = np.sin(convergence), np.cos(convergence)
        yaw, pitch, roll = p.angles
        graticule = Rotation.from_euler("YX", np.stack([p.graticule[0], -p.graticule[1]], axis=-1))
        body = Rotation.from_euler("ZYX", p.angles.T)
        return States(
            time=t,
            lat=np.arctan2(normal[2], np.hypot(normal[0], normal[1])),
            lon=np.arctan2(normal[1], normal[0]),
            height=p.height,
            velocity_n=np.stack(
                [cc * p.velocity[0] + sc * p.velocity[1], cc * p.velocity[1] - sc * p.velocity[0], p.velocity[2]],
                axis=-1,
            ),
            q_nb=Rotation.from_euler("ZYX", np.stack([yaw - convergence, pitch, roll], axis=-1)).as_quat(),
            position_e=position.T,
            velocity_e=np.einsum("ain,an->ni", axes_e, p.velocity),
            q_eb=(Rotation.from_matrix(self._rot_e0) * graticule * body).as_quat(),
            rate=p.rate.T,
            specific_force=p.specific_force.T,
        )

    def trajectory(self, rate: float) -> Trajectory:
        """The whole motion sampled at a rate, Hz.

        The increments are integrals by 4-point Gauss-Legendre quadrature.
        """
        count = round(self.motion.duration * rate)
        dt = 1.0 / rate
        states: list[States] = []
        theta: list[Array] = []
        velocity: list[Array] = []
        for start in range(0, count + 1, _CHUNK):
            t = np.arange(start, min(start + _CHUNK, count + 1)) / rate
            states.append(self.states(t))
            left = t[: count - start]
            rates, forces = self.readings((left[:, None] + (0.5 + 0.5 * _NODES) * dt).ravel())
            theta.append(0.5 * dt * (_WEIGHTS @ rates.reshape(-1, len(_NODES), 3)))
            velocity.append(0.5 * dt * (_WEIGHTS @ forces.reshape(-1, len(_NODES), 3)))
        joined = {f.name: np.concatenate([getattr(s, f.name) for s in states]) for f in fields(States)}
        return Trajectory(
            origin=self.origin, delta_theta=np.concatenate(theta), delta_velocity=np.concatenate(velocity), **joined
        )


class _Point:
    """Kinematics at n instants, on the axes of the graticule; vectors have shape (3, n)."""

    def __init__(self, on: EarthMotion, t: Array) -> None:
        motion = on.motion.sample(t)
        self.angles = motion.angles
        self.height = on.origin.height + motion.position[2]
        self.graticule = motion.position[:2] / on._radii
        rate, second = motion.velocity[:2] / on._radii, motion.acceleration[:2] / on._radii
        sl, sp = np.sin(self.graticule)
        cl, cp = np.cos(self.graticule)
        self.trig = sl, cl, sp, cp
        # Earth's axis on the axes of g
        self.axis = k = np.stack(
            [-sl * on._sin_lat, cp * on._cos_lat - sp * cl * on._sin_lat, sp * on._cos_lat + cp * cl * on._sin_lat]
        )
        w = np.stack([-rate[1], rate[0] * cp, rate[0] * sp])
        u = np.array([[0.0], [0.0], [1.0]])
        u1 = _cross(w, u)
        w_dot_u = np.stack([second[0] * cp - rate[0] * rate[1] * sp, second[1], np.zeros_like(cp)])  # dw/dt × u
        u2 = w_dot_u + _cross(w, u1)
        s, s1, s2 = k[2], np.sum(u1 * k, axis=0), np.sum(u2 * k, axis=0)
        e2, a2 = earth.ECCENTRICITY_SQUARED, earth.SEMI_MAJOR_AXIS**2
        _, radius = earth.principal_radii(s)
        radius1 = e2 / a2 * radius**3 * s * s1
        radius2 = e2 / a2 * (3.0 * radius**2 * radius1 * s * s1 + radius**3 * (s1 * s1 + s * s2))
        self.prime_vertical = radius
        climb, climb1 = motion.velocity[2], motion.acceleration[2]
        self.velocity = (radius1 + climb) * u + (radius + self.height) * u1 - e2 * (radius1 * s + radius * s1) * k
        acceleration = (
            (radius2 + climb1) * u
            + 2.0 * (radius1 + climb) * u1
            + (radius + self.height) * u2
            - e2 * (radius2 * s + 2.0 * radius1 * s1 + radius * s2) * k
        )
        # north component c h sin(2 lat) along (k - s u) / cos(lat): no division, so regular at the poles
        gravity = (2.0 * earth.NORTH_GRAVITY_PER_METRE * self.height * s) * (k - s * u)
        gravity -= earth.normal_gravity(s, self.height, on.water_surface) * u
        force = acceleration + 2.0 * earth.RATE * _cross(k, self.velocity) - gravity
        sin, cos = np.sin(self.angles), np.cos(self.angles)
        yaw1, pitch1, roll1 = motion.angle_rates
        euler_rate = np.stack(
            [
                roll1 - yaw1 * sin[1],
                pitch1 * cos[2] + yaw1 * sin[2] * cos[1],
                yaw1 * cos[2] * cos[1] - pitch1 * sin[2],
            ]
        )
        self.rate = euler_rate + _to_body(sin, cos, w + earth.RATE * k)
        self.specific_force = _to_body(sin, cos, force)


def _to_body(sin: Array, cos: Array, v: Array) -> Array:
    """Vectors v turned from the axes of g to the body, by sines and cosines of yaw, pitch, roll."""
    x, y, z = v
    x, y = cos[0] * x + sin[0] * y, cos[0] * y - sin[0] * x
    x, z = cos[1] * x - sin[1] * z, cos[1] * z + sin[1] * x
    y, z = cos[2] * y + sin[2] * z, cos[2] * z - sin[2] * y
    return np.stack([x, y, z])


def _cross(a: Array, b: Array) -> Array:
    """Cross product along the first axis."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
