"""Header stamps."""

from ins_nav.recordings.bags import message
from ins_nav.stamps import set_stamp, stamp_of


def test_every_nanosecond_is_kept() -> None:
    """A float of seconds since the epoch resolves 0.2 µs."""
    imu = message("sensor_msgs/msg/Imu")
    for stamp_ns in (0, 1_700_000_000_123_456_789, 1_999_999_999):
        set_stamp(imu, stamp_ns)
        assert 0 <= imu.header.stamp.nanosec < 10**9
        assert stamp_of(imu) == stamp_ns
