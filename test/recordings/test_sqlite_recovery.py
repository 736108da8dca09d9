"""Damaged sqlite3 files: every whole message is read."""

from pathlib import Path

from recordings_harness import read

from ins_nav.recordings.bags import (
    RawMessage,
)


def test_sqlite_cut_off(sqlite: bytes, original: list[RawMessage], tmp_path: Path) -> None:
    (tmp_path / "cut.db3").write_bytes(sqlite[: len(sqlite) * 8 // 10])
    messages, damage = read(tmp_path)
    assert messages == original[: len(messages)]
    assert 0.7 * len(original) < len(messages) < 0.85 * len(original)  # messages fill nearly all pages, evenly
    assert "cut off at byte" in damage


def test_hole_in_sqlite(sqlite: bytes, original: list[RawMessage], tmp_path: Path) -> None:
    middle = len(sqlite) // 2
    (tmp_path / "hole.db3").write_bytes(sqlite[:middle] + bytes([255]) * 8192 + sqlite[middle + 8192 :])
    messages, damage = read(tmp_path)
    assert set(messages) <= set(original)
    assert [raw.stamp_ns for raw in messages] == sorted(raw.stamp_ns for raw in messages)
    assert len(messages) > len(original) - 100  # 8 kB hold some 24 of them
    assert "malformed" in damage
