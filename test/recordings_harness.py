"""Recordings written and read by the tests of `ins_nav.recordings`."""

from pathlib import Path

import numpy as np

from ins_nav.recordings.bags import (
    BagReader,
    BagWriter,
    DamagedBagError,
    RawMessage,
    header,
    message,
)

IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
START_NS = 1_700_000_000_000_000_000
STEP_NS = 2_500_000


def imu_at(stamp_ns: int, count: int) -> object:
    return message(IMU, header=header(stamp_ns, "imu_link"), orientation_covariance=np.full(9, float(count)))


def write_bag(path: Path, messages: int) -> None:
    """400 Hz of Imu, a NavSatFix every 100; about 3000 messages make a chunk of the file."""
    with BagWriter(path) as bag:
        for i in range(messages):
            stamp_ns = START_NS + i * STEP_NS
            bag.write("imu/data_raw", IMU, imu_at(stamp_ns, i), stamp_ns)
            if i % 100 == 0:
                bag.write("gnss/fix", FIX, message(FIX, header=header(stamp_ns, "gnss"), latitude=0.01 * i), stamp_ns)


def read(path: Path) -> tuple[list[RawMessage], str]:
    """All readable messages, and the damage that the reader names."""
    found = []
    with BagReader(path) as bag:
        try:
            for raw in bag.messages():
                found.append(raw)
        except DamagedBagError as error:
            return found, str(error)
    return found, ""


def storage(bag: Path) -> Path:
    return bag / f"{bag.name}.mcap"
