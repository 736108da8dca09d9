"""One run of the navigation system over recorded messages in memory, as `ins_process` does it, and its errors."""

import heapq
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.fault_injection import IMU, NS, Recording, Stream
from ins_nav.aiding.acoustic_range import range_message
from ins_nav.aiding.depth import depth_message
from ins_nav.aiding.heading import heading_message
from ins_nav.aiding.pressure import pressure_message
from ins_nav.aiding.simulated import Fixes, fix_message, velocity_message
from ins_nav.estimation.state_layout import HEADING, HEIGHT, HORIZONTAL_POSITION, TILT
from ins_nav.event_log import INFO
from ins_nav.mechanization import attitude, earth, nav_state
from ins_nav.messages import diagnostics
from ins_nav.navigator.system import NavigationSystem, ScheduledCalls
from ins_nav.recordings.bags import message
from ins_nav.simulation.scenarios import Simulation
from ins_nav.simulation.trajectory import Trajectory

Array = NDArray[np.float64]
COMPONENTS = ("position", "height", "heading", "level")
"""Columns of errors and sigmas: m, m, rad, rad; position is the horizontal distance."""
PROTECTED = 3
"""The first of them have a protection level."""
EVERY = 0.5
"""s between two looks at the errors."""
_SILENT = 1.0
"""s without a new solution, while samples arrive, that count as no solution."""
_NO_SOLUTION = (math.nan,) * (2 * len(COMPONENTS))
_NO_LEVELS = (math.nan,) * PROTECTED


class Line(NamedTuple):
    """A warning or an error that a user gets."""

    time: float
    """s since the start."""
    text: str
    diagnostic: bool = False
    """Of diagnostics; otherwise of the event log."""


@dataclass
class Track:
    """What a run leads to.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s since the start.
    error, sigma : ndarray, shape (n, 4)
        Of `COMPONENTS`; NaN without a solution.
    level : ndarray, shape (n, 3)
        Protection levels of the first three; NaN where the system has none.
    lines : list of Line
        Warnings and errors of the event log, and of diagnostics where their text changed.
    counts : dict
        Of events.
    raised : str
        The exception that ended the run; empty: none.
    """

    time: Array
    error: Array
    sigma: Array
    level: Array
    lines: list[Line] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    raised: str = ""


def recording_of(simulation: Simulation) -> Recording:
    """Messages of a simulation; those of aids arrive at their stamps."""
    start_ns = simulation.start_ns

    def stream(stamps_ns: NDArray[np.int64], values: Array, stddev: Any) -> Stream:
        values = values.reshape(len(stamps_ns), -1)
        deviations = np.broadcast_to(
            np.reshape(stddev, (-1, np.shape(stddev)[-1] if np.ndim(stddev) else 1)), values.shape
        )
        time = (stamps_ns - start_ns) / NS
        return Stream(time, stamps_ns, stamps_ns, values, np.square(deviations), np.zeros(len(values), np.int64))

    samples = np.hstack([simulation.angular_velocity, simulation.linear_acceleration])
    found = {IMU: stream(simulation.stamps_ns, samples, 0.0)}
    for topic, readings in simulation.aids.items():
        if topic.startswith("truth/") or not len(readings.stamps_ns):
            continue
        if isinstance(readings, Fixes):
            values = np.column_stack([np.degrees(readings.lat), np.degrees(readings.lon), readings.height])
        else:
            values = _values(readings)
        stddev = np.reshape(readings.stddev, (-1, 1)) if topic == "log" else np.asarray(readings.stddev)
        found[topic] = stream(readings.stamps_ns, values, stddev)
    return found


def _values(readings: Any) -> Array:
    """What readings of an aid other than a fix measured, shape (m,) or (m, k)."""
    names = ("velocity", "distance", "value", "yaw")
    values: Array = next(getattr(readings, name) for name in names if hasattr(readings, name))
    return values


def _make(topic: str, stream: Stream) -> Iterator[tuple[int, str, Any]]:
    """Arrival, topic and message."""
    columns = (stream.arrival_ns, stream.stamps_ns, stream.values, stream.variances, stream.status)
    for arrival, stamp, values, variances, status in zip(*(x.tolist() for x in columns), strict=True):
        yield arrival, topic, _message(topic, stamp, values, variances, status)


def _message(topic: str, stamp_ns: int, values: list[float], variances: list[float], status: int) -> Any:
    covariance = np.diag(variances).ravel().tolist() if any(variances) else ()
    if topic.endswith("/fix"):
        return fix_message(message, stamp_ns, status, *values, covariance)
    if topic in ("log", "gnss/velocity"):
        return velocity_message(message, stamp_ns, values, covariance)
    scalar: Callable[..., Any] = {"depth": depth_message, "pressure": pressure_message, "heading": heading_message}.get(
        topic, range_message
    )
    return scalar(message, stamp_ns, *values, *variances)


def protection_levels(system: NavigationSystem) -> tuple[float, ...]:
    """Horizontal and vertical, m, and heading, rad: the system's; NaN where it has none."""
    levels = getattr(system, "protection_levels", None)
    return _NO_LEVELS if levels is None else tuple(levels)


def run(simulation: Simulation, recording: Recording, parameters: Mapping[str, Any]) -> Track:
    """Navigate over the messages in their order of arrival.

    An exception ends the run; it is in the result.
    """
    system = NavigationSystem(parameters)
    calls = ScheduledCalls(system, lambda stopped: None)
    rows: list[tuple[float, ...]] = []
    track = Track(*(np.empty(0),) * 4)
    imu = recording[IMU]
    aids = heapq.merge(*(_sorted(topic, s) for topic, s in recording.items() if topic != IMU), key=lambda m: m[0])
    samples = zip(imu.arrival_ns.tolist(), imu.stamps_ns.tolist(), imu.time.tolist(), imu.values.tolist(), strict=True)
    waiting = next(aids, None)
    due, said = 0.0, set[str]()
    try:
        for arrival, stamp_ns, time, values in samples:
            while waiting is not None and waiting[0] <= arrival:
                system.add(*waiting[1:])
                waiting = next(aids, None)
            new = system.add_imu(stamp_ns, *values)
            if system.front_end.stamp_ns:
                calls.after_sample()
            if time < due or not (new or time > due + _SILENT or system.realtime.state is None):
                continue
            due += EVERY * (1 + (time - due) // EVERY)
            found = _errors(simulation.trajectory, time, system) if new else _NO_SOLUTION
            rows.append((time, *found, *(protection_levels(system) if new else _NO_LEVELS)))
            _listen(track, time, system, said)
    except Exception as error:  # a row that says so
        track.raised = f"{type(error).__name__}: {error}"
    table = np.array(rows).reshape(len(rows), 1 + 2 * len(COMPONENTS) + PROTECTED)
    track.time, track.error, track.sigma, track.level = np.split(table, np.cumsum([1, 4, 4]), axis=1)
    track.time, track.counts = track.time[:, 0], dict(system.events.counts)
    return track


def _sorted(topic: str, stream: Stream) -> Iterator[tuple[int, str, Any]]:
    return _make(topic, stream.rows(np.argsort(stream.arrival_ns, kind="stable")))


def _listen(track: Track, time: float, system: NavigationSystem, said: set[str]) -> None:
    """Keep what a user gets to read: warnings of the log, and what diagnostics say when it is new."""
    for report in system.events.drain():
        if report.level != INFO:
            track.lines.append(Line(time, report.text))
    now = set()
    statuses = (
        diagnostics.diagnostics(system.realtime, system.services.solved),
        diagnostics.alignment_diagnostics(system.delayed),
    )
    for level, text, _ in statuses:
        if level:
            now.add(text)
            if text not in said:
                track.lines.append(Line(time, text, True))
    said.clear()
    said |= now


def _errors(path: Trajectory, time: float, system: NavigationSystem) -> tuple[float, ...]:
    """Errors and sigmas of `COMPONENTS` at present."""
    state, p = system.realtime.state, system.realtime.covariance
    if state is None or p is None:
        return _NO_SOLUTION
    i = min(round(time / path.interval), len(path.time) - 1)
    where = nav_state.geodetic(state)
    meridian, prime_vertical = earth.principal_radii(math.sin(path.lat[i]))
    east = (
        math.remainder(where.lon - path.lon[i], 2.0 * math.pi)
        * (prime_vertical + path.height[i])
        * math.cos(path.lat[i])
    )
    north = (where.lat - path.lat[i]) * (meridian + path.height[i])
    yaw, true_yaw = (attitude.to_euler(tuple(q))[2] for q in (where.q_gb, path.q_nb[i]))
    vertical, true_vertical = (_vertical(q) for q in (where.q_gb, path.q_nb[i]))
    level = math.atan2(float(np.linalg.norm(np.cross(vertical, true_vertical))), float(vertical @ true_vertical))
    sigma = np.sqrt(p.diagonal())
    return (
        math.hypot(east, north),
        abs(where.height - path.height[i]),
        abs(math.remainder(yaw - true_yaw, 2.0 * math.pi)),
        level,
        math.hypot(*sigma[HORIZONTAL_POSITION]),
        *(float(sigma[HEIGHT]), float(sigma[HEADING])),
        math.hypot(*sigma[TILT]),
    )


def _vertical(q: Any) -> Array:
    """The vertical on the body's axes."""
    x, y, z, w = map(float, q)
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
