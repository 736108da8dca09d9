"""One run of the navigation system over recorded messages in memory, as `ins_process` does it, and its errors."""

import copy
import functools
import heapq
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
_NO_SOLUTION = (math.nan,) * (2 * len(COMPONENTS) + PROTECTED)


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
    lines: list[Line]
    counts: dict[str, int]
    raised: str


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
    return (math.nan,) * PROTECTED if levels is None else tuple(levels)


class Run:
    """A navigation system that is led through recorded messages in their order of arrival.

    Parameters
    ----------
    simulation : Simulation
        The truth.
    recording : Recording
    parameters : mapping
        Of the navigator.
    """

    def __init__(self, simulation: Simulation, recording: Recording, parameters: Mapping[str, Any]) -> None:
        self._path = simulation.trajectory
        self._system = NavigationSystem(parameters)
        self._calls = ScheduledCalls(self._system, _nothing)
        self._rows: list[tuple[float, ...]] = []
        self._lines: list[Line] = []
        self._said: set[str] = set()
        self._due = 0.0
        self._raised = ""
        self._sample = self._aid = 0
        self._load(recording)

    def _load(self, recording: Recording) -> None:
        self._imu = recording[IMU]
        streams = (_messages(topic, stream) for topic, stream in recording.items() if topic != IMU)
        self._aids = list(heapq.merge(*streams, key=lambda item: item[0]))

    def fork(self, recording: Recording) -> "Run":
        """Another run that goes on from here with a recording whose messages have been the same until now."""
        other = copy.copy(self)
        owned = {name: value for name, value in vars(self).items() if name not in ("_path", "_imu", "_aids")}
        vars(other).update(copy.deepcopy(owned))
        other._load(recording)
        return other

    def until(self, end: float = math.inf) -> "Run":
        """Process the samples measured before ``end``, s, and the messages before each; an exception ends the run."""
        imu, first = self._imu, self._sample
        last = first + int(np.searchsorted(imu.time[first:], end))
        columns = (imu.arrival_ns, imu.stamps_ns, imu.time, imu.values)
        try:
            for arrival_ns, stamp_ns, time, values in zip(*(x[first:last].tolist() for x in columns), strict=True):
                while self._aid < len(self._aids) and self._aids[self._aid][0] <= arrival_ns:
                    _, topic, make = self._aids[self._aid]
                    self._aid += 1
                    self._system.add(topic, make())
                self._step(stamp_ns, time, values)
        except Exception as error:  # a row that says so
            self._raised = f"{type(error).__name__}: {error}"
        self._sample = last
        return self

    def _step(self, stamp_ns: int, time: float, values: Sequence[float]) -> None:
        system = self._system
        new = system.add_imu(stamp_ns, *values)
        if system.front_end.stamp_ns:
            self._calls.after_sample()
        if time < self._due or not (new or time > self._due + _SILENT or system.realtime.state is None):
            return
        self._due += EVERY * (1 + (time - self._due) // EVERY)
        found = (*_errors(self._path, time, system), *protection_levels(system)) if new else _NO_SOLUTION
        self._rows.append((time, *found))
        self._listen(time)

    def _listen(self, time: float) -> None:
        """Keep what a user gets to read: warnings of the log, and what diagnostics say when it is new."""
        system = self._system
        for report in system.events.drain():
            if report.level != INFO:
                self._lines.append(Line(time, report.text))
        statuses = (
            diagnostics.diagnostics(system.realtime, system.services.solved),
            diagnostics.alignment_diagnostics(system.delayed),
        )
        now = {text for level, text, _ in statuses if level}
        self._lines += [Line(time, text, True) for text in sorted(now - self._said)]
        self._said = now

    @property
    def track(self) -> Track:
        """What the run has led to."""
        table = np.array(self._rows).reshape(len(self._rows), 1 + len(_NO_SOLUTION))
        time, error, sigma, level = np.split(table, np.cumsum([1, len(COMPONENTS), len(COMPONENTS)]), axis=1)
        return Track(time[:, 0], error, sigma, level, self._lines, dict(self._system.events.counts), self._raised)


def _nothing(stopped: bool) -> None:
    pass


def _messages(topic: str, stream: Stream) -> Iterator[tuple[int, str, Callable[[], Any]]]:
    """Arrival, topic, and what makes the message."""
    stream = stream.rows(np.argsort(stream.arrival_ns, kind="stable"))
    for arrival_ns, *content in zip(
        *(column.tolist() for column in stream[2:3] + stream[1:2] + stream[3:]), strict=True
    ):
        yield arrival_ns, topic, functools.partial(_message, topic, *content)


def _errors(path: Trajectory, time: float, system: NavigationSystem) -> tuple[float, ...]:
    """Errors and sigmas of `COMPONENTS` at present."""
    state, p = system.realtime.state, system.realtime.covariance
    if state is None or p is None:
        return (math.nan,) * (2 * len(COMPONENTS))
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
