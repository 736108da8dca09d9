"""A navigator with the filter that is fed a simulation, for the tests of `ins_nav.navigator.delayed`."""

import functools
import itertools
import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import aid_messages
import numpy as np
from navigators import Filter, Ins
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import nav_state
from ins_nav.navigator.correction import Correction
from ins_nav.simulation.scenarios import Simulation, simulate

BOTH = ("--nodes", "ins_node", "alignment_node")
NS = 1_000_000_000
PLACE = {"initial.latitude_deg": 55.7, "initial.longitude_deg": 37.6, "initial.height": 150.0}
SHORT = {"alignment.duration": 20.0, "alignment.fine_duration": 40.0}
FOG = {
    "imu.gyro_bias_stddev_deg_per_hour": 0.2,
    "imu.gyro_noise_deg_per_sqrt_hour": 0.009,
    "imu.accel_bias_stddev_mg": 0.51,
    "imu.accel_noise_ug_per_sqrt_hz": 102.0,
}
"""What the sensors of the rocking scenarios have."""

Event = tuple[int, int, str, tuple[Any, ...]]
"""Stamp of arrival, number, kind, arguments."""


@functools.cache
def drive(seed: int = 3, duration: float = 110.0) -> Simulation:
    """24 s standing, then driving; 50 Hz, a stop after some 100 s."""
    return simulate("vehicle", seed, duration=duration, rate=50.0, stand_time=24.0)


def imu_events(s: Simulation) -> list[Event]:
    values = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    return [(stamp, 0, "imu", (stamp, *row)) for stamp, row in zip(s.stamps_ns.tolist(), values, strict=True)]


def aid_events(s: Simulation, names: Iterable[str] = ("fix",), delay: float = 0.0, shuffle: float = 0.0) -> list[Event]:
    """Observations at the stamps of the fixes; they come late by ``delay`` and up to ``shuffle`` more, s."""
    rng, late = np.random.default_rng(5), random.Random(7)
    index = {stamp: i for i, stamp in enumerate([s.start_ns, *s.stamps_ns.tolist()])}
    covariance = tuple(np.diag(np.square(s.fixes.stddev)).ravel().tolist())
    events: list[Event] = []
    for stamp, lat, lon, height in zip(*(x.tolist() for x in s.fixes[:4]), strict=True):
        where = nav_state.geodetic(true_state(s, index[stamp]))
        velocity, noise = np.array(where.velocity_g), rng.normal(0.0, 0.1, (2, 3))
        body = Rotation.from_quat(where.q_gb).inv().apply(velocity)
        rows = tuple((0.01 * np.eye(3)).ravel().tolist())
        content = {
            "fix": (stamp, 0, math.degrees(lat), math.degrees(lon), height, covariance),
            "velocity": (stamp, tuple((velocity + noise[0]).tolist()), rows),
            "log": (stamp, tuple((body + noise[1]).tolist()), rows),
        }
        for name in names:
            comes = stamp + round((delay + late.uniform(0.0, shuffle)) * 1e9)
            events.append((comes, 1 + len(events), name, content[name]))
    return events


def true_state(s: Simulation, i: int) -> nav_state.NavState:
    t = s.trajectory
    rot_eg = Rotation.from_quat(t.q_eb[i]) * Rotation.from_quat(t.q_nb[i]).inv()
    velocity = rot_eg.inv().apply(t.velocity_e[i])
    return nav_state.initial_state(t.lat[i], t.lon[i], t.height[i], tuple(velocity), tuple(t.q_nb[i]))  # type: ignore[arg-type]


@dataclass
class Fed:
    """Both navigators, fed as `ins_process` does it."""

    parameters: dict[str, Any]
    aided: Filter = field(init=False)
    ins: Ins = field(init=False)
    feedback: list[Correction] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.aided, self.ins = Filter(self.parameters), Ins(self.parameters)

    def feed(self, *streams: list[Event], ins: bool = False) -> "Fed":
        feeds = {"imu": self.aided.add_imu, "zupt": self.aided.call_zupt}
        for _, _, kind, arguments in sorted(itertools.chain(*streams), key=lambda event: event[:2]):
            if kind in feeds:
                feeds[kind](*arguments)
            else:
                aid_messages.add(self.aided, kind, *arguments)
            new = self.aided.drain()
            self.feedback += new
            if ins:
                for feedback in new:
                    self.ins.correct(feedback)
                if kind == "imu":
                    self.ins.add_imu(*arguments)
                elif kind == "fix":
                    aid_messages.add(self.ins, kind, *arguments)
        self.said += [report.text for report in self.aided.events.drain()]
        return self

    @property
    def counts(self) -> dict[str, int]:
        return self.aided.events.counts


def same_feedback(a: Sequence[Correction], b: Sequence[Correction]) -> bool:
    """Bit for bit."""
    return len(a) == len(b) and all(
        x._replace(covariance=None) == y._replace(covariance=None)  # type: ignore[arg-type]
        and np.array_equal(x.covariance, y.covariance)
        for x, y in zip(a, b, strict=True)
    )


def feedback_error(feedback: Correction, s: Simulation) -> np.ndarray:
    """Position on n, velocity as `ins_nav.estimation.error_model` has it, attitude; computed less true."""
    i = int(np.searchsorted(s.stamps_ns, feedback.stamp_ns)) + 1
    t, state = s.trajectory, feedback.state
    to_n = Rotation.from_quat(state[7:11]).inv()
    position = to_n.apply(np.subtract(nav_state.position_ecef(state), t.position_e[i]))
    turn = Rotation.from_quat(state[0:4]) * (to_n * Rotation.from_quat(t.q_eb[i])).inv()
    velocity = np.array(state[4:7]) - turn.apply(to_n.apply(t.velocity_e[i]))
    return np.concatenate([position, velocity, turn.as_rotvec()])


def feedback_nees(feedback: Correction, s: Simulation, *states: int) -> float:
    error = feedback_error(feedback, s)[list(states)]
    return float(error @ np.linalg.solve(feedback.covariance[np.ix_(states, states)], error))


def standing(zero_velocity: bool, duration: float = 90.0, **more: Any) -> tuple[Simulation, Fed]:
    s = simulate("static", 5, duration=duration, rate=50.0)
    return s, Fed({**PLACE, **SHORT, "zupt.zero_velocity": zero_velocity, **more})
