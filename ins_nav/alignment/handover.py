"""Covariance of the first solution, from coarse alignment to the filter."""

import numpy as np

from ins_nav.alignment.coarse_alignment import Alignment
from ins_nav.estimation.error_model import Array, Vector, mean_reading
from ins_nav.estimation.imu_error import ImuErrors
from ins_nav.estimation.state_layout import ATTITUDE, MOTION, POSITION, SENSED, SOLUTION_SIZE
from ins_nav.mechanization.nav_state import NavState

_LEAST_VELOCITY = 1e-3
"""m/s: least sigma of velocity after coarse alignment."""


def after_alignment(
    alignment: Alignment, state: NavState, position_stddev: Vector, lever_arm_g: Vector, imu_errors: ImuErrors
) -> Array:
    """Covariance of the errors at the end of coarse alignment, on east, north, up (`covariance_of`).

    Parameters
    ----------
    alignment : Alignment
    state : NavState
        The first solution.
    position_stddev : 3 floats
        Of the known position, m.
    lever_arm_g : 3 floats
        From the IMU to that position, east, north, up, m: it turns with the error of attitude.
    imu_errors : ImuErrors
        Errors of level and heading contain these errors as they contain the biases.
    """
    size = SOLUTION_SIZE + imu_errors.size
    covariance = np.zeros((size, size))
    velocity = max(alignment.velocity_stddev, _LEAST_VELOCITY)
    covariance[MOTION, MOTION] = np.diag(np.square([*position_stddev, *[velocity] * 3]))
    covariance[SENSED, SENSED] = alignment.joint
    np.einsum("ii->i", covariance)[SOLUTION_SIZE:] = [s.stddev**2 for s in imu_errors.states]
    x, y, z = lever_arm_g
    carried, correlated = np.eye(size), np.eye(size)
    carried[POSITION, ATTITUDE] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    correlated[ATTITUDE, SOLUTION_SIZE:] = alignment.by_bias @ imu_errors.columns(mean_reading(state, state, 1.0))
    both = carried @ correlated
    return both @ covariance @ both.T
