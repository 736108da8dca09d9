"""Residual rates of a stationary carrier, level and yaw, from the first sample of a stop on.

The measurement of every ``b`` of the ZUPT equations (`zupt_equations`). At rest the platform's residual tilt rate shows
in specific force carried into inertial space, exactly as in coarse alignment: the same series, the same noise, but
on the axes S of the mechanization, whose azimuth is kept. (The paper reads it off the Schuler oscillation of velocity,
which is the integral of the same series.) The vertical component is the run-off of yaw.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ins_nav.alignment.gravity_cone import GravityCone, cone_path
from ins_nav.alignment.noise_model import TrendNoise, trend_basis
from ins_nav.mechanization.attitude import Quaternion
from ins_nav.mechanization.earth import RATE
from ins_nav.mechanization.nav_state import NavState, geodetic
from ins_nav.mechanization.strapdown import Sample, sample_of
from ins_nav.zupt.zupt_equations import StopMeasurement, ZuptError

Array = NDArray[np.float64]

_EXPECTED = 60.0
"""s: sets the length of the first blocks; they double as the stop lasts."""
_MIN_BLOCKS = 12
MIN_DURATION = 6.0
"""s: twelve of the first blocks."""


_ENDS = 6.0
"""s at both ends of a stop in which the vehicle may still, or already, have moved."""
_OUTLIER = 9.0
"""Median deviations from the median, 6 sigmas: what lies beyond is no rest."""


@dataclass(frozen=True)
class StationaryRatesResult:
    """A stop, analysed.

    Attributes
    ----------
    measurement : StopMeasurement
        At the start of the stop; its ``azimuth_gain`` reaches from there to the last sample.
    q_gb : Quaternion
        Body to S at the last sample, by the gyros as they are, level by gravity.
    rocking : float
        RMS of the tilt about its mean, rad.
    level_variance : float
        Of the level at the last sample, each axis, rad².
    gyro_noise : float
        White noise of an axis, rad/√s.
    """

    measurement: StopMeasurement
    q_gb: Quaternion
    rocking: float
    level_variance: float
    gyro_noise: float


class StationaryRates:
    """Gathers a stop.

    Parameters
    ----------
    state : NavState
        The navigation solution at the last sample before the first that is added.
    cone : GravityCone, optional
        What coarse alignment has gathered of this stop up to that sample; the stop is then that much longer.
    """

    def __init__(self, state: NavState, cone: GravityCone | None = None) -> None:
        now = geodetic(state)
        self._lat = now.lat
        self._cone = cone or GravityCone(_EXPECTED)
        earth = np.array([0.0, math.cos(now.lat), math.sin(now.lat)])
        since = Rotation.from_rotvec(RATE * self._cone.time * earth)
        q_s0b0 = since * Rotation.from_quat(now.q_gb) * Rotation.from_quat(self._cone.q_b0b).inv()
        self._rot_b0s0: Array = q_s0b0.inv().as_matrix()

    @property
    def duration(self) -> float:
        """s."""
        return self._cone.time

    def add(self, previous: Sample, sample: Sample, instantaneous: bool) -> None:
        """Add one sample, biases in use removed, as in `ins_nav.mechanization.strapdown.step`."""
        self._cone.add(previous, sample, instantaneous)

    def add_block(self, previous: Sample, samples: Array, instantaneous: bool) -> None:
        """Add samples, a row each, as `add` would one after the other; compiled."""
        while len(samples):
            count, _ = self._cone.add_block(previous, samples, instantaneous)
            previous, samples = sample_of(samples[count - 1]), samples[count:]

    def result(self, accel_bias_stddev: float = 0.0, until: float = math.inf) -> StationaryRatesResult:
        """Analyse the stop so far.

        The rates are those of the complete blocks: a sample more or less changes nothing in them.

        Parameters
        ----------
        accel_bias_stddev : float
            m/s²; the tilt it makes lets some of the Earth's rate pass for drift.
        until : float
            Blocks that end later than this, s from the start, are left out.

        Raises
        ------
        ZuptError
            Too short.
        """
        usable = min(until, self._cone.time)
        if len(self._cone) == 0 or usable < MIN_DURATION:
            raise _too_short(max(usable, 0.0))
        blocks, lat = self._cone.blocks(until), self._lat
        if len(blocks.time) < _MIN_BLOCKS:
            raise _too_short(usable)
        path = cone_path(lat, blocks.time)
        gravity = float(np.linalg.norm(blocks.force.mean(axis=0)) / np.linalg.norm(path.mean(axis=0)))
        limits = self._cone.noise_limits(gravity, until)
        rot_b0s = self._rot_b0s0
        earth: Array = RATE * np.array([0.0, math.cos(lat), math.sin(lat)])
        middle = Rotation.from_rotvec(-np.outer(blocks.time, earth))
        # blocks are whole samples, so not of one length; each middle lies halfway between two ends
        sign = (-1.0) ** np.arange(len(blocks.time))
        ends: Array = np.asarray(2.0 * sign * np.cumsum(sign * blocks.time), float)
        every = np.insert(ends, 0, 0.0), np.vstack([[0.0, 0.0, 0.0, 1.0], blocks.q_b0b])
        keep = _still(ends, blocks.force, _attitudes(rot_b0s, earth, ends, blocks.q_b0b))
        if keep.stop - keep.start < _MIN_BLOCKS or ends[keep][-1] - ends[keep][0] < 0.8 * MIN_DURATION:
            raise ZuptError(
                f"stop too short: the vehicle still moved in the first seconds of {self.duration:.1f} s; stand still "
                "and call again"
            )
        ends, middle = ends[keep], middle[keep]
        blocks = replace(blocks, time=blocks.time[keep], force=blocks.force[keep], q_b0b=blocks.q_b0b[keep])
        rate = np.zeros(3)
        noise = yaw_noise = None
        for i in range(3):
            force_s = middle.apply(blocks.force @ rot_b0s) / gravity
            bend = _bend(rate, earth, blocks.time)
            series = force_s[:, :2] - np.column_stack([bend[:, 1], -bend[:, 0]])
            tilted = _attitudes(rot_b0s, earth, ends, blocks.q_b0b)
            tilts = np.outer(ends, rate) + _bend(rate, earth, ends)  # a rocking body would read them as yaw
            tilts[:, 2] = 0.0
            attitudes: Array = Rotation.from_rotvec(-tilts).as_matrix() @ tilted
            yaw = np.unwrap(np.arctan2(attitudes[:, 1, 0], attitudes[:, 0, 0])) - _bend(rate, earth, ends)[:, 2]
            yaw_series = (yaw - yaw[0])[:, None]
            if i == 1:  # the first time only finds the axes
                noise = TrendNoise.of(blocks.time, float(ends[-1]), series, limits)
                yaw_noise = TrendNoise.of(ends, float(ends[-1]), yaw_series, np.array([math.inf, limits[1]]))
            if noise is None or yaw_noise is None:
                (level, slope), (_, yaw_slope) = _trend(blocks.time, series), _trend(ends, yaw_series)
            else:
                fit, yaw_fit = noise.fit(series), yaw_noise.fit(yaw_series)
                level, slope, yaw_slope = fit.level, fit.slope, yaw_fit.slope
            rate = np.array([-slope[1], slope[0], yaw_slope[0]])
            rot_b0s = rot_b0s @ Rotation.from_rotvec([-level[1], level[0], 0.0]).as_matrix()

        assert noise is not None and yaw_noise is not None
        # what a unit drift makes of the series goes through the same estimator: a rocking body has turned in between
        turn = CubicSpline(every[0], _attitudes(rot_b0s, earth, *every)).antiderivative()
        tilt_turn, yaw_turn = (turn(time).reshape(-1, 9) for time in (blocks.time, ends))
        rot_sb = np.concatenate([noise.fit(tilt_turn).slope[:6], yaw_noise.fit(yaw_turn).slope[6:]]).reshape(3, 3)
        mean: Array = attitudes.mean(axis=0)
        tilt = np.linalg.norm(attitudes[:, 2, :] - mean[2], axis=1)
        leak = (RATE * accel_bias_stddev / gravity) ** 2
        variance = fit.slope_variance + leak
        last = _attitudes(rot_b0s, earth, np.array([self.duration]), np.array([self._cone.q_b0b]))
        # level at the end of the blocks; after that it drifts on
        end = fit.end - fit.level + fit.slope * (self.duration - ends[-1])
        end += _bend(rate, earth, np.array([self.duration]))[0, [1, 0]] * [1.0, -1.0]
        q = (Rotation.from_rotvec([end[1], -end[0], 0.0]) * Rotation.from_matrix(last[0])).as_quat()
        return StationaryRatesResult(
            StopMeasurement(
                rot_sb,
                rate,
                np.diag([variance, variance, yaw_fit.slope_variance + leak]),
                float(earth[1]),
                self.duration * mean[2],
            ),
            (float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            float(np.sqrt((tilt**2).mean())),
            fit.end_variance + (accel_bias_stddev / gravity) ** 2,
            math.sqrt(float(limits[1])),
        )


def _too_short(duration: float) -> ZuptError:
    return ZuptError(f"stop too short: {duration:.1f} s of at least {MIN_DURATION:g} s; stand still and call again")


def _still(ends: Array, force: Array, attitudes: Array) -> slice:
    """The blocks without those at both ends in which the vehicle turned or was accelerated unlike in the rest.

    Yaw shows a turn that has hardly begun: drift is a thousand times slower.
    """
    yaw = np.unwrap(np.arctan2(attitudes[:, 1, 0], attitudes[:, 0, 0]))
    series = np.column_stack([np.gradient(yaw, ends), force])
    deviation = np.abs(series - np.median(series, axis=0))
    strange = np.flatnonzero((deviation > _OUTLIER * np.median(deviation, axis=0)).any(axis=1))
    early, late = strange[ends[strange] < _ENDS], strange[ends[strange] > ends[-1] - _ENDS]
    first = int(early[-1]) + 1 if len(early) else 0
    return slice(first, max(first, int(late[0])) if len(late) else len(ends))


def _bend(rate: Array, earth: Array, time: Array) -> Array:
    """What the tilt of S, drifting at ``rate``, adds to ``rate`` times time, shape (n, 3), rad.

    S drifts by ``d theta/dt = rate - earth x theta``: over minutes its axes turn with the Earth, and the drift of the
    azimuth turns the horizontal part of the Earth's rate. Two terms of the series: the third is 1e-4 of the first.
    """
    once = np.cross(earth, rate)
    twice = np.cross(earth, once)
    bend: Array = -0.5 * np.outer(time**2, once) + np.outer(time**3, twice) / 6.0
    return bend


def _attitudes(rot_b0s: Array, earth: Array, time: Array, q_b0b: Array) -> Array:
    """Body to S at the times given, shape (n, 3, 3); S turns with the Earth."""
    turn = Rotation.from_rotvec(-np.outer(time, earth))
    attitudes: Array = (turn * Rotation.from_matrix(rot_b0s.T) * Rotation.from_quat(q_b0b)).as_matrix()
    return attitudes


def _trend(time: Array, series: Array) -> Array:
    """Level and slope by least squares, shape (2, d)."""
    return np.asarray(np.linalg.lstsq(trend_basis(time), series, rcond=None)[0], float)
