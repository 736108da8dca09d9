"""A simulation as a recording: topics, stamps, values."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import NS, close

from ins_nav.cli.simulate import main
from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate


def test_recording(tmp_path: Path) -> None:
    s = simulate("rocking", 4, duration=4.0, heave_amplitude=0.5, **{"truth.rate": 100.0})
    assert write_bag(s, tmp_path / "bag") == 1600 + 5 + 3 * 400
    messages: dict[str, list[Any]] = {}
    with BagReader(tmp_path / "bag") as reader:
        counts = {name: info.count for name, info in reader.topics.items()}
        stamps = []
        for raw in reader.messages():
            stamps.append(raw.stamp_ns)
            msg = reader.deserialize(raw)
            assert msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec == raw.stamp_ns
            messages.setdefault(raw.topic, []).append(msg)
    assert counts == {
        "/imu/data_raw": 1600,
        "/gnss/fix": 5,
        "/truth/odometry": 400,
        "/truth/imu": 400,
        "/truth/fix": 400,
    }
    assert stamps == sorted(stamps)
    t = s.trajectory

    imu = messages["/imu/data_raw"]
    assert imu[0].header.frame_id == "imu_link"
    assert imu[0].orientation_covariance[0] == -1.0
    assert imu[0].angular_velocity_covariance[0] == pytest.approx(math.radians(0.003) ** 2)
    assert [imu[7].linear_acceleration.z, imu[7].angular_velocity.x] == [
        s.linear_acceleration[7, 2],
        s.angular_velocity[7, 0],
    ]
    fix = messages["/gnss/fix"][2]
    assert (fix.latitude, fix.altitude) == (math.degrees(s.fixes.lat[2]), s.fixes.height[2])
    assert fix.position_covariance_type == 2
    np.testing.assert_array_equal(fix.position_covariance, [1, 0, 0, 0, 1, 0, 0, 0, 2.25])

    k = 400 * 2  # the truth at 2 s
    true_imu, true_fix, odometry = (messages[f"/truth/{name}"][199] for name in ("imu", "fix", "odometry"))
    assert true_imu.header.stamp.sec == 1_700_000_002
    q = true_imu.orientation
    np.testing.assert_array_equal([q.x, q.y, q.z, q.w], t.q_nb[k])
    assert true_imu.linear_acceleration.z == t.specific_force[k, 2]
    assert true_fix.altitude == t.height[k]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    p, v = odometry.pose.pose.position, odometry.twist.twist.linear
    assert p.z == pytest.approx(t.height[k] - 150.0, abs=1e-8)
    q = odometry.pose.pose.orientation
    speed = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([v.x, v.y, v.z])
    close(speed, t.velocity_n[k], atol=1e-12)
    w = odometry.twist.twist.angular
    earth_rate = Rotation.from_quat(t.q_eb[k]).inv().apply([0.0, 0.0, earth.RATE])
    close([w.x, w.y, w.z], t.rate[k] - earth_rate, atol=1e-18)


def test_recording_of_aids(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more: dict[str, Any] = {"gnss.velocity_rate": 1.0, "pressure.rate": 2.0, "log.lost_duration": 1.0}
    s = simulate("auv_dive", 4, rate=10.0, duration=20.0, **more)
    total = write_bag(s, tmp_path / "bag")
    messages: dict[str, list[Any]] = {}
    with BagReader(tmp_path / "bag") as reader:
        types = {name: info.msgtype for name, info in reader.topics.items()}
        counts = {name: info.count for name, info in reader.topics.items()}
        stamps = []
        for raw in reader.messages():
            stamps.append(raw.stamp_ns)
            messages.setdefault(raw.topic, []).append(reader.deserialize(raw))
            at = messages[raw.topic][-1].header.stamp
            assert at.sec * NS + at.nanosec == raw.stamp_ns
    assert stamps == sorted(stamps)
    assert len(stamps) == total
    aids = {
        "/gnss/velocity": ("geometry_msgs/msg/TwistWithCovarianceStamped", 21),
        "/log": ("geometry_msgs/msg/TwistWithCovarianceStamped", 101),
        "/depth": ("geometry_msgs/msg/PoseWithCovarianceStamped", 101),
        "/pressure": ("sensor_msgs/msg/FluidPressure", 41),
        "/range/vessel": ("sensor_msgs/msg/Range", 5),
        "/beacon/vessel/fix": ("sensor_msgs/msg/NavSatFix", 21),
        "/truth/beacon/vessel/fix": ("sensor_msgs/msg/NavSatFix", 5),
    }
    assert {name: (types[name], counts[name]) for name in aids} == aids
    assert len(counts) == len(aids) + 5

    def last(topic: str) -> Any:
        return messages[topic][-1]

    log = last("/log")
    assert log.header.frame_id == "log_link"
    v = log.twist.twist.linear
    np.testing.assert_array_equal([v.x, v.y, v.z], s.aids["log"].velocity[-1])
    assert log.twist.covariance[7] == s.aids["log"].stddev[-1] ** 2 > 1e-4
    assert math.isnan(messages["/log"][0].twist.twist.linear.x)
    velocity = last("/gnss/velocity")
    assert velocity.twist.twist.linear.y == s.aids["gnss/velocity"].velocity[-1, 1]
    assert velocity.twist.covariance[14] == 0.05**2
    depth = last("/depth")
    assert depth.pose.pose.position.z == -s.aids["depth"].value[-1]
    assert depth.pose.covariance[14] == 0.05**2
    pressure = last("/pressure")
    assert (pressure.fluid_pressure, pressure.variance) == (s.aids["pressure"].value[-1], 500.0**2)
    ranged = last("/range/vessel")
    assert ranged.range == np.float32(s.aids["range/vessel"].distance[-1])
    assert (ranged.variance, ranged.min_range, ranged.max_range) == (0.25, 0.0, 5000.0)
    fix, true = last("/beacon/vessel/fix"), last("/truth/beacon/vessel/fix")
    assert fix.latitude == math.degrees(s.aids["beacon/vessel/fix"].lat[-1])
    assert fix.position_covariance[0] == 0.25
    assert true.altitude == s.aids["range/vessel"].beacon.height[-1]

    command = ["auv_dive", "-o", str(tmp_path / "other"), "--param", "duration:=5", "--param", "rate:=10"]
    assert main([*command, "--param", "beacon.names:=[north]", "--param", "beacon.positions:=[0, 0, -30]"]) == 0
    # it circles by 50 m, and begins in the east
    assert "truth/beacon/north/fix at first: 55.7000000°, 37.6007" in capsys.readouterr().out
