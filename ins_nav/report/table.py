"""Tables: one column a result, one row a measure."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ins_nav.report.comparison import Comparison, Errors
from ins_nav.report.series import Array, Track

Rows = dict[str, str]
"""Text of each measure; the names carry the units."""

_MINUTES = (1, 2, 5, 10, 20, 30, 60, 120, 180, 360, 720, 1440)
_NEAR = 5.0
"""s: largest distance of an error from the full minute it is shown for."""
_PER_HOUR = math.degrees(1.0) * 3600.0


def rows_of(result: Track, comparison: Comparison | None) -> Rows:
    """The measures of one result."""
    stamps = result.position.stamps_ns
    duration = (stamps[-1] - stamps[0]) * 1e-9
    rows = {"duration, s": f"{duration:.1f}", "solutions": str(len(stamps))}
    if "gyro" in result.bias:
        rows["gyro bias in use, deg/h"] = _numbers(result.bias["gyro"] * _PER_HOUR, 4)
        rows["accelerometer bias in use, mg"] = _numbers(result.bias["accel"] / 9.80665e-3, 4)
    if comparison is None:
        return rows
    if comparison.attitude is not None:
        rows |= _alignment(comparison.attitude)
    rows |= _position(comparison.position, int(stamps[0]), duration)
    if comparison.velocity is not None:
        rows["velocity error RMS, horizontal / up, m/s"] = _pair(_rms(comparison.velocity.values), 3)
    if comparison.attitude is not None:
        heading = np.unwrap(comparison.attitude.values[:, 2])
        rows["heading drift to the end, deg"] = f"{math.degrees(heading[-1] - heading[0]):+.4f}"
        level = np.degrees(np.abs(comparison.attitude.values[:, :2]).max(axis=0))
        rows["greatest roll / pitch error, deg"] = _pair(level, 4)
    return rows


def table(columns: Mapping[str, Rows]) -> str:
    """The columns side by side under their names."""
    measures: dict[str, None] = {}
    for rows in columns.values():
        measures |= dict.fromkeys(rows)
    lines = [
        ["", *columns],
        *([name, *(rows.get(name, "-") for rows in columns.values())] for name in _ordered(columns)),
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        line[0].ljust(widths[0]) + "".join(f"  {cell:>{w}}" for cell, w in zip(line[1:], widths[1:], strict=True))
        for line in lines
    )


def _ordered(columns: Mapping[str, Rows]) -> Sequence[str]:
    """All measures, in the order of the longest list: results of different length have different minutes."""
    ordered: list[str] = []
    for rows in sorted(columns.values(), key=len, reverse=True):
        before = 0
        for name in rows:
            if name in ordered:
                before = ordered.index(name) + 1
            else:
                ordered.insert(before, name)
                before += 1
    return ordered


def _alignment(attitude: Errors) -> Rows:
    rows = {}
    for i, name in ((2, "heading"), (0, "roll"), (1, "pitch")):
        sigma = math.degrees(attitude.stddev[0, i])
        given = "" if math.isnan(sigma) else f" (sigma {sigma:.4f})"
        rows[f"{name} error after alignment, deg"] = f"{math.degrees(attitude.values[0, i]):+.4f}{given}"
    return rows


def _position(position: Errors, start_ns: int, duration: float) -> Rows:
    time = (position.stamps_ns - start_ns) * 1e-9
    sizes = np.column_stack([np.hypot(position.values[:, 0], position.values[:, 1]), np.abs(position.values[:, 2])])
    named = "horizontal / vertical error"
    rows = {f"{named} at the start, m": _pair(sizes[0], 2)}
    for minutes in _MINUTES:
        nearest = int(np.argmin(np.abs(time - 60.0 * minutes)))
        if 60.0 * minutes < duration and abs(time[nearest] - 60.0 * minutes) < _NEAR:
            rows[f"{named} after {minutes} min, m"] = _pair(sizes[nearest], 2)
    rows[f"{named} at the end, m"] = _pair(sizes[-1], 2)
    rows[f"{named} RMS, m"] = _pair(_rms(position.values), 2)
    rows[f"{named} greatest, m"] = _pair(sizes.max(axis=0), 2)
    return rows


def _rms(values: Array) -> Array:
    """Of the horizontal length and of the up component."""
    mean = np.mean(np.square(values), axis=0)
    return np.sqrt([mean[0] + mean[1], mean[2]])


def _pair(values: Array, digits: int) -> str:
    return " / ".join(f"{x:.{digits}f}" for x in values)


def _numbers(values: Array, digits: int) -> str:
    return " ".join(f"{x:.{digits}f}" for x in values)
