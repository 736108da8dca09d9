"""Stops, found in the IMU's stream alone.

A base at rest is still in two ways, and both are asked for:

- *It does not shake.* Rate and specific force over a window of 1 s are tested against their mean: the generalized
  likelihood ratio of [1]_, with the noise of the IMU (learnt at rest, or given) and what an idling engine adds.
  Gyros are tested against what they show at rest: a slow even turn is motion.
- *It does not travel.* An even creep cannot be felt, its beginning can: the velocity since the last rest is dead
  reckoned, with its covariance. Only a velocity and an acceleration that agree with zero make a stop. After some
  minutes of driving the velocity says little, and the first test decides.

A stop, once found, ends only when the base travels: people who rock a parked car shake it, but do not move it. So
the swell under a ship that has come to rest is no motion as long as surge and sway stay under ``max_speed``; a ship
that rocks all the time never passes the first test and is never at a stop.

Samples are summed over blocks of 0.1 s, so that vibration of tens of Hz averages out; all tests are made once a block.

References
----------
.. [1] I. Skog, P. Händel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection: an algorithm evaluation", IEEE
       Transactions on Biomedical Engineering, 2010, vol. 57, no. 11.
"""

import copy
import math
from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ins_nav.attitude import Quaternion, from_rotation_vector, multiply, normalized, rotate
from ins_nav.strapdown import Sample

Triple = tuple[float, float, float]

_BLOCK = 0.1
"""s: five blocks a second resolve a body's motion on its springs (1 to 2 Hz), and average an engine's."""
_LONGEST_GAP = 1.0
"""s: over a longer gap a stop is not certain any more. A car gains 3 m/s in it."""
_HISTORY = 100
"""Blocks of velocity kept to find when a stop began."""
_START_SPEED = 0.05
"""m/s: the stop began when the speed fell below this."""
_GRAVITY = 9.81
_SPEED_PRIOR = 30.0
"""m/s: standard deviation of the speed of what this detector rides on, before anything is known."""
_SPEED_PRIOR_CORRELATION = 30.0
"""s: the time over which that speed stays the same."""
_TILT_PRIOR = 0.3
"""rad: the first level is taken from a specific force that may be that of a curve."""
_GYRO_BIAS_PRIOR = 5e-3
"""rad/s, 1000 °/h."""
_ACCEL_BIAS_PRIOR = 0.05
"""m/s², 5 mg."""
_EARTH_RATE_PRIOR = 5e-5
"""rad/s: horizontal components of the Earth's rate, of unknown direction."""
_ALLAN_MINIMUM = 100.0
"""s: where the random walk of a bias overtakes the sensor's white noise (the usual minimum of Allan deviation)."""
_SCALE_ERROR = 2e-3
"""Scale factors and misalignments of MEMS sensors."""
_REST_SPEED = 0.01
"""m/s: sway of a base that passes the first test (0.02 m/s² at 1 Hz is a third of it)."""
_LOST_ACCELERATION = 3.0
"""m/s²: what lost samples may have held."""
_LOOK_BACK = 3.0
"""s before the still time in which a stop's beginning is sought."""
_SWAY = 0.15
"""Of max_speed: a base that sways from the first stands when its velocity varies by less over 10 s, RMS, apart from
the parabola that tilt and gyro biases make of it."""
_SWAY_EVERY = 500_000_000
"""ns between two looks for that."""
_ROLL = 1.0
"""m/s: whoever rolls faster shakes."""
_GLIDES = 0.1
"""Share of the time surely spent moving: a carrier that is still for more of it is a smooth one (a ship, a train)."""
_CERTAIN = 5.0
"""s: a shorter stop may have been an even roll, if the velocity was not well known when it began."""
_ARRIVAL_ALARM = 0.05
"""Probability to wait for more: the standard deviation grows with time, a creep that is taken for a stop does harm."""
_GLIDE_ACCELERATION = 0.01
"""m/s²: mean over a window of what moves without shaking."""
_EPOCHS = 10
"""Windows of a stop that are taken back when it ends: a slow start looks like rest at first."""
_GATE = 13.8
"""Squared distance of 0.1 % of normal pairs."""
_SMOOTHING = 0.02
"""Share of a new variance in the mean over 5 s."""
_LEAST = 2.0
"""The least of many such means is about half of the variance."""
_FORGETTING = 1.001
"""Growth of the least variance a block: a sensor that has become noisier is known in minutes."""
_NOISE_FLOOR = 0.005
"""Of sway and vibration: no base is quieter."""


class Change(NamedTuple):
    """A stop begins or ends.

    Attributes
    ----------
    stopped : bool
    stamp_ns : int
        When it began or ended, as the data shows it: before the decision.
    decided_ns : int
        Stamp of the sample that brought the decision.
    """

    stopped: bool
    stamp_ns: int
    decided_ns: int


@dataclass(frozen=True)
class StopLimits:
    """What is a stop.

    Attributes
    ----------
    window : float
        Length of the test window, s.
    min_duration : float
        A stop is one after so many still seconds.
    max_speed : float
        Mean over a window from which on the base travels, m/s.
    vibration : float
        Disturbance of specific force at rest, averaged over 0.1 s, standard deviation an axis, m/s².
    sway : float
        The same of angular rate, rad/s.
    false_alarm : float
        Probability that a window at rest fails a test.
    gyro_noise : float
        White noise, rad/√s; NaN: learnt at rest.
    accel_noise : float
        White noise, m/s/√s; NaN: learnt at rest.
    """

    window: float = 1.0
    min_duration: float = 2.0
    max_speed: float = 0.1
    vibration: float = 0.02
    sway: float = 1e-3
    false_alarm: float = 1e-3
    gyro_noise: float = math.nan
    accel_noise: float = math.nan


class StopDetector:
    """Takes checked samples, tells stops.

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
        Standard deviation of an axis over 0.1 s by the sensors, rad/s and m/s²: given or learnt; until then the
        limits' sway and vibration.
    """

    def __init__(self, limits: StopLimits | None = None) -> None:
        self.limits = limits or StopLimits()
        alarm = self.limits.false_alarm
        self._speed_threshold = float(stats.chi2.isf(alarm, 2))
        self._arrival_threshold = float(stats.chi2.isf(_ARRIVAL_ALARM, 4))
        self._sigmas = math.sqrt(self._speed_threshold)
        self._size = round(self.limits.window / _BLOCK)
        self._shake_threshold = float(stats.chi2.isf(alarm, 6 * self._size - 3))
        given = self.limits.gyro_noise / math.sqrt(_BLOCK), self.limits.accel_noise / math.sqrt(_BLOCK)
        unknown = self.limits.sway, self.limits.vibration
        self.noise = unknown[0] if math.isnan(given[0]) else given[0], unknown[1] if math.isnan(given[1]) else given[1]
        self._least = [math.inf, math.inf]
        self._variance: NDArray[np.float64] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget everything but the IMU's noise: the stamps have jumped."""
        self.stopped = False
        self.since_ns = self.stamp_ns = 0
        self._reckoning = _DeadReckoning()
        self._lose_track()

    def _lose_track(self) -> None:
        """After a gap nothing is known but the biases."""
        self.shake = math.inf
        self._reckoning.lose_track()
        self._blocks: deque[tuple[float, ...]] = deque(maxlen=self._size + 1)
        self._epochs: deque[tuple[_DeadReckoning, list[tuple[int, Any]]]] = deque(maxlen=_EPOCHS)
        self._track: deque[tuple[int, float, float, float, float]] = deque(maxlen=_HISTORY)
        self._still = self._sure = self._glided = 0
        self._doubt = self._glide_speed = 0.0
        self._next_sway_ns = self._due = 0
        self._rest_of_block: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._clear_block()

    def _clear_block(self) -> None:
        self._time = self._tx = self._ty = self._tz = self._vx = self._vy = self._vz = 0.0
        self._sx = self._sy = self._sz = 0.0

    @property
    def rest_ns(self) -> int:
        """How long the present stop lasts, ns; 0 when there is none."""
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
        """Take one sample, as `ins_nav.imu_stream.ImuStream` gives it; says when a stop begins or ends.

        Parameters
        ----------
        stamp_ns : int
        sample : Sample
        """
        h, wx, wy, wz, fx, fy, fz = sample
        if not 0.0 < h <= _LONGEST_GAP:
            return self._gap(stamp_ns)
        # turned back to the body at the block's start, to first order: a block turns by some hundredths of a radian
        half = 0.5 * h
        mx, my, mz = self._tx + half * wx, self._ty + half * wy, self._tz + half * wz
        vx, vy, vz = self._vx, self._vy, self._vz
        self._vx = vx + h * (fx + my * fz - mz * fy)
        self._vy = vy + h * (fy + mz * fx - mx * fz)
        self._vz = vz + h * (fz + mx * fy - my * fx)
        self._sx += half * (vx + self._vx)
        self._sy += half * (vy + self._vy)
        self._sz += half * (vz + self._vz)
        self._tx = mx + half * wx
        self._ty = my + half * wy
        self._tz = mz + half * wz
        self._time += h
        self.stamp_ns = stamp_ns
        if self._time < _BLOCK - half:
            return None
        return self._end_block()

    def _gap(self, stamp_ns: int) -> Change | None:
        last, was = self.stamp_ns, self.stopped
        self.stopped = False
        self.since_ns = self.stamp_ns = stamp_ns
        self._lose_track()
        return Change(False, last, stamp_ns) if was else None

    def _end_block(self) -> Change | None:
        time, turn, velocity = self._time, (self._tx, self._ty, self._tz), (self._vx, self._vy, self._vz)
        mean = (self._sx / time, self._sy / time, self._sz / time)
        self._clear_block()
        reckoning = self._reckoning
        gyro, accel = self.noise
        # between the mean velocities of two blocks, not from end to end: engines are averaged twice
        fx, fy, fz = ((b - a) / time for a, b in zip(self._rest_of_block, mean, strict=True))
        self._rest_of_block = tuple(m - v for m, v in zip(mean, velocity, strict=True))
        block = time, turn, velocity, mean, gyro, accel
        reckoning.propagate(*block)
        if self._epochs:
            self._epochs[-1][1].append((self.stamp_ns, block))
        if time > 2.0 * _BLOCK:
            self._blocks.clear()
            self._track.clear()
            self._still = 0
        self._track.append((self.stamp_ns, *reckoning.mean_velocity, reckoning.yaw))
        self._blocks.append((turn[0] / time, turn[1] / time, turn[2] / time, fx, fy, fz))
        if len(self._blocks) <= self._size:
            return None
        mean_rate, spread = self._test(gyro, accel)
        return self._stay(mean_rate, spread) if self.stopped else self._arrive(accel)

    def _test(self, gyro: float, accel: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The likelihood ratio over the window; its mean rate, and its sums of squares about the means."""
        n, limits = self._size, self.limits
        blocks = np.array(self._blocks)[1:]
        mean = blocks.sum(axis=0) / n
        blocks -= mean
        spread = (blocks * blocks).sum(axis=0)
        rate2, force2 = gyro * gyro + limits.sway**2, accel * accel + limits.vibration**2
        wx, wy, wz, fx, fy, fz = spread.tolist()
        offset, variance = self._reckoning.rate_offset(mean[:3])
        turning = float((offset * offset / (rate2 / n + variance)).sum())
        self.shake = ((wx + wy + wz) / rate2 + (fx + fy + fz) / force2 + turning) / self._shake_threshold
        self._still = self._still + 1 if self.shake < 1.0 else 0
        return mean[:3], spread

    def _arrive(self, accel: float) -> Change | None:
        """While moving: has a stop begun?"""
        reckoning, tracked = self._reckoning, len(self._track)
        if self._smooth():
            self._glide()
            return None
        still = self._size + self._still - 1
        if self._still and still >= round(self.limits.min_duration / _BLOCK):
            blocks, order, tolerance = min(still, tracked), 1, _START_SPEED
        elif not self._still and tracked == _HISTORY and self.stamp_ns >= self._next_sway_ns:
            self._next_sway_ns = self.stamp_ns + _SWAY_EVERY
            blocks, order, tolerance = _HISTORY, 2, _SWAY * self.limits.max_speed
        else:
            return None
        track = np.array(self._track)[-blocks:]
        age, velocity, yaw = (track[:, 0] - self.stamp_ns) * 1e-9, track[:, 1:4], track[:, 4]
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
        self.stopped = True
        self.since_ns = self._began(blocks, trend[:, :2])
        self._doubt = min(reckoning.speed_stddev, _ROLL)
        self._sure = self._glided = 0
        self._glide_speed = 0.0
        reckoning.rest(_REST_SPEED, None, 0.0)
        self._track.clear()  # velocities before this correction are no measure of those after it
        return Change(True, self.since_ns, self.stamp_ns)

    def _smooth(self) -> bool:
        """Whether stillness says nothing: this drive has been without shaking before, and may be so now."""
        speed, stddev = self._reckoning.speed, self._reckoning.speed_stddev
        if speed > self._sigmas * stddev + self.limits.max_speed:
            self._sure += 1
            if self._still:
                self._glided += 1
                self._glide_speed += speed
        if self._glided <= _GLIDES * self._sure:
            return False
        glide = self._glide_speed / self._glided
        if glide > _ROLL:
            return max(speed, stddev) > 0.5 * glide
        return speed > 0.5 * glide and stddev < glide  # a creep, as long as the velocity tells

    def _glide(self) -> None:
        """A base that does not shake does not gain speed either: once a window, the level is learnt from that."""
        self._due -= 1
        if not self._still or self._due > 0 or len(self._track) <= self._size:
            return
        self._due = self._size
        (past, x, y, *_), (now, vx, vy, *_) = self._track[-1 - self._size], self._track[-1]
        time = (now - past) * 1e-9
        self._reckoning.glide(np.array([(vx - x) / time, (vy - y) / time]), _GLIDE_ACCELERATION)

    def _began(self, blocks: int, trend: NDArray[np.float64]) -> int:
        """When the speed fell to zero, given that the base stands since some blocks and what it seemed to do then."""
        trend_x, trend_y = trend.T[:, ::-1].tolist()
        track = list(self._track)
        began = track[-blocks][0]
        for stamp, x, y, _, _ in reversed(track[-blocks - round(_LOOK_BACK / _BLOCK) :]):
            age = (stamp - self.stamp_ns) * 1e-9
            if math.hypot(x - _polynomial(trend_x, age), y - _polynomial(trend_y, age)) > _START_SPEED:
                break
            began = stamp
        return began

    def _stay(self, mean_rate: NDArray[np.float64], spread: NDArray[np.float64]) -> Change | None:
        """While at a stop: has it ended? Otherwise learn from it."""
        limits, reckoning = self.limits, self._reckoning
        still = self.shake < 1.0
        margin = self._sigmas * reckoning.speed_stddev
        latest = [self._track[-i] for i in range(1, min(len(self._track), self._size) + 1)]
        mean_speed = math.hypot(sum(v[1] for v in latest), sum(v[2] for v in latest)) / len(latest)
        if mean_speed > limits.max_speed + margin or reckoning.speed > 2.0 * limits.max_speed + margin:
            return self._leave()
        if still:
            self._learn(spread)
        self._due -= 1
        if self._due <= 0:
            self._due = self._size
            self._epochs.append((copy.copy(reckoning), []))
        whole = still and self._due == self._size  # windows overlap: their mean rate is news once a window
        speed_noise = _REST_SPEED * max(0.1, math.sqrt(self.shake)) if still else limits.max_speed
        reckoning.rest(speed_noise, mean_rate if whole else None, limits.sway)
        return None

    def _leave(self) -> Change:
        """The stop is over, and was for a while: take back what was learnt from it in the last seconds."""
        reckoning, track = self._reckoning, list(self._track)
        if self._epochs:
            reckoning = self._epochs[0][0]
            blocks = [block for _, epoch in self._epochs for block in epoch]
            track = []
            for stamp, block in blocks:
                reckoning.propagate(*block)
                track.append((stamp, *reckoning.mean_velocity, reckoning.yaw))
            self._epochs.clear()
        self._track.clear()
        self._track.extend(track)
        ended = self.stamp_ns
        for stamp, x, y, _, _ in reversed(track):
            ended = stamp
            if math.hypot(x, y) < _START_SPEED:
                break
        if self.stamp_ns - self.since_ns < _CERTAIN * 1e9:
            reckoning.doubt_velocity(self._doubt)
        self._reckoning = reckoning
        self.stopped = False
        self.since_ns = ended
        self._still = 0
        return Change(False, ended, self.stamp_ns)

    def _learn(self, spread: NDArray[np.float64]) -> None:
        """Noise from the quietest axis and time at rest: engines and people only add."""
        variance = spread / (self._size - 1)
        self._variance = variance if self._variance is None else self._variance + _SMOOTHING * (variance - self._variance)
        smooth = self._variance.tolist()
        limits = self.limits
        noise = list(self.noise)
        for i, (given, floor) in enumerate(((limits.gyro_noise, limits.sway), (limits.accel_noise, limits.vibration))):
            if math.isnan(given):
                least = min(_LEAST * min(smooth[3 * i : 3 * i + 3]), self._least[i] * _FORGETTING)
                self._least[i] = least
                noise[i] = max(math.sqrt(least), _NOISE_FLOOR * floor)
        self.noise = noise[0], noise[1]


_H_V: NDArray[np.float64] = np.eye(2, 12)
_V, _TILT, _GYRO, _EARTH, _ACCEL = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 9), slice(9, 12)


class _DeadReckoning:
    """Horizontal velocity by a small error-state Kalman filter on level axes that are free in azimuth.

    States: velocity (2), tilt (2), gyro biases (3, body), the Earth's horizontal rate (2, level axes: it stays
    where it is when the body turns), accelerometer biases (3, body). Arrays are replaced, never changed in place: a
    shallow copy keeps the state.
    """

    def __init__(self) -> None:
        self.velocity = (0.0, 0.0)
        self.mean_velocity = (0.0, 0.0, 0.0)
        self.yaw = 0.0
        self._climb = 0.0
        self._q: Quaternion | None = None
        self._gyro = np.zeros(3)
        self._earth = np.zeros(2)
        self._accel = np.zeros(3)
        self._rotation = np.eye(3)
        self._p = np.diag(
            np.square(
                [_SPEED_PRIOR] * 2
                + [_TILT_PRIOR] * 2
                + [_GYRO_BIAS_PRIOR] * 3
                + [_EARTH_RATE_PRIOR] * 2
                + [_ACCEL_BIAS_PRIOR] * 3
            )
        )

    @property
    def speed(self) -> float:
        return math.hypot(*self.velocity)

    @property
    def speed_stddev(self) -> float:
        return math.sqrt(max(self._p[0, 0], self._p[1, 1]))

    def yaw_rate_stddev(self, sway: float) -> float:
        """Of the rate about the vertical at rest, rad/s."""
        up = self._rotation[2]
        return math.sqrt(float(up @ self._p[_GYRO, _GYRO] @ up) + _EARTH_RATE_PRIOR**2 + sway**2)

    def lose_track(self) -> None:
        """Velocity and attitude are unknown again."""
        self.velocity = (0.0, 0.0)
        self._q = None
        self._p = self._p.copy()
        self._p[:4, :] = self._p[:, :4] = 0.0
        self._p[:4, :4] = np.diag(np.square([_SPEED_PRIOR] * 2 + [_TILT_PRIOR] * 2))

    def doubt_velocity(self, stddev: float) -> None:
        """Add an error of unknown direction, m/s."""
        self._p = self._p + np.diag([stddev**2] * 2 + [0.0] * 10)

    def propagate(self, time: float, turn: Triple, velocity: Triple, mean: Triple, gyro: float, accel: float) -> None:
        """Carry the state over a block.

        Parameters
        ----------
        time : float
            Its length, s.
        turn, velocity : 3 floats
            Integrals of rate, and of specific force on the body's axes at the block's start.
        mean : 3 floats
            Mean of the second as it grew.
        gyro, accel : float
            Standard deviation of the block's mean rate and specific force, rad/s and m/s².
        """
        if self._q is None:
            self._q = _level(*velocity)
        rotation = self._rotation = _matrix(self._q)
        rate = self._gyro + rotation[:2].T @ self._earth
        rx, ry, rz = rate.tolist()
        bx, by, bz = self._accel.tolist()
        dv = (velocity[0] - bx * time, velocity[1] - by * time, velocity[2] - bz * time)
        dx, dy, dz = rotate(self._q, *dv)
        if time > 2.0 * _BLOCK:  # samples were lost, and with them what they felt
            self.doubt_velocity(time * _LOST_ACCELERATION)
        mx, my, mz = rotate(self._q, mean[0] - 0.5 * bx * time, mean[1] - 0.5 * by * time, mean[2] - 0.5 * bz * time)
        self.mean_velocity = self.velocity[0] + mx, self.velocity[1] + my, self._climb + mz - 0.5 * _GRAVITY * time
        self.velocity = self.velocity[0] + dx, self.velocity[1] + dy
        self._climb += dz - _GRAVITY * time
        tx, ty, tz = turn[0] - rx * time, turn[1] - ry * time, turn[2] - rz * time
        self._q = normalized(multiply(self._q, from_rotation_vector(tx, ty, tz)))
        ux, uy, uz = rotation[2].tolist()
        self.yaw += ux * tx + uy * ty + uz * tz
        f = np.eye(12)
        f[0, 3], f[1, 2] = dz, -dz
        f[_V, _ACCEL] = f[_TILT, _GYRO] = -time * rotation[:2]
        f[2, 7] = f[3, 8] = -time
        p = f @ self._p @ f.T
        scale2 = _SCALE_ERROR**2
        qv, qt = (accel * time) ** 2, (gyro * time) ** 2
        v = qv + scale2 * math.hypot(dx, dy)
        t = qt + scale2 * math.sqrt(tx * tx + ty * ty + tz * tz)
        b, a = qt / _ALLAN_MINIMUM**2, qv / _ALLAN_MINIMUM**2
        p.flat[::13] += (v, v, t, t, b, b, b, 0.0, 0.0, a, a, a)
        self._p = p
        # whatever it is, it is not at 100 m/s: keeps the level bounded in a long drive
        if p[0, 0] > _SPEED_PRIOR**2 or p[1, 1] > _SPEED_PRIOR**2:
            self._update(_H_V, -np.array(self.velocity), _SPEED_PRIOR**2 * _SPEED_PRIOR_CORRELATION / time)

    def rate_offset(self, mean: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean rate over what is expected at rest, and the variance of that, rad/s."""
        down = self._rotation[:2].T
        variance = self._p.diagonal()[_GYRO] + _EARTH_RATE_PRIOR**2
        return mean - self._gyro - down @ self._earth, variance

    def _acceleration_rows(self) -> NDArray[np.float64]:
        """Error of the horizontal acceleration by the states."""
        h = np.zeros((2, 12))
        h[0, 3], h[1, 2] = _GRAVITY, -_GRAVITY
        h[:, _ACCEL] = -self._rotation[:2]
        return h

    def glide(self, acceleration: NDArray[np.float64], noise: float) -> None:
        """The base moves evenly: its mean acceleration, m/s², is zero, unless that contradicts what is known."""
        h = self._acceleration_rows()
        s = h @ self._p @ h.T
        if float(acceleration @ acceleration) < _GATE * (noise**2 + max(s[0, 0], s[1, 1])):
            self._update(h, -acceleration, noise**2)

    def rest_distance(self, acceleration: NDArray[np.float64], speed_noise2: float, accel_noise2: float) -> float:
        """Squared Mahalanobis distance of velocity and mean acceleration, m/s², from zero."""
        h = np.concatenate([_H_V, self._acceleration_rows()])
        s = h @ self._p @ h.T
        s.flat[::5] += [speed_noise2, speed_noise2, accel_noise2, accel_noise2]
        z = np.array([*self.velocity, *acceleration])
        return float(z @ np.linalg.solve(s, z))

    def rest(self, speed_noise: float, rate: NDArray[np.float64] | None, rate_noise: float) -> None:
        """The base stands: velocity is zero, and where a rate is given, it is that of the biases and the Earth.

        A velocity that contradicts this is left alone: it is jolted, or about to move.
        """
        vx, vy = self.velocity
        limit = _GATE * (speed_noise**2 + max(self._p[0, 0], self._p[1, 1]))
        if vx * vx + vy * vy < limit:
            self._update(_H_V, np.array([-vx, -vy]), speed_noise**2)
        if rate is not None:
            h = np.zeros((3, 12))
            h[0, 4] = h[1, 5] = h[2, 6] = 1.0
            h[:, _EARTH] = down = self._rotation[:2].T
            self._update(h, rate - self._gyro - down @ self._earth, rate_noise**2)

    def _update(self, h: NDArray[np.float64], residual: NDArray[np.float64], variance: float) -> None:
        assert self._q is not None
        ph = self._p @ h.T
        s = h @ ph
        s.flat[:: len(s) + 1] += variance
        gain = np.linalg.solve(s, ph.T).T
        dx = gain @ residual
        p = self._p - gain @ ph.T
        self._p = 0.5 * (p + p.T)
        vx, vy, px, py = dx[:4].tolist()
        self.velocity = self.velocity[0] + vx, self.velocity[1] + vy
        self._q = multiply(from_rotation_vector(px, py, 0.0), self._q)
        self._gyro = self._gyro + dx[_GYRO]
        self._earth = self._earth + dx[_EARTH]
        self._accel = self._accel + dx[_ACCEL]


def _polynomial(coefficients: list[float], x: float) -> float:
    """Highest power first."""
    value = 0.0
    for coefficient in coefficients:
        value = value * x + coefficient
    return value


def _level(x: float, y: float, z: float) -> Quaternion:
    """Body to level axes, from what is taken for the direction up."""
    norm = math.sqrt(x * x + y * y + z * z)
    if z < -0.999 * norm:  # upside down: half a turn about x
        return 1.0, 0.0, 0.0, 0.0
    return normalized((y, -x, 0.0, norm + z))


def _matrix(q: Quaternion) -> NDArray[np.float64]:
    x, y, z, w = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
