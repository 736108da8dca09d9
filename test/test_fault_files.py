"""The bench of broken files: what it makes of a process's end, and the files it makes."""

import os
import stat
from pathlib import Path

import pytest

from bench.fault_files import Outcome, Row, rows, text, verdict

ROW = Row("row", lambda folder: (), must_solve=True)
KILLED = ROW._replace(must_solve=False, kill_after=1.0)


@pytest.mark.parametrize(
    ("row", "outcome", "expected"),
    [
        (ROW, Outcome(0, 1.0, "[warn] broken: not used\n", True), "right"),
        (ROW, Outcome(1, 1.0, "ins_process: broken\n", False), "no result"),
        (ROW, Outcome(0, 1.0, "", False), "no result"),
        (
            ROW,
            Outcome(1, 1.0, "Traceback (most recent call last):\nValueError: math domain error\n", False),
            "traceback",
        ),
        (ROW, Outcome(None, 60.0, "", False), "hangs"),
        (ROW, Outcome(-9, 1.0, "", False), "signal 9"),
        (KILLED, Outcome(-9, 1.0, "", False), "right"),
        (ROW._replace(must_solve=False), Outcome(1, 1.0, "ins_process: no such file\n", False), "right"),
    ],
)
def test_the_end_of_a_process(row: Row, outcome: Outcome, expected: str) -> None:
    assert verdict(row, outcome) == expected
    assert expected in text(row, outcome)


def test_a_traceback_shows_its_last_line() -> None:
    outcome = Outcome(1, 1.0, "Traceback (most recent call last):\n  File x\nValueError: math domain error\n", False)
    assert text(ROW, outcome).endswith("ValueError: math domain error")


def test_files_are_of_their_kind(tmp_path: Path) -> None:
    by_name = {row.name: row for row in rows()}
    path = tmp_path / "file.yaml"
    kinds = {"fifo": stat.S_ISFIFO, "folder": stat.S_ISDIR, "symlink to itself": stat.S_ISLNK, "binary": stat.S_ISREG}
    for name, is_kind in kinds.items():
        by_name[f"parameters: {name}"].prepare(tmp_path)
        assert is_kind(os.lstat(path).st_mode), name


def test_a_bag_changes_in_a_copy(tmp_path: Path) -> None:
    good = tmp_path / "good"
    good.mkdir()
    content = bytes(range(256)) * 8
    (good / "good.mcap").write_bytes(content)
    (good / "metadata.yaml").write_text("x")
    by_name = {row.name: row for row in rows()}
    for name in ("bag cut off at 50%", "bag with 10 bits flipped, seed 3", "bag without metadata"):
        bag, *_ = by_name[name].prepare(tmp_path)
        assert Path(bag) != good
        assert (good / "good.mcap").read_bytes() == content
    by_name["bag cut off at 50%"].prepare(tmp_path)
    assert (tmp_path / "bad" / "good.mcap").read_bytes() == content[:1024]
    by_name["bag with 10 bits flipped, seed 3"].prepare(tmp_path)
    after = (tmp_path / "bad" / "good.mcap").read_bytes()
    assert sum((a ^ b).bit_count() for a, b in zip(after, content, strict=True)) == 10
