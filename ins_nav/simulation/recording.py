"""A simulation as a rosbag2, with the topics of a live system and the truth beside them."""

import heapq
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.aiding.simulated import Fixes, Messages, Readings, rows
from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagWriter, header, message, typestore
from ins_nav.simulation.scenarios import Simulation
from ins_nav.simulation.trajectory import Trajectory

_IMU = "sensor_msgs/msg/Imu"
_FIX = "sensor_msgs/msg/NavSatFix"
_ODOMETRY = "nav_msgs/msg/Odometry"

Topic = tuple[str, str, int, Messages]
"""Name, type, number of messages, messages."""


def write_bag(simulation: Simulation, path: str | Path, overwrite: bool = False, progress: bool = False) -> int:
    """Write a recording of the simulation.

    Topics: /imu/data_raw, and those of the aids with readings (`ins_nav.aiding.base.Aid.simulate`). The truth:
    /truth/odometry (body in map, the tangent plane east-north-up at the simulation's origin; twist relative to Earth,
    on body axes), /truth/imu (body to local east-north-up, true angular rate in inertial space and specific force) and
    /truth/fix with the stamps of samples; further topics below /truth are those of aids.

    Parameters
    ----------
    simulation : Simulation
        Data to write.
    path : str or Path
        Folder of the bag.
    overwrite : bool
        Replace an existing bag.
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
    true_fixes = Fixes(truth_stamps, t.lat[truth], t.lon[truth], t.height[truth], (0.0, 0.0, 0.0), "base_link")
    topics: list[Topic] = [
        ("/imu/data_raw", _IMU, len(s.stamps_ns), _measured_imu(s)),
        *_aids(s.aids),
        ("/truth/odometry", _ODOMETRY, len(truth), _true_odometry(truth_stamps, t, truth)),
        ("/truth/imu", _IMU, len(truth), _true_imu(truth_stamps, t, truth)),
        ("/truth/fix", _FIX, len(truth), true_fixes.messages(message)),
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


def _named(topic: str, msgtype: str, stream: Messages) -> Iterator[tuple[str, str, Any, int]]:
    for stamp_ns, msg in stream:
        yield topic, msgtype, msg, stamp_ns


def _aids(aids: Mapping[str, Readings]) -> Iterator[Topic]:
    """Topics of the aids with readings."""
    for topic, readings in aids.items():
        if len(readings.stamps_ns):
            yield f"/{topic}", readings.message_type, len(readings.stamps_ns), readings.messages(message)


def _measured_imu(s: Simulation) -> Messages:
    dt = s.trajectory.interval
    make = typestore().types[_IMU]
    unknown = _quaternion((0.0, 0.0, 0.0, 1.0))
    no_orientation = np.array([-1.0] + [0.0] * 8)
    rate_covariance = np.eye(3).ravel() * s.errors.gyro.noise_stddev(dt) ** 2
    force_covariance = np.eye(3).ravel() * s.errors.accel.noise_stddev(dt) ** 2
    for stamp, rate, force in rows(s.stamps_ns, s.angular_velocity, s.linear_acceleration):
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


def _true_imu(stamps_ns: NDArray[np.int64], t: Trajectory, index: NDArray[np.int64]) -> Messages:
    make, exact = typestore().types[_IMU], np.zeros(9)
    for stamp, q, rate, force in rows(stamps_ns, t.q_nb[index], t.rate[index], t.specific_force[index]):
        yield (
            stamp,
            make(header(stamp, "imu_link"), _quaternion(q), exact, _vector(rate), exact, _vector(force), exact),
        )


def _true_odometry(stamps_ns: NDArray[np.int64], t: Trajectory, index: NDArray[np.int64]) -> Messages:
    map_from_e = Rotation.from_matrix(earth.enu_axes(t.origin.lat, t.origin.lon)).inv()
    origin_e = earth.geodetic_to_ecef(t.origin.lat, t.origin.lon, t.origin.height)
    body = Rotation.from_quat(t.q_eb[index])
    position = map_from_e.apply(t.position_e[index] - origin_e)
    orientation = (map_from_e * body).as_quat()
    velocity = body.inv().apply(t.velocity_e[index])
    rate = t.rate[index] - body.inv().apply([0.0, 0.0, earth.RATE])
    types = typestore().types
    for stamp, r, q, v, w in rows(stamps_ns, position, orientation, velocity, rate):
        msg = message(_ODOMETRY, header=header(stamp, "map"), child_frame_id="base_link")
        msg.pose.pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*r), _quaternion(q))
        msg.twist.twist = types["geometry_msgs/msg/Twist"](_vector(v), _vector(w))
        yield stamp, msg


def _vector(v: Any) -> Any:
    return typestore().types["geometry_msgs/msg/Vector3"](*v)


def _quaternion(q: Any) -> Any:
    return typestore().types["geometry_msgs/msg/Quaternion"](*q)
