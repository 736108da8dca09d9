"""Recordings in and out; parts that are missing or empty."""

import struct
from pathlib import Path

import pytest
from recordings_harness import FIX, IMU, START_NS, STEP_NS, imu_at, read, storage, write_bag
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg

from ins_nav.errors import InsNavError
from ins_nav.recordings.bags import (
    BagError,
    BagReader,
    BagWriter,
    DamagedBagError,
    RawMessage,
    message,
    typestore,
)


def test_written_messages_are_read(whole: Path) -> None:
    with BagReader(whole) as bag:
        assert {name: (info.msgtype, info.count) for name, info in bag.topics.items()} == {
            "/imu/data_raw": (IMU, 9000),
            "/gnss/fix": (FIX, 90),
        }
        assert (bag.start_ns, bag.end_ns) == (START_NS, START_NS + 8999 * STEP_NS)
        raws = list(bag.messages(["imu/data_raw"]))
        assert [raw.stamp_ns for raw in raws] == [START_NS + i * STEP_NS for i in range(9000)]
        assert raws[-1].data == typestore().serialize_cdr(imu_at(START_NS + 8999 * STEP_NS, 8999), IMU)
        assert bag.deserialize(raws[-1]).orientation_covariance.tolist() == [8999.0] * 9
        fixes = list(bag.messages(["/gnss/fix"], start_ns=START_NS + 8900 * STEP_NS))
        assert [bag.deserialize(raw).latitude for raw in fixes] == [89.0]


def test_messages_of_all_topics_are_in_order_of_stamps(original: list[RawMessage]) -> None:
    stamps = [raw.stamp_ns for raw in original]
    assert stamps == sorted(stamps)


def test_other_tools_find_the_definitions(whole: Path) -> None:
    with AnyReader([whole]) as bag:  # refuses a bag without them, or whose hashes differ from them
        connection, stamp_ns, data = next(iter(bag.messages()))
        assert bag.deserialize(data, connection.msgtype).header.stamp.sec == stamp_ns // 10**9


def test_latched_topics_are_marked(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("imu/bias", IMU, latched=True)
        bag.write("imu/bias", IMU, message(IMU), START_NS)
        bag.write("imu/data", IMU, message(IMU), START_NS)
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag.mcap"):
        with BagReader(path) as reader:
            assert {name: info.latched for name, info in reader.topics.items()} == {
                "/imu/bias": True,
                "/imu/data": False,
            }
    assert "transient_local" in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_every_type_of_the_store_has_a_default_message() -> None:
    for msgtype in typestore().fielddefs:
        if "/msg/" in msgtype:
            data = typestore().serialize_cdr(message(msgtype), msgtype)
            assert typestore().serialize_cdr(typestore().deserialize_cdr(data, msgtype), msgtype) == data


def test_wrong_type_and_field_names_are_errors() -> None:
    with pytest.raises(InsNavError, match=r"sensor_msgs/msg/Imuu.*did you mean sensor_msgs/msg/Imu\?"):
        message("sensor_msgs/msg/Imuu")
    with pytest.raises(InsNavError, match=r"no field 'latitud' \(did you mean latitude\?\)"):
        message(FIX, latitud=1.0)


class TestWithoutMetadata:
    def test_lone_file(self, whole: Path, original: list[RawMessage]) -> None:
        assert read(storage(whole)) == (original, "")

    def test_folder(self, whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
        (tmp_path / "a.mcap").write_bytes(storage(whole).read_bytes())
        assert read(tmp_path) == (original, "")

    def test_unreadable_metadata(self, whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
        (tmp_path / "a.mcap").write_bytes(storage(whole).read_bytes())
        (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n  relative_file_pa")
        assert read(tmp_path) == (original, "")

    def test_parts_of_a_split_recording_are_merged(self, tmp_path: Path) -> None:
        whole = tmp_path / "whole"
        whole.mkdir()
        for part in range(2):
            with BagWriter(tmp_path / f"part_{part}") as bag:
                for i in range(part, 20, 2):
                    bag.write("imu/data_raw", IMU, message(IMU), START_NS + i)
            storage(tmp_path / f"part_{part}").rename(whole / f"part_{part}.mcap")
        messages, damage = read(whole)
        assert [raw.stamp_ns - START_NS for raw in messages] == list(range(20))
        assert not damage


class TestOtherRecorders:
    @pytest.mark.parametrize("plugin", list(StoragePlugin))
    @pytest.mark.parametrize("mode", list(CompressionMode))
    def test_storage_and_compression(
        self, original: list[RawMessage], tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
    ) -> None:
        if (plugin, mode) == (StoragePlugin.SQLITE3, CompressionMode.STORAGE):
            pytest.skip("sqlite3 has none")
        path = tmp_path / "bag"
        writer = Writer(path, version=9, storage_plugin=plugin)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connections = {t: writer.add_connection(f"/{t}", t, typestore=typestore()) for t in (IMU, FIX)}
            for raw in original[:500]:
                writer.write(connections[raw.msgtype], raw.stamp_ns, raw.data)
        messages, damage = read(path)
        assert [raw.data for raw in messages] == [raw.data for raw in original[:500]]
        assert not damage
        if mode != CompressionMode.FILE:
            (path / "metadata.yaml").unlink()
            assert read(path) == (messages, "")

    def test_a_type_defined_in_the_bag_only(self, tmp_path: Path) -> None:
        definition, msgtype = "float64 speed\nstring sensor\n", "some_msgs/msg/Speed"
        types = typestore().__class__()
        types.register(get_types_from_msg(definition, msgtype))
        with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/speed", msgtype, typestore=types)
            data = types.serialize_cdr(types.types[msgtype](speed=1.5, sensor="log"), msgtype)
            writer.write(connection, START_NS, data)
        with BagReader(tmp_path / "bag") as bag:
            (raw,) = bag.messages()
            assert (bag.deserialize(raw).speed, bag.deserialize(raw).sensor) == (1.5, "log")

    def test_unchunked_messages_a_little_out_of_order(self, original: list[RawMessage], tmp_path: Path) -> None:
        """As `ros2 bag record` with the fastwrite preset writes them: no chunks, no index, order of arrival."""
        arrived = original[:50]
        arrived[20], arrived[21] = arrived[21], arrived[20]
        assert arrived[20].stamp_ns > arrived[21].stamp_ns
        with BagWriter(tmp_path / "bag") as bag:
            for raw in arrived:
                bag.write_raw(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
        path = storage(tmp_path / "bag")
        content = path.read_bytes()
        (header_size,) = struct.unpack_from("<Q", content, 9)
        chunk = 17 + header_size
        (chunk_size,) = struct.unpack_from("<Q", content, chunk + 1)
        records = content[chunk + 9 + 40 : chunk + 9 + chunk_size]  # 40: the head of an uncompressed chunk
        data_end, footer = struct.pack("<BQI", 15, 4, 0), struct.pack("<BQQQI", 2, 20, 0, 0, 0)
        path.write_bytes(content[:chunk] + records + data_end + footer + content[:8])
        messages, damage = read(path)
        assert sorted(messages) == sorted(original[:50])
        assert not damage


class TestDamage:
    def test_empty_part(self, whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
        """A recorder killed just after it began the next file of a split recording."""
        (tmp_path / "drive_0.mcap").write_bytes(storage(whole).read_bytes())
        (tmp_path / "drive_1.mcap").write_bytes(b"")
        messages, damage = read(tmp_path)
        assert messages == original
        assert "drive_1.mcap: is empty" in damage

    def test_reading_again(self, whole: Path, tmp_path: Path) -> None:
        content = bytearray(storage(whole).read_bytes())
        content[len(content) // 2 : len(content) // 2 + 1000] = bytes([255]) * 1000
        (tmp_path / "hole.mcap").write_bytes(content)
        found: list[list[RawMessage]] = [[], []]
        with BagReader(tmp_path / "hole.mcap") as bag:
            for messages in found:
                with pytest.raises(DamagedBagError):
                    for raw in bag.messages():
                        messages.append(raw)
        assert found[0] == found[1]

    def test_missing_part(self, whole: Path, original: list[RawMessage], tmp_path: Path) -> None:
        (tmp_path / storage(whole).name).write_bytes(storage(whole).read_bytes())
        listing = (whole / "metadata.yaml").read_text()
        (tmp_path / "metadata.yaml").write_text(
            listing.replace("relative_file_paths:\n", "relative_file_paths:\n  - drive_1.mcap\n")
        )
        messages, damage = read(tmp_path)
        assert messages == original
        assert "drive_1.mcap is missing" in damage

    def test_bad_message(self, whole: Path) -> None:
        with BagReader(whole) as bag:
            raw = next(bag.messages())
            with pytest.raises(BagError, match=r"the message on /imu/data_raw at 17.* is not a valid"):
                bag.deserialize(raw._replace(data=raw.data[:20]))


class TestErrors:
    @pytest.mark.parametrize(
        ("name", "content", "expected"),
        [
            ("drivee", None, "no such bag .did you mean .*drive"),
            ("empty.mcap", b"", "is empty"),
            ("text.mcap", b"imu data", "does not begin as an mcap file"),
            ("text.db3", b"imu data", "is not a sqlite3 file"),
            ("notes.txt", b"imu data", "is not a bag; give a rosbag2 folder"),
            ("header.mcap", b"\x89MCAP0\r\n" + bytes(9), "has no messages"),
            (".", None, "is a folder without .*mcap"),
        ],
    )
    def test_not_a_bag(self, tmp_path: Path, name: str, content: bytes | None, expected: str) -> None:
        if name == "drivee":
            write_bag(tmp_path / "drive", 1)
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(BagError, match=expected) as raised, BagReader(tmp_path / name):
            pass
        assert str(tmp_path) in str(raised.value)
        assert "\n" not in str(raised.value)

    def test_no_messages(self, tmp_path: Path) -> None:
        with BagWriter(tmp_path / "bag") as bag:
            bag.add_topic("imu/data_raw", IMU)
        with pytest.raises(BagError, match="has no messages"), BagReader(tmp_path / "bag"):
            pass

    def test_unknown_topic(self, whole: Path) -> None:
        with BagReader(whole) as bag:
            with pytest.raises(BagError, match=r"no topic 'imu/dataraw' \(did you mean /imu/data_raw\?\)"):
                bag.messages(["imu/dataraw"])
            with pytest.raises(BagError, match=r"there are: /gnss/fix, /imu/data_raw"):
                bag.messages(["pressure"])


class TestWriter:
    def test_an_existing_path_is_kept(self, tmp_path: Path) -> None:
        write_bag(tmp_path / "bag", 1)
        with pytest.raises(BagError, match="exists already"), BagWriter(tmp_path / "bag"):
            pass
        with BagWriter(tmp_path / "bag", overwrite=True) as bag:
            bag.write("imu/data", IMU, message(IMU), START_NS)
        with BagReader(tmp_path / "bag") as bag:
            assert list(bag.topics) == ["/imu/data"]

    def test_only_bags_are_overwritten(self, tmp_path: Path) -> None:
        home = tmp_path / "home"
        home.mkdir()
        (home / "thesis.pdf").write_bytes(b"x")
        for path in (home, home / "thesis.pdf"):
            with pytest.raises(BagError, match="is not a bag"), BagWriter(path, overwrite=True):
                pass
        assert (home / "thesis.pdf").exists()

    def test_written_messages_survive_an_exception(self, tmp_path: Path) -> None:
        with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag") as bag:
            bag.write("imu/data", IMU, message(IMU), START_NS)
            raise KeyboardInterrupt
        messages, damage = read(tmp_path / "bag")
        assert len(messages) == 1
        assert not damage

    def test_misuse_is_an_error(self, tmp_path: Path) -> None:
        with BagWriter(tmp_path / "bag") as bag:
            bag.write("imu/data", IMU, message(IMU), START_NS)
            with pytest.raises(BagError, match="carries sensor_msgs/msg/Imu, not sensor_msgs/msg/NavSatFix"):
                bag.write("/imu/data", FIX, message(FIX), START_NS)
            with pytest.raises(BagError, match=r"unknown message type 'sensor_msgs/msg/imu' .*did you mean"):
                bag.add_topic("imu", "sensor_msgs/msg/imu")
            with pytest.raises(BagError, match="was added before"):
                bag.add_topic("imu/data", IMU)
            with pytest.raises(BagError, match=r"cannot write .* as sensor_msgs/msg/Imu"):
                bag.write("imu/data", IMU, message(FIX), START_NS)
