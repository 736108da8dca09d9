"""Covariance of the real-time solution: that of the last correction, propagated to the present.

The filter (`ins_nav.navigator.delayed`) corrects states of the past; between corrections the covariance is propagated
as the filter propagates its own. A correction replaces the covariance at its stamp, and the propagation over the
re-integrated states (`ins_nav.mechanization.replay_buffer`) is repeated.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ins_nav.config.configuration import Configuration
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Array, ErrorModel, rotation_matrix
from ins_nav.estimation.filter_bank import FilterBank
from ins_nav.estimation.imu_error import ImuErrors
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import (
    ATTITUDE,
    BIASES,
    COSINE,
    HEADING,
    POSITION,
    SOLUTION,
    VELOCITY,
    VERTICAL_VELOCITY,
)
from ins_nav.estimation.states import kinds
from ins_nav.mechanization.earth import known_surface
from ins_nav.mechanization.imu_condition import ImuCondition
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import ReplayBuffer
from ins_nav.mechanization.stamped_rows import LENGTH_NS

_STEP_NS, _LONGEST_NS = 100_000_000, 500_000_000
"""ns of data over which the covariance is propagated in one step: the first where the body turns, the second where it
turns by less than `_TURN` in it (`ErrorModel.transition`)."""
_TURN = 0.1
"""rad."""
_GRAVITY = 9.81
_NEVER_NS = 2**63 - 1
_REGULAR = 1e-9
"""Share of a variance that keeps a matrix regular whose parts are fully correlated."""
_NOTHING = 1e-40
"""The same where the variance is zero."""


def error_model(configuration: Configuration, learnt_noise: tuple[float, float]) -> ErrorModel:
    """The model of errors that the parameters describe.

    Parameters
    ----------
    configuration : Configuration
    learnt_noise : 2 floats
        White noise of gyros and accelerometers, rad/√s and m/s/√s, where the parameters do not give it.
    """
    imu = configuration.imu
    return ErrorModel(
        vertical=configuration.navigation.vertical_channel,
        gyro_noise=learnt_noise[0] if math.isnan(imu.gyro_noise) else imu.gyro_noise,
        accel_noise=learnt_noise[1] if math.isnan(imu.accel_noise) else imu.accel_noise,
        gyro_bias=SlowState(imu.gyro_bias_stddev, imu.gyro_bias_walk),
        accel_bias=SlowState(imu.accel_bias_stddev, imu.accel_bias_walk),
        height_walk=configuration.aiding.height_walk,
        water_surface=known_surface(configuration.navigation.water_surface),
        imu_errors=imu_errors(configuration),
    )


def imu_errors(configuration: Configuration) -> ImuErrors:
    """Errors of the IMU beside the biases that the parameters describe."""
    mounting = Rotation.from_euler("ZYX", configuration.imu.mounting_rpy[::-1]).as_matrix()
    return ImuErrors([kind.from_values("imu", configuration.values) for kind in kinds()], mounting)


def filter_of(
    model: ErrorModel, covariance: Array, own_states: Mapping[str, Sequence[SlowState]] | None = None
) -> ErrorFilter:
    """A filter with an initial covariance.

    Parameters
    ----------
    model : ErrorModel
    covariance : ndarray, shape (n, n)
        Of the errors on n, as of `covariance_of`. Of a model with other errors of the IMU only what both have is used.
    own_states : mapping of name to sequence of SlowState
        Those of aids.
    """
    stddev = np.sqrt(covariance.diagonal())
    result = ErrorFilter(
        model, stddev[POSITION].tolist(), stddev[VELOCITY].tolist(), covariance[ATTITUDE, ATTITUDE], own_states
    )
    rows = model.solution_rows
    if len(rows) != len(covariance):
        rows = rows[SOLUTION]
    covariance = covariance[: len(rows), : len(rows)]
    scale = np.ones(len(rows))
    scale[HEADING] = 1.0 - result.x[COSINE]  # of an unknown heading the sine
    if not model.vertical:
        scale[VERTICAL_VELOCITY] = 0.0
    heading = result.p[HEADING, HEADING]
    result.p[np.ix_(rows, rows)] = scale[:, None] * covariance * scale
    result.p[HEADING, HEADING] = heading
    return result


def covariance_of(error_filter: ErrorFilter) -> Array:
    """Mean squares of a solution's errors, heading as an angle, shape (n, n).

    n is SOLUTION_SIZE and the number of the further errors of the IMU that are in use.
    """
    rows = error_filter.model.solution_rows
    x = error_filter.x[rows]
    covariance: Array = error_filter.p[np.ix_(rows, rows)] + np.outer(x, x)
    covariance[HEADING, HEADING] = max(covariance[HEADING, HEADING], error_filter.heading_stddev**2)
    return covariance


def propagate(
    error_filter: ErrorFilter | FilterBank,
    condition: ImuCondition,
    before: NavState,
    after: NavState,
    begin_ns: int,
    end_ns: int,
) -> None:
    """Propagate a filter from one state of the mechanization to the next, with what the samples between may hide.

    Parameters
    ----------
    error_filter : ErrorFilter or FilterBank
    condition : ImuCondition
    before, after : NavState
        With no correction between them.
    begin_ns, end_ns : int
        Their stamps.
    """
    duration = (end_ns - begin_ns) * 1e-9
    error_filter.model.limit_noise(*condition.noise_limits)
    error_filter.propagate(before, after, duration)
    hidden = condition.between(begin_ns, end_ns)
    if hidden is not None:
        widen(error_filter, after, *hidden, duration)


def widen(error_filter: ErrorFilter | FilterBank, state: NavState, turn: Array, speed: Array, duration: float) -> None:
    """Add errors on the body's axes.

    Parameters
    ----------
    error_filter : ErrorFilter or FilterBank
    state : NavState
        At present.
    turn, speed : ndarray, shape (3,)
        Variances on each axis, rad² and m²/s².
    duration : float
        Time in which they have grown, s.
    """
    squares = np.square(rotation_matrix(state[0:4]))
    speeds = np.sqrt(squares @ speed)
    error_filter.disturb(np.sqrt(squares @ turn), speeds, duration * speeds)


class _Epoch(NamedTuple):
    stamp_ns: int
    state: NavState
    x: Array
    p: Array


class CovariancePropagation:
    """Covariance of the real-time solution.

    Parameters
    ----------
    configuration : Configuration
    condition : ImuCondition

    Attributes
    ----------
    count : int
        Number of changes of the covariance.
    due_ns : int
        Earlier states need no propagation.
    hidden : int
        Number of hidden errors (`ImuCondition.count`) that it contains.
    """

    def __init__(self, configuration: Configuration, condition: ImuCondition) -> None:
        self._configuration = configuration
        self._condition = condition
        self._height_walk = configuration.aiding.height_walk
        self.count = 0
        self.restart()

    def restart(self) -> None:
        """Reset to the priors that the parameters give."""
        self._filter: ErrorFilter | None = None
        self._model = error_model(self._configuration, (0.0, 0.0))
        size = len(self._model.solution_rows)
        self._idle: Array = np.zeros((size, size))
        np.einsum("ii->i", self._idle)[BIASES.start :] = [s.stddev**2 for s in self._model.slow]
        self.clear()

    def clear(self) -> None:
        """Drop the solution; the covariance of the biases remains."""
        self._idle[BIASES, BIASES] = self.covariance[BIASES, BIASES]
        self._filter = None
        self._epochs: deque[_Epoch] = deque()
        self._stamp_ns = self.due_ns = self._corrected_ns = 0
        self.hidden = self._condition.count
        self._state: NavState = NavState(*(0.0,) * 12)
        self.count += 1

    @property
    def covariance(self) -> Array:
        """Of the errors (`error_model`), as of `covariance_of`; biases only without a solution.

        Where height stays, vertical velocity is that of the random walk of height, as a mean over a second.
        """
        if self._filter is None:
            return self._idle.copy()
        covariance = covariance_of(self._filter)
        if not self._model.vertical:
            covariance[VERTICAL_VELOCITY, VERTICAL_VELOCITY] = self._height_walk**2
        return covariance

    @property
    def white_noise(self) -> tuple[float, float]:
        """Angle random walk, rad/√s, and velocity random walk, m/s/√s, in use; zeros without a solution."""
        return self._model.white_noise

    def begin(self, stamp_ns: int, state: NavState, covariance: Array, learnt_noise: tuple[float, float]) -> None:
        """Begin with a solution; noise as of `error_model`."""
        self.clear()
        self._model = error_model(self._configuration, learnt_noise)
        self._filter = filter_of(self._model, covariance)
        self._corrected_ns = stamp_ns
        self._keep(stamp_ns, state)

    def advance(self, stamp_ns: int, state: NavState) -> None:
        """Propagate to the newest state, which no correction has changed."""
        if stamp_ns < self.due_ns:
            return
        self.due_ns = stamp_ns + _STEP_NS
        if stamp_ns - self._stamp_ns >= _LONGEST_NS or _turn(self._state, state) > _TURN:
            self._propagate(stamp_ns, state)

    def rewind(self, stamp_ns: int, state: NavState) -> None:
        """Return to a past state and its covariance, before `replace`."""
        assert self._filter is not None
        epochs = self._epochs
        while len(epochs) > 1 and epochs[-1].stamp_ns > stamp_ns:
            epochs.pop()
        self._stamp_ns, self._state, self._filter.x, self._filter.p = epochs[-1]
        if stamp_ns > self._stamp_ns:
            self._propagate(stamp_ns, state)

    def renew(self, history: ReplayBuffer) -> None:
        """Repeat the propagation since the last correction: samples of the past turn out to hide errors."""
        known, self.hidden = self.hidden, self._condition.count
        if self._filter is None or self.hidden <= known:
            return
        entry = history.at(max(self._condition.earliest(known), self._corrected_ns))
        self.rewind(entry.stamp_ns, entry.state)
        self.catch_up(self._state, history)

    def replace(self, covariance: Array) -> None:
        """Replace the covariance by that of a correction."""
        self._filter = filter_of(self._model, covariance)
        self._corrected_ns = self._stamp_ns

    def catch_up(self, state: NavState, history: ReplayBuffer) -> None:
        """Propagate from the corrected state to the newest, over the re-integrated states."""
        stamp_ns = self._stamp_ns
        if self._epochs and self._epochs[-1].stamp_ns == stamp_ns:
            self._epochs.pop()
        self._keep(stamp_ns, state)
        stamps, _, states = history.between(stamp_ns, _NEVER_NS)
        while (row := int(np.searchsorted(stamps, self.due_ns))) < len(stamps):
            self.advance(int(stamps[row]), NavState._make(states[row].tolist()))
        if len(stamps) and stamps[-1] > self._stamp_ns:
            self._propagate(int(stamps[-1]), NavState._make(states[-1].tolist()))

    def _propagate(self, stamp_ns: int, state: NavState) -> None:
        assert self._filter is not None
        propagate(self._filter, self._condition, self._state, state, self._stamp_ns, stamp_ns)
        self._keep(stamp_ns, state)

    def _keep(self, stamp_ns: int, state: NavState) -> None:
        assert self._filter is not None
        epochs = self._epochs
        epochs.append(_Epoch(stamp_ns, state, self._filter.x, self._filter.p))
        while len(epochs) > 1 and epochs[1].stamp_ns < stamp_ns - LENGTH_NS:
            epochs.popleft()
        self._stamp_ns, self._state = stamp_ns, state
        self.due_ns = stamp_ns + _STEP_NS
        self.count += 1


def _turn(before: NavState, after: NavState) -> float:
    """Angle between two attitudes, rad."""
    return 2.0 * math.acos(min(1.0, abs(sum(a * b for a, b in zip(before[0:4], after[0:4], strict=True)))))
