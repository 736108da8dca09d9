"""The error filter on a simulated trajectory."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.aiding.base import NO_STATES, Observation
from ins_nav.aiding.gnss import Gnss, GnssParameters
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Array, ErrorModel
from ins_nav.estimation.fault_hypotheses import Verdict
from ins_nav.estimation.filter_bank import FilterBank
from ins_nav.estimation.observation import Measurement, Update
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import COSINE, HEADING, SIZE
from ins_nav.mechanization import nav_state, strapdown
from ins_nav.simulation.motion import Motion, constant, sinusoid
from ins_nav.simulation.trajectory import EarthMotion, Origin, Trajectory

ZERO = (0.0, 0.0, 0.0)


GYRO_NOISE = math.radians(0.003) / 20.0
"""rad/√s: 0.003 deg/s a sample at 400 Hz, the paper's."""


ACCEL_NOISE = 0.02 / 20.0


RATE = 100.0


@functools.cache
def bench(surge: float = 0.0) -> Trajectory:
    """The paper's: roll and pitch ±5°, 11 s, 5 min, 55.7°; and a surge by so many metres."""
    motion = Motion(
        300.0,
        yaw=constant(0.9),
        roll=sinusoid(math.radians(5.0), 11.0),
        pitch=sinusoid(math.radians(5.0), 11.0, 0.7),
        x=sinusoid(surge, 7.0),
        y=sinusoid(0.7 * surge, 9.0, 1.0),
    )
    return EarthMotion(motion, Origin(math.radians(55.7), 0.6, 10.0)).trajectory(RATE)


def difference(computed: nav_state.NavState, true: nav_state.NavState) -> Array:
    """The error state between two solutions, by rotations alone, independent of the model and of `apply`."""
    q = [(Rotation.from_quat(s[0:4]), Rotation.from_quat(s[7:11])) for s in (computed, true)]
    x = np.zeros(SIZE)
    turn = (q[1][1].inv() * q[0][1]).as_rotvec()  # computed n from the true one; its vertical part is azimuth alone
    azimuth = Rotation.from_rotvec([0.0, 0.0, turn[2]])
    away = np.subtract(nav_state.position_ecef(computed), nav_state.position_ecef(true))
    x[0:3] = q[0][1].inv().apply(away)
    x[2] = computed[11] - true[11]
    rot = q[0][0] * (azimuth.inv() * q[1][0]).inv()
    twist = rot.as_quat()
    heading = 2.0 * math.atan2(twist[2], twist[3])  # swing after twist
    x[6:8] = (rot * Rotation.from_rotvec([0.0, 0.0, -heading])).as_rotvec()[:2]
    x[HEADING], x[COSINE] = math.sin(heading), 1.0 - math.cos(heading)
    x[3:6] = np.subtract(computed[4:7], (rot * azimuth.inv()).apply(true[4:7]))
    return x


@dataclass
class Run:
    """A filter on a simulated trajectory: samples with noise, propagation at 10 Hz, an update a second."""

    path: Trajectory
    model: ErrorModel
    seed: int
    stddev: tuple[float, float, float] = (1.0, 0.1, math.radians(0.05))
    """Of the start: horizontal position, m, velocity, m/s, level, rad."""
    heading_stddev: float = math.radians(5.0)
    heading_error: float | None = None
    """rad; drawn with its deviation when None."""
    gyro_noise: float = GYRO_NOISE
    accel_noise: float = ACCEL_NOISE
    gyro_bias: Sequence[float] = ZERO
    accel_bias: Sequence[float] = ZERO
    aids: dict[str, Sequence[SlowState]] | None = None
    watched: bool = False
    """The filter has others beside it that detect faults."""

    def __post_init__(self) -> None:
        rng = self.rng = np.random.default_rng(self.seed)
        n = len(self.path.delta_theta)
        noise = math.sqrt(RATE) * rng.standard_normal((n, 6))
        rate = RATE * self.path.delta_theta + self.gyro_bias + self.gyro_noise * noise[:, :3]
        force = RATE * self.path.delta_velocity + self.accel_bias + self.accel_noise * noise[:, 3:]
        self.samples = np.c_[np.full(n, 1.0 / RATE), rate, force]
        position, velocity, level = self.stddev
        covariance = np.diag([level**2, level**2, self.heading_stddev**2])
        self.filter = ErrorFilter(self.model, (position,) * 3, (velocity,) * 3, covariance, self.aids)
        x = np.zeros(SIZE)
        x[0:2], x[3:5], x[6:8] = (s * rng.standard_normal(2) for s in self.stddev)
        gamma = self.heading_error
        gamma = self.heading_stddev * rng.standard_normal() if gamma is None else gamma
        x[HEADING], x[COSINE] = math.sin(gamma), math.cos(gamma) - 1.0
        self.state = self.model.apply(-x, self.truth(0), ZERO, ZERO)[0]
        self.bias = (ZERO, ZERO)
        self.previous = tuple(self.samples[0])
        self.bank = FilterBank(self.filter)
        self.propagate = self.bank.propagate if self.watched else self.filter.propagate
        self.verdicts: list[tuple[int, Verdict]] = []

    def truth(self, second: int) -> nav_state.NavState:
        p, i = self.path, second * round(RATE)
        v = (*p.velocity_n[i, :2], p.velocity_n[i, 2] if self.model.vertical else 0.0)
        return nav_state.initial_state(p.lat[i], p.lon[i], p.height[i], v, tuple(p.q_nb[i]))

    def advance(self, second: int) -> None:
        """Mechanization and propagation up to a second from the one before."""
        per, step = round(RATE), 10
        chunk = self.samples[(second - 1) * per : second * per] - [0.0, *self.bias[0], *self.bias[1]]
        states = strapdown.integrate(self.state, self.previous, chunk, vertical=self.model.vertical)
        self.previous = tuple(chunk[-1])
        for i in range(step - 1, per, step):
            after = tuple(states[i].tolist())
            self.propagate(self.state, after, step / RATE)
            self.state = after

    def gnss(self, second: int, stddev: float = 1.0, offset: Sequence[float] = (0.0, 0.0)) -> Update:
        """A fix with noise and an offset, m east and north; fed back."""
        i = second * round(RATE)
        east, north = stddev * self.rng.standard_normal(2) + offset
        lat, lon = self.path.lat[i], self.path.lon[i]
        fix = (lat + north / 6.371e6, lon + east / (6.38e6 * math.cos(lat)), self.path.height[i])
        solution = self.filter.solution(self.state, tuple(self.previous[1:4]), self.bias[0])
        seen = Observation(0, "gnss", (*fix[:2], math.nan), stddev**2 * np.eye(3))
        measurement = Gnss(GnssParameters()).measure(solution, NO_STATES, seen)
        return self.update("gnss", second * 10**9, measurement)

    def update(self, source: str, stamp_ns: int, measurement: Measurement) -> Update:
        """Update and feed back."""
        if self.watched:
            update, verdict = self.bank.update(source, source, stamp_ns, measurement)
            if verdict is not Verdict.NONE:
                self.verdicts.append((round(stamp_ns * 1e-9), verdict))
        else:
            update = self.filter.update(source, stamp_ns, measurement)
        self.feed_back()
        return update

    def feed_back(self) -> None:
        self.state, *self.bias = self.filter.feed_back(self.state, *self.bias)
        if self.watched:
            self.bank.follow()

    def error(self, second: int) -> Array:
        """The true errors."""
        x = difference(self.state, self.truth(second))
        x[9:15] = np.subtract(np.ravel(self.bias), [*self.gyro_bias, *self.accel_bias])
        return x

    def heading_error_now(self, second: int) -> float:
        x = self.error(second)
        return math.atan2(x[HEADING], 1.0 - x[COSINE])


def standing(**changes: SlowState) -> ErrorModel:
    return ErrorModel(vertical=False, gyro_noise=GYRO_NOISE, accel_noise=ACCEL_NOISE, **changes)
