"""Error-state Kalman filter with feedback: covariance of the solution's errors, aids, gate.

The filter propagates between two states of the mechanization, an aid's measurement updates it, and
`ErrorFilter.feed_back` subtracts the estimated errors from the solution at once, so that the model stays linear::

    filter.propagate(before, after, duration)
    update = filter.update("gnss", stamp_ns, gnss.measure(filter.solution(state, rate, gyro_bias), *fix))
    state, gyro_bias, accel_bias = filter.feed_back(state, gyro_bias, accel_bias)

Covariances for output: position and attitude on n directly, velocity on body axes ``rot_bn P_vv rot_nb`` (see
`ins_nav.estimation.error_model`).
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ins_nav.estimation.error_model import Array, ErrorModel, Vector, rotation_matrix
from ins_nav.estimation.innovation_gate import GATE, NoiseEstimate, limit, square
from ins_nav.estimation.observation import Measurement, Solution, Update
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import (
    ATTITUDE,
    COSINE,
    HEADING,
    HORIZONTAL_POSITION,
    HORIZONTAL_VELOCITY,
    POSITION,
    SIZE,
    TILT,
    VELOCITY,
    VERTICAL_VELOCITY,
    StateLayout,
)
from ins_nav.mechanization.attitude import from_rotation_vector
from ins_nav.mechanization.nav_state import NavState

_SMALL = math.radians(3.0)
"""Up to this sigma heading error is an angle: its square, which the linear model neglects, is 0.0014."""
_TRAVEL = 25.0
"""Squared velocity over its variance above which it is travel and observes heading: 4e-6 by chance."""
_SURGE = 1.0
"""s: correlation time of velocity that is no travel: a tenth of the period of waves."""


class ErrorFilter:
    """The filter.

    Parameters
    ----------
    model : ErrorModel
    position_stddev : 3 floats
        At the start, along n, m.
    velocity_stddev : 3 floats
        m/s.
    attitude_covariance : ndarray, shape (3, 3)
        Of the rotation vector on n, rad². The heading's sigma is not limited.
    aids : mapping of name to sequence of SlowState
        States of aids.

    Attributes
    ----------
    layout : StateLayout
        Those of the model's further errors of the IMU, then those of aids, follow the states that every filter has.
    x : ndarray, shape (n,)
        Estimated errors not fed back yet; zero after `feed_back` but for the cosine of an unknown heading.
    p : ndarray, shape (n, n)
        Covariance.
    values : ndarray, shape (n,)
        Of slow states: what was fed back since the start.
    fed_back : ndarray, shape (n,)
        By the last `feed_back`.
    disturbance : ndarray, shape (n,), or None
        Intensities of white noise beside that of the model, unit²/s.
    """

    def __init__(
        self,
        model: ErrorModel,
        position_stddev: Sequence[float],
        velocity_stddev: Sequence[float],
        attitude_covariance: Array,
        aids: Mapping[str, Sequence[SlowState]] | None = None,
    ) -> None:
        self.model = model
        own = [state for states in (aids or {}).values() for state in states]
        sizes = {name: len(states) for name, states in (aids or {}).items()}
        self.layout = StateLayout(model.imu_errors.sizes | sizes)
        self._considered = SIZE + np.flatnonzero(model.imu_errors.considered)
        size = self.layout.size
        self.x: Array = np.zeros(size)
        self.values: Array = np.zeros(size)
        self._start: Array = np.array([s.value for s in own])
        self.p: Array = np.zeros((size, size))
        diagonal = np.einsum("ii->i", self.p)
        diagonal[POSITION] = np.square(position_stddev)
        diagonal[VELOCITY] = np.square(velocity_stddev)
        if not model.vertical:
            diagonal[VERTICAL_VELOCITY] = 0.0
        diagonal[model.slow_rows] = [s.stddev**2 for s in model.slow]
        diagonal[model.size :] = [s.stddev**2 for s in own]
        self.p[ATTITUDE, ATTITUDE] = attitude_covariance
        if self.p[HEADING, HEADING] > _SMALL**2:
            self._open_heading()
        self._own_walk: Array = np.array([s.walk**2 for s in own])
        self._own_rate: Array = np.array([1.0 / s.correlation_time for s in own])
        self._integrals = [(i, i + s.derivative) for i, s in enumerate(own) if s.derivative]
        self._relaxes = bool(self._integrals) or any(math.isfinite(s.correlation_time) for s in (*model.slow, *own))
        self._noise: dict[str, NoiseEstimate] = {}
        self.fed_back: Array = np.zeros(size)
        self.disturbance: Array | None = None

    @property
    def imu_errors(self) -> Array:
        """What was fed back of the model's further errors of the IMU since the start, shape (k,)."""
        return self.values[SIZE : self.model.size]

    def own(self, *aids: str) -> Array:
        """Values in use of the states of aids, one aid after the other; none for an aid without states."""
        columns = self.layout.columns(*aids)
        values: Array = self.values[columns] + self._start[columns - self.model.size]
        return values

    def own_covariance(self, *aids: str) -> Array:
        """Covariance of the states of aids."""
        columns = self.layout.columns(*aids)
        return self.p[np.ix_(columns, columns)]

    def own_stddev(self, *aids: str) -> Array:
        """Sigmas of the states of aids."""
        return np.sqrt(self.own_covariance(*aids).diagonal())

    @property
    def heading_stddev(self) -> float:
        """rad; that of an unknown heading is pi / √3."""
        cosine = 1.0 - float(self.x[COSINE])
        stddev = math.sqrt(self.p[HEADING, HEADING])
        limit = math.pi / math.sqrt(3.0)
        return min(limit, stddev / cosine) if cosine > 0.0 else limit

    def travels(self, state: NavState) -> bool:
        """Whether the carrier moves by more than the velocity's error.

        Only then does heading act through velocity. The computed velocity of a base at rest is an error, and must not
        observe heading.
        """
        (a, b), (_, c) = self.p[HORIZONTAL_VELOCITY, HORIZONTAL_VELOCITY].tolist()
        x, y = state[4:6]
        # v' P^-1 v > limit, written without the division
        return bool(c * x * x - 2.0 * b * x * y + a * y * y > _TRAVEL * max(0.0, a * c - b * b))

    @property
    def turn(self) -> float:
        """Mean square of a unit vector's change by the correction of heading."""
        return float(self.p[HEADING, HEADING] + self.p[COSINE, COSINE] + self.x[COSINE] ** 2)

    def solution(self, state: NavState, rate: Vector, gyro_bias: Vector, stamp_ns: int = 0) -> Solution:
        """Input of the aids' measurement equations at the state's stamp; ``rate`` has the bias removed."""
        return Solution(state, rate, gyro_bias, self.travels(state), self.turn, self.p[POSITION, POSITION], stamp_ns)

    def propagate(self, before: NavState, after: NavState, duration: float) -> None:
        """Propagate the covariance from one state of the mechanization to the next.

        Parameters
        ----------
        before, after : NavState
            With no correction between them.
        duration : float
            s; see `ErrorModel.transition`.
        """
        travels = self.travels(after)
        core = self.model.transition(before, after, duration, travels)
        self.grow(core, self.model.noise(before, after, 0.5 * duration), after, duration, travels)

    def grow(self, core: Array, half: Array, after: NavState, duration: float, travels: bool) -> None:
        """Propagate with matrices of the model, which filters of the same solution share.

        Parameters
        ----------
        core, half : ndarray, shape (model.size, model.size)
            Transition matrix, and covariance of the noise of half the interval; both are left as they are.
        after : NavState
        duration : float
            s.
        travels : bool
            As of `ErrorModel.transition`.
        """
        half = half.copy()
        if self.disturbance is not None:
            common = self.disturbance[: len(half)]
            np.einsum("ii->i", half)[:] += 0.5 * duration * common
        # turns with heading and is not in the matrix: surge, or the error of travel
        variance = self.p.diagonal()[HORIZONTAL_VELOCITY].sum()
        left = variance if travels else max(0.0, after[4] ** 2 + after[5] ** 2 - variance)
        np.einsum("ii->i", half)[HORIZONTAL_POSITION] += 0.5 * duration * _SURGE * self.turn * left
        size, aids = len(self.x), self.model.size
        if size > aids:
            full, more = np.zeros((size, size)), np.zeros((size, size))
            full[:aids, :aids], more[:aids, :aids] = core, half
            full[aids:, aids:] = self._own_transition(duration)
            np.einsum("ii->i", more)[aids:] = (0.5 * duration) * self._own_walk
            core, half = full, more
        p = core @ (self.p + half) @ core.T
        p += half
        self.p = 0.5 * (p + p.T)
        self.x = core @ self.x
        if self.p[COSINE, COSINE] == 0.0 and self.p[HEADING, HEADING] > 4.0 * _SMALL**2:
            self._open_heading()
        if self._relaxes:  # the value in use stays, the true one tends to that of the start
            slow = self.model.slow_rows
            self.x[slow] += (1.0 - core.diagonal()[slow]) * self.values[slow]
            self.x[aids:] += self.values[aids:] - core[aids:, aids:] @ self.values[aids:]

    def disturb(self, attitude_stddev: ArrayLike, velocity_stddev: ArrayLike, position_stddev: ArrayLike) -> None:
        """Add an error of unknown direction, sigma of each axis: rad, m/s, m."""
        more = np.zeros(len(self.x))
        more[POSITION], more[VELOCITY], more[ATTITUDE] = position_stddev, velocity_stddev, attitude_stddev
        if not self.model.vertical:
            more[VERTICAL_VELOCITY] = 0.0
        self.p = self.p + np.diag(more**2)

    def _own_transition(self, duration: float) -> Array:
        """Transition matrix of the aids' states, shape (k, k)."""
        decay = np.exp(-duration * self._own_rate)
        phi: Array = np.diag(decay)
        for i, j in self._integrals:
            rate = self._own_rate[j]
            phi[i, j] = (1.0 - decay[j]) / rate if rate > 0.0 else duration
        return phi

    def noise_factor(self, aid: str, size: int) -> float:
        """By how much the variance of an aid's measurements of that size is too small, by their innovations."""
        return self._noise.get(aid, NoiseEstimate()).factor(size)

    def update(self, aid: str, stamp_ns: int, measurement: Measurement, gate: float = GATE) -> Update:
        """Update with a measurement of the present state, unless it is above the gate.

        The variance of an aid whose normalized squares have too large a median is scaled by it. Only measurements
        within the gate count: those outside are outliers or jumps, not noise.

        Parameters
        ----------
        aid : str
            Its name.
        stamp_ns : int
        measurement : Measurement
        gate : float
            Probability of rejecting a consistent measurement.

        Returns
        -------
        Update
        """
        found = self.examine(aid, stamp_ns, measurement, gate)
        if found.accepted:
            self.accept(found, measurement)
        return found

    def accept(self, found: Update, measurement: Measurement) -> None:
        """Update with a measurement that `examine` has found within the gate; arguments as there."""
        aid, size = found.aid, len(measurement.innovation)
        h, residual = self.design(aid, measurement), np.array(found.innovation)
        plain = square(residual, h @ self.p @ h.T + measurement.r)
        self._noise = self._noise | {aid: self._noise.get(aid, NoiseEstimate()).including(plain, size)}
        self.correct(h, found.noise_factor * measurement.r, residual)

    def examine(self, aid: str, stamp_ns: int, measurement: Measurement, gate: float = GATE) -> Update:
        """The record of a measurement, as of `update`, without an update."""
        innovation, size = measurement.innovation, len(measurement.innovation)
        if not measurement.finite:
            nothing = (math.nan,) * size
            return Update(aid, stamp_ns, tuple(innovation.tolist()), nothing, math.nan, False, "not a number")
        factor = self.noise_factor(aid, size)
        h = self.design(aid, measurement)
        residual = innovation - h @ self.x
        s = h @ self.p @ h.T + factor * measurement.r
        sigma = tuple(math.sqrt(v) for v in s.diagonal().tolist())
        ratio = square(residual, s) / limit(size, gate)
        accepted = ratio <= 1.0  # not above, nor too large to be a number
        reason = "" if accepted else "outside the gate"
        return Update(aid, stamp_ns, tuple(residual.tolist()), sigma, ratio, accepted, reason, factor)

    def design(self, aid: str, measurement: Measurement) -> Array:
        """Jacobian of an aid's measurement by all states, shape (m, n)."""
        h_core, h_own, shares = measurement.h, measurement.own, measurement.shares
        if len(self.x) == SIZE:
            return h_core
        h: Array = np.zeros((len(h_core), len(self.x)))
        h[:, :SIZE] = h_core
        if h_own is not None:
            h[:, self.layout.columns(aid, *shares)] = h_own
        return h

    def correct(self, h: Array, r: Array, residual: Array) -> None:
        """Update with a residual, without a gate.

        Parameters
        ----------
        h : ndarray, shape (m, n)
        r : ndarray, shape (m, m)
            Covariance of its noise.
        residual : ndarray, shape (m,)
        """
        ph = self.p @ h.T
        self._correct(ph @ np.linalg.inv(h @ ph + r), h, r, residual)

    def _correct(self, gain: Array, h: Array, r: Array, residual: Array) -> None:
        """Joseph's form, valid for any gain: that of considered states is zero."""
        gain[self._considered] = 0.0
        self.x = self.x + gain @ residual
        left = -gain @ h
        np.einsum("ii->i", left)[:] += 1.0
        p = left @ self.p @ left.T + gain @ r @ gain.T
        self.p = 0.5 * (p + p.T)

    def admit(self, measurement: Measurement) -> bool:
        """Widen what a measurement outside the gate measures until it fits; whether that was necessary.

        For a measurement that nothing else contradicts: the filter, not the measurement, is wrong.
        """
        innovation, h_core, r, direct, *_ = measurement
        if direct is None or not (np.isfinite(innovation).all() and np.isfinite(r).all()):
            return False
        h = np.zeros((len(innovation), len(self.x)))
        h[:, :SIZE] = h_core
        residual, predicted = innovation - h @ self.x, h @ self.p @ h.T + r
        if square(residual, predicted) <= limit(len(residual), GATE):
            return False
        p = self.p.copy()
        if not _grow(p, direct, h[:, direct], residual, predicted):
            return False
        self.p = p
        return True

    def feed_back(self, state: NavState, gyro_bias: Vector, accel_bias: Vector) -> tuple[NavState, Vector, Vector]:
        """Subtract the estimated errors from the solution; the estimate is zero afterwards.

        The covariance is transformed to the corrected axes: exact for any heading error.

        Parameters
        ----------
        state : NavState
        gyro_bias, accel_bias : 3 floats
            In use.

        Returns
        -------
        state : NavState
        gyro_bias, accel_bias : 3 floats
            Corrected.
        """
        open_heading = bool(self.p[COSINE, COSINE] > 0.0)
        close = open_heading and self._join_heading()
        x = self.x
        if not open_heading:  # the state of a known heading is the angle, also where it jumps
            angle = float(x[HEADING])
            x = x.copy()
            x[HEADING], x[COSINE] = math.sin(angle), 1.0 - math.cos(angle)
        corrected = self.model.apply(x, state, gyro_bias, accel_bias)
        turn = _change_of_axes(x, open_heading)
        p = turn @ self.p @ turn.T
        self.values = self.values - x
        self.fed_back = x
        length = _unit(x)[2]
        self.x = np.zeros_like(x)
        if close:
            p[COSINE, :] = p[:, COSINE] = 0.0
        elif open_heading:
            self.x[COSINE] = 1.0 - length
        self._set_covariance(p)
        return corrected

    def follow(self, fed_back: Array) -> None:
        """Change to the solution that another filter of the same layout has corrected.

        Parameters
        ----------
        fed_back : ndarray, shape (n,)
            The other's `fed_back`.
        """
        open_heading = bool(self.p[COSINE, COSINE] > 0.0)
        if open_heading and self._join_heading():
            open_heading = False
            sine, cosine = float(self.x[HEADING]), 1.0 - float(self.x[COSINE])
            self.x = self.x.copy()
            self.x[HEADING], self.x[COSINE] = math.atan2(sine, cosine), 0.0
            self.p[COSINE, :] = self.p[:, COSINE] = 0.0
        turn = _change_of_axes(fed_back, open_heading)
        if open_heading:  # sine and cosine turn, rather than being subtracted
            c, s, _ = _unit(fed_back)
            sine, cosine = float(self.x[HEADING]), 1.0 - float(self.x[COSINE])
            heading, left = c * sine - s * cosine, 1.0 - (c * cosine + s * sine)
        else:
            heading, left = float(self.x[HEADING]) - math.atan2(fed_back[HEADING], 1.0 - fed_back[COSINE]), 0.0
        self.x = turn @ (self.x - fed_back)
        self.x[HEADING], self.x[COSINE] = heading, left
        self.values = self.values - fed_back
        self._set_covariance(turn @ self.p @ turn.T)

    def _set_covariance(self, p: Array) -> None:
        if not self.model.vertical:
            p[VERTICAL_VELOCITY, :] = p[:, VERTICAL_VELOCITY] = 0.0
        self.p = 0.5 * (p + p.T)

    def forget_heading(self) -> None:
        """Heading is unknown from here on; a measurement before the next propagation may be of the angle."""
        p, x = self.p.copy(), self.x.copy()
        p[HEADING, :] = p[:, HEADING] = p[COSINE, :] = p[:, COSINE] = 0.0
        p[HEADING, HEADING] = math.pi**2
        is_open = bool(self.p[COSINE, COSINE] > 0.0)
        if is_open:
            x[HEADING] = x[COSINE] = 0.0
        self.p, self.x = p, x
        if is_open:
            self._open_heading()

    def _open_heading(self) -> None:
        """Model an unknown heading error by its sine and cosine, with the moments of a normal angle."""
        p = self.p.copy()
        variance = float(p[HEADING, HEADING])
        mean = math.exp(-0.5 * variance)
        p[HEADING, :] *= mean
        p[:, HEADING] *= mean
        p[HEADING, HEADING] = 0.5 * (1.0 - mean**4)
        p[COSINE, COSINE] = 0.5 * (1.0 - mean**2) ** 2
        self.p, self.x = p, self.x.copy()
        self.x[COSINE] = 1.0 - mean

    def _join_heading(self) -> bool:
        """Once heading is known, constrain its sine and cosine to one angle; whether it is known."""
        c, s, length = _unit(self.x)
        across: Array = np.zeros(len(self.x))
        across[HEADING], across[COSINE] = c, s
        variance = float(across @ self.p @ across) / length**2
        if variance > _SMALL**2:
            return False
        h: Array = np.zeros((1, len(self.x)))
        h[0, HEADING], h[0, COSINE] = s, -c
        r = np.array([[0.5 * variance**2]])
        ph = self.p @ h.T
        self._correct(ph / (h @ ph + r), h, r, np.array([1.0 - 0.5 * variance - length]))
        return True


def _unit(x: Array) -> tuple[float, float, float]:
    """Cosine and sine of the heading error, and the length of the two as estimated."""
    sine, cosine = float(x[HEADING]), 1.0 - float(x[COSINE])
    length = math.hypot(sine, cosine)
    return cosine / length, sine / length, length


def _change_of_axes(x: Array, open_heading: bool) -> Array:
    """Matrix by which the errors change when a solution is corrected by ``x``, and its axes with it."""
    tilt_x, tilt_y = x[TILT].tolist()
    c, s, _ = _unit(x)
    back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turn: Array = np.eye(len(x))
    turn[VELOCITY, VELOCITY] = back @ rotation_matrix(from_rotation_vector(-tilt_x, -tilt_y, 0.0))
    turn[TILT, TILT] = back[:2, :2]
    if open_heading:
        turn[HEADING, HEADING], turn[HEADING, COSINE] = c, s
        turn[COSINE, HEADING], turn[COSINE, COSINE] = -s, c
    return turn


def _grow(p: Array, states: slice, h: Array, misfit: Array, predicted: Array) -> bool:
    """Scale the covariance block of the states, in place, until the misfit's normalized square is its expectation."""
    block = p[states, states].copy()
    projected = h @ block @ h.T
    factor = 0.0
    for _ in range(60):
        if misfit @ np.linalg.solve(predicted + factor * projected, misfit) <= len(misfit):
            p[states, states] += factor * block
            return True
        factor = 4.0 * factor + 1.0
    return False
