"""Damaged mcap files: every whole message is read."""

from pathlib import Path

import pytest
from recordings_harness import read, storage
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from ins_nav.recordings.bags import (
    BagReader,
    RawMessage,
    typestore,
)


@pytest.mark.parametrize("with_metadata", [True, False])
def test_cut_off(whole: Path, original: list[RawMessage], tmp_path: Path, with_metadata: bool) -> None:
    content = storage(whole).read_bytes()
    (tmp_path / storage(whole).name).write_bytes(content[: len(content) * 6 // 10])
    if with_metadata:
        (tmp_path / "metadata.yaml").write_text((whole / "metadata.yaml").read_text())
    messages, damage = read(tmp_path)
    assert messages == original[: len(messages)]
    # messages fill all but the index, which is 5 % of the file
    assert 0.55 * len(original) < len(messages) < 0.65 * len(original)
    assert "cut off at byte" in damage


def test_damage_is_known_before_reading(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(storage(whole).read_bytes()[:1_000_000])
    with BagReader(path) as bag:
        assert "cut off" in bag.damage


def test_only_the_end_record_missing_loses_nothing(whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(storage(whole).read_bytes()[:-100])
    assert read(path) == (original, "")


def test_hole_inside_a_chunk(whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
    content = bytearray(storage(whole).read_bytes())
    content[len(content) // 2 : len(content) // 2 + 1000] = bytes([255]) * 1000
    check_hole(content, original, tmp_path, "the chunk at byte")


def test_zeros_inside_a_chunk(whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
    content = bytearray(storage(whole).read_bytes())
    content[len(content) // 2 : len(content) // 2 + 100_000] = bytes(100_000)
    check_hole(content, original, tmp_path, "the chunk at byte")


def test_hole_over_a_chunks_head(whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
    content = bytearray(storage(whole).read_bytes())
    a, b = len(content) * 3 // 10, len(content) * 4 // 10  # the second chunk begins at 33 %
    content[a:b] = bytes(b - a)
    check_hole(content, original, tmp_path, "unreadable from byte")


def test_damaged_compressed_chunk(original: list[RawMessage], tmp_path: Path) -> None:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {
            raw.topic: writer.add_connection(raw.topic, raw.msgtype, typestore=typestore()) for raw in original[:2]
        }
        for raw in original:
            writer.write(connections[raw.topic], raw.stamp_ns, raw.data)
    content = bytearray(storage(tmp_path / "bag").read_bytes())
    second = content.index(b"\x28\xb5\x2f\xfd", content.index(b"\x28\xb5\x2f\xfd") + 1)
    content[second + 1000 : second + 1100] = bytes(100)
    check_hole(content, original, tmp_path, "is damaged and left out")


def check_hole(content: bytearray, original: list[RawMessage], folder: Path, expected: str) -> None:
    path = folder / "hole.mcap"
    path.write_bytes(content)
    messages, damage = read(path)
    assert expected in damage
    assert messages[0] == original[0]
    assert messages[-1] == original[-1]  # messages behind the hole are read
    # one chunk of three at most is gone, and the message across which the hole begins is not detectable
    assert len(original) * 0.5 < len(messages) < len(original)
    assert len(set(messages) - set(original)) <= 1
