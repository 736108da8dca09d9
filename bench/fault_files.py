"""Faults of files and processes: `ins_process` over a short recording with every broken kind of file.

A row passes where the process ends by itself within `_LIMIT`, without a traceback, with at most a few lines for people,
and, where the file is not essential (``state_file``), with a solution.
"""

import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

_LIMIT = 60.0
"""s, after which a process hangs."""
_MEMORY = 4 << 30
"""Bytes of address space: more is a leak."""
_HUGE = 50 << 20
"""Bytes of a huge file."""
_HERE = ("initial.latitude_deg:=55.7", "initial.longitude_deg:=37.6", "initial.height:=150.0")
_HEADING = ("initial.heading_deg:=30.0", "alignment.level_duration:=2.0")
_COMMAND = "import sys; from ins_nav.cli.process import main; sys.exit(main())"
HEAD = f"{'file':45} {'exit':>6} {'s':>6} lines  verdict     first line"


class Outcome(NamedTuple):
    """What a command did."""

    code: int | None
    """Exit code; None: it hung."""
    seconds: float
    errors: str
    """Of stderr."""
    solutions: bool
    """It wrote a bag with metadata."""


class Row(NamedTuple):
    """A broken file or a killed process.

    Attributes
    ----------
    name : str
    prepare : callable
        Gets a folder, with the bag ``good`` in it, and gives the arguments of `ins_process`; the bag comes first.
    must_solve : bool
        The fault must not prevent a solution.
    before : callable, optional
        Called in the process before the command starts.
    kill_after : float
        s until the process is killed; 0: it is not.
    """

    name: str
    prepare: Callable[[Path], Sequence[str]]
    must_solve: bool = False
    before: Callable[[], None] | None = None
    kill_after: float = 0.0


def run(row: Row, folder: Path) -> Outcome:
    """Run the command of a row in a folder of its own."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    bag, *arguments = row.prepare(folder)
    command = [sys.executable, "-c", _COMMAND, bag, "-o", str(folder / "out"), *arguments]

    def before() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        if row.before is not None:
            row.before()

    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=before)
    try:
        _, errors = process.communicate(timeout=row.kill_after or _LIMIT)
        code: int | None = process.returncode
    except subprocess.TimeoutExpired:
        process.kill()
        _, errors = process.communicate()
        code = process.returncode if row.kill_after else None
    solved = (folder / "out" / "metadata.yaml").exists()
    return Outcome(code, time.monotonic() - began, errors, solved)


def verdict(row: Row, outcome: Outcome) -> str:
    """``right``, or what is wrong."""
    if outcome.code is None:
        return "hangs"
    if "Traceback" in outcome.errors:
        return "traceback"
    if outcome.code < 0 and not row.kill_after:
        return f"signal {-outcome.code}"
    if row.must_solve and (outcome.code != 0 or not outcome.solutions):
        return "no result"
    return "right"


def text(row: Row, outcome: Outcome) -> str:
    """One line of the table."""
    lines = [line for line in outcome.errors.replace("\r", "\n").splitlines() if line.strip()]
    told = [line for line in lines if " s [" not in line] or [""]
    last = told[-1] if "Traceback" in outcome.errors else told[0]
    code = "-" if outcome.code is None else str(outcome.code)
    return f"{row.name:45} {code:>6} {outcome.seconds:6.1f} {len(told):5}  {verdict(row, outcome):10}  {last[:110]}"


# --- files of parameters and state

_GOOD_STATE = """/**:
  ros__parameters:
    imu:
      gyro_bias_deg_per_hour: [0.1, 0.0, 0.0]
      accel_bias_mg: [0.0, 0.0, 0.0]
    last_pose:
      {latitude_deg: 55.7, longitude_deg: 37.6, height: 150.0, heading_deg: 30.0, position_stddev: 1.0, stamp: 1.7e+9}
"""


def _write(content: str | bytes) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return make


def _symlink(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


def _unreadable(path: Path) -> None:
    path.write_text(_GOOD_STATE)
    path.chmod(0)


def _laughs() -> str:
    """References to references: 9 to the power of 9 values."""
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)]
    return "\n".join(lines) + "\n" + _GOOD_STATE.replace("[0.1, 0.0, 0.0]", "*a8")


_FILES: dict[str, Callable[[Path], None]] = {
    "good": _write(_GOOD_STATE),
    "empty": _write(""),
    "binary": _write(np.random.default_rng(1).bytes(4096)),
    "zeros": _write(bytes(4096)),
    "cut off": _write(_GOOD_STATE[: len(_GOOD_STATE) // 2]),
    "huge": _write("# " + "x" * _HUGE + "\n" + _GOOD_STATE),
    "nested 100,000 deep": _write("[" * 100_000 + "]" * 100_000),
    "recursive": _write("a: &a [*a]\n" + _GOOD_STATE.replace("[0.1, 0.0, 0.0]", "*a")),
    "recursive sections": _write("/**: &a\n  ros__parameters: &b\n    imu: *b\n"),
    "references to references": _write(_laughs()),
    "of wrong types": _write(_GOOD_STATE.replace("[0.1, 0.0, 0.0]", "{x: [yes]}")),
    "with NaN": _write(_GOOD_STATE.replace("0.1", ".nan")),
    "with infinity": _write(_GOOD_STATE.replace("0.1", "1.0e308")),
    "with an object of Python": _write("!!python/object/apply:os.system ['true']\n"),
    "fifo": os.mkfifo,
    "folder": Path.mkdir,
    "symlink to itself": _symlink("file.yaml"),
    "symlink to nothing": _symlink("nowhere.yaml"),
    "symlink to /dev/zero": _symlink("/dev/zero"),
    "symlink to /dev/null": _symlink("/dev/null"),
    "unreadable": _unreadable,
}
_FATAL = ("folder", "symlink to itself")


def _with_file(name: str, option: str) -> Callable[[Path], Sequence[str]]:
    def prepare(folder: Path) -> Sequence[str]:
        path, make = folder / "file.yaml", _FILES[name]
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        path.unlink(missing_ok=True)
        make(path)
        if option == "parameters" and path.is_file() and not path.is_symlink():
            path.write_bytes(path.read_bytes().partition(b"    last_pose")[0])  # no parameter
        chosen = (
            ("--params-file", str(path)) if option == "parameters" else ("--param", f"state_file:={path}", "--save")
        )
        return str(folder / "good"), "--param", _HERE[0], *_values(), *chosen

    return prepare


def _values() -> Iterator[str]:
    for value in (*_HERE[1:], *_HEADING):
        yield from ("--param", value)


# --- recordings


def _bag(change: Callable[[Path], None]) -> Callable[[Path], Sequence[str]]:
    """Arguments for a copy of the bag with a change."""

    def prepare(folder: Path) -> Sequence[str]:
        bad = folder / "bad"
        shutil.rmtree(bad, ignore_errors=True)
        shutil.copytree(folder / "good", bad)
        change(bad)
        return str(bad), "--param", _HERE[0], *_values()

    return prepare


def _data(bag: Path) -> Path:
    return next(path for path in bag.iterdir() if path.suffix == ".mcap")


def _truncated(share: float) -> Callable[[Path], None]:
    def change(bag: Path) -> None:
        path = _data(bag)
        os.truncate(path, int(share * path.stat().st_size))

    return change


def _flipped(count: int, seed: int) -> Callable[[Path], None]:
    def change(bag: Path) -> None:
        path, rng = _data(bag), np.random.default_rng(seed)
        content = bytearray(path.read_bytes())
        for place in rng.integers(0, len(content), count):
            content[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)

    return change


def _replaced(name: str, content: bytes | None) -> Callable[[Path], None]:
    def change(bag: Path) -> None:
        path = _data(bag) if name == "data" else bag / name
        path.unlink()
        if content is not None:
            path.write_bytes(content)

    return change


def _full_disk() -> None:
    """Files may not grow beyond 100 kB: a write fails as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))


def _nothing(bag: Path) -> None:
    pass


def rows() -> list[Row]:
    """All rows."""
    found = [Row(f"state_file: {name}", _with_file(name, "state"), name not in _FATAL) for name in _FILES]
    found += [Row(f"parameters: {name}", _with_file(name, "parameters")) for name in _FILES]
    found += [Row(f"bag cut off at {share:.0%}", _bag(_truncated(share))) for share in (0.0, 0.01, 0.5, 0.9, 0.999)]
    found += [
        Row(f"bag with {count} bits flipped, seed {seed}", _bag(_flipped(count, seed)))
        for count, seed in ((1, 1), (1, 2), (10, 3), (1000, 4))
    ]
    return [
        *found,
        Row("bag without data", _bag(_replaced("data", None))),
        Row("bag without metadata", _bag(_replaced("metadata.yaml", None)), True),
        Row("bag with empty metadata", _bag(_replaced("metadata.yaml", b""))),
        Row("bag with binary metadata", _bag(_replaced("metadata.yaml", bytes(range(256))))),
        Row("bag of zeros", _bag(_replaced("data", bytes(100_000)))),
        Row("disk full", _bag(_nothing), before=_full_disk),
        Row("killed after 4 s", _bag(_nothing), kill_after=4.0),
    ]


def results(data: Path) -> Iterator[str]:
    """Rows as they are ready, then which of them are not right.

    Parameters
    ----------
    data : Path
        Not used.
    """
    yield HEAD
    wrong = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bag(simulate("static", 1, duration=30.0, rate=100.0), folder / "good")
        for row in rows():
            outcome = run(row, folder)
            print(text(row, outcome), flush=True)
            if verdict(row, outcome) != "right":
                wrong.append(f"- {row.name}: {verdict(row, outcome)}")
    yield "\n".join([f"{len(rows())} rows, not right: {len(wrong)}", *wrong])
