"""Measurements of a stationary carrier: zero velocity, residual rates."""

import numpy as np

from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, SIZE, VELOCITY
from ins_nav.zupt.zupt_equations import MODEL_ERROR, StopMeasurement


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
        # the azimuth is that of the stop's start: since then S has turned by the drift
        h[0, GYRO_BIAS] -= stop.horizontal_rate * stop.azimuth_gain
        h[0, HEADING] = -stop.horizontal_rate
        z = stop.rate - stop.rot_sb @ np.subtract(solution.gyro_bias, bias)
        rows = self._rows
        r = stop.covariance + MODEL_ERROR**2 * np.eye(3)
        return Measurement(z[rows], h[rows], r[rows, rows], GYRO_BIAS)


_LEAST_NEW = 1e-6
"""Share of a measurement's information that stays where the filter knows all of it."""


def without_known(measurement: Measurement, before: Array, now: Array) -> Measurement:
    """The measurement with the information alone that the filter does not have from the same data.

    The measurement covers a span of data. Other measurements of that span have reduced the covariance of ``h x`` from
    its value before the span to the present one; the difference of the inverses is their information. It is subtracted
    from the measurement's, so that both together count as the better of the two, direction by direction.

    Parameters
    ----------
    measurement : Measurement
    before, now : ndarray, shape (n, n)
        Covariance of the filter when the span began, and at present; the first `SIZE` states count.
    """
    h, r = measurement.h, measurement.r
    root = np.linalg.cholesky(r)
    # whitened by the measurement's noise: its information is the unit matrix
    known = [np.linalg.solve(root, np.linalg.solve(root, h @ p[:SIZE, :SIZE] @ h.T).T) for p in (before, now)]
    floor = 1e-12 * np.trace(known[0]) * np.eye(len(r))
    learnt = np.linalg.inv(known[1] + floor) - np.linalg.inv(known[0] + floor)
    shares, axes = np.linalg.eigh(0.5 * (learnt + learnt.T))
    spread = root @ axes
    widened: Array = (spread / np.clip(1.0 - shares, _LEAST_NEW, 1.0)) @ spread.T
    return measurement._replace(r=widened)
