"""Stop detection from the IMU's stream alone.

A stationary base satisfies two tests:

- *It does not shake.* Rate and specific force over a window of 1 s are tested against their mean: the generalized
  likelihood ratio of [1]_, with the noise of the IMU (estimated at rest, or given) and the vibration of an idling
  engine. Gyros are tested against their rate at rest, so that a slow even turn is motion.
- *It does not travel.* Specific force does not reveal an even creep, only its beginning: the velocity since the last
  rest is dead reckoned, with its covariance. A stop requires a velocity and an acceleration that agree with zero. After
  some minutes of driving the velocity is too uncertain and the first test decides, unless this carrier has moved
  without shaking before.

For a carrier that glides (a train, a ship, a robot on a smooth floor) the shaking test is replaced by a likelihood
ratio: standing against gliding at a velocity like those observed in this drive, or a lower one. While the velocity is a
straight line, zero acceleration is a measurement of tilt and biases, which keeps the velocity accurate for minutes. The
odds of a stop grow with the duration of stillness. Once the velocity's sigma exceeds a fraction of the glides'
velocities, stillness decides after some minutes: a stop that is never detected does more harm then.

A base that rocks without end (people in a car, swell) is stationary when its velocity over 10 s differs from that of
tilt and biases by a few cm/s at most, and it does not turn. A stop ends when the base

- travels: rocking does not count while the velocity stays under ``max_speed``;
- turns on the spot: yaw leaves its mean over 20 s by 5° and the possible drift, or the base is still again with a tilt
  that differs by 5° from the last still one. Swaying and rocking by as much is no turn;
- or after a gap in the stream of more than 1 s.

Limits: these look like rest: a recording that starts in even motion without shaking; a glide, after faster ones, at
less than twice the sigma of the velocity; with a MEMS sensor a start so gentle that it looks like a drifting tilt.

At a stop the filter uses zero velocity and zero mean yaw rate only: a mean rate over some seconds is no measurement of
gyro bias, since slow rocking looks the same. When the velocity diverges nevertheless, the filter is reset. Samples are
summed over blocks of 0.1 s, so that vibration of tens of Hz averages out; all tests run once a block.

References
----------
.. [1] I. Skog, P. Händel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection: an algorithm evaluation", IEEE
       Transactions on Biomedical Engineering, 2010, vol. 57, no. 11.
.. [2] R. E. Krichevsky, V. K. Trofimov, "The Performance of Universal Encoding", IEEE Transactions on Information
       Theory, 1981, vol. 27, no. 2: the probability of an event that was not observed in n trials, 0.5 / (n + 1).
"""

import cmath
import copy
import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ins_nav.mechanization.strapdown import Sample
from ins_nav.stop_detection.gliding import Glides
from ins_nav.stop_detection.sample_sums import BLOCK, EMPTY, add_sample, add_samples, completes, is_gap
from ins_nav.stop_detection.stop_limits import StopLimits
from ins_nav.stop_detection.turn_monitor import TurnMonitor
from ins_nav.stop_detection.velocity_filter import LONG_BLOCK, VelocityFilter

_HISTORY = 100
"""Blocks of velocity in which the beginning of a stop is sought."""
_START_SPEED = 0.05
"""m/s: the stop began when the speed fell below this."""
_REST_SPEED = 0.01
"""m/s: sway of a base that passes the first test (0.02 m/s² at 1 Hz is a third of it)."""
_LOOK_BACK = 3.0
"""s before the still time that this search includes."""
_SWAY = 0.15
"""Of max_speed: a base that sways from the first sample on stands when its velocity over 10 s deviates by less, RMS,
from the parabola that tilt and gyro biases cause."""
_SWAY_EVERY = 500_000_000
"""ns between two such tests."""
_ROLL = 1.0
"""m/s: a carrier that rolls faster shakes."""
_GLIDES = 0.1
"""Share of the certainly moving time: a carrier that is still for more of it moves smoothly (a ship, a train)."""
_GLIDE_TIME = 30.0
"""s: a stillness of so long is half as likely for a glide as for a stop."""
_ODDS = 20.0
"""A stop is so many times likelier than a glide."""
_EVEN_BLOCKS = 40
"""Blocks over which a glide must be even."""
_STRAIGHT = 0.01
"""m/s: largest deviation of a velocity that counts as a straight line."""
_CERTAIN = 5.0
"""s: a shorter stop may have been an even roll, if the velocity was not well known when it began."""
_DOUBTED_TILT = 0.01
"""rad: and its end may have been mistaken for a tilt, 0.2 m/s gained in 2 s."""
_ARRIVAL_ALARM = 0.05
"""Probability to wait for more: the standard deviation grows with time, a creep mistaken for a stop does harm."""
_EPOCHS = 10
"""Windows of a stop that can be undone when it ends: a slow start looks like rest at first."""
_TURN_EPOCHS = 40
"""Windows that can be undone after a turn, which is detected later than travel."""
_TURN_GOES_ON = math.radians(0.1)
"""A larger turn within 10 s may be the gentle end of one."""
_EPOCH_MARGIN = 1_000_000_000
"""ns before the estimated start that are undone too, besides the time in which the start was not detected."""
_SMOOTHING = 0.02
"""Share of a new variance in the mean over 5 s."""
_LEAST = 2.0
"""Variance over the least of many such means."""
_FORGETTING = 1.001
"""Growth of the least variance a block: adapts to a noisier sensor within minutes."""
_NOISE_FLOOR = 0.005
"""Of sway and vibration: no base is quieter."""

_ROUNDING_NS = 1_000
"""ns: more than the rounding of a sum of intervals."""

_Place = tuple[int, float, float, float, float, float, float]
"""Stamp; mean over the block that ends there of the horizontal velocity (2) and of the integral (3); yaw."""
_Epoch = tuple[int, VelocityFilter, list[tuple[int, Any]]]
"""Stamp, state then, and the stamped blocks since."""


class Change(NamedTuple):
    """A stop begins or ends.

    Attributes
    ----------
    stopped : bool
    stamp_ns : int
        Estimated time of beginning or end, before the decision.
    decided_ns : int
        Stamp of the sample of the decision.
    speed_stddev : float
        Of the dead reckoned speed at the beginning of a stop, m/s: large after a gap or a long drive.
    stillness : float
        Logarithm of the odds of rest against even motion by stillness alone: of a carrier that has shaken all the
        time while it moved, stillness is evidence.
    """

    stopped: bool
    stamp_ns: int
    decided_ns: int
    speed_stddev: float = 0.0
    stillness: float = 0.0


class StopDetector:
    """Detects stops in a stream of checked samples.

    Parameters
    ----------
    limits : StopLimits

    Attributes
    ----------
    stopped : bool
    since_ns : int
        Stamp at which the present stop began, or the present drive.
    stamp_ns : int
        Of the last sample.
    shake : float
        Statistic of the first test over its threshold: below 1 the base does not shake.
    noise : 2 floats
        Standard deviation of an axis over 0.1 s by the sensors, rad/s and m/s²: given or estimated; until then the
        limits' sway and vibration.
    """

    def __init__(self, limits: StopLimits | None = None) -> None:
        self.limits = limits or StopLimits()
        alarm = self.limits.false_alarm
        self._arrival_threshold = float(stats.chi2.isf(_ARRIVAL_ALARM, 4))
        self._sigmas = math.sqrt(float(stats.chi2.isf(alarm, 2)))
        self._size = round(self.limits.window / BLOCK)
        self._average = np.full(self._size, 1.0 / self._size)
        self._shake_threshold = float(stats.chi2.isf(alarm, 6 * self._size - 3))
        given = self.limits.gyro_noise / math.sqrt(BLOCK), self.limits.accel_noise / math.sqrt(BLOCK)
        unknown = self.limits.sway, self.limits.vibration
        self.noise = unknown[0] if math.isnan(given[0]) else given[0], unknown[1] if math.isnan(given[1]) else given[1]
        self._least = [math.inf, math.inf]
        self._variance: list[float] = []
        self.restart()

    def restart(self) -> None:
        """Reset everything but the IMU's noise: the stamps have jumped."""
        self.stopped = False
        self.since_ns = self.stamp_ns = 0
        self._reckoning = VelocityFilter()
        self._lose_track()

    def _lose_track(self) -> None:
        """Reset everything but the biases: after a gap."""
        self.shake = math.inf
        self._reckoning.lose_track()
        self._blocks: deque[tuple[float, ...]] = deque(maxlen=self._size + 1)
        self._epochs: deque[_Epoch] = deque(maxlen=_TURN_EPOCHS)
        self._track: deque[_Place] = deque(maxlen=_HISTORY)
        self._turns = TurnMonitor()
        self._still = self._sure = self._glided = 0
        self._shaken = self._smooth = 0
        self._doubt = 0.0
        self._glides = Glides()
        self._next_sway_ns = self._due = 0
        self._rest_of_block: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._sums = EMPTY

    @property
    def rest_ns(self) -> int:
        """Duration of the present stop, ns; 0 while moving."""
        return self.stamp_ns - self.since_ns if self.stopped else 0

    @property
    def speed(self) -> float:
        """Horizontal, dead reckoned since the last stop, m/s."""
        return math.hypot(*self._reckoning.velocity)

    @property
    def speed_stddev(self) -> float:
        """m/s."""
        return self._reckoning.speed_stddev

    def add(self, stamp_ns: int, sample: Sample) -> Change | None:
        """Add one sample of an `ins_nav.mechanization.imu_stream.ImuStream`; return what begins or ends with it.

        Parameters
        ----------
        stamp_ns : int
        sample : Sample
        """
        h = sample[0]
        if is_gap(h):
            return self._gap(stamp_ns)
        self.stamp_ns = stamp_ns
        self._sums = add_sample(self._sums, sample)
        return self._end_block() if completes(self._sums[0], h) else None

    def due_ns(self, longest: float) -> int:
        """Stamp before which no sample completes a block, where no interval is longer than this, s."""
        return self.stamp_ns + int((BLOCK - 0.5 * longest - self._sums[0]) * 1e9) - _ROUNDING_NS

    def add_run(self, stamp_ns: int, samples: NDArray[np.float64]) -> None:
        """Add samples before `due_ns`, as `add` would one after the other; compiled.

        Parameters
        ----------
        stamp_ns : int
            Of the last.
        samples : ndarray, shape (n, 7)
            A `Sample` a row.
        """
        self.stamp_ns = stamp_ns
        self._sums = add_samples(self._sums, samples)

    def _gap(self, stamp_ns: int) -> Change | None:
        last, was = self.stamp_ns, self.stopped
        self.stopped = False
        self.since_ns = self.stamp_ns = stamp_ns
        self._lose_track()
        return Change(False, last, stamp_ns) if was else None

    def _end_block(self) -> Change | None:
        time, tx, ty, tz, vx, vy, vz, sx, sy, sz = self._sums
        turn, velocity, mean = (tx, ty, tz), (vx, vy, vz), (sx / time, sy / time, sz / time)
        self._sums = EMPTY
        reckoning = self._reckoning
        gyro, accel = self.noise
        # between the mean velocities of two blocks, not from end to end: engines are averaged twice
        fx, fy, fz = ((b - a) / time for a, b in zip(self._rest_of_block, mean, strict=True))
        self._rest_of_block = tuple(m - v for m, v in zip(mean, velocity, strict=True))
        block = time, turn, velocity, mean, gyro, accel
        reckoning.propagate(*block)
        if reckoning.absurd:
            self._reckoning = VelocityFilter()
            return self._gap(self.stamp_ns)
        if self._epochs:
            self._epochs[-1][2].append((self.stamp_ns, block))
        if time > LONG_BLOCK:
            self._blocks.clear()
            self._track.clear()
            self._still = 0
        self._track.append((self.stamp_ns, *reckoning.mean_velocity, *reckoning.mean_integral, reckoning.yaw))
        self._turns.append(self.stamp_ns, reckoning)
        self._blocks.append((turn[0] / time, turn[1] / time, turn[2] / time, fx, fy, fz))
        if len(self._blocks) <= self._size:
            return None
        spread = self._test(gyro, accel)
        return self._stay(spread) if self.stopped else self._arrive(accel)

    def _test(self, gyro: float, accel: float) -> list[float]:
        """The likelihood ratio over the window; its sums of squares about the means."""
        n, limits = self._size, self.limits
        blocks = np.array(self._blocks)[1:]
        mean = self._average @ blocks
        blocks -= mean
        spread: list[float] = np.einsum("ij,ij->j", blocks, blocks).tolist()
        rate2, force2 = gyro * gyro + limits.sway**2, accel * accel + limits.vibration**2
        wx, wy, wz, fx, fy, fz = spread
        offset, variance = self._reckoning.rate_offset(mean[:3])
        turning = float((offset * offset / (rate2 / n + variance)).sum())
        shaking = (wx + wy + wz) / rate2 + (fx + fy + fz) / force2
        self.shake = (shaking + turning) / self._shake_threshold
        if self.shake < 1.0:
            self._still += 1
            return spread
        if not self.stopped:
            self._smooth += self._still
            self._shaken += shaking > self._shake_threshold  # a turn alone is even motion
        self._still = 0
        return spread

    def _arrive(self, accel: float) -> Change | None:
        """Test for the beginning of a stop."""
        reckoning, tracked = self._reckoning, len(self._track)
        if self._may_glide():
            return None
        needed = max(self._size, round(self.limits.min_duration / BLOCK))
        if self._still and self._size + self._still > needed and tracked >= self._size:
            blocks, order, tolerance = min(needed, tracked), 1, _START_SPEED
        elif not self._still and tracked == _HISTORY and self.stamp_ns >= self._next_sway_ns:
            self._next_sway_ns = self.stamp_ns + _SWAY_EVERY
            blocks, order, tolerance = _HISTORY, 2, _SWAY * self.limits.max_speed
        else:
            return None
        track = np.array(self._track)[-blocks:]
        age, velocity, yaw = (track[:, 0] - self.stamp_ns) * 1e-9, track[:, 3:6], track[:, 6]
        if abs(yaw[-1] - yaw[0]) > self._sigmas * reckoning.yaw_rate_stddev(self.limits.sway) * -age[0]:
            return None
        basis = np.vander(age, order + 1, increasing=True)
        trend = np.linalg.lstsq(basis, velocity, rcond=None)[0]
        residual2 = ((velocity - basis @ trend) ** 2).sum(axis=1)
        if residual2.mean() > tolerance**2 or residual2.max() > 9.0 * tolerance**2:
            return None
        noise = _REST_SPEED**2, (accel**2 + self.limits.vibration**2) / self._size
        if reckoning.rest_distance(trend[1, :2], *noise) > self._arrival_threshold:
            return None
        began = self._began(blocks, trend[:, :2])
        if abs(self._track[-1][6] - self._track[0][6]) > _TURN_GOES_ON:
            if self._still and self._turns.ends_gently(self._size, self._sigmas):
                return None
            began = self._turns.turn_ended(began)
        self.stopped = True
        self.since_ns = max(began, self.since_ns)
        speed_stddev = reckoning.speed_stddev
        stillness = self._stillness()
        self._doubt = min(speed_stddev, _ROLL)
        self._sure = self._glided = self._due = 0
        self._shaken = self._smooth = 0
        self._glides.velocities.clear()
        reckoning.rest(_REST_SPEED)
        self._turns.stand(reckoning)
        self._track.clear()  # velocities before this correction are no measure of those after it
        return Change(True, self.since_ns, self.stamp_ns, speed_stddev, stillness)

    def _stillness(self) -> float:
        """`Change.stillness`: at rest the base is still, in motion with the share of the drive ([2]_) that was even.

        Windows of an even glide are the independent samples.
        """
        if not self._still:
            return 0.0
        shaken, smooth = self._shaken / _EVEN_BLOCKS, self._smooth / _EVEN_BLOCKS
        return math.log((shaken + smooth + 1.0) / (smooth + 0.5))

    def _may_glide(self) -> bool:
        """Whether stillness is no evidence: this carrier has moved without shaking before, and may do so now."""
        reckoning = self._reckoning
        speed, stddev = reckoning.speed, reckoning.speed_stddev
        along = complex(*reckoning.velocity) * cmath.exp(-1j * reckoning.yaw)  # carriers mostly move along their nose
        sure = speed > self._sigmas * stddev + self.limits.max_speed
        self._sure += sure
        self._glided += sure and self._still > self._size
        if self._glided <= _GLIDES * self._sure:
            return False
        if self._still and (self._still + self._size) % _EVEN_BLOCKS == 0 and self._coasts() and sure:
            self._glides.velocities.append(along)
        if not self._glides.velocities:
            return False
        odds = self._glides.odds_of_rest(along, stddev**2 + _REST_SPEED**2)
        return odds * (1.0 + self._still * BLOCK / _GLIDE_TIME) < _ODDS

    def _coasts(self) -> bool:
        """Whether the velocity is a straight line; zero acceleration is then a measurement."""
        if len(self._track) <= _EVEN_BLOCKS:
            return False
        track = np.array(list(self._track)[-_EVEN_BLOCKS - 1 :])
        age, velocity = (track[:, 0] - self.stamp_ns) * 1e-9, track[:, 3:5]
        basis = np.vander(age, 2, increasing=True)
        trend = np.linalg.lstsq(basis, velocity, rcond=None)[0]
        if np.abs(velocity - basis @ trend).max() > _STRAIGHT:
            return False
        noise = self._glides.unevenness(self._reckoning.speed)
        return self._reckoning.coast(trend[1], noise, self._sigmas**2)

    def _began(self, blocks: int, trend: NDArray[np.float64]) -> int:
        """Stamp at which the speed fell to zero, given the trend of the velocity over the blocks at rest."""
        before = list(self._track)[-blocks - round(_LOOK_BACK / BLOCK) :]
        age = np.array([place[0] - self.stamp_ns for place in before]) * 1e-9
        off = np.array([place[3:5] for place in before]) - np.vander(age, len(trend), increasing=True) @ trend
        moving = np.flatnonzero(np.hypot(*off.T) > _START_SPEED)
        return before[min(int(moving[-1]) + 1, len(before) - 1) if len(moving) else 0][0]

    def _stay(self, spread: list[float]) -> Change | None:
        """Test for the end of the stop; without one, use the block as a measurement."""
        limits, reckoning = self.limits, self._reckoning
        still = self.shake < 1.0
        margin = self._sigmas * reckoning.speed_stddev
        latest = [self._track[-i] for i in range(1, min(len(self._track), self._size) + 1)]
        mean_speed = math.hypot(sum(v[1] for v in latest), sum(v[2] for v in latest)) / len(latest)
        fast = mean_speed > limits.max_speed + margin or reckoning.speed > 2.0 * limits.max_speed + margin
        if (self._turns.turned(reckoning, self._sigmas) or fast) and self._epochs:
            return self._leave(fast)
        if still:
            self._learn(spread)
        # a tilt has ended already, with zero velocity in use all the time: nothing to undo
        tilted_ns = self._turns.tilted(reckoning, self.since_ns) if self._still > 2 * self._size else 0
        if tilted_ns:
            self._track = deque(list(self._track)[-2 * self._size :], _HISTORY)
            return self._end(tilted_ns)
        self._due -= 1
        if self._due <= 0:
            self._due = self._size
            self._epochs.append((self.stamp_ns, copy.copy(reckoning), []))
            self._turns.learn(reckoning, self._size, limits.sway)
        reckoning.rest(_REST_SPEED * max(0.1, math.sqrt(self.shake)) if still else limits.max_speed)
        return None

    def _leave(self, travels: bool) -> Change:
        """End the stop, and undo its measurements since the estimated end, which is some time ago."""
        turns = self._turns.turn_began(self._reckoning, self.since_ns)
        epochs, ended, least = list(self._epochs), turns, 0
        if travels:
            # of a short stop half is kept in any case
            least = 0 if len(epochs) >= _EPOCHS else len(epochs) // 2
            epochs = epochs[-_EPOCHS:]
            ended = min(turns, self._again(epochs)[2])
        start = ended - (self.stamp_ns - ended) - _EPOCH_MARGIN
        last = max((i for i, epoch in enumerate(epochs) if epoch[0] <= start), default=0)
        reckoning, track, stood = self._again(epochs[max(last, least) :])
        if travels:
            ended = min(turns, stood)
        if self.stamp_ns - self.since_ns < _CERTAIN * 1e9:
            reckoning.doubt_velocity(self._doubt)
            reckoning.doubt_tilt(_DOUBTED_TILT)
        self._reckoning = reckoning
        self._track.clear()
        self._track.extend(track)
        self._still = 0
        return self._end(ended)

    def _end(self, ended: int) -> Change:
        self._epochs.clear()
        self.stopped = False
        self.since_ns = ended
        return Change(False, ended, self.stamp_ns)

    def _again(self, epochs: list[_Epoch]) -> tuple[VelocityFilter, list[_Place], int]:
        """Repeat dead reckoning from the first of the epochs; the track, and the last stamp at rest."""
        reckoning = copy.copy(epochs[0][1])
        track, ended = [], epochs[0][0]
        for stamp, block in (block for epoch in epochs for block in epoch[2]):
            reckoning.propagate(*block)
            track.append((stamp, *reckoning.mean_velocity, *reckoning.mean_integral, reckoning.yaw))
            if math.hypot(*reckoning.mean_velocity) < _START_SPEED:
                ended = stamp
        return reckoning, track, ended

    def _learn(self, spread: list[float]) -> None:
        """Estimate the noise from the quietest axis and time at rest: engines and people only add to it."""
        variance = [s / (self._size - 1) for s in spread]
        before = self._variance or variance
        self._variance = smooth = [b + _SMOOTHING * (v - b) for b, v in zip(before, variance, strict=True)]
        limits = self.limits
        noise = list(self.noise)
        for i, (given, floor) in enumerate(((limits.gyro_noise, limits.sway), (limits.accel_noise, limits.vibration))):
            if math.isnan(given):
                least = min(_LEAST * min(smooth[3 * i : 3 * i + 3]), self._least[i] * _FORGETTING)
                self._least[i] = least
                noise[i] = max(math.sqrt(least), _NOISE_FLOOR * floor)
        self.noise = noise[0], noise[1]
