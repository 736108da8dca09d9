"""Serialized messages, compared with those of rosbags."""

import math
import struct
from typing import Any

import numpy as np
import pytest

from ins_nav.messages.cdr import StampedMessage, read_imu
from ins_nav.recordings.bags import header, message, typestore

STAMP_NS = 1_700_000_000_123_456_789
ODOMETRY, IMU, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
FRAMES = ["", "b", "map", "base_link", "körper", "x" * 300]


def _serialized(msgtype: str, content: Any) -> bytes:
    return bytes(typestore().serialize_cdr(content, msgtype))


@pytest.mark.parametrize("frame", FRAMES)
def test_messages_have_the_bytes_of_rosbags(frame: str) -> None:
    """Strings of every length modulo 8, and one whose encoding is longer than it is."""
    numbers = np.random.default_rng(1).normal(size=85)
    filled = StampedMessage(ODOMETRY, frame, "child", count=85)
    filled.numbers[:] = numbers
    filled.set_stamp(STAMP_NS)
    expected = message(ODOMETRY, header=header(STAMP_NS, frame), child_frame_id="child")
    for part, values in ((expected.pose, numbers[:43]), (expected.twist, numbers[43:])):
        part.covariance[:] = values[-36:]
    p, q = expected.pose.pose.position, expected.pose.pose.orientation
    v, w = expected.twist.twist.linear, expected.twist.twist.angular
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = numbers[:7]
    v.x, v.y, v.z, w.x, w.y, w.z = numbers[43:49]
    assert filled.serialized() == _serialized(ODOMETRY, expected)
    fix = StampedMessage(FIX, frame, ("b", -1), ("H", 7), count=12, end=b"\x03")
    fix.numbers[:3] = 1.0, 2.0, 3.0
    fix.set_stamp(STAMP_NS)
    expected = message(FIX, header=header(STAMP_NS, frame), latitude=1.0, longitude=2.0, altitude=3.0)
    expected.status.status, expected.status.service, expected.position_covariance_type = -1, 7, 3
    assert fix.serialized() == _serialized(FIX, expected)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("big_endian", [False, True])
def test_imu_is_read_from_its_bytes(frame: str, big_endian: bool) -> None:
    sample = message(IMU, header=header(STAMP_NS, frame))
    w, f = sample.angular_velocity, sample.linear_acceleration
    w.x, w.y, w.z, f.x, f.y, f.z = 1.0, -2.0, 3.0, math.nan, 5.0, math.inf
    data = bytes(typestore().serialize_cdr(sample, IMU, little_endian=not big_endian))
    stamp_ns, *values = read_imu(data)
    assert stamp_ns == STAMP_NS
    np.testing.assert_array_equal(values, [1.0, -2.0, 3.0, math.nan, 5.0, math.inf])


@pytest.mark.parametrize("length", [0, 1, 5, 20, 200, 315])
def test_other_bytes_are_an_error(length: int) -> None:
    data = _serialized(IMU, message(IMU))
    assert len(data) == 316
    with pytest.raises(ValueError, match=f"{length} bytes are not a sensor_msgs/Imu"):
        read_imu(data[:length])
    with pytest.raises(ValueError, match="316 bytes are not"):
        read_imu(data[:12] + struct.pack("<I", 2**32 - 1) + data[16:])
