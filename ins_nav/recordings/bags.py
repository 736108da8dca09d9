"""rosbag2 recordings (mcap, sqlite3) in and out, without ROS.

Stamps of a bag are integer nanoseconds since the epoch. Topics are matched with or without their leading slash
and always returned with it. No loss is silent: a truncated or damaged recording yields every readable message and then
raises `DamagedBagError`.
"""

import difflib
import functools
import heapq
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
import yaml
from backports import zstd
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, ReaderError, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ins_nav.errors import InsNavError
from ins_nav.recordings.deferred_signals import DeferredSignals
from ins_nav.recordings.mcap_recovery import RecoveredMcap
from ins_nav.recordings.sqlite_recovery import RecoveredSqlite

Source = Reader | RecoveredMcap | RecoveredSqlite

_RECOVERY: dict[str, type[RecoveredMcap] | type[RecoveredSqlite]] = {".mcap": RecoveredMcap, ".db3": RecoveredSqlite}
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no CDR message begins with it
_FOREVER = QosTime(9223372036, 854775807)  # rmw's "infinite"
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    False,
)


@functools.cache
def typestore() -> Typestore:
    """The message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


class BagError(InsNavError):
    """A recording that cannot be used: its path, the fault, the remedy."""


class DamagedBagError(BagError):
    """Raised after the last readable message of a damaged recording; names the loss."""


@dataclass(frozen=True)
class TopicInfo:
    """Type and count of a topic in a bag; latched: its publisher offered transient-local durability."""

    msgtype: str
    count: int
    latched: bool


class RawMessage(NamedTuple):
    """A message as recorded: CDR bytes, and the bag's stamp, ns."""

    topic: str
    msgtype: str
    stamp_ns: int
    data: bytes


def suggestion(name: str, known: Iterable[str]) -> str:
    """`` (did you mean X?)`` or, without a close match, the list of known names."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    return f" (did you mean {close[0]}?)" if close else f" (there are: {', '.join(names)})"


def absolute(topic: str) -> str:
    """The topic's name with its leading slash."""
    return topic if topic.startswith("/") else "/" + topic


def message(msgtype: str, **fields: Any) -> Any:
    """A message of type ``package/msg/Name`` from the Jazzy type store: zeros, apart from the fields given.

    Raises
    ------
    InsNavError
        If the type or a field is unknown.
    """
    if msgtype not in typestore().fielddefs:
        raise InsNavError(f"unknown message type {msgtype!r}{_type_hint(msgtype)}")
    values = {}
    for name, (kind, detail) in typestore().fielddefs[msgtype][1]:
        values[name] = fields.pop(name) if name in fields else _zero(kind, detail)
    if fields:
        name = next(iter(fields))
        raise InsNavError(f"{msgtype} has no field {name!r}{suggestion(name, values)}")
    return typestore().types[msgtype](**values)


def header(stamp_ns: int, frame_id: str) -> Any:
    """std_msgs/Header with a stamp in ns since the epoch."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = typestore().types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return typestore().types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def _type_hint(msgtype: str) -> str:
    close = difflib.get_close_matches(msgtype, typestore().fielddefs, n=1)
    return f" (did you mean {close[0]}?)" if close else "; expected the form sensor_msgs/msg/Imu"


def _zero(kind: Nodetype, detail: Any) -> Any:
    """Default of a field, from its description in the type store."""
    if kind == Nodetype.NAME:
        return message(detail)
    if kind == Nodetype.BASE:
        return {"string": "", "wstring": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(detail[0], 0)
    (item_kind, item), length = detail
    size = length if kind == Nodetype.ARRAY else 0
    if item_kind == Nodetype.BASE and item[0] not in ("string", "wstring"):
        return np.zeros(size, {"byte": "uint8", "char": "uint8"}.get(item[0], item[0]))
    return [_zero(item_kind, item) for _ in range(size)]


class BagReader:
    """A rosbag2 folder, or a lone .mcap or .db3 file; a context manager.

    Attributes
    ----------
    topics : dict of topic name to `TopicInfo`
    start_ns, end_ns : int
        Stamps of the first and the last message, ns.
    damage : str
        Damage of the recording found so far; empty when it is sound.

    Raises
    ------
    BagError
        On entering: if there is no such recording, or nothing in it can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.topics: dict[str, TopicInfo] = {}
        self.start_ns = 0
        self.end_ns = 0
        self.damage = ""
        self._sources: list[Source] = []
        self._opened = ExitStack()
        self._stores: dict[str, Typestore] = {}

    def __enter__(self) -> Self:
        try:
            self._open()
        except BaseException:
            self._opened.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def topic(self, name: str) -> str:
        """Name as recorded, for a name with or without its leading slash; BagError if it is not in the bag."""
        found = absolute(name)
        if found not in self.topics:
            raise BagError(f"{self.path}: no topic {name!r}{suggestion(found, self.topics)}")
        return found

    def messages(self, topics: Iterable[str] | None = None, start_ns: int | None = None) -> Iterator[RawMessage]:
        """Messages by stamp, of all topics or those named, from start_ns on.

        Raises
        ------
        BagError
            If a topic is not in the bag.
        DamagedBagError
            After the last message that could be read.
        """
        wanted = set(self.topics if topics is None else map(self.topic, topics))
        return self._messages(wanted, start_ns)

    def deserialize(self, raw: RawMessage) -> Any:
        """The message decoded, by the bag's definition of its type when it has one."""
        try:
            return self._store(raw.msgtype).deserialize_cdr(raw.data, raw.msgtype)
        except Exception as error:  # rosbags passes on any error that invalid bytes cause
            raise self.invalid(raw, error) from error

    def invalid(self, raw: RawMessage, reason: Exception) -> BagError:
        """The error that a message cannot be decoded."""
        text = f"the message on {raw.topic} at {raw.stamp_ns} ns is not a valid {raw.msgtype}"
        return BagError(f"{self.path}: {text}: {reason}")

    def _open(self) -> None:
        files = self._files()
        for file in files:
            try:
                self._sources.append(self._open_file(file))
            except BagError as error:
                if len(files) == 1:
                    raise
                self._note(str(error))
        for source in self._sources:
            for c in source.connections:
                known = self.topics.get(c.topic, TopicInfo(c.msgtype, 0, False))
                self.topics[c.topic] = TopicInfo(c.msgtype, known.count + c.msgcount, known.latched or _is_latched(c))
        filled = [source for source in self._sources if source.message_count]
        if not filled:
            raise BagError(f"{self.path}: has no messages{'; ' + self.damage if self.damage else ''}")
        self.start_ns = min(source.start_time for source in filled)
        self.end_ns = max(source.end_time for source in filled) - 1

    def _files(self) -> list[Path]:
        """The storage files of the recording: those that metadata.yaml lists, or else those in the folder."""
        path = self.path
        if not path.exists():
            near = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
            close = difflib.get_close_matches(path.name, near, n=1)
            raise BagError(f"{path}: no such bag" + (f" (did you mean {path.with_name(close[0])}?)" if close else ""))
        if path.is_file():
            if path.suffix not in _RECOVERY:
                raise BagError(f"{path}: is not a bag; give a rosbag2 folder, or a .mcap or .db3 file")
            return [path]
        listed = _listed_files(path / "metadata.yaml")
        for missing in (file for file in listed if not file.exists()):
            self._note(f"{missing.name} is missing")
        files = [f for f in listed if f.exists()] or sorted(p for p in path.iterdir() if p.suffix in _RECOVERY)
        if any(f.suffix == ".zstd" for f in files):
            return [path]  # only rosbags' reader of whole folders unpacks files
        if not files:
            packed = "; unpack its files with zstd -d" if any(path.glob("*.zstd")) else ""
            raise BagError(f"{path}: is a folder without *.mcap or *.db3, so not a bag{packed}")
        return files

    def _open_file(self, file: Path) -> Source:
        try:
            reader = Reader(file)
            reader.open()
        except PermissionError as error:
            raise BagError(f"{file}: no permission to read it") from error
        except Exception as error:  # rosbags passes on any error that invalid bytes cause
            recovered = self._recovered(file)
            if recovered is None:
                raise BagError(f"{file}: cannot be read: {error}") from error
            return recovered
        if isinstance(reader.storage, McapReader) and not reader.storage.chunks:
            # rosbags refuses such a file when its stamps are not in order
            reader.close()
            return self._recovered(file) or reader
        self._opened.callback(reader.close)
        return reader

    def _recovered(self, file: Path) -> RecoveredMcap | RecoveredSqlite | None:
        """The file, read without its index; None where that is impossible (a folder of packed files)."""
        if file.suffix not in _RECOVERY:
            return None
        try:
            recovered = _RECOVERY[file.suffix](file)
        except ReaderError as error:
            raise BagError(f"{file}: {error}") from error
        self._opened.callback(recovered.close)
        if recovered.damage:
            self._note(f"{file.name}: {recovered.damage}")
        return recovered

    def _note(self, damage: str) -> None:
        if damage not in self.damage:
            self.damage = f"{self.damage}; {damage}" if self.damage else damage

    def _messages(self, wanted: set[str], start_ns: int | None) -> Iterator[RawMessage]:
        streams = [self._read(source, wanted, start_ns) for source in self._sources]
        yield from heapq.merge(*streams, key=lambda raw: raw.stamp_ns) if len(streams) > 1 else streams[0]
        if self.damage:
            raise DamagedBagError(f"{self.path}: is damaged, all readable messages have been read: {self.damage}")

    def _read(self, source: Source, wanted: set[str], start_ns: int | None) -> Iterator[RawMessage]:
        connections = [c for c in source.connections if c.topic in wanted]
        if not connections:
            return
        done = dict.fromkeys(wanted, 0)
        try:
            for c, stamp_ns, data in source.messages(connections, start_ns):
                yield RawMessage(c.topic, c.msgtype, stamp_ns, _unpacked(data))
                done[c.topic] += 1
        except Exception as error:  # as in _open_file
            reason = str(error)
        else:
            # rosbags also passes over damage without an error; with a later start its count is unknown
            lost = sum(c.msgcount for c in connections) - sum(done.values())
            if lost <= 0 or (start_ns is not None and start_ns > source.start_time):
                return
            reason = f"{lost} messages are missing"
        recovered = self._recovered(Path(str(source.path)))
        if recovered is None or not recovered.damage:
            self._note(f"{source.path}: {reason}")
        if recovered is None:
            return
        self._sources = [recovered if s is source else s for s in self._sources]  # for reading the bag again
        connections = [c for c in recovered.connections if c.topic in wanted]
        for c, stamp_ns, data in recovered.messages(connections, start_ns):
            if done[c.topic]:
                done[c.topic] -= 1
            else:
                yield RawMessage(c.topic, c.msgtype, stamp_ns, _unpacked(data))

    def _store(self, msgtype: str) -> Typestore:
        if msgtype not in self._stores:
            self._stores[msgtype] = self._make_store(msgtype)
        return self._stores[msgtype]

    def _make_store(self, msgtype: str) -> Typestore:
        connections = (c for source in self._sources for c in source.connections)
        definition = next((c.msgdef for c in connections if c.msgtype == msgtype and c.msgdef.data), None)
        if definition is None:
            if msgtype not in typestore().fielddefs:
                raise BagError(f"{self.path}: has no definition of {msgtype}, and Jazzy's common interfaces have none")
            return typestore()
        try:
            if definition.format == MessageDefinitionFormat.MSG:
                types = get_types_from_msg(definition.data, msgtype)
            else:
                types = get_types_from_idl(definition.data)
        except TypesysError as error:
            raise BagError(f"{self.path}: its definition of {msgtype} cannot be read: {error}") from error
        if all(typestore().fielddefs.get(name) == fields for name, fields in types.items()):
            return typestore()
        store = get_typestore(Stores.EMPTY)
        store.register(types)
        return store


def _listed_files(metadata: Path) -> list[Path]:
    """The files that metadata.yaml lists; none where it is missing or unreadable (a killed recorder)."""
    try:
        names = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]["relative_file_paths"]
        return [metadata.with_name(Path(name).name) for name in names]
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return []


def _unpacked(data: bytes) -> bytes:
    """The message, decompressed where the recorder compressed each one."""
    return zstd.decompress(data) if data[:4] == _ZSTD_MAGIC else data


def _is_latched(connection: Connection) -> bool:
    ext = connection.ext
    return isinstance(ext, ConnectionExtRosbag2) and any(
        qos.durability == QosDurability.TRANSIENT_LOCAL for qos in ext.offered_qos_profiles
    )


class BagWriter:
    """A new rosbag2 folder with mcap storage and message definitions; a context manager.

    Written messages stay readable, also when an exception ends the block. SIGINT, SIGTERM and SIGHUP wait within the
    block until a message is complete, and raise there (`Interrupted` where nothing else handles them).

    Raises
    ------
    BagError
        On entering: if the path exists and overwrite is false, or the path is no bag.
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.path = Path(path)
        self._overwrite = overwrite
        self._connections: dict[str, Connection] = {}
        self._signals = DeferredSignals()

    def __enter__(self) -> Self:
        try:
            if self.path.exists():
                self._make_way()
            self._writer = Writer(self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BagError(f"{self.path}: cannot write a bag there: {error}") from error
        self._signals.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.close()
        except OSError as failure:
            raise BagError(f"{self.path}: the bag could not be finished: {failure}") from failure
        finally:
            self._signals.end()

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Add a topic before its first message; latched offers it as transient local, depth 1."""
        name = absolute(topic)
        if msgtype not in typestore().fielddefs:
            raise BagError(f"{self.path}: unknown message type {msgtype!r} for {name}{_type_hint(msgtype)}")
        if name in self._connections:
            raise BagError(f"{self.path}: topic {name} was added before")
        self._connections[name] = self._writer.add_connection(
            name, msgtype, typestore=typestore(), offered_qos_profiles=[_LATCHED] if latched else []
        )

    def write(self, topic: str, msgtype: str, message: Any, stamp_ns: int) -> None:
        """Write a message of the Jazzy type store (see `message`)."""
        try:
            data = typestore().serialize_cdr(message, msgtype)
        except Exception as error:  # a field of a wrong type can raise anything in the serializer
            raise BagError(f"{self.path}: cannot write {type(message).__name__} as {msgtype}: {error}") from error
        self.write_raw(topic, msgtype, data, stamp_ns)

    def write_raw(self, topic: str, msgtype: str, data: bytes | memoryview, stamp_ns: int) -> None:
        """Write a message that is CDR bytes already."""
        name = absolute(topic)
        connection = self._connections.get(name)
        if connection is None:
            self.add_topic(name, msgtype)
            connection = self._connections[name]
        if connection.msgtype != msgtype:
            raise BagError(f"{self.path}: {name} carries {connection.msgtype}, not {msgtype}")
        try:
            self._writer.write(connection, stamp_ns, data)
        except OSError as error:
            raise BagError(f"{self.path}: writing failed: {error.strerror}; is the disk full?") from error
        self._signals.deliver()

    def _make_way(self) -> None:
        if not self._overwrite:
            raise BagError(f"{self.path}: exists already; choose another name, or add --overwrite")
        parts = list(self.path.iterdir()) if self.path.is_dir() else []
        if not self.path.is_dir() or any(p.name != "metadata.yaml" and p.suffix not in _RECOVERY for p in parts):
            raise BagError(f"{self.path}: is not a bag, so it is not overwritten; choose another name")
        for part in parts:
            part.unlink()
        self.path.rmdir()
