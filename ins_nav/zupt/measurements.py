"""Measurements of a stationary carrier: zero velocity, residual rates, solutions of ZUPT-1."""

from typing import NamedTuple

import numpy as np

from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.innovation_gate import GATE, limit
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, SIZE, VELOCITY
from ins_nav.mechanization.nav_state import NavState, heading_change
from ins_nav.zupt.zupt_equations import MODEL_ERROR, Calibration, StopMeasurement


class ZeroVelocity:
    """Velocity of a stationary carrier: all of it is error, and none of it depends on attitude."""

    def measure(self, solution: Solution, stddev: float) -> Measurement:
        """Residual velocity of a standing carrier, each axis, m/s."""
        h: Array = np.zeros((3, SIZE))
        h[:, VELOCITY] = np.eye(3)
        return Measurement(np.array(solution.state[4:7]), h, stddev**2 * np.eye(3), VELOCITY)


class ResidualRate:
    """Residual rate at a stop (`stationary_rates`): gyro drift, and the part of the Earth's rate of a heading error.

    Parameters
    ----------
    vertical : bool
        Only the drift of yaw: velocity at rest contains the same information on the horizontal rates.
    """

    def __init__(self, vertical: bool) -> None:
        self._rows = slice(2, 3) if vertical else slice(0, 3)

    def measure(self, solution: Solution, stop: StopMeasurement, bias: Vector) -> Measurement:
        """Residual rate less its prediction, rad/s.

        Parameters
        ----------
        solution : Solution
        stop : StopMeasurement
        bias : 3 floats
            Gyro bias removed from the samples of the stop, body, rad/s.
        """
        k = stop.horizontal_rate
        h: Array = np.zeros((3, SIZE))
        h[:, GYRO_BIAS] = -stop.rot_sb
        # the azimuth is that of the stop's start: since then S has turned by the drift
        h[0, GYRO_BIAS] -= k * stop.azimuth_gain
        h[0, HEADING] = -k
        z = stop.rate - stop.rot_sb @ np.subtract(solution.gyro_bias, bias)
        rows = self._rows
        r = stop.covariance + MODEL_ERROR**2 * np.eye(3)
        # second order of the heading error: k (cos - 1), of mean square 3/4 k² variance²
        r[1, 1] += 0.75 * (k * solution.turn) ** 2
        return Measurement(z[rows], h[rows], r[rows, rows], GYRO_BIAS)


class StopCalibration(NamedTuple):
    """Solution of ZUPT-1, as a measurement of drifts and heading.

    Attributes
    ----------
    stamp_ns : int
    state : NavState
        Solution at the stamp whose heading has the errors below.
    found : Calibration
        From the two stops alone; drifts are absolute, azimuth is that of ``state``.
    expected : Calibration
        Drifts and azimuth before the first stop, by the solution of that time, on the same axes.
    """

    stamp_ns: int
    state: NavState
    found: Calibration
    expected: Calibration

    def measure(self, solution: Solution) -> Measurement:
        """Heading error, rad, and gyro bias errors, rad/s, of a solution at the stamp."""
        h: Array = np.zeros((4, SIZE))
        h[0, HEADING] = 1.0
        h[1:, GYRO_BIAS] = np.eye(3)
        return Measurement(self._errors(solution, self.found), h, _by_heading(self.found), _CALIBRATED)

    def new(self, solution: Solution, now: Array) -> tuple[Measurement, float]:
        """As `measure`, without the information that the filter has from the same data (`without_known`).

        Parameters
        ----------
        solution : Solution
        now : ndarray, shape (n, n)
            Covariance of the filter.
        """
        before = np.zeros((SIZE, SIZE))
        before[_CALIBRATED, _CALIBRATED] = _by_heading(self.expected)
        # error of the solution at the stamp, had it not been corrected since the first stop began
        uncorrected = self._errors(solution, self.found) - self._errors(solution, self.expected)
        return without_known(self.measure(solution), before, now, uncorrected)

    def _errors(self, solution: Solution, calibration: Calibration) -> Array:
        azimuth = calibration.azimuth + heading_change(self.state, solution.state)
        return np.array([azimuth, *(np.asarray(solution.gyro_bias) - calibration.drift)])


_CALIBRATED = slice(HEADING, GYRO_BIAS.stop)


def _by_heading(calibration: Calibration) -> Array:
    """Covariance of the errors of heading and gyro biases, from that of drifts and azimuth."""
    order, signs = [3, 0, 1, 2], np.array([1.0, -1.0, -1.0, -1.0])
    return calibration.covariance[np.ix_(order, order)] * np.outer(signs, signs)


NO_GATE = 0.0
"""Probability of rejection of a measurement whose consistency has been tested."""
_LEAST_NEW, _NOTHING = 0.02, 1e-6
"""Share of a direction's information that must be new; the share that stands for less."""
_EXACT = 1e-6
"""Variance over that of the measurement that counts as zero."""


def without_known(measurement: Measurement, before: Array, now: Array, uncorrected: Array) -> tuple[Measurement, float]:
    """The part of a measurement that the filter does not have from the same data.

    The measurement covers a span of data. Other measurements of that span have changed estimate and covariance of
    ``h x`` from their values before the span to the present ones; the differences of information vector and information
    matrix are theirs. Both are subtracted from the measurement's, so that together they count as the measurement alone.
    A direction in which the filter has learnt more keeps the filter's estimate. An estimate before the span that the
    measurement contradicts (a drift has changed) has its covariance increased until they agree; a present estimate that
    it contradicts is no knowledge.

    Parameters
    ----------
    measurement : Measurement
    before, now : ndarray, shape (n, n)
        Covariance of the filter when the span began, and at present; the first `SIZE` states count.
    uncorrected : ndarray, shape (m,)
        The innovation, had the filter not been corrected since the span began.

    Returns
    -------
    Measurement
    float
        Its gate. Consistency is tested here, on the whole measurement: the difference of two estimates from the same
        data is small, and its division by the new share is no innovation.
    """
    h, r = measurement.h, measurement.r
    root = np.linalg.cholesky(r)
    white = np.linalg.inv(root)
    # whitened by the measurement's noise: its information is the unit matrix
    known = [white @ h @ p[:SIZE, :SIZE] @ h.T @ white.T for p in (before, now)]
    present, past = white @ measurement.innovation, white @ uncorrected
    squares = [z @ np.linalg.solve(p + np.eye(len(r)), z) for z, p in zip((past, present), known, strict=True)]
    if squares[1] > limit(len(r), GATE):
        return measurement, GATE
    if squares[0] > limit(len(r), GATE):
        known[0] *= squares[0] / len(r)
    floor = (_EXACT + 1e-15 * float(np.trace(known[0]))) * np.eye(len(r))
    prior = np.linalg.inv(known[0] + floor)
    learnt = np.linalg.inv(known[1] + floor) - prior
    shares, axes = np.linalg.eigh(0.5 * (learnt + learnt.T))
    # information vector of what was learnt: that of the present estimate, zero, less that of the past one
    z = axes.T @ present + np.where(shares > 0.0, axes.T @ (prior @ (present - past)), 0.0)
    left = 1.0 - np.clip(shares, 0.0, 1.0)
    is_new = left > _LEAST_NEW
    z[~is_new], left[~is_new] = 0.0, _NOTHING
    spread = root @ axes
    widened: Array = (spread / left) @ spread.T
    # no innovation, and relative to what this filter knows: other filters do not process it
    return measurement._replace(innovation=spread @ (z / left), r=widened, valid_within=0.0), NO_GATE
