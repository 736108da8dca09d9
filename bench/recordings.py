"""Real recordings: by ins_process and, for one of them, live by bag_player and ins_node."""

import contextlib
import io
import math
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.markdown import table
from demo.run import navigate
from ins_nav.cli.process import main as ins_process
from ins_nav.errors import InsNavError
from ins_nav.report.comparison import compare, horizontal_offset
from ins_nav.report.series import Track, read_reference, read_result, rotations_at

_RATE = 5.0
"""Times real time, live."""
_FIRST_STOP = 500.0
"""s, of kingston_a."""
_TACTICAL = "imu.gyro_bias_stddev_deg_per_hour:=1.0"
"""Its class of gyros, as in the simulator's preset."""


def process(bag: Path, out: Path, *parameters: str) -> str:
    """Run ins_process, free inertial; return its output.

    Raises
    ------
    InsNavError
        It failed.
    """
    output = io.StringIO()
    settings = [word for parameter in parameters for word in ("--param", parameter)]
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = ins_process([str(bag), "-o", str(out), "--nodes", "ins_node", *settings])
    if code:
        raise InsNavError(output.getvalue().strip().splitlines()[-1])
    return output.getvalue()


def results(data: Path) -> Iterator[str]:
    """The section's tables."""
    for name, section in (("rlg_drive", _drive), ("kingston_a", _stop)):
        if (data / name).exists():
            with tempfile.TemporaryDirectory() as folder:
                yield section(data / name, Path(folder))
        else:
            yield f"{name} skipped: no recordings in {data}"


def _drive(bag: Path, folder: Path) -> str:
    output = process(bag, folder / "batch")
    published, _ = navigate(bag, folder / "live", _RATE)
    batch, live = (read_result(folder / name, name) for name in ("batch", "live"))
    measured = [(_heading(track), *_distance(track, bag)) for track in (batch, live)]
    difference, turn, common = _difference(batch, live)
    counted = re.search(r"(\d+) integrated", output)
    integrated = [counted and counted[1], live.diagnostics["imu/data_raw integrated"]]
    rows: list[Sequence[object]] = [
        ["heading after 60 s of standing, °", *(f"{heading:.3f}" for heading, _, _ in measured), "2.45 ± 0.3"],
        ["distance from gnss/fix, greatest, m", *(f"{greatest:.2f}" for _, greatest, _ in measured), "10"],
        ["distance from gnss/fix, RMS, m", *(f"{rms:.2f}" for _, _, rms in measured), ""],
        [f"samples integrated, of {published}", *integrated, published],
        ["solutions", len(batch.position.stamps_ns), len(live.position.stamps_ns), ""],
        [f"greatest difference, mm, of {common} solutions", "", f"{difference * 1e3:.1e}", "1"],
        ["greatest difference, °", "", f"{math.degrees(turn):.1e}", "1e-04"],
    ]
    return table([bag.name, "ins_process", f"live, {_RATE:g} times real time", "limit"], rows)


def _stop(bag: Path, folder: Path) -> str:
    process(bag, folder / "batch", f"alignment.duration:={_FIRST_STOP:g}", _TACTICAL)
    result = read_result(folder / "batch", "batch")
    reference = read_reference(bag)
    assert result.attitude is not None and reference is not None and reference.attitude is not None
    errors = compare(result, reference).attitude
    assert errors is not None
    at = rotations_at(reference.attitude, errors.stamps_ns[:1])
    true = (90.0 - at.as_euler("ZYX", degrees=True)[0, 0]) % 360.0
    rows = [
        ["heading, °", f"{_heading(result):.2f}"],
        ["of the reference, °", f"{true:.2f}"],
        ["error, °", f"{math.degrees(errors.values[0, 2]):+.2f}"],
        ["sigma, °", f"{math.degrees(errors.stddev[0, 2]):.2f}"],
        ["error of roll and pitch, °", " ".join(f"{x:+.3f}" for x in np.degrees(errors.values[0, :2]))],
    ]
    return table([f"{bag.name}, tactical IMU at 10 Hz: alignment over {_FIRST_STOP:g} s of the first stop", ""], rows)


def _heading(track: Track) -> float:
    """At the end of the alignment, deg."""
    assert track.attitude is not None
    return float(np.degrees(track.attitude.euler[0, 2]))


def _distance(track: Track, bag: Path) -> tuple[float, float]:
    """Greatest and RMS horizontal distance from the fixes, m."""
    reference = read_reference(bag, "gnss/fix")
    assert reference is not None
    errors = compare(track, reference).position.values
    distance = np.hypot(errors[:, 0], errors[:, 1])
    return float(distance.max()), float(np.sqrt(np.mean(distance**2)))


def _difference(one: Track, other: Track) -> tuple[float, float, int]:
    """Greatest horizontal distance, m, and turn, rad, between two results at their common stamps, and how many."""
    stamps, i, j = np.intersect1d(one.position.stamps_ns, other.position.stamps_ns, return_indices=True)
    a, b = one.position, other.position
    offset = horizontal_offset(b.ecef[j], a.ecef[i], a.lat[i], a.lon[i])
    assert one.attitude is not None and other.attitude is not None
    turns = rotations_at(one.attitude, stamps).inv() * rotations_at(other.attitude, stamps)
    return float(np.hypot(offset[:, 0], offset[:, 1]).max()), float(turns.magnitude().max()), len(stamps)
