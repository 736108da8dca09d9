"""Which is at fault, a source of measurements or the solution: the odds of the two hypotheses, instead of a time-out.

When measurements are rejected, two explanations compete from the first of them on:

source
    Every source with rejected measurements is at fault: its error jumped to an unknown value and stays near it
    (`_Offset`), or is an outlier. The solution is right, and all other measurements agree with it.
solution
    The propagation has failed (an unrecognized fault of the IMU, a wrong start): a second filter starts before the
    first rejected measurement with a wide covariance (`_wide`) and processes all sources.

The logarithm of the ratio of their likelihoods over all measurements since ([1]_), and of their priors, decides. Faults
of sources begin with a probability a message and last for an exponentially distributed time; so a source that
contradicts the solution for a long time, and keeps to the propagation's law of motion, wins in the end.

After a failure of the solution the IMU is on probation: the main filter propagates with the uncertainty of an unknown
motion beside the IMU's noise, until a filter without that explains the measurements better.

References
----------
.. [1] A. Wald, Sequential Analysis, 1947: the sequential probability ratio test.
"""

import copy
import enum
import math
from dataclasses import dataclass, field

import numpy as np

from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Array
from ins_nav.estimation.innovation_gate import square
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    HEADING,
    POSITION,
    TILT,
    VELOCITY,
    VERTICAL_VELOCITY,
)
from ins_nav.stamps import NS

_SOURCE_FAULT = 1e-3
"""Probability that a fault of a source begins with a message."""
_FAULT_TIME = 60.0
"""s: mean time that a fault of a source lasts."""
_FAILURE_RATE = 1e-4
"""1/s: unrecognized failures of the propagation: one in three hours."""
_WRONG_START = 0.1
"""Probability that initial values are wrong which no measurement of this kind has confirmed yet."""
_OUTLIER = 1e-2
"""Probability of an outlier among the measurements of a sound source, and of another change of a faulty one."""
_OUTLIER_WIDTH = 100.0
"""Sigmas of the noise over which outliers and errors of faulty sources are spread."""
DECIDED = math.log(100.0)
"""Logarithm of the odds that decide."""
_CERTAIN = math.log(1e6)
"""The same, beyond which the other hypothesis is dropped."""
_FORGOTTEN_NS = 20_000_000_000
"""ns without a rejected measurement after which the solution has not failed."""
_DRIFT = 0.5
"""m/s: sigma of the rate at which the error of a faulty source of position changes."""
_CHANGE = 0.01
"""Share of its variance by which the rate of the solution's error changes from one measurement to the next."""
_AGREED = 8
"""Measurements in a row, in agreement with the solution, after which a source is no longer at fault."""
_CONFIRMED = 4
"""Measurements that agree with each other, and not with the solution, without which it has not failed."""
_REPEATED = 4
"""Measurements of a source in a row, rejected by the filter of a failed solution, too, that begin a new episode."""
_WIDE = (100.0, 10.0, math.radians(3.0))
"""Sigmas that a failed solution has beside its own: position, m, where no measurement shows a greater error, velocity,
m/s, tilt and heading, rad."""
_FASTEST = 300.0
"""m/s: an error of position does not grow faster; no carrier of such a system travels faster, either."""
_SHOCK = (math.radians(0.1), 0.5)
"""The same of the biases of an IMU that has suffered, rad/s and m/s²."""
_HEADING = slice(HEADING, HEADING + 1)
_UNKNOWN_MOTION = (1.0, math.radians(0.3))
"""m/s/√s and rad/√s: acceleration of a vehicle, 0.5 m/s² with a correlation time of 2 s, and what turns it hides."""


class Verdict(enum.Enum):
    """Change of the main filter with a measurement."""

    NONE = 0
    EXCLUDED = 1
    """The source is at fault, and its fault is not over: the measurement is not to be processed.

    That the sigma of the solution grows does not make the error of the source smaller."""
    FAILED = 2
    """The solution has failed: the main filter is now the wide one, and the IMU is on probation."""
    RESTORED = 3
    """The solution had not failed: the main filter is again that without the sources at fault."""
    RECOVERED = 4
    """The IMU is no longer on probation."""

    @property
    def replaced(self) -> bool:
        """Whether the main filter has been replaced by one that has processed the measurement."""
        return self.value > 1


class _Offset:
    """The error of a faulty source: constant, or changing at a constant rate, and the drift of the solution besides.

    Parameters
    ----------
    stamp_ns : int
    first : _Residual
        The first that was rejected.
    rate : float
        Sigma of the rate, unit/s.
    is_angle : bool
        Residuals are known but for whole turns.
    """

    def __init__(self, stamp_ns: int, first: "_Residual", rate: float, is_angle: bool) -> None:
        size = len(first.value)
        self._x = np.concatenate([first.value, np.zeros(size)])
        self._p: Array = np.zeros((2 * size, 2 * size))
        self._p[:size, :size] = first.r
        self._p[size:, size:] = rate**2 * np.eye(size)
        self._predicted = first.predicted
        self._stamp_ns = stamp_ns
        self._is_angle = is_angle

    def square(self, r: Array) -> float:
        """Normalized square of the error, with noise of that covariance."""
        size = len(r)
        return square(self._x[:size], self._p[:size, :size] + r)

    def likelihood(self, stamp_ns: int, residual: "_Residual") -> float:
        """Log-likelihood of one more residual, which is then included."""
        size, time = len(residual.value), (stamp_ns - self._stamp_ns) / NS
        self._stamp_ns = stamp_ns
        phi = np.eye(2 * size)
        phi[:size, size:] = time * np.eye(size)
        growth = np.sqrt(residual.predicted.diagonal()) - np.sqrt(self._predicted.diagonal())
        # by corrections of other sources
        drift = np.maximum((self._predicted - residual.predicted).diagonal(), 0.0) + 0.01 * residual.r.diagonal()
        self._predicted = residual.predicted
        x, p = phi @ self._x, phi @ self._p @ phi.T
        p[:size, :size] += np.diag(drift)
        if time > 0.0:  # the rate at which the error of the solution grows is as uncertain, and changes
            p[size:, size:] += np.diag(_CHANGE * (growth / time) ** 2)
        s = p[:size, :size] + residual.r
        away = residual.value - x[:size]
        if self._is_angle:
            away = np.remainder(away + math.pi, math.tau) - math.pi
        gain = p[:, :size] @ np.linalg.inv(s)
        self._x, self._p = x + gain @ away, p - gain @ p[:size]
        return _mixed(_log_normal(square(away, s), s), residual.r)


@dataclass
class _Suspect:
    """A source whose measurements the solution rejects.

    Attributes
    ----------
    source : str
    offset : _Offset
    count : int
        Rejected measurements.
    agreed : int
        Measurements in a row since that agree with the solution better than with the offset.
    """

    source: str
    offset: _Offset
    count: int = 1
    agreed: int = 0


@dataclass
class _Episode:
    """From the first rejected measurement on.

    Attributes
    ----------
    other : ErrorFilter
        Of the hypothesis that the main filter does not follow.
    odds : float
        Logarithm of the odds of a failed solution.
    rejected_ns : int
        Stamp of the last measurement that the solution as it was rejects.
    suspects : dict of name to _Suspect
        Measurements that would be at fault.
    failed : bool
        The main filter is that of a failed solution.
    confirmed : int
        Measurements that the solution as it was rejects, and the wide one accepts.
    again : dict of name to int
        Measurements in a row that the main filter rejects although it is that of a failed solution.
    """

    other: ErrorFilter
    odds: float
    rejected_ns: int
    suspects: dict[str, _Suspect] = field(default_factory=dict)
    failed: bool = False
    confirmed: int = 0
    again: dict[str, int] = field(default_factory=dict)


class _Residual:
    """A measurement as one filter predicts it.

    Attributes
    ----------
    value : ndarray, shape (m,)
    predicted : ndarray, shape (m, m)
        Covariance of the solution's part.
    h, r : ndarray, shape (m, n) and (m, m)
    square : float
        Normalized.
    likelihood : float
        Logarithm, of a sound source.
    valid : bool
        The measurement may be applied to this filter.
    """

    def __init__(self, each: ErrorFilter, measurement: Measurement, h: Array, r: Array) -> None:
        self.h, self.r = h, r
        self.value = measurement.innovation - h @ each.x
        self.predicted = h @ each.p @ h.T
        s = self.predicted + r
        self.square = square(self.value, s)
        self.likelihood = _mixed(_log_normal(self.square, s), r)
        self.valid = math.sqrt(float(each.p[POSITION, POSITION].trace())) < measurement.valid_within


class FaultHypotheses:
    """The two hypotheses beside a main filter.

    Parameters
    ----------
    main : ErrorFilter
    """

    def __init__(self, main: ErrorFilter) -> None:
        self._main = main
        self._episode: _Episode | None = None
        self._accepted_ns: dict[str, int] = {}
        self._sound: ErrorFilter | None = None
        self._sound_odds = 0.0

    @property
    def probation(self) -> bool:
        """The main filter allows for an unknown motion beside the IMU's noise."""
        return self._sound is not None

    @property
    def suspects(self) -> dict[str, int]:
        """Sources that are at fault unless the solution has failed, with the numbers of their rejected measurements."""
        found: dict[str, int] = {}
        for each in () if self._episode is None else self._episode.suspects.values():
            found[each.source] = found.get(each.source, 0) + each.count
        return found

    @property
    def failed(self) -> bool:
        """The main filter is that of a failed solution, and the other hypothesis is not yet dropped."""
        return self._episode is not None and self._episode.failed

    @property
    def other(self) -> tuple[ErrorFilter, float] | None:
        """Filter of the hypothesis that the main filter does not follow, with its probability; None without one."""
        episode = self._episode
        if episode is None:
            return None
        odds = -episode.odds if episode.failed else episode.odds
        return episode.other, 1.0 / (1.0 + math.exp(min(-odds, 700.0)))

    @property
    def filters(self) -> list[ErrorFilter]:
        """Beside the main one: they propagate and follow as it does."""
        found = [] if self._episode is None else [self._episode.other]
        return found if self._sound is None else [*found, self._sound]

    def unconfirm(self) -> None:
        """The solution has had a known disturbance: what confirmed it before counts no longer."""
        self._accepted_ns.clear()

    def weigh(
        self, source: str, name: str, stamp_ns: int, measurement: Measurement, h: Array, r: Array, gate: float
    ) -> Verdict:
        """Weigh a measurement, before the main filter processes it.

        Parameters
        ----------
        source, name : str
            ``name`` distinguishes measurements of a source.
        stamp_ns : int
        measurement : Measurement
            Finite.
        h : ndarray, shape (m, n)
            `ErrorFilter.design`.
        r : ndarray, shape (m, m)
            Covariance of its noise.
        gate : float
            Greatest normalized square that a filter accepts.
        """
        main = _Residual(self._main, measurement, h, r)
        accepted = main.square <= gate
        if self._episode is None and not accepted:
            self._begin(name, stamp_ns, measurement.direct, main)
        if accepted:
            self._accepted_ns[name] = stamp_ns
        verdict, episode = Verdict.NONE, self._episode
        if episode is not None:
            other = _Residual(episode.other, measurement, h, r)
            verdict = self._weigh(episode, source, name, stamp_ns, main, other, gate, measurement.direct)
        if not verdict.replaced and self._sound is not None:
            verdict = self._try(self._sound, main, _Residual(self._sound, measurement, h, r), gate) or verdict
        return verdict

    def _begin(self, name: str, stamp_ns: int, direct: slice | None, main: _Residual) -> None:
        accepted_ns = self._accepted_ns.get(name)
        since = math.inf if accepted_ns is None else max((stamp_ns - accepted_ns) / NS, 1.0)
        prior = min(_WRONG_START, _FAILURE_RATE * since)
        away = float(np.abs(main.value).max()) if direct == POSITION else 0.0
        position = min(max(_WIDE[0], away), _WIDE[0] + _FASTEST * since)
        self._episode = _Episode(_wide(self._main, direct, position), math.log(prior), stamp_ns)

    def _weigh(
        self,
        episode: _Episode,
        source: str,
        name: str,
        stamp_ns: int,
        main: _Residual,
        other: _Residual,
        gate: float,
        direct: slice | None,
    ) -> Verdict:
        as_it_was, wide = (other, main) if episode.failed else (main, other)
        suspect = episode.suspects.get(name)
        rejected = not as_it_was.square <= gate
        excluded = False
        if suspect is not None:
            offset = suspect.offset.likelihood(stamp_ns, as_it_was)
            over = as_it_was.likelihood - offset > DECIDED or suspect.offset.square(as_it_was.r) <= gate
            excluded = not over
            rival = max(offset, as_it_was.likelihood)  # the fault may be over
            suspect.count += rejected or excluded
            suspect.agreed = 0 if rejected or excluded else suspect.agreed + 1
            if suspect.agreed >= _AGREED:
                del episode.suspects[name]
        elif rejected:
            rate = _DRIFT if direct == POSITION else 0.5 * math.sqrt(float(main.r.trace()) / len(main.value))
            episode.suspects[name] = _Suspect(
                source, _Offset(stamp_ns, as_it_was, rate, direct == _HEADING and len(main.value) == 1)
            )
            # the first error is as unlikely where the source has made it
            rival = math.log(_SOURCE_FAULT) + (wide.likelihood if wide.valid else _log_spread(main.r))
        else:
            rival = as_it_was.likelihood
        if rejected or excluded:
            episode.odds += min((stamp_ns - episode.rejected_ns) / NS, 1.0) / _FAULT_TIME
            episode.rejected_ns = stamp_ns
        if wide.valid:
            episode.odds += wide.likelihood - rival
        if wide.square <= gate and wide.valid and rejected:
            episode.confirmed += 1
        if other.square <= gate and other.valid and not (episode.failed and excluded):
            episode.other.correct(other.h, other.r, other.value)
        if not episode.failed and episode.odds > DECIDED and episode.confirmed >= _CONFIRMED:
            self._swap(episode)
            self._main.disturbance = _unknown_motion(self._main)
            self._sound, self._sound_odds = _sound(self._main), 0.0
            return Verdict.FAILED
        if episode.failed and episode.odds < -DECIDED:
            self._swap(episode)
            self._main.disturbance = self._sound = None
            return Verdict.RESTORED
        if episode.failed:
            episode.again[name] = 0 if main.square <= gate else episode.again.get(name, 0) + 1
            if episode.again[name] >= _REPEATED:
                self._begin(name, stamp_ns, direct, main)
                return Verdict.NONE
        quiet = not episode.suspects or stamp_ns - episode.rejected_ns > _FORGOTTEN_NS
        if quiet or (episode.failed and episode.odds > _CERTAIN):
            self._episode = None
        return Verdict.EXCLUDED if excluded and not episode.failed else Verdict.NONE

    def _swap(self, episode: _Episode) -> None:
        """The main filter follows the other hypothesis."""
        main, other = self._main, episode.other
        episode.other = _sound(main)
        main.x, main.p = other.x, other.p
        episode.failed = not episode.failed

    def _try(self, sound: ErrorFilter, main: _Residual, other: _Residual, gate: float) -> Verdict | None:
        """Weigh a measurement between unknown motion and the IMU's noise alone."""
        if other.valid:
            self._sound_odds += other.likelihood - main.likelihood
            if other.square <= gate:
                sound.correct(other.h, other.r, other.value)
        if self._sound_odds > DECIDED:
            self._main.x, self._main.p, self._main.disturbance = sound.x, sound.p, None
            self._sound = None
            return Verdict.RECOVERED
        if self._sound_odds < -DECIDED:
            self._sound, self._sound_odds = _sound(self._main), 0.0
        return None


def _sound(main: ErrorFilter) -> ErrorFilter:
    """A copy that propagates with the noise of the IMU alone."""
    found = copy.copy(main)
    found.disturbance = None
    return found


def _wide(main: ErrorFilter, direct: slice | None, position: float) -> ErrorFilter:
    """A copy whose solution may be wrong by anything; heading too, where it is that which is measured directly."""
    wide = copy.copy(main)
    more = np.zeros(len(main.x))
    more[POSITION], more[VELOCITY], more[ATTITUDE] = position, *_WIDE[1:]
    more[GYRO_BIAS], more[ACCEL_BIAS] = _SHOCK
    if not main.model.vertical:
        more[VERTICAL_VELOCITY] = 0.0
    wide.p = main.p + np.diag(more**2)
    if direct == _HEADING:
        wide.forget_heading()
    return wide


def _unknown_motion(main: ErrorFilter) -> Array:
    """Intensities of an unknown motion, shape (n,)."""
    more = np.zeros(len(main.x))
    more[VELOCITY], more[TILT] = _UNKNOWN_MOTION
    if not main.model.vertical:
        more[VERTICAL_VELOCITY] = 0.0
    return np.asarray(more**2)


def _log_normal(normalized_square: float, covariance: Array) -> float:
    """Logarithm of the normal density."""
    _, logarithm = np.linalg.slogdet(covariance)
    return -0.5 * (normalized_square + float(logarithm) + len(covariance) * math.log(math.tau))


def _log_spread(r: Array) -> float:
    """Logarithm of the density of outliers, and of errors of faulty sources."""
    return -float(np.log(_OUTLIER_WIDTH * np.sqrt(r.diagonal())).sum())


def _mixed(likelihood: float, r: Array) -> float:
    """Of a sound source, whose measurements have outliers."""
    return float(np.logaddexp(math.log1p(-_OUTLIER) + likelihood, math.log(_OUTLIER) + _log_spread(r)))
