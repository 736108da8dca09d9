"""Aids from parameters, observations, and a true motion with a sensor at the end of an arm, for tests of aids."""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.aiding.base import Aid, Observation, OwnStates
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import create_aids
from ins_nav.estimation.error_model import Array
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.mechanization import nav_state
from ins_nav.simulation.motion import Motion, constant, sinusoid
from ins_nav.simulation.trajectory import EarthMotion, Origin

NAN = math.nan
ZERO = (0.0, 0.0, 0.0)
ARM = (2.0, -1.0, 3.0)
COVARIANCE = np.diag([1.0, 4.0, 9.0])
LAT, LON = 0.97, 0.6
STATE = nav_state.initial_state(
    math.radians(55.7), math.radians(37.6), 150.0, (3.0, 4.0, 0.0), (0.0, 0.0, math.sin(0.2), math.cos(0.2))
)
SOLUTION = Solution(STATE, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), True, 0.0)


def aids_of(overrides: Mapping[str, object] | None = None) -> dict[str, Aid[Any]]:
    return create_aids(configuration(overrides).values)


def own_of(*values: float) -> OwnStates:
    """Exactly known."""
    return OwnStates(np.array(values), np.zeros((len(values), len(values))))


def observed(name: str, *value: float, covariance: np.ndarray | None = None) -> Observation:
    size = len(value)
    return Observation(1, name, value, np.eye(size) if covariance is None else covariance)


Measure = Callable[[Solution, Array], Measurement | None]
"""Measurement of a solution with states of the aid in use."""


def of(aid: Aid[Any], *value: float, covariance: Array = COVARIANCE) -> Measure:
    """The measurement of an aid by a value; of one number the variance is the first."""
    size = len(value)

    def measure(solution: Solution, own: Array) -> Measurement | None:
        states = OwnStates(np.asarray(own), np.zeros((len(own), len(own))))
        return aid.measure(solution, states, Observation(0, aid.name, value, covariance[:size, :size]))

    return measure


def state_at() -> nav_state.NavState:
    """Under way and heeling; n turned from east-north-up by 0.4 rad."""
    q = tuple(Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_quat())
    state = nav_state.initial_state(LAT, LON, 30.0, (6.0, 5.0, 0.4), q)
    q_en = Rotation.from_quat(state[7:11]) * Rotation.from_rotvec([0.0, 0.0, 0.4])
    return (*state[:7], *map(float, q_en.as_quat()), state[11])


@functools.cache
def flight() -> tuple[EarthMotion, float]:
    motion = Motion(
        60.0,
        speed=constant(8.0),
        yaw=sinusoid(1.0, 20.0),
        z=sinusoid(3.0, 10.0),
        roll=sinusoid(0.2, 5.0),
        pitch=sinusoid(0.1, 7.0),
    )
    return EarthMotion(motion, Origin(LAT, LON, 30.0)), 23.4


def at(time: float) -> tuple[Solution, Array, Array]:
    """The truth as a solution, and Earth-fixed position, attitude matrix."""
    s = flight()[0].states(np.array([time]))
    state = nav_state.initial_state(s.lat[0], s.lon[0], s.height[0], tuple(s.velocity_n[0]), tuple(s.q_nb[0]))
    q_en = Rotation.from_quat(state[7:11]) * Rotation.from_rotvec([0.0, 0.0, 0.4])
    q_nb = Rotation.from_rotvec([0.0, 0.0, -0.4]) * Rotation.from_quat(state[0:4])
    velocity = Rotation.from_rotvec([0.0, 0.0, -0.4]).apply(state[4:7])
    turned = (*map(float, q_nb.as_quat()), *map(float, velocity), *map(float, q_en.as_quat()), state[11])
    rate = tuple(s.rate[0].tolist())
    return Solution(turned, rate, ZERO, True, 0.0), s.position_e[0], Rotation.from_quat(s.q_eb[0]).as_matrix()


def point(time: float) -> Array:
    """Earth-fixed position of the end of the arm."""
    _, position, rot_eb = at(time)
    return position + rot_eb @ ARM


def point_velocity(time: float) -> Array:
    """Earth-fixed, m/s; five-point difference."""
    h = 0.02
    a, b, c, d = (point(time + k * h) for k in (-2, -1, 1, 2))
    return (a - 8.0 * b + 8.0 * c - d) / (12.0 * h)
