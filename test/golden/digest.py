"""Digest of a result bag: solution with its sigmas at intervals, phases, stops, biases, counts; as text, and compared.

Numbers are compared within 1 % of their own sigma: far above rounding on any platform, far below what matters to a
user. Sigmas are compared within 1 %, everything else exactly.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ins_nav.mechanization.attitude import heading_from_yaw, to_euler
from ins_nav.recordings.bags import BagReader
from ins_nav.stamps import NS, stamp_of

Digest = dict[str, dict[str, tuple[str, ...]]]
"""Section -> row -> values; where a section is a table, its first row has the names of the columns."""

_SHARE = 0.01
_TIME = "t, s"
_BIAS = "last"
# name -> its sigma, digits; units: m, m/s, deg; east, north, up in map, forward, left, rise on the body's axes
_SOLUTION = {
    "east": ("s_east", 4),
    "north": ("s_north", 4),
    "up": ("s_up", 4),
    "forward": ("s_forward", 5),
    "left": ("s_left", 5),
    "rise": ("s_rise", 5),
    "roll": ("s_level", 6),
    "pitch": ("s_level", 6),
    "heading": ("s_heading", 5),
}
_BIASES = {f"{sensor}_{axis}": (f"s_{sensor}_{axis}", 6) for sensor in ("gyro", "accel") for axis in "xyz"}
_SIGMAS = {name: sigma for name, (sigma, _) in (_SOLUTION | _BIASES).items()}
_DEG_PER_HOUR = math.degrees(1.0) * 3600.0


def read_result(path: Path, start_ns: int, every: float) -> Digest:
    """Digest of a result of `ins_process`.

    Parameters
    ----------
    path : Path
    start_ns : int
        Of the times in the digest.
    every : float
        Interval of the rows of the solution, s; the first and the last solution are rows besides.
    """
    messages: dict[str, list[tuple[int, Any]]] = {}
    with BagReader(path) as reader:
        for raw in reader.messages(["odometry", "imu/data", "imu/bias", "stopped", "diagnostics"]):
            messages.setdefault(raw.topic, []).append((raw.stamp_ns, reader.deserialize(raw)))
    solutions = list(zip(messages["/odometry"], messages["/imu/data"], strict=True))
    stamps = [stamp_of(odometry) for (_, odometry), _ in solutions]

    def at(stamp_ns: int) -> str:
        return f"{(stamp_ns - start_ns) / NS:.2f}"

    table: dict[str, tuple[str, ...]] = {_TIME: _columns(_SOLUTION)}
    for i in _rows((np.array(stamps) - start_ns) / NS, every):
        (_, odometry), (_, imu) = solutions[i]
        table[at(stamps[i])] = _numbers(_SOLUTION, _solution(odometry, imu))
    stops = {at(stamp_ns): (str(message.data).lower(),) for stamp_ns, message in messages["/stopped"]}
    phases, counts = {}, {"solutions": (str(len(solutions)),)}
    for stamp_ns, message in messages["/diagnostics"]:
        for status in message.status:
            subject = status.name.partition(": ")[2]
            values = {item.key: item.value for item in status.values}
            phase = f"{subject} {values.pop('phase')}"
            phases.setdefault(phase, (at(stamp_ns),))  # the first time
            counts |= {f"{subject}: {key}": (value,) for key, value in values.items() if _is_count(value)}
    bias = messages["/imu/bias"][-1][1]
    return {
        "solution": table,
        "biases": {"": _columns(_BIASES), _BIAS: _numbers(_BIASES, _biases(bias))},
        "phases": phases,
        "stopped": stops,
        "counts": counts,
    }


def to_text(title: str, digest: Digest) -> str:
    """The digest as text that `from_text` reads."""
    lines = [f"# {title}."]
    for section, rows in digest.items():
        lines += ["", f"[{section}]"]
        widths = [max(map(len, column)) for column in zip(*rows.values(), strict=True)]
        first = max(map(len, rows), default=0)
        for row, values in rows.items():
            cells = [value.rjust(width) for value, width in zip(values, widths, strict=True)]
            lines.append(f"{row.ljust(first)} | {'  '.join(cells)}")
    return "\n".join(lines) + "\n"


def from_text(text: str) -> Digest:
    """The digest out of its text."""
    digest: Digest = {}
    rows: dict[str, tuple[str, ...]] = {}
    for line in text.splitlines():
        if line.startswith("["):
            rows = digest[line.strip("[]")] = {}
        elif "|" in line:
            row, _, values = line.partition("|")
            rows[row.strip()] = tuple(values.split())
    return digest


def differences(stored: Digest, computed: Digest) -> list[str]:
    """A line for every difference: numbers first, the greatest change in sigmas foremost, then everything else."""
    lines: list[tuple[float, str]] = []
    for section in stored | computed:
        old, new = stored.get(section, {}), computed.get(section, {})
        for row in sorted(old.keys() | new.keys()):
            before, after = old.get(row), new.get(row)
            if before is None or after is None:
                lines.append((-1.0, f"{section}, {row}: {_shown(before)} -> {_shown(after)}"))
            elif section in ("solution", "biases") and before != after:
                lines += _moved(f"{section}, {row}", next(iter(new.values())), before, after)
            elif before != after:
                lines.append((-1.0, f"{section}, {row}: {_shown(before)} -> {_shown(after)}"))
    return [line for _, line in sorted(lines, key=lambda item: -item[0])]


def _moved(
    where: str, columns: tuple[str, ...], before: tuple[str, ...], after: tuple[str, ...]
) -> Iterator[tuple[float, str]]:
    """Numbers of a row that moved by more than rounding: by how many sigmas, and a line."""
    if len(before) != len(columns) or len(after) != len(columns):
        yield math.inf, f"{where}: other columns"
        return
    old, new = (dict(zip(columns, map(float, values), strict=True)) for values in (before, after))
    texts = dict(zip(columns, before, strict=True))
    for name in columns:
        change = new[name] - old[name]
        if name == "heading":
            change = math.remainder(change, 360.0)
        sigma = old[_SIGMAS.get(name, name)]
        last_digit = 10.0 ** -len(texts[name].partition(".")[2]) if name in _SIGMAS else 0.0
        if abs(change) > max(_SHARE * sigma, 1.5 * last_digit):
            share = abs(change) / sigma if sigma else math.inf
            unit = "sigma" if name in _SIGMAS else "of it"
            yield share, f"{where}: {name} {old[name]:g} -> {new[name]:g} ({change:+.4g}, {share:.2g} {unit})"


def _shown(values: tuple[str, ...] | None) -> str:
    return "nothing" if values is None else " ".join(values)


def _rows(times: np.ndarray, every: float) -> list[int]:
    """Indices of the first solution, of the first at or after each multiple of ``every``, of the last."""
    multiples = np.arange(every * math.ceil(times[0] / every), times[-1], every)
    return sorted({0, *np.searchsorted(times, multiples - 1e-6).tolist(), len(times) - 1})


def _columns(table: dict[str, tuple[str, int]]) -> tuple[str, ...]:
    return *table, *dict.fromkeys(sigma for sigma, _ in table.values())


def _numbers(table: dict[str, tuple[str, int]], values: dict[str, float]) -> tuple[str, ...]:
    digits = {name: digits for name, (_, digits) in table.items()}
    return tuple(f"{values[n]:.{digits[n]}f}" if n in digits else f"{values[n]:.3e}" for n in _columns(table))


def _solution(odometry: Any, imu: Any) -> dict[str, float]:
    position, velocity, q = odometry.pose.pose.position, odometry.twist.twist.linear, imu.orientation
    roll, pitch, yaw = to_euler((q.x, q.y, q.z, q.w))
    pose, twist = (np.sqrt(np.diag(np.reshape(c.covariance, (6, 6)))) for c in (odometry.pose, odometry.twist))
    turn = np.sqrt(np.diag(np.reshape(imu.orientation_covariance, (3, 3))))
    return {
        "east": position.x,
        "north": position.y,
        "up": position.z,
        "forward": velocity.x,
        "left": velocity.y,
        "rise": velocity.z,
        "roll": math.degrees(roll),
        "pitch": math.degrees(pitch),
        "heading": math.degrees(heading_from_yaw(yaw)),
        **dict(zip(("s_east", "s_north", "s_up"), pose[:3], strict=True)),
        **dict(zip(("s_forward", "s_left", "s_rise"), twist[:3], strict=True)),
        "s_level": math.degrees(max(turn[:2])),
        "s_heading": math.degrees(turn[2]),
    }


def _biases(bias: Any) -> dict[str, float]:
    values: dict[str, float] = {}
    for sensor, vector, covariance, unit in (
        ("gyro", bias.angular_velocity, bias.angular_velocity_covariance, _DEG_PER_HOUR),
        ("accel", bias.linear_acceleration, bias.linear_acceleration_covariance, 1.0),
    ):
        sigma = np.sqrt(np.diag(np.reshape(covariance, (3, 3))))
        for axis, x, s in zip("xyz", (vector.x, vector.y, vector.z), sigma, strict=True):
            values |= {f"{sensor}_{axis}": x * unit, f"s_{sensor}_{axis}": s * unit}
    return values


def _is_count(value: str) -> bool:
    return value.replace(", ", "").isdigit()
