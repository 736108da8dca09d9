"""A mission under water, shortened, and a navigator with the filter that is fed its messages."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aid_messages
import numpy as np
from navigators import Filter, Ins

from ins_nav.config.parameters import read_file
from ins_nav.mechanization import earth, nav_state
from ins_nav.navigator.correction import Correction
from ins_nav.simulation.scenarios import Simulation, simulate

NS = 10**9
CONFIG = Path(__file__).resolve().parents[1] / "config" / "auv.yaml"
# the noises of the IMU are densities: these tests do not depend on its rate
MOTION: dict[str, Any] = {
    "rate": 10.0,
    "alignment_time": 120.0,
    "turn_start": 70.0,
    "surface_leg": 60.0,
    "depth": 15.0,
    "leg_length": 100.0,
    "dive_time": 300.0,
    "surface_time": 40.0,
    "log.rate": 1.0,
    "depth.rate": 1.0,
}
PARAMETERS: dict[str, Any] = {"alignment.fine_duration": 120.0}
ALIGNED, DIVE = 60.0, 180.0
"""s, when coarse alignment ends, and when the dive begins."""
Event = tuple[int, str, tuple[Any, ...]]
"""Stamp of arrival, kind, arguments."""


@functools.cache
def mission(*changes: tuple[str, Any]) -> Simulation:
    return simulate("auv_dive", 0, **{**MOTION, **dict(changes)})


def messages(s: Simulation, without: Sequence[str] = (), until: float = math.inf) -> list[Event]:
    """All messages, in order, but of some kinds, or after a time, s."""
    aids = s.aids
    events: list[Event] = []

    def add(kind: str, stamps: np.ndarray, values: Sequence[tuple[Any, ...]]) -> None:
        if kind not in without:
            events.extend((stamp, kind, (stamp, *value)) for stamp, value in zip(stamps.tolist(), values, strict=True))

    imu = np.column_stack([s.angular_velocity, s.linear_acceleration])
    add("imu", s.stamps_ns, list(map(tuple, imu.tolist())))
    named = {tuple(topic.split("/")): readings for topic, readings in aids.items()}
    fixes = [("fix", (), aids["gnss/fix"]), *(("beacon", (k[1],), fix) for k, fix in named.items() if k[0] == "beacon")]
    for kind, name, fix in fixes:
        covariance = tuple(np.diag(np.square(fix.stddev)).ravel().tolist())
        places = np.column_stack([np.degrees(fix.lat), np.degrees(fix.lon), fix.height]).tolist()
        add(kind, fix.stamps_ns, [(*name, 0, *place, covariance) for place in places])
    noise = [tuple((stddev**2 * np.eye(3)).ravel().tolist()) for stddev in aids["log"].stddev.tolist()]
    add("log", aids["log"].stamps_ns, list(zip(map(tuple, aids["log"].velocity.tolist()), noise, strict=True)))
    add(
        "depth", aids["depth"].stamps_ns, [(depth, aids["depth"].stddev ** 2) for depth in aids["depth"].value.tolist()]
    )
    for (_, name_, *_), ranges in ((k, r) for k, r in named.items() if k[0] == "range"):
        add("range", ranges.stamps_ns, [(name_, x, ranges.stddev**2) for x in ranges.distance.tolist()])
    return sorted((e for e in events if e[0] <= s.start_ns + until * NS), key=lambda event: event[0])


@dataclass
class Fed:
    """A navigator with the filter, fed in order of arrival, and its errors every second."""

    simulation: Simulation
    parameters: dict[str, Any] = field(default_factory=dict)
    follow: bool = False
    rows: list[list[float]] = field(default_factory=list)
    feedback: list[Correction] = field(default_factory=list)
    reports: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        parameters = read_file(CONFIG, "ins_node") | PARAMETERS | self.parameters
        self.aided, self.ins = Filter(parameters), Ins(parameters)

    def feed(self, events: list[Event]) -> "Fed":
        aided, ins = self.aided, self.ins
        due_ns = 0
        for _, kind, arguments in events:
            if kind == "imu":
                aided.add_imu(*arguments)
            else:
                aid_messages.add(aided, kind, *arguments)
            new = aided.drain()
            self.feedback += new
            if self.follow:
                for feedback in new:
                    ins.correct(feedback)
                if kind == "imu":
                    ins.add_imu(*arguments)
                elif kind == "fix":
                    aid_messages.add(ins, kind, *arguments)
            if aided.filter is not None and aided.settled_ns >= due_ns:
                due_ns = aided.settled_ns + NS
                self.rows.append(self._row())
        self.reports += [report.text for report in aided.events.drain()]
        return self

    def _row(self) -> list[float]:
        """Time, s, errors east, north, up, sigma of the horizontal distance and of height, m."""
        assert self.aided.filter is not None
        error = off(self.aided, self.aided.settled_ns, self.simulation)
        p = self.aided.filter.p
        time = (self.aided.settled_ns - self.simulation.start_ns) / NS
        return [time, *error, math.sqrt(p[0, 0] + p[1, 1]), math.sqrt(p[2, 2])]

    @property
    def counts(self) -> dict[str, int]:
        return self.aided.events.counts

    def since(self, time: float) -> np.ndarray:
        """Rows from a time on, s."""
        rows = np.array(self.rows)
        return rows[rows[:, 0] >= time]


def off(navigator: Ins, stamp_ns: int, s: Simulation) -> tuple[float, float, float]:
    """Error of its position at that stamp: east, north, up, m."""
    assert navigator.state is not None
    path, i = s.trajectory, int(np.searchsorted(s.stamps_ns, stamp_ns)) + 1
    away = np.subtract(nav_state.position_ecef(navigator.state), path.position_e[i])
    east, north, up = (earth.enu_axes(path.lat[i], path.lon[i]).T @ away).tolist()
    return east, north, up


def run(s: Simulation, without: Sequence[str] = ()) -> Fed:
    return Fed(s).feed(messages(s, without))


def greatest(rows: np.ndarray) -> tuple[float, float]:
    """Greatest horizontal distance and error of height, over sigma."""
    return float((np.hypot(rows[:, 1], rows[:, 2]) / rows[:, 4]).max()), float(np.abs(rows[:, 3] / rows[:, 5]).max())


@functools.cache
def plain_dive() -> Fed:
    """The mission without faults."""
    return run(mission().redrawn(1))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
