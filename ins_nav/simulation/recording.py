"""A simulation as a rosbag2, with the topics of a live system and the truth beside them."""

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagWriter, header, message, typestore
from ins_nav.simulation import messages
from ins_nav.simulation.aids import GaugeReadings, RangeReadings, SimulatedAids
from ins_nav.simulation.motion import Array
from ins_nav.simulation.scenarios import Simulation
from ins_nav.simulation.trajectory import Trajectory

_IMU = "sensor_msgs/msg/Imu"
_TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_PRESSURE = "sensor_msgs/msg/FluidPressure"
_RANGE = "sensor_msgs/msg/Range"
_FIX = "sensor_msgs/msg/NavSatFix"
_ODOMETRY = "nav_msgs/msg/Odometry"
_CHUNK = 10_000

Stream = Iterator[tuple[int, Any]]
"""Messages of one topic with their stamps, ns, in order."""
Topic = tuple[str, str, int, Stream]
"""Name, type, number of messages, messages."""


def write_bag(simulation: Simulation, path: str | Path, overwrite: bool = False, progress: bool = False) -> int:
    """Write a recording of the simulation.

    Topics: /imu/data_raw and /gnss/fix as measured; those of the other aids that measured anything: /gnss/velocity,
    /log, /depth, /pressure, /range/<beacon>, /beacon/<beacon>/fix. The truth: /truth/odometry (body in map, the
    tangent plane east-north-up at the simulation's origin; twist relative to Earth, on body axes), /truth/imu (body
    to local east-north-up, true angular rate in inertial space and specific force) and /truth/fix with the stamps of
    samples; /truth/beacon/<beacon>/fix, where a beacon was at the instants it was ranged.

    Parameters
    ----------
    simulation : Simulation
        What to write.
    path : str or Path
        Folder of the bag.
    overwrite : bool
        Replace a bag that is there.
    progress : bool
        Show a bar on stderr, when that is a terminal.

    Returns
    -------
    int
        Number of messages written.

    Raises
    ------
    BagError
        If the bag cannot be written.
    """
    from tqdm import tqdm

    s, t = simulation, simulation.trajectory
    step = max(1, round(s.parameters["rate"] / s.parameters["truth.rate"]))
    truth = np.arange(step, len(t.time), step)
    truth_stamps = s.stamps_ns[truth - 1]
    topics: list[Topic] = [
        ("/imu/data_raw", _IMU, len(s.stamps_ns), _measured_imu(s)),
        ("/gnss/fix", _FIX, len(s.fixes.stamps_ns), _fixes("gnss_link", *s.fixes)),
        *(topic for topic in _aids(s.aids) if topic[2]),
        ("/truth/odometry", _ODOMETRY, len(truth), _true_odometry(truth_stamps, t, truth)),
        ("/truth/imu", _IMU, len(truth), _true_imu(truth_stamps, t, truth)),
        (
            "/truth/fix",
            _FIX,
            len(truth),
            _fixes("base_link", truth_stamps, t.lat[truth], t.lon[truth], t.height[truth], (0.0, 0.0, 0.0)),
        ),
    ]
    total = sum(count for _, _, count, _ in topics)
    with BagWriter(path, overwrite) as writer:
        for topic, msgtype, _, _ in topics:
            writer.add_topic(topic, msgtype)
        named = [_named(topic, msgtype, stream) for topic, msgtype, _, stream in topics]
        merged = heapq.merge(*named, key=lambda item: item[3])
        for topic, msgtype, msg, stamp_ns in tqdm(
            merged, total=total, unit=" messages", disable=None if progress else True
        ):
            writer.write(topic, msgtype, msg, stamp_ns)
    return total


def _named(topic: str, msgtype: str, stream: Stream) -> Iterator[tuple[str, str, Any, int]]:
    for stamp_ns, msg in stream:
        yield topic, msgtype, msg, stamp_ns


def _measured_imu(s: Simulation) -> Stream:
    dt = s.trajectory.interval
    make = typestore().types[_IMU]
    unknown = _quaternion((0.0, 0.0, 0.0, 1.0))
    no_orientation = np.array([-1.0] + [0.0] * 8)
    rate_covariance = np.eye(3).ravel() * s.errors.gyro.noise_stddev(dt) ** 2
    force_covariance = np.eye(3).ravel() * s.errors.accel.noise_stddev(dt) ** 2
    for stamp, rate, force in _rows(s.stamps_ns, s.angular_velocity, s.linear_acceleration):
        yield (
            stamp,
            make(
                header(stamp, "imu_link"),
                unknown,
                no_orientation,
                _vector(rate),
                rate_covariance,
                _vector(force),
                force_covariance,
            ),
        )


def _true_imu(stamps_ns: NDArray[np.int64], t: Trajectory, index: NDArray[np.int64]) -> Stream:
    make, exact = typestore().types[_IMU], np.zeros(9)
    for stamp, q, rate, force in _rows(stamps_ns, t.q_nb[index], t.rate[index], t.specific_force[index]):
        yield (
            stamp,
            make(header(stamp, "imu_link"), _quaternion(q), exact, _vector(rate), exact, _vector(force), exact),
        )


def _true_odometry(stamps_ns: NDArray[np.int64], t: Trajectory, index: NDArray[np.int64]) -> Stream:
    map_from_e = Rotation.from_matrix(earth.enu_axes(t.origin.lat, t.origin.lon)).inv()
    origin_e = earth.geodetic_to_ecef(t.origin.lat, t.origin.lon, t.origin.height)
    body = Rotation.from_quat(t.q_eb[index])
    position = map_from_e.apply(t.position_e[index] - origin_e)
    orientation = (map_from_e * body).as_quat()
    velocity = body.inv().apply(t.velocity_e[index])
    rate = t.rate[index] - body.inv().apply([0.0, 0.0, earth.RATE])
    types = typestore().types
    for stamp, r, q, v, w in _rows(stamps_ns, position, orientation, velocity, rate):
        msg = message(_ODOMETRY, header=header(stamp, "map"), child_frame_id="base_link")
        msg.pose.pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*r), _quaternion(q))
        msg.twist.twist = types["geometry_msgs/msg/Twist"](_vector(v), _vector(w))
        yield stamp, msg


def _fixes(
    frame_id: str,
    stamps_ns: NDArray[np.int64],
    lat: Array,
    lon: Array,
    height: Array,
    stddev: tuple[float, float, float],
) -> Stream:
    covariance = np.diag(np.square(stddev)).ravel().tolist()
    for stamp, lat_deg, lon_deg, h in _rows(stamps_ns, np.degrees(lat), np.degrees(lon), height):
        yield stamp, messages.nav_sat_fix(stamp, 0, lat_deg, lon_deg, h, covariance, frame_id)


def _aids(aids: SimulatedAids) -> Iterator[Topic]:
    """Topics of the aids but the fixes, also those without messages."""
    velocity, log, depth, pressure = aids.gnss_velocity, aids.log, aids.depth, aids.pressure
    count = len(velocity.stamps_ns)
    stddev = np.full(count, velocity.stddev)
    yield "/gnss/velocity", _TWIST, count, _twists("gnss_link", velocity.stamps_ns, velocity.velocity, stddev)
    yield "/log", _TWIST, len(log.stamps_ns), _twists("log_link", log.stamps_ns, log.velocity, log.stddev)
    yield "/depth", _POSE, len(depth.stamps_ns), _depths(depth)
    yield "/pressure", _PRESSURE, len(pressure.stamps_ns), _pressures(pressure)
    for name, ranges in aids.ranges.items():
        yield f"/range/{name}", _RANGE, len(ranges.stamps_ns), _ranges(ranges)
        beacon = ranges.beacon
        yield f"/truth/beacon/{name}/fix", _FIX, len(beacon.stamps_ns), _fixes(name, *beacon)
    for name, fixes in aids.beacon_fixes.items():
        yield f"/beacon/{name}/fix", _FIX, len(fixes.stamps_ns), _fixes(name, *fixes)


def _twists(frame_id: str, stamps_ns: NDArray[np.int64], velocity: Array, stddev: Array) -> Stream:
    """Velocities; the angular part is not measured."""
    for stamp, v, sigma in _rows(stamps_ns, velocity, stddev):
        yield stamp, messages.twist(stamp, v, (sigma**2 * np.eye(3)).ravel().tolist(), frame_id)


def _depths(depth: GaugeReadings) -> Stream:
    for stamp, value in _rows(depth.stamps_ns, depth.value):
        yield stamp, messages.depth_pose(stamp, value, depth.stddev**2)


def _pressures(pressure: GaugeReadings) -> Stream:
    for stamp, value in _rows(pressure.stamps_ns, pressure.value):
        yield stamp, messages.fluid_pressure(stamp, value, pressure.stddev**2)


def _ranges(ranges: RangeReadings) -> Stream:
    for stamp, distance in _rows(ranges.stamps_ns, ranges.distance):
        yield stamp, messages.acoustic_range(stamp, distance, ranges.stddev**2, (0.0, ranges.limit))


def _rows(*arrays: NDArray[Any]) -> Iterator[Any]:
    """Rows of all arrays together, as plain numbers."""
    for start in range(0, len(arrays[0]), _CHUNK):
        yield from zip(*(array[start : start + _CHUNK].tolist() for array in arrays), strict=True)


def _vector(v: Any) -> Any:
    return typestore().types["geometry_msgs/msg/Vector3"](*v)


def _quaternion(q: Any) -> Any:
    return typestore().types["geometry_msgs/msg/Quaternion"](*q)
