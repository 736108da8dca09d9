"""Measurements of a stationary carrier: zero velocity, residual rates."""

import numpy as np

from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, SIZE, VELOCITY
from ins_nav.zupt.zupt_equations import StopMeasurement


class ZeroVelocity:
    """The carrier stands: all of its velocity is error, and nothing of it turns with attitude."""

    def measure(self, solution: Solution, stddev: float) -> Measurement:
        """Residual velocity of a standing carrier, each axis, m/s."""
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = np.eye(3)
        return Measurement(np.array(solution.state[4:7]), h, stddev**2 * np.eye(3), VELOCITY)


class ResidualRate:
    """What is left of the rates at a stop (`stationary_rates`): drift, and what a wrong heading leaves of Earth's rate.

    Parameters
    ----------
    vertical : bool
        Only the run-off of yaw: what the horizontal rates say, velocity at rest says too.
    """

    def __init__(self, vertical: bool) -> None:
        self._rows = slice(2, 3) if vertical else slice(0, 3)

    def measure(self, solution: Solution, stop: StopMeasurement, bias: Vector) -> Measurement:
        """The stop, and the gyro bias that was taken out then, body, rad/s."""
        h: Array = np.zeros((3, SIZE))
        h[:, GYRO_BIAS] = -stop.rot_sb
        h[0, HEADING] = -stop.horizontal_rate
        z = stop.rate - stop.rot_sb @ np.subtract(solution.gyro_bias, bias)
        rows = self._rows
        return Measurement(z[rows], h[rows], stop.covariance[rows, rows], GYRO_BIAS)
