"""Simulated readings of aids: the truth that they measure, their instants and random numbers, and their messages.

An aid that can be simulated declares a section of parameters (`Aid.SIMULATED`) and draws its readings in
`Aid.simulate`; `ins_nav.simulation` has the motion and writes the messages. A sensor measures at the trajectory's
instants nearest to its own, and is where its lever arm puts it. Every error source draws from a stream of its own,
named after it, and draws for every instant, with a reading or without: switching one source on or off does not change
the draws of the others.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ins_nav.config.declaration import Section
from ins_nav.errors import InsNavError
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.mechanization import earth
from ins_nav.stamps import NS

Stamps = NDArray[np.int64]
Index = NDArray[np.int64]
MakeMessage = Callable[..., Any]
"""Factory of a message: type ``package/msg/Name``, fields by name; the other fields are zero."""
Messages = Iterator[tuple[int, Any]]
"""Messages with their stamps, ns, in order."""
S = TypeVar("S", bound=Section)
_CHUNK = 10_000
UNKNOWN = 1e9
"""Variance of fields of a message that the sensor does not measure."""


class Readings(Protocol):
    """Simulated readings of an aid."""

    @property
    def stamps_ns(self) -> Stamps:
        """Shape (m,)."""

    @property
    def message_type(self) -> str:
        """``package/msg/Name``."""

    def messages(self, make: MakeMessage) -> Messages:
        """The readings as messages."""


class Truth(Protocol):
    """True states at m instants (`ins_nav.simulation.trajectory.States`)."""

    @property
    def time(self) -> Array:
        """(m,), s."""

    @property
    def lat(self) -> Array:
        """(m,), rad."""

    @property
    def lon(self) -> Array:
        """(m,), rad."""

    @property
    def height(self) -> Array:
        """(m,), ellipsoidal, m."""

    @property
    def q_nb(self) -> Array:
        """(m, 4), x y z w, body to east-north-up."""

    @property
    def position_e(self) -> Array:
        """(m, 3), Earth-fixed, m."""

    @property
    def velocity_e(self) -> Array:
        """(m, 3), relative to Earth, on Earth-fixed axes, m/s."""

    @property
    def q_eb(self) -> Array:
        """(m, 4), body to Earth-fixed axes."""

    @property
    def rate(self) -> Array:
        """(m, 3), of the body in inertial space, on body axes, rad/s."""


class Circle(Protocol):
    """True states of a point that circles a place on the tangent plane at the trajectory's origin."""

    def __call__(self, centre: Vector, radius: float, period: float, time: Array) -> Truth:
        """East, north, up of the centre and the radius, m; period and times, s."""


@dataclass(frozen=True)
class World:
    """Truth of a simulation, measured by the aids.

    Attributes
    ----------
    parameters : mapping
        All of the simulation's, by full name.
    truth : Truth
        At n + 1 instants, evenly spaced.
    stamps_ns : ndarray, shape (n + 1,)
    seed : int
        Not negative.
    origin : (lat, lon, height)
        Of the tangent plane, rad and m.
    circle : Circle
    """

    parameters: Mapping[str, Any]
    truth: Truth
    stamps_ns: Stamps
    seed: int
    origin: tuple[float, float, float]
    circle: Circle

    def section(self, kind: type[S], prefix: str) -> S:
        """The parameters of a section."""
        values = {row.name: self.parameters[row.name] for row in kind.rows(prefix)}
        return kind.from_values(prefix, {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()})

    def instants(self, rate: float, name: str) -> Index:
        """Indices of the instants nearest to those of a sensor with a rate, Hz (0: none).

        Raises
        ------
        InsNavError
            If the sensor is faster than the trajectory; ``name`` is that of its parameter.
        """
        return instants(self.truth.time, rate, name)

    def stream(self, name: str) -> np.random.Generator:
        """The random numbers of one named source."""
        return stream(self.seed, name)

    def velocity_body(self, index: Index, arm: Vector) -> Array:
        """Velocity over ground of a place on the body, on body axes, m/s, (m, 3)."""
        t = self.truth
        q = t.q_eb[index]
        rate = t.rate[index] - turned(q, [0.0, 0.0, earth.RATE], inverse=True)
        return turned(q, t.velocity_e[index], inverse=True) + np.cross(rate, arm)

    def height(self, index: Index, arm: Vector) -> Array:
        """Ellipsoidal height of a place on the body, m, to d² / 2R, (m,)."""
        up: Array = self.truth.height[index] + turned(self.truth.q_nb[index], arm)[:, 2]
        return up

    def outliers(
        self, name: str, share: float, span: Sequence[float], source: str, count: int
    ) -> tuple[NDArray[np.bool_], Array]:
        """Outliers: which readings, and the errors that they would have.

        Raises
        ------
        InsNavError
            If the span, parameter ``<name>_span``, goes down.
        """
        low, high = span
        if low > high:
            raise InsNavError(f"{name}_span: [{low:g}, {high:g}] goes down; give the smaller number first")
        wrong = self.stream(f"{source}.outlier").random(count) < share
        return wrong, self.stream(f"{source}.outlier_size").uniform(low, high, count)


class Fixes(NamedTuple):
    """Position fixes, m of them."""

    stamps_ns: Stamps
    lat: Array
    """(m,), rad."""
    lon: Array
    """(m,), rad."""
    height: Array
    """(m,), ellipsoidal, m."""
    stddev: Vector
    """East, north, up, m."""
    frame_id: str = "gnss_link"
    message_type: str = "sensor_msgs/msg/NavSatFix"

    def messages(self, make: MakeMessage) -> Messages:
        """As sensor_msgs/NavSatFix."""
        covariance = np.diag(np.square(self.stddev)).ravel().tolist()
        for stamp, lat, lon, height in rows(self.stamps_ns, np.degrees(self.lat), np.degrees(self.lon), self.height):
            yield stamp, fix_message(make, stamp, 0, lat, lon, height, covariance, self.frame_id)


def instants(time: Array, rate: float, name: str) -> Index:
    """As `World.instants`, of instants that are evenly spaced from 0, s, shape (n + 1,)."""
    interval = float(time[-1]) / (len(time) - 1)
    if rate * interval > 1.0:
        raise InsNavError(f"{name} {rate:g} Hz is above the IMU's rate; lower it")
    count = int(time[-1] * rate + 1e-6) + 1 if rate else 0
    return np.rint(np.arange(count) / np.float64(rate * interval)).astype(np.int64)


def stream(seed: int, name: str) -> np.random.Generator:
    """The random numbers of one named source.

    Raises
    ------
    InsNavError
        If the seed is negative.
    """
    if seed < 0:
        raise InsNavError(f"seed {seed} is negative; give 0 or more")
    return np.random.default_rng([seed, *name.encode()])


def moved(lat: Array, lon: Array, height: Array, offset: Array) -> tuple[Array, Array, Array]:
    """Position moved by a few metres east, north, up (n, 3); to d²/2R (0.1 mm at 30 m), at the poles too."""
    meridian, prime_vertical = earth.principal_radii(np.sin(lat))
    east, north = offset[:, 0] / (prime_vertical + height), offset[:, 1] / (meridian + height)
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    x = cl * co - east * so - north * sl * co
    y = cl * so + east * co - north * sl * so
    z = sl + north * cl
    return np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x), height + offset[:, 2]


def turned(q: Array, vector: ArrayLike, inverse: bool = False) -> Array:
    """One vector, or one each, turned by quaternions; by none too, which older scipy refuses; (m, 3)."""
    if not len(q):
        return np.zeros((0, 3))
    result: Array = Rotation.from_quat(q).apply(vector, inverse=inverse)
    return result


def within(time: Array, start: float, duration: float, period: float = 0.0) -> NDArray[np.bool_]:
    """Which times, s, are in a window, or in one of its periodic repetitions."""
    since = time - start
    if period:
        since = np.where(since < 0.0, since, since % period)
    inside: NDArray[np.bool_] = (since >= 0.0) & (since < duration)
    return inside


def rows(*arrays: NDArray[Any]) -> Iterator[Any]:
    """Rows of all arrays together, as plain numbers."""
    for start in range(0, len(arrays[0]), _CHUNK):
        yield from zip(*(array[start : start + _CHUNK].tolist() for array in arrays), strict=True)


def header(make: MakeMessage, stamp_ns: int, frame_id: str) -> Any:
    """std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def fix_message(
    make: MakeMessage,
    stamp_ns: int,
    status: int,
    latitude_deg: float,
    longitude_deg: float,
    height: float,
    covariance: Sequence[float] = (),
    frame_id: str = "gnss_link",
) -> Any:
    """sensor_msgs/NavSatFix; covariance on east, north, up, row by row, m², empty: unknown."""
    return make(
        "sensor_msgs/msg/NavSatFix",
        header=header(make, stamp_ns, frame_id),
        status=make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        latitude=latitude_deg,
        longitude=longitude_deg,
        altitude=height,
        position_covariance=np.array(covariance, float) if len(covariance) else np.zeros(9),
        position_covariance_type=2 if len(covariance) else 0,  # diagonal known
    )


def velocity_message(
    make: MakeMessage,
    stamp_ns: int,
    velocity: Sequence[float],
    covariance: Sequence[float] = (),
    frame_id: str = "log_link",
) -> Any:
    """geometry_msgs/TwistWithCovarianceStamped; m/s, covariance row by row, m²/s², empty: zeros."""
    matrix = np.diag([UNKNOWN] * 6)
    matrix[:3, :3] = np.reshape(covariance, (3, 3)) if len(covariance) else 0.0
    x, y, z = velocity
    linear, angular = (make("geometry_msgs/msg/Vector3", x=a, y=b, z=c) for a, b, c in ((x, y, z), (0.0, 0.0, 0.0)))
    content = make("geometry_msgs/msg/Twist", linear=linear, angular=angular)
    twist = make("geometry_msgs/msg/TwistWithCovariance", twist=content, covariance=matrix.ravel())
    return make("geometry_msgs/msg/TwistWithCovarianceStamped", header=header(make, stamp_ns, frame_id), twist=twist)


def isotropic(stddev: float) -> list[float]:
    """Covariance with that sigma on each of three axes, row by row."""
    covariance: list[float] = (stddev**2 * np.eye(3)).ravel().tolist()
    return covariance
