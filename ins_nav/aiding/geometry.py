"""Formulas that the measurements of aids share.

Three facts about errors (`ins_nav.estimation.error_model`) give most Jacobians: a vector on body axes, turned to n, is
wrong by ``phi x vector``; velocity on body axes by ``rot_bn dv``; position by ``dp``. A sine and a cosine stand for
heading: a horizontal vector that turns with heading has its own components in the column of the cosine.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ins_nav.estimation.error_model import Array, Vector, azimuth
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import ATTITUDE, COSINE
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import rotate


def set_turned(h: Array, vector: Sequence[float] | Array) -> None:
    """Set the columns of attitude and of the cosine in h, shape (3, n), for a vector on n that turns with the body."""
    x, y, z = map(float, vector)
    h[:, ATTITUDE] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    h[0, COSINE], h[1, COSINE] = x, y


def cross_matrix(vector: Sequence[float]) -> Array:
    """Matrix of ``vector x``, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rate_to_earth(solution: Solution) -> Vector:
    """Angular rate of the body relative to the Earth, body axes, rad/s."""
    x, y, z = nav_state.earth_rate_body(solution.state)
    return solution.rate[0] - x, solution.rate[1] - y, solution.rate[2] - z


def from_earth(state: nav_state.NavState, vector: Array) -> Vector:
    """An Earth-fixed vector on n."""
    x, y, z, w = state[7:11]
    return rotate((-x, -y, -z, w), *map(float, vector))


def east_north(state: nav_state.NavState) -> Array:
    """East and north on n, shape (3, 2)."""
    c, s = azimuth(state)
    return np.array([[c, s], [-s, c], [0.0, 0.0]])


def enu_covariance_on_n(state: nav_state.NavState, covariance: ArrayLike) -> Array:
    """A covariance on east, north, up, shape (3, 3), on n."""
    c, s = azimuth(state)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = turn @ np.asarray(covariance, float) @ turn.T
    return turned


def first_rows(measurement: Measurement, count: int) -> Measurement:
    """A measurement of the first axes only."""
    z, h, r, _, own, *_ = measurement
    own = None if own is None else own[:count]
    return measurement._replace(innovation=z[:count], h=h[:count], r=r[:count, :count], own=own)
