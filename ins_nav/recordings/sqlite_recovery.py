"""Recovery of messages from a rosbag2 sqlite3 file that is cut off or damaged.

Rows are read in the order they were written, from both ends, up to the damage.
"""

import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import parse_qos

_HEADER_SIZE = 100


class RecoveredSqlite:
    """Reads a sqlite3 recording row by row; offers the used part of the interface of `rosbags.rosbag2.Reader`.

    Attributes
    ----------
    damage : str
        Damage of the file; empty when every row was found.

    Raises
    ------
    ReaderError
        If the file is no rosbag2 sqlite3 file, or not even its topics can be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self._folder = TemporaryDirectory()
        try:
            self._database = sqlite3.connect(f"{self._whole_pages().as_uri()}?immutable=1", uri=True)
            self._rows = self._find_rows()
            self.connections = self._find_connections()
        except sqlite3.Error as error:
            self._folder.cleanup()
            raise ReaderError(f"cannot be read: {error}") from error
        self.message_count = len(self._rows)
        self.start_time = self._rows[0][0] if self._rows else 0
        self.end_time = self._rows[-1][0] + 1 if self._rows else 0

    def close(self) -> None:
        """Close the file."""
        self._database.close()
        self._folder.cleanup()

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages of the connections by stamp, from start on, ns."""
        wanted = {c.id: c for c in connections or self.connections}
        for stamp_ns, row, topic in self._rows:
            if topic in wanted and (start is None or stamp_ns >= start):
                try:
                    (data,) = self._database.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
                except sqlite3.Error as error:
                    self.damage = f"{self.damage}; message {row}: {error}"
                    continue
                yield wanted[topic], stamp_ns, data

    def _whole_pages(self) -> Path:
        """The file, or a copy filled up with zeros: sqlite refuses a file shorter than its header states."""
        with self.path.open("rb") as file:
            header = file.read(_HEADER_SIZE)
        if len(header) < _HEADER_SIZE or not header.startswith(b"SQLite format 3\0"):
            raise ReaderError("is not a sqlite3 file" if header else "is empty")
        (page_size,), (pages,) = struct.unpack(">H", header[16:18]), struct.unpack(">I", header[28:32])
        page_size = 65536 if page_size == 1 else page_size
        full, size = page_size * pages, self.path.stat().st_size
        if size >= full:
            return self.path.resolve()
        self.damage = f"cut off at byte {size} of {full}"
        copy = Path(self._folder.name, self.path.name)
        shutil.copyfile(self.path, copy)
        with copy.open("r+b") as file:
            file.truncate(size // page_size * page_size)  # a partial page would be read as a complete one
            file.truncate(full)
        return copy

    def _find_rows(self) -> list[tuple[int, int, int]]:
        """Stamp, row and topic of all reachable messages, by stamp."""
        found: dict[int, tuple[int, int, int]] = {}
        for order in ("ASC", "DESC"):
            try:
                rows = self._database.execute(f"SELECT timestamp, id, topic_id FROM messages ORDER BY id {order}")
                for stamp_ns, row, topic in rows:
                    if row in found:
                        break
                    if isinstance(stamp_ns, int) and isinstance(topic, int):
                        found[row] = stamp_ns, row, topic
                if order == "ASC":
                    break  # all of them
            except sqlite3.DatabaseError as error:
                self.damage = self.damage or f"read up to the damage, from both ends: {error}"
        return sorted(found.values())

    def _find_connections(self) -> list[Connection]:
        counts = Counter(topic for _, _, topic in self._rows)
        columns = {column[1] for column in self._database.execute("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        topics = self._database.execute(f"SELECT id, name, type, serialization_format, {qos} FROM topics").fetchall()
        return [
            Connection(
                key,
                name,
                msgtype,
                self._definition(msgtype),
                "",
                counts[key],
                ConnectionExtRosbag2(encoding, parse_qos(profiles)),
                self,
            )
            for key, name, msgtype, encoding, profiles in topics
        ]

    def _definition(self, msgtype: str) -> MessageDefinition:
        query = "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type = ?"
        try:
            encoding, text = self._database.execute(query, (msgtype,)).fetchone()
        except (sqlite3.Error, TypeError):  # older recordings have no such table
            return MessageDefinition(MessageDefinitionFormat.NONE, "")
        return MessageDefinition(
            MessageDefinitionFormat.MSG if encoding == "ros2msg" else MessageDefinitionFormat.IDL, text
        )
