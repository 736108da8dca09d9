"""Bags of results and references with known errors, for the tests of reports."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.mechanization.earth import principal_radii
from ins_nav.recordings.bags import BagWriter, header, message

START_NS = 1_700_000_000 * 10**9
LAT, LON, HEIGHT = np.radians(55.0), np.pi, 100.0  # where longitude jumps
SPEED = 12.0
TURN = np.radians(3.0)  # rad/s
TRUTH = ("truth/fix", "truth/imu", "truth/odometry")
RESULT = ("fix", "imu/data", "odometry")
RESULT_SIGMAS = {"enu": (1.0, 2.0, 3.0), "turn": (1e-4, 2e-4, 3e-4)}


def write(
    path: Path,
    topics: tuple[str, str, str],
    times: np.ndarray,
    offset=(0.0, 0.0, 0.0),
    turned=(0.0, 0.0, 0.0),
    faster=(0.0, 0.0, 0.0),
    heading_deg=350.0,
    turn=TURN,
    sigmas=None,
) -> Path:
    """A bag of a body that goes east at constant speed and turns left at a constant rate, its nose 2° down.

    Errors: offset east, north, up in m; turned roll, pitch, heading in deg; faster east, north, up in m/s.
    """
    fix_topic, imu_topic, velocity_topic = topics
    sigmas = sigmas or {"enu": (0.0,) * 3, "turn": (0.0,) * 3}
    meridian, prime_vertical = principal_radii(np.sin(LAT))
    with BagWriter(path) as bag:
        for time in times:
            stamp = START_NS + round(time * 1e9)
            east, north, up = SPEED * time + offset[0], offset[1], offset[2]
            fix = message("sensor_msgs/msg/NavSatFix", header=header(stamp, "base_link"))
            fix.latitude = np.degrees(LAT + north / (meridian + HEIGHT))
            lon = LON + east / ((prime_vertical + HEIGHT) * np.cos(LAT))
            fix.longitude = np.degrees((lon + np.pi) % (2.0 * np.pi) - np.pi)
            fix.altitude = HEIGHT + up
            fix.position_covariance[:] = np.diag(np.square(sigmas["enu"])).ravel()
            fix.position_covariance_type = 2
            bag.write(fix_topic, "sensor_msgs/msg/NavSatFix", fix, stamp)

            heading = heading_deg - np.degrees(turn) * time
            body = Rotation.from_euler("ZYX", [90.0 - heading - turned[2], 2.0 + turned[1], turned[0]], degrees=True)
            imu = message("sensor_msgs/msg/Imu", header=header(stamp, "base_link"))
            imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w = body.as_quat()
            imu.orientation_covariance[:] = np.diag(np.square(sigmas["turn"])).ravel()
            bag.write(imu_topic, "sensor_msgs/msg/Imu", imu, stamp)

            velocity = np.array([SPEED, 0.0, 0.0]) + faster
            msgtype = "geometry_msgs/msg/TwistWithCovarianceStamped"
            if "odometry" in velocity_topic:
                velocity, msgtype = body.inv().apply(velocity), "nav_msgs/msg/Odometry"
            twist = message(msgtype, header=header(stamp, "map"))
            linear = twist.twist.twist.linear
            linear.x, linear.y, linear.z = velocity
            bag.write(velocity_topic, msgtype, twist, stamp)
    return path


def write_bags(folder: Path) -> Path:
    """Truth at 4 Hz between the stamps of a result at 10 Hz with known errors from 10 s on."""
    write(folder / "truth", TRUTH, np.arange(0.03, 100.0, 0.25))
    write(
        folder / "result",
        RESULT,
        np.arange(10.0, 90.0, 0.1),
        offset=(3.0, -4.0, 2.0),
        turned=(0.1, -0.2, 0.5),
        faster=(0.3, 0.4, -0.5),
        sigmas=RESULT_SIGMAS,
    )
    write(folder / "plain", RESULT, np.arange(20.0, 60.0, 0.1))
    return folder
