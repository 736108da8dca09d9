"""Recovery of messages from an mcap file that is cut off, damaged or without its index.

The file is read record by record instead of through the index at its end. A chunk with a wrong checksum is left out;
of a chunk that is cut off, complete messages are kept.

Format: MCAP specification, version 0 (mcap.dev/spec).
"""

import heapq
import mmap
import struct
from binascii import crc32
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import lz4.frame
from backports import zstd
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import parse_qos

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER_SIZE = 28  # from its summary offset on, with the magic
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _DATA_END = 3, 4, 5, 6, 8, 15
_LAST_OPCODE = 15
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")

Buffer = bytes | mmap.mmap


class _Segment(NamedTuple):
    """A chunk, or a plain message, of the file, with the first and last stamp in it, ns."""

    first_ns: int
    last_ns: int
    opcode: int
    begin: int
    end: int


class RecoveredMcap:
    """Reads an mcap file without its index; offers the used part of the interface of `rosbags.rosbag2.Reader`.

    Attributes
    ----------
    damage : str
        Damage of the file; empty when it was sound to its end.

    Raises
    ------
    ReaderError
        If the file is no mcap at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self.message_count = 0
        self._found: dict[int, Connection] = {}
        self._counts: dict[int, int] = {}
        self._schemas: dict[int, tuple[str, MessageDefinition]] = {}
        self._segments: list[_Segment] = []
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise ReaderError("is empty" if not path.stat().st_size else "does not begin as an mcap file")
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._scan()
        self._segments.sort()
        self.connections = [c._replace(msgcount=self._counts.get(c.id, 0)) for c in self._found.values()]
        self.start_time = min((s.first_ns for s in self._segments), default=0)
        self.end_time = max((s.last_ns for s in self._segments), default=-1) + 1

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages of the connections by stamp, from start on, ns."""
        wanted = {c.id: c for c in connections or self.connections}
        pending: list[tuple[int, int, int, bytes]] = []
        number = 0
        for segment in self._segments:
            while pending and pending[0][0] < segment.first_ns:
                stamp_ns, _, channel, data = heapq.heappop(pending)
                yield wanted[channel], stamp_ns, data
            if start is not None and segment.last_ns < start:
                continue
            for channel, stamp_ns, buffer, begin, end in self._segment_messages(segment):
                if channel in wanted and (start is None or stamp_ns >= start):
                    heapq.heappush(pending, (stamp_ns, number, channel, bytes(buffer[begin:end])))
                    number += 1
        while pending:
            stamp_ns, _, channel, data = heapq.heappop(pending)
            yield wanted[channel], stamp_ns, data

    def _note(self, damage: str) -> None:
        self.damage = f"{self.damage}; {damage}" if self.damage else damage

    def _scan(self) -> None:
        """Find topics, segments and damage."""
        size = len(self._map)
        place = len(_MAGIC)
        chunks = self._read_summary()
        while True:
            opcode = 0
            for opcode, begin, end in _records(self._map, place):
                if opcode == _DATA_END:
                    return
                if end <= size or opcode == _CHUNK:
                    self._register(opcode, begin, end)
                place = end
            if place >= size or size - place < _RECORD.size:
                self._note(f"cut off at byte {size}")
                return
            resume = min((offset for offset in chunks if offset > place), default=size)
            self._note(f"unreadable from byte {place} to {resume}")
            if resume == size:
                return
            place = resume

    def _read_summary(self) -> list[int]:
        """Read the topics listed at the file's end, where it exists; return the beginnings of the chunks."""
        offsets = []
        if self._map[-len(_MAGIC) :] == _MAGIC:
            (summary,) = struct.unpack_from("<Q", self._map, len(self._map) - _FOOTER_SIZE)
            for opcode, begin, end in _records(self._map, summary) if summary else ():
                if opcode == _CHUNK_INDEX:
                    offsets.append(struct.unpack_from("<QQQ", self._map, begin)[2])
                elif opcode in (_SCHEMA, _CHANNEL):
                    self._register(opcode, begin, end)
        return offsets

    def _register(self, opcode: int, begin: int, end: int) -> None:
        try:
            if opcode in (_MESSAGE, _CHUNK):
                self._add_segment(opcode, begin, end)
            else:
                self._describe(opcode, self._map[begin:end])
        except (ReaderError, struct.error, ValueError, LookupError, RuntimeError, zstd.ZstdError) as error:
            self._note(f"the record at byte {begin} is damaged and left out: {error}")

    def _add_segment(self, opcode: int, begin: int, end: int) -> None:
        segment = _Segment(0, 0, opcode, begin, end)
        stamps = []
        for channel, stamp_ns, *_ in self._segment_messages(segment, describe=True):
            if channel in self._found:
                self._counts[channel] = self._counts.get(channel, 0) + 1
                stamps.append(stamp_ns)
        if stamps:
            self.message_count += len(stamps)
            self._segments.append(segment._replace(first_ns=min(stamps), last_ns=max(stamps)))

    def _segment_messages(
        self, segment: _Segment, describe: bool = False
    ) -> Iterator[tuple[int, int, Buffer, int, int]]:
        """Channel, stamp, and the place of the data, of each complete message; describe reads the topics too."""
        if segment.opcode == _MESSAGE:
            channel, _, stamp_ns, _ = _MESSAGE_HEAD.unpack_from(self._map, segment.begin)
            yield channel, stamp_ns, self._map, segment.begin + _MESSAGE_HEAD.size, segment.end
            return
        cut_off = segment.end > len(self._map)
        chunk = _unpacked(self._map[segment.begin : segment.end], cut_off)
        reached = 0
        for opcode, begin, end in _records(chunk, 0):
            if end > len(chunk):
                break
            reached = end
            if opcode == _MESSAGE:
                channel, _, stamp_ns, _ = _MESSAGE_HEAD.unpack_from(chunk, begin)
                yield channel, stamp_ns, chunk, begin + _MESSAGE_HEAD.size, end
            elif describe:
                self._describe(opcode, chunk[begin:end])
        if describe and reached < len(chunk) and not cut_off:
            self._note(f"the chunk at byte {segment.begin} is damaged, its last {len(chunk) - reached} bytes are lost")

    def _describe(self, opcode: int, record: bytes) -> None:
        """Read a schema or a channel record."""
        if opcode == _SCHEMA:
            (key,) = struct.unpack_from("<H", record)
            name, place = _string(record, 2)
            encoding, place = _string(record, place)
            text, _ = _string(record, place)
            self._schemas[key] = name, MessageDefinition(_FORMATS.get(encoding, MessageDefinitionFormat.NONE), text)
        elif opcode == _CHANNEL:
            key, schema = struct.unpack_from("<HH", record)
            topic, place = _string(record, 4)
            encoding, place = _string(record, place)
            msgtype, definition = self._schemas[schema]
            ext = ConnectionExtRosbag2(encoding, _offered_qos(record, place + 4))
            self._found[key] = Connection(key, topic, msgtype, definition, "", 0, ext, self)


def _records(buffer: Buffer, place: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, begin and end of each record; the last one may end beyond the buffer. Stops at the first invalid one."""
    while place + _RECORD.size <= len(buffer):
        opcode, length = _RECORD.unpack_from(buffer, place)
        if not 0 < opcode <= _LAST_OPCODE:
            return
        place += _RECORD.size
        yield opcode, place, place + length
        place += length


def _unpacked(chunk: bytes, cut_off: bool) -> bytes:
    """The records in a chunk record; of one that is cut off, those that remain."""
    _, _, size, crc = _CHUNK_HEAD.unpack_from(chunk)
    compression, place = _string(chunk, _CHUNK_HEAD.size)
    packed = chunk[place + 8 :]
    if compression == "zstd":
        data = zstd.ZstdDecompressor().decompress(packed)
    elif compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed)
    elif compression:
        raise ReaderError(f"unknown compression {compression!r}")
    else:
        data = packed
    if not cut_off and (len(data) != size or (crc and crc32(data) != crc)):
        raise ReaderError("its checksum is wrong")
    return data


def _string(record: bytes, place: int) -> tuple[str, int]:
    """A string with its length before it, and the place after it."""
    (length,) = struct.unpack_from("<I", record, place)
    end = place + 4 + length
    if end > len(record):
        raise ReaderError("a string in it runs over its end")
    return record[place + 4 : end].decode(), end


def _offered_qos(record: bytes, place: int) -> list[Qos]:
    """The QoS profiles in a channel's metadata."""
    while place < len(record):
        key, place = _string(record, place)
        value, place = _string(record, place)
        if key == "offered_qos_profiles":
            return parse_qos(value)
    return []
