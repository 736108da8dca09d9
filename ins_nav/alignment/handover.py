"""From coarse alignment to the filter: the covariance of the first solution."""

import numpy as np

from ins_nav.alignment.coarse_alignment import Alignment
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.state_layout import ATTITUDE, MOTION, POSITION, SENSED, SOLUTION_SIZE

_LEAST_VELOCITY = 1e-3
"""m/s: no velocity is known better after coarse alignment."""


def after_alignment(alignment: Alignment, position_stddev: Vector, lever_arm_g: Vector) -> Array:
    """Covariance of the errors at the end of coarse alignment, on east, north, up (`covariance_of`).

    Parameters
    ----------
    alignment : Alignment
    position_stddev : 3 floats
        Of the place known, m.
    lever_arm_g : 3 floats
        From the IMU to that place, east, north, up, m: it turns with the error of attitude.
    """
    covariance = np.zeros((SOLUTION_SIZE, SOLUTION_SIZE))
    velocity = max(alignment.velocity_stddev, _LEAST_VELOCITY)
    covariance[MOTION, MOTION] = np.diag(np.square([*position_stddev, *[velocity] * 3]))
    covariance[SENSED, SENSED] = alignment.joint
    x, y, z = lever_arm_g
    carried = np.eye(SOLUTION_SIZE)
    carried[POSITION, ATTITUDE] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return carried @ covariance @ carried.T
