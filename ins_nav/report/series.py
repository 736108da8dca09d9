"""From bags to arrays: solutions of a navigator, and a reference.

Times are header stamps, not those of recording.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ins_nav.errors import InsNavError
from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagReader, DamagedBagError
from ins_nav.stamps import stamp_of

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_FIX = "sensor_msgs/msg/NavSatFix"
_IMU = "sensor_msgs/msg/Imu"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_COVARIANCE_UNKNOWN = 0
_REFERENCES = ("/truth/fix", "/reference/fix", "/gnss/fix")
_GAP = 5.0
"""Times the median interval: a longer one is a gap."""

_LEAST_SIGMA = 1e-9
"""rad."""


class ReportError(InsNavError):
    """A bag lacks the topics or messages of a report."""


@dataclass(frozen=True)
class Positions:
    """Geodetic positions.

    Attributes
    ----------
    stamps_ns : (n,)
    lat, lon, height : (n,)
        Rad, rad, m above the ellipsoid.
    stddev : (n, 3)
        East, north, up, m; NaN where not given.
    """

    stamps_ns: Stamps
    lat: Array
    lon: Array
    height: Array
    stddev: Array

    @property
    def ecef(self) -> Array:
        """Earth-fixed Cartesian, (n, 3), m."""
        return earth.geodetic_to_ecef(self.lat, self.lon, self.height)


@dataclass(frozen=True)
class Attitudes:
    """Body to local east-north-up: stamps (n,), n rotations, and their covariances on east, north, up, (n, 3, 3),
    rad², NaN where not given."""

    stamps_ns: Stamps
    rotations: Rotation
    covariance: Array

    @property
    def euler(self) -> Array:
        """Roll, pitch and heading (clockwise from north, in [0, 2 pi)), (n, 3), rad."""
        yaw, pitch, roll = self.rotations.as_euler("ZYX").T
        return np.column_stack([roll, pitch, (0.5 * np.pi - yaw) % (2.0 * np.pi)])

    @property
    def stddev(self) -> Array:
        """Of roll, pitch and heading, (n, 3), rad, from the covariance of small turns about east, north, up.

        NaN where not given, or rounding only, as that of a heading given as a parameter.
        """
        yaw, pitch, _ = self.rotations.as_euler("ZYX").T
        c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
        tangent, secant = np.tan(pitch), 1.0 / np.cos(pitch)
        jacobian = np.moveaxis(
            np.array([[c * secant, s * secant, zero], [-s, c, zero], [c * tangent, s * tangent, one]]), 2, 0
        )
        stddev = np.sqrt(np.einsum("nij,njk,nik->ni", jacobian, self.covariance, jacobian))
        return np.where(stddev > _LEAST_SIGMA, stddev, np.nan)


@dataclass(frozen=True)
class Velocities:
    """Stamps (n,) and velocity relative to the Earth, east, north, up, (n, 3), m/s."""

    stamps_ns: Stamps
    enu: Array


@dataclass(frozen=True)
class Track:
    """A trajectory by a navigator or a reference.

    Attributes
    ----------
    name : str
    position : Positions
    attitude : Attitudes or None
    velocity : Velocities or None
    bias : dict
        Last values on imu/bias: "gyro" (rad/s), "accel" (m/s²), each (3,).
    diagnostics : dict
        Last values on /diagnostics.
    damage : str
        Damage of the bag; empty when it is sound.
    """

    name: str
    position: Positions
    attitude: Attitudes | None
    velocity: Velocities | None
    bias: dict[str, Array] = field(default_factory=dict)
    diagnostics: dict[str, str] = field(default_factory=dict)
    damage: str = ""


def gaps(stamps_ns: Stamps) -> NDArray[np.bool_]:
    """Which of the n - 1 intervals of a series are gaps."""
    intervals = np.diff(stamps_ns)
    return np.asarray(intervals > _GAP * np.median(intervals))


def covered(stamps_ns: Stamps, at_ns: Stamps) -> NDArray[np.bool_]:
    """Where a series can be interpolated: not before it, not after it, not in a gap.

    Parameters
    ----------
    stamps_ns : (n,)
        Of the series, ascending; n at least 2.
    at_ns : (m,)
        Stamps of interest.

    Returns
    -------
    (m,) of bool
    """
    after = np.clip(np.searchsorted(stamps_ns, at_ns), 1, len(stamps_ns) - 1)
    inside = (at_ns >= stamps_ns[0]) & (at_ns <= stamps_ns[-1])
    exact = (stamps_ns[after] == at_ns) | (stamps_ns[after - 1] == at_ns)
    return np.asarray(inside & (exact | ~gaps(stamps_ns)[after - 1]))


def interpolated(stamps_ns: Stamps, values: Array, at_ns: Stamps) -> Array:
    """Values (n, k) of a series at other stamps, linearly, (m, k)."""
    seconds, at = _seconds(stamps_ns, stamps_ns[0]), _seconds(at_ns, stamps_ns[0])
    return np.column_stack([np.interp(at, seconds, column) for column in values.T])


def rotations_at(attitude: Attitudes, at_ns: Stamps) -> Rotation:
    """Attitudes at other stamps within their range, by spherical interpolation."""
    start = attitude.stamps_ns[0]
    return Slerp(_seconds(attitude.stamps_ns, start), attitude.rotations)(_seconds(at_ns, start))


def read_result(path: Path, name: str) -> Track:
    """Result of ins_process, or recording of ins_node: /fix, /imu/data, /odometry, and optional topics.

    Raises
    ------
    ReportError, BagError
    """
    with BagReader(path) as bag:
        topics = {"/fix": _FIX, "/imu/data": _IMU, "/odometry": _ODOMETRY}
        for topic in topics:
            if topic not in bag.topics:
                there = ", ".join(bag.topics)
                raise ReportError(f"{path}: is not a result bag, it has no {topic}; topics: {there}")
        extras = {"/imu/bias": _IMU, "/diagnostics": _DIAGNOSTICS}
        topics |= {topic: msgtype for topic, msgtype in extras.items() if topic in bag.topics}
        rows, damage = _read(bag, topics)
        positions = _positions(path, "/fix", rows["/fix"])
        attitudes = _attitudes(rows["/imu/data"])
        if attitudes is None:
            raise ReportError(f"{path}: /imu/data has fewer than 2 orientations")
        velocities = _velocities(rows["/odometry"], attitudes)
        biases, diagnostics = (rows[topic].items if topic in rows else [] for topic in extras)
        bias = {"gyro": np.array(biases[-1][13:16]), "accel": np.array(biases[-1][16:19])} if biases else {}
        return Track(name, positions, attitudes, velocities, bias, diagnostics[-1] if diagnostics else {}, damage)


def _find_reference(bag: BagReader, topic: str | None) -> str | None:
    """Name of the reference's NavSatFix topic: the requested one, else the best available, else None.

    Raises
    ------
    BagError
        If the topic asked for is not in the bag.
    ReportError
        If it is no NavSatFix.
    """
    if topic is None:
        return next((name for name in _REFERENCES if name in bag.topics), None)
    name = bag.topic(topic)
    _check_type(bag, name, _FIX)
    return name


def read_reference(path: Path, topic: str | None = None) -> Track | None:
    """The reference in a bag; None without one.

    A reference is a NavSatFix topic and, where present, other topics under the same prefix:
    ``imu`` or ``imu/data`` for orientation, ``velocity`` (east, north, up) or ``odometry`` for velocity.

    Raises
    ------
    ReportError, BagError
    """
    with BagReader(path) as bag:
        fix = _find_reference(bag, topic)
        if fix is None:
            return None
        prefix = fix.rpartition("/")[0]
        imu = _first(bag, prefix, {"imu": _IMU, "imu/data": _IMU})
        velocity = _first(bag, prefix, {"velocity": _TWIST, "odometry": _ODOMETRY})
        rows, damage = _read(bag, {fix: _FIX} | imu | velocity)
        attitude = next((_attitudes(rows[name]) for name in imu), None)
        velocities = next((_velocities(rows[name], attitude) for name in velocity), None)
        return Track(fix, _positions(path, fix, rows[fix]), attitude, velocities, damage=damage)


def _first(bag: BagReader, prefix: str, wanted: Mapping[str, str]) -> dict[str, str]:
    """The first of the topics, with its type, that the bag has under the prefix, or none."""
    for name, msgtype in wanted.items():
        info = bag.topics.get(f"{prefix}/{name}")
        if info is not None and info.msgtype == msgtype:
            return {f"{prefix}/{name}": msgtype}
    return {}


class _Rows:
    """Stamps and values of one topic, in order of arrival."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.items: list[Any] = []

    def arrays(self) -> tuple[Stamps, Array]:
        """Sorted by stamp, each stamp once."""
        stamps, index = np.unique(np.array(self.stamps, dtype=np.int64), return_index=True)
        return stamps, np.array(self.items, dtype=float)[index]


def _fix_row(m: Any) -> Any:
    if m.status.status < 0 or not np.isfinite(m.latitude + m.longitude + m.altitude):
        return None
    known = m.position_covariance_type != _COVARIANCE_UNKNOWN
    variance = m.position_covariance[::4].tolist() if known else (np.nan,) * 3
    return (m.latitude, m.longitude, m.altitude, *variance)


def _imu_row(m: Any) -> Any:
    q, rate, force = m.orientation, m.angular_velocity, m.linear_acceleration
    return (q.x, q.y, q.z, q.w, *m.orientation_covariance.tolist(), rate.x, rate.y, rate.z, force.x, force.y, force.z)


def _twist_row(m: Any) -> Any:
    v = m.twist.twist.linear
    return v.x, v.y, v.z


def _odometry_row(m: Any) -> Any:
    """A row with a fourth value, which marks the body's axes."""
    return (*_twist_row(m), 1.0)


def _diagnostics_row(m: Any) -> Any:
    ours = [status for status in m.status if status.name.endswith(": navigation")]
    return {"summary": ours[0].message} | {v.key: v.value for v in ours[0].values} if ours else None


_ROW: dict[str, Callable[[Any], Any]] = {
    _FIX: _fix_row,
    _IMU: _imu_row,
    _TWIST: _twist_row,
    _ODOMETRY: _odometry_row,
    _DIAGNOSTICS: _diagnostics_row,
}


def _check_type(bag: BagReader, topic: str, msgtype: str) -> None:
    if bag.topics[topic].msgtype != msgtype:
        raise ReportError(f"{bag.path}: {topic} is of type {bag.topics[topic].msgtype}, expected {msgtype}")


def _read(bag: BagReader, topics: Mapping[str, str]) -> tuple[dict[str, _Rows], str]:
    """The rows of each topic, and the damage of the bag."""
    from tqdm import tqdm

    for topic, msgtype in topics.items():
        _check_type(bag, topic, msgtype)
    rows = {topic: _Rows() for topic in topics}
    total = sum(bag.topics[topic].count for topic in topics)
    try:
        for raw in tqdm(bag.messages(topics), bag.path.name, total, leave=False, unit=" messages", disable=None):
            message = bag.deserialize(raw)
            row = _ROW[raw.msgtype](message)
            if row is not None:
                rows[raw.topic].stamps.append(stamp_of(message))
                rows[raw.topic].items.append(row)
    except DamagedBagError as error:
        return rows, str(error)
    return rows, ""


def _positions(path: Path, topic: str, rows: _Rows) -> Positions:
    stamps, values = rows.arrays() if rows.items else (np.zeros(0, np.int64), np.zeros((0, 6)))
    if len(stamps) < 2:
        raise ReportError(f"{path}: {topic} has fewer than 2 valid positions")
    lat, lon = np.radians(values[:, 0]), np.radians(values[:, 1])
    variance = np.where(values[:, 3:6] > 0.0, values[:, 3:6], np.nan)
    return Positions(stamps, lat, lon, values[:, 2], np.sqrt(variance))


def _attitudes(rows: _Rows) -> Attitudes | None:
    if not rows.items:
        return None
    stamps, values = rows.arrays()
    given = (values[:, 4] >= 0.0) & (np.abs(np.linalg.norm(values[:, :4], axis=1) - 1.0) < 0.1)
    if np.count_nonzero(given) < 2:
        return None
    covariance = values[given, 4:13].reshape(-1, 3, 3)
    covariance[~covariance.any(axis=(1, 2))] = np.nan
    return Attitudes(stamps[given], Rotation.from_quat(values[given, :4]), covariance)


def _velocities(rows: _Rows, attitude: Attitudes | None) -> Velocities | None:
    """East, north, up; a velocity on the body's axes requires the attitude."""
    if not rows.items:
        return None
    stamps, values = rows.arrays()
    if values.shape[1] == 4:
        if attitude is None:
            return None
        known = covered(attitude.stamps_ns, stamps)
        stamps = stamps[known]
        values = rotations_at(attitude, stamps).apply(values[known, :3])
    return Velocities(stamps, values) if len(stamps) >= 2 else None


def _seconds(stamps_ns: Stamps, start_ns: Any) -> Array:
    return np.asarray((stamps_ns - start_ns) * 1e-9)
