"""Fixtures of the recordings' tests."""

from pathlib import Path

import pytest
from recordings_harness import read, write_bag
from rosbags.rosbag2 import StoragePlugin, Writer

from ins_nav.recordings.bags import (
    RawMessage,
    typestore,
)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "drive"
    write_bag(path, 9000)
    return path


@pytest.fixture(scope="session")
def original(whole: Path) -> list[RawMessage]:
    messages, damage = read(whole)
    assert not damage
    return messages


@pytest.fixture(scope="session")
def sqlite(original: list[RawMessage], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("sqlite") / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {
            raw.topic: writer.add_connection(raw.topic, raw.msgtype, typestore=typestore()) for raw in original[:2]
        }
        for raw in original:
            writer.write(connections[raw.topic], raw.stamp_ns, raw.data)
    return (path / "bag.db3").read_bytes()
