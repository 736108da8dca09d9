"""Coarse alignment on gravity's cone: level and heading with no initial angle, standing or rocking.

The gyros carry the body's first attitude b0 through all its motion, so b0 stands still in inertial space. There
the specific force of a base at rest on the Earth is gravity's reaction, going round a cone once a day. Its
direction is the vertical; the way it moves is east ("cone alignment" of the alignment paper, reference [10]
there). Rocking averages out, gravity does not.

Specific force is averaged over short blocks. On the axes of the solution the blocks' deviations from the cone
are two series, east and north, each a constant (level), a slope (north: heading; east: a rate that is not the
Earth's) and noise. The noise is a sum of four processes, whose intensities are found by restricted maximum
likelihood, so that weights and covariance are those of the data at hand:

- white noise of the accelerometers,
- random walk of attitude from the gyros' white noise,
- jolts: acceleration of a velocity that is white and bursts (people moving, doors, a base that shakes),
- waves: acceleration of a position that is white (surge and sway, which go nowhere).

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base.
.. [2] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal",
       Biometrika, 1971, vol. 58 (restricted maximum likelihood).
.. [3] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t distribution",
       Journal of the American Statistical Association, 1989, vol. 84.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize
from scipy.spatial.transform import Rotation

from ins_nav.attitude import Quaternion, from_rotation_vector, multiply, normalized, rotate
from ins_nav.earth import RATE, normal_gravity
from ins_nav.errors import InsNavError
from ins_nav.strapdown import Sample, compensated_increments

_BLOCKS = 120
"""Blocks in an alignment: enough to tell the noise processes apart, few enough for dense algebra in 0.1 s."""
_MIN_BLOCKS = 12
_MAX_SAMPLES = 100_000
"""Samples kept to judge noise and units by: four minutes at 400 Hz, 40 MB."""
_GRAVITY_TOLERANCE = 0.5
"""m/s²: 50 mg, beyond any accelerometer's bias."""
_STUDENT_FREEDOM = 3.0
"""Degrees of freedom of the jolts' distribution: finite variance, heavy tails."""
_EXPECTATION_ROUNDS = 4
_STARTS = (np.array([0.5, 0.01, 0.29, 0.2]), np.array([1e-3, 1e-3, 1e-3, 0.997]))
"""Shares of the variance from which the likelihood is climbed: a base at rest, a base on waves."""
_SETTLED = 0.5
"""Largest change of the logarithm of a jolt's scale that needs no further round."""
_CONTRADICTION = 5.0
"""Log-likelihood: the data contradicts a value that costs more (99 % by Wilks' theorem)."""
_ACCEL_EXCESS = math.log(10.0)
"""Accelerometers' noise over whole blocks may exceed what their white noise makes (1/f): logarithm, in variance."""
_LOG_RANGE_WHITE, _LOG_RANGE = 14.0, 25.0
"""How far below the whole variance an intensity is sought."""
_STRAIGHT_TIME = 600.0
"""s: gravity's path bends away from its tangent later; the bend is 0.1 m/s of seeming velocity here."""
_DEGREES_TOLERANCE = 0.2
"""Rates are in degrees per second when that makes them the Earth's to this share: 3 °/h, any bias of good gyros."""
_DEGREES = (
    "angular velocity agrees with the turning of gravity only as degrees per second: publish angular_velocity in rad/s"
)
_REST_SPEED = 0.05
"""m/s: below this RMS the base stands, and velocity is zero rather than estimated."""


class AlignmentError(InsNavError):
    """Alignment cannot be done with this data; the text says why and what to do."""


class MovedError(AlignmentError):
    """The base did not stay: the data so far is of no use."""


@dataclass(frozen=True)
class Alignment:
    """Result of an alignment, at the stamp of its last sample.

    Attributes
    ----------
    q_gb : Quaternion
        Body to east-north-up.
    covariance : ndarray, shape (3, 3)
        Of the attitude error as a rotation vector on east, north, up, rad².
    velocity_g : 3 floats
        East, north, up, m/s: zero for a base at rest, else that of its surge and heave.
    velocity_stddev : float
        m/s.
    gravity_ratio : float
        Measured specific force over normal gravity.
    rate_error : float
        Horizontal rate found less that of the Earth at this latitude, rad/s: the north gyro's bias when all is well.
    """

    q_gb: Quaternion
    covariance: NDArray[np.float64]
    velocity_g: tuple[float, float, float]
    velocity_stddev: float
    gravity_ratio: float
    rate_error: float

    @property
    def heading_stddev(self) -> float:
        """rad."""
        return math.sqrt(self.covariance[2, 2])


@dataclass(frozen=True)
class _Blocks:
    """Block means: time of the middles (n,), s; specific force on b0 (n, 3), m/s²; block length, total, s."""

    time: NDArray[np.float64]
    force: NDArray[np.float64]
    length: float
    total: float


class CoarseAlignment:
    """Gathers IMU samples and solves for attitude.

    Parameters
    ----------
    duration : float
        Intended length, s; sets the length of the blocks.
    gyro_bias_stddev, accel_bias_stddev : float
        What a constant bias may be, rad/s and m/s². It cannot be seen here: the east gyro's goes straight into
        heading, the accelerometers' into level. Added to the covariance.
    max_speed : float
        A base whose velocity, less what rocking explains, goes beyond this has moved off, m/s.
    """

    def __init__(
        self, duration: float, gyro_bias_stddev: float = 0.0, accel_bias_stddev: float = 0.0, max_speed: float = 2.0
    ) -> None:
        self._duration = duration
        self._block_length = duration / _BLOCKS
        self._gyro_bias_stddev = gyro_bias_stddev
        self._accel_bias_stddev = accel_bias_stddev
        self._max_speed = max_speed
        self._samples: list[tuple[Sample, Sample, bool]] = []
        self._reset_integration()

    def _reset_integration(self) -> None:
        self._q: Quaternion = (0.0, 0.0, 0.0, 1.0)  # body to b0
        self._time = 0.0
        self._block_start = 0.0
        self._velocity = [0.0, 0.0, 0.0]
        self._blocks: list[tuple[float, float, float, float, float]] = []

    @property
    def time(self) -> float:
        """Length of the data gathered, s."""
        return self._time

    def add(self, previous: Sample, sample: Sample, instantaneous: bool) -> None:
        """Take one sample; ``previous`` is the one before, as in `ins_nav.strapdown.step`.

        Raises
        ------
        MovedError
            When the base moves off.
        AlignmentError
            When specific force is not that of an IMU at rest in m/s².
        """
        if self._time < self._duration and len(self._samples) < _MAX_SAMPLES:
            self._samples.append((previous, sample, instantaneous))
        if self._integrate(previous, sample, instantaneous, 1.0):
            self._check(self._gathered())

    def _integrate(self, previous: Sample, sample: Sample, instantaneous: bool, gyro_unit: float) -> bool:
        """Carry attitude and velocity on b0; True when a block was completed."""
        h0, ax, ay, az, bx, by, bz = previous
        h, wx, wy, wz, fx, fy, fz = sample
        change = 1.0 if instantaneous else 2.0 * h / (h0 + h)
        back = 0.5 if instantaneous else 0.0  # from the value at the end to the mean
        u = gyro_unit
        dw = (u * (wx - ax), u * (wy - ay), u * (wz - az))
        df = (fx - bx, fy - by, fz - bz)
        rx, ry, rz, ux, uy, uz = compensated_increments(
            h,
            u * wx - back * dw[0],
            u * wy - back * dw[1],
            u * wz - back * dw[2],
            fx - back * df[0],
            fy - back * df[1],
            fz - back * df[2],
            *(change * x for x in dw),
            *(change * x for x in df),
        )
        ux, uy, uz = rotate(self._q, ux, uy, uz)
        v = self._velocity
        v[0] += ux
        v[1] += uy
        v[2] += uz
        self._q = normalized(multiply(self._q, from_rotation_vector(rx, ry, rz)))
        self._time += h
        length = self._time - self._block_start
        if length < self._block_length * (1.0 - 1e-6):
            return False
        self._blocks.append((self._block_start + 0.5 * length, length, v[0] / length, v[1] / length, v[2] / length))
        self._block_start = self._time
        self._velocity = [0.0, 0.0, 0.0]
        if len(self._blocks) == 2 * _BLOCKS:
            self._join_blocks()
        return True

    def _join_blocks(self) -> None:
        """Halve the number of blocks: an alignment that waits for a position keeps its memory and its time."""
        pairs = np.array(self._blocks).reshape(_BLOCKS, 2, 5)
        length = pairs[:, :, 1].sum(axis=1)
        joined = (pairs * pairs[:, :, 1:2]).sum(axis=1) / length[:, None]
        joined[:, 1] = length
        self._blocks = [(t, h, x, y, z) for t, h, x, y, z in joined.tolist()]
        self._block_length *= 2.0

    def _gathered(self) -> _Blocks:
        blocks = np.array(self._blocks)
        return _Blocks(blocks[:, 0], blocks[:, 2:], float(blocks[:, 1].mean()), self._time)

    def _check(self, blocks: _Blocks) -> None:
        """Raise when this is not an IMU at rest or rocking."""
        size = float(np.linalg.norm(blocks.force[-1]))
        if len(blocks.time) == 1 and abs(size - 1.0) < 0.2:
            raise AlignmentError(
                f"specific force is {size:.2f} at rest, so it is in g: publish linear_acceleration in m/s² (x 9.80665)"
            )
        if len(blocks.time) < _MIN_BLOCKS:
            return
        speed = _seeming_speed(blocks)
        if speed > self._max_speed:
            if self._gyro_in_degrees(speed):
                raise AlignmentError(_DEGREES)
            raise MovedError(
                f"the base moved off after {self._time:.1f} s (speed {speed:.1f} m/s, limit "
                f"alignment.max_speed {self._max_speed:g}): stand still, or rock without travelling"
            )

    def _check_turning(self, gravity: float, normal: float) -> None:
        """Raise when specific force has the right size, but the gyros do not carry its direction."""
        size = float(np.mean([math.hypot(*sample[4:7]) for _, sample, _ in self._samples]))
        if abs(size - normal) > _GRAVITY_TOLERANCE or size - gravity < _GRAVITY_TOLERANCE:
            return
        if self._gyro_in_degrees(_seeming_speed(self._gathered())):
            raise AlignmentError(_DEGREES)
        raise AlignmentError(
            "angular velocity does not turn with the direction of specific force: "
            "check the unit and the axes (x forward, y left, z up) of both"
        )

    def _gyro_in_degrees(self, speed: float) -> bool:
        """Whether the same data makes far better sense with the gyros' output taken as degrees per second."""
        if self._time > 1.01 * self._duration or len(self._samples) == _MAX_SAMPLES:
            return False  # it agreed long enough with radians
        trial = CoarseAlignment(self._duration)
        for sample in self._samples:
            trial._integrate(*sample, math.radians(1.0))
        return _seeming_speed(trial._gathered()) < 0.1 * speed

    def solve(self, lat: float, height: float, heading: float | None = None) -> Alignment:
        """Attitude at the last sample.

        Parameters
        ----------
        lat, height : float
            Geodetic latitude, rad, and ellipsoidal height, m.
        heading : float, optional
            Known heading, rad: only the level is found then.

        Raises
        ------
        AlignmentError
            Too little data, a latitude too near the pole, specific force or rates that are not an IMU's.
        """
        if len(self._blocks) < _MIN_BLOCKS:
            raise AlignmentError(
                f"{self._time:.2f} s with {len(self._blocks)} samples or blocks of them, {_MIN_BLOCKS} are needed: "
                "align for longer"
            )
        blocks = self._gathered()
        self._check(blocks)
        mean_cone = _cone(lat, blocks.time).mean(axis=0)  # the mean of directions is shorter than they are
        gravity = float(np.linalg.norm(blocks.force.mean(axis=0)) / np.linalg.norm(mean_cone))
        normal = normal_gravity(math.sin(lat), height)
        if abs(gravity - normal) > _GRAVITY_TOLERANCE:
            self._check_turning(gravity, normal)
            raise AlignmentError(
                f"mean specific force is {gravity:.3f} m/s², gravity here {normal:.3f}: check the unit of "
                "linear_acceleration, and that gravity has not been taken out of it"
            )
        horizontal_rate = RATE * math.cos(lat)
        if heading is None and horizontal_rate < 0.01 * RATE:
            raise AlignmentError(
                f"latitude {math.degrees(lat):.3f}° is too near the pole to find north: give initial.heading_deg"
            )

        rot_b0g0 = _first_guess(blocks)
        limits = self._noise_limits(gravity, blocks.length)
        noise = None
        for _ in range(4):
            series = (blocks.force @ rot_b0g0 / gravity - _cone(lat, blocks.time))[:, :2]
            if noise is None:
                noise = _Noise.of(blocks, series, limits)
            fit = noise.fit(series)
            turn = math.atan2(fit.slope[1], horizontal_rate + fit.slope[0]) if heading is None else 0.0
            rot_b0g0 = rot_b0g0 @ Rotation.from_rotvec([-fit.level[1], fit.level[0], turn]).as_matrix()
            if abs(turn) > 0.01 or np.abs(fit.level).max() > 1e-3:
                noise = None  # the axes were still turning
        deviation = blocks.force @ rot_b0g0 / gravity - _cone(lat, blocks.time)
        noise = noise or _Noise.of(blocks, deviation[:, :2], limits)
        fit = noise.fit(deviation[:, :2])
        found_rate = float(horizontal_rate + fit.slope[0])

        # Attitude now: the vertical where it is at the end, not where the fit had it at the start
        rot_g0b = (Rotation.from_quat(self._q).inv() * Rotation.from_matrix(rot_b0g0)).inv()
        tilt = Rotation.from_rotvec([-fit.end[1], fit.end[0], 0.0]).inv()
        axis = np.array([0.0, math.cos(lat), math.sin(lat)])
        rot_gb = Rotation.from_rotvec(-RATE * self._time * axis) * tilt * rot_g0b

        covariance = self._covariance(fit, gravity, lat, found_rate if heading is None else math.inf)
        if heading is None:
            self._check_rate(fit, found_rate, horizontal_rate, lat, covariance)
        else:
            forward = rot_gb.as_matrix()[:, 0]
            turn = math.atan2(forward[0], forward[1]) - heading
            covariance[:2, :2] += np.eye(2) * self._excess(fit, horizontal_rate) ** 2
            rot_gb = Rotation.from_rotvec([0.0, 0.0, turn]) * rot_gb
        velocity, speed_stddev = self._end_velocity(blocks, noise, deviation, fit, gravity, lat, rot_b0g0)
        q = rot_gb.as_quat()
        return Alignment(
            (float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            covariance,
            velocity,
            speed_stddev,
            gravity / normal,
            found_rate - horizontal_rate,
        )

    def _noise_limits(self, gravity: float, block_length: float) -> NDArray[np.float64]:
        """Most that the sensors' own white noise can be: variance of a block mean, and of the walk in a second.

        Second differences of means over 1, 2, 4, ... samples show white noise with hardly any of the motion; motion
        and quantization only add, so the least of them is nearest.
        """
        samples = np.array([sample for _, sample, _ in self._samples])
        interval = float(np.median(samples[:, 0]))
        density, penalty = [], []
        size = 1
        while size == 1 or (size * interval <= 0.25 * block_length and len(samples) >= 24 * size):
            n = len(samples) // size
            means = samples[: n * size, 1:].reshape(n, size, 6).mean(axis=1)
            density.append((np.diff(means, 2, axis=0) ** 2).mean(axis=0) / 6.0 * size * interval)
            penalty.append(1.0 + 4.0 / math.sqrt(n))  # two sigmas of such a mean square: the least is not the luckiest
            size *= 2
        least = np.argmin(np.array(density) * np.array(penalty)[:, None], axis=0)
        gyro, accel = np.array(density)[least, np.arange(6)].reshape(2, 3).mean(axis=1)
        return np.array([accel / gravity**2 / block_length, gyro])

    def _covariance(self, fit: "_Fit", gravity: float, lat: float, rate: float) -> NDArray[np.float64]:
        tilt = self._accel_bias_stddev / gravity
        level = fit.end_variance + tilt**2
        # a tilt east by the accelerometer's bias turns with the Earth about the vertical: a false rate north
        up = (fit.slope_variance + self._gyro_bias_stddev**2 + (RATE * math.sin(lat) * tilt) ** 2) / rate**2
        cross = -fit.end_slope_covariance / rate  # north deviation is minus the turn about east
        return np.array([[level, 0.0, cross], [0.0, level, 0.0], [cross, 0.0, up]])

    def _excess(self, fit: "_Fit", horizontal_rate: float) -> float:
        """Error of the level, rad, that a turning of gravity betrays which is neither the Earth's nor the gyros'.

        A slow surge in a short alignment looks so: there is no telling it from a level that drifts.
        """
        stddev = math.sqrt(fit.slope_variance + self._gyro_bias_stddev**2)
        error = float(np.hypot(*fit.slope)) - 2.0 * horizontal_rate  # the axes' azimuth is not that of the cone here
        return 0.5 * self._time * error if error > 3.0 * stddev else 0.0

    def _check_rate(
        self, fit: "_Fit", found: float, expected: float, lat: float, covariance: NDArray[np.float64]
    ) -> None:
        """Refuse or widen heading when the rate of gravity's turning is not the Earth's."""
        degrees_per_hour = math.degrees(found) * 3600.0
        text = (
            f"gravity turns at {degrees_per_hour:.2f} °/h, the Earth at latitude {math.degrees(lat):.2f}° "
            f"at {math.degrees(expected) * 3600.0:.2f} °/h"
        )
        up_rate, expected_up = self._vertical_rate(), RATE * math.sin(lat)
        in_degrees = math.hypot(math.radians(found) - expected, math.radians(up_rate) - expected_up)
        if in_degrees < _DEGREES_TOLERANCE * RATE:
            raise AlignmentError(f"{text}: angular velocity is in degrees per second, publish it in rad/s")
        stddev = math.sqrt(fit.slope_variance + self._gyro_bias_stddev**2)
        error = abs(found - expected)
        if found < 0.1 * expected and error > 3.0 * stddev:
            raise AlignmentError(
                f"{text}: the gyros do not feel the Earth turn (a simulated IMU, a dead zone?): "
                "give initial.heading_deg"
            )
        if error > 3.0 * stddev:  # a bias the parameters do not know of: the east gyro's is likely as large
            covariance[2, 2] += (error / found) ** 2
        if covariance[2, 2] > math.radians(30.0) ** 2:
            raise AlignmentError(
                f"{text}: heading would be uncertain by {math.degrees(math.sqrt(covariance[2, 2])):.0f}°; "
                "align for longer, use better gyros, or give initial.heading_deg"
            )

    def _vertical_rate(self) -> float:
        """Mean turning about the vertical, rad/s."""
        h, wx, wy, wz, fx, fy, fz = np.array([sample for _, sample, _ in self._samples]).T
        up = np.array([h @ fx, h @ fy, h @ fz])
        return float(up @ [h @ wx, h @ wy, h @ wz] / (np.linalg.norm(up) * h.sum()))

    def _end_velocity(
        self,
        blocks: _Blocks,
        noise: "_Noise",
        deviation: NDArray[np.float64],
        fit: "_Fit",
        gravity: float,
        lat: float,
        rot_b0g0: NDArray[np.float64],
    ) -> tuple[tuple[float, float, float], float]:
        """Velocity at the end of a base that surges and heaves but goes nowhere: its mean over the time is zero."""
        residual = gravity * deviation
        residual[:, :2] -= gravity * noise.attitude_part(deviation[:, :2], fit)
        rest = self._time - self._block_start  # the block not yet complete
        vertical_now = _cone(lat, np.array([self._time - 0.5 * rest]))[0] + [*fit.end, 0.0]
        since = np.array(self._velocity) @ rot_b0g0 - gravity * rest * vertical_now
        velocity = np.cumsum(residual, axis=0) * blocks.length
        drift = np.vander(blocks.time / blocks.total, 3)  # what slow errors of the accelerometers leave
        velocity -= drift @ np.linalg.lstsq(drift, velocity, rcond=None)[0]
        rms = np.sqrt((velocity**2).mean(axis=0))
        moving = rms > _REST_SPEED
        last = np.where(moving, velocity[-1] + since, 0.0)
        stddev = float(np.where(moving, 0.5 * rms, 0.2 * _REST_SPEED).max())
        east, north, vertical = Rotation.from_rotvec([0.0, 0.0, -RATE * self._time]).apply(last)
        return (float(east), float(north), float(vertical)), stddev


def _trend(time: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.ones_like(time), time])


def _seeming_speed(blocks: _Blocks) -> float:
    """Largest velocity, m/s, of what the path of gravity does not explain."""
    basis = _trend(blocks.time)
    if blocks.total > _STRAIGHT_TIME:
        basis = np.column_stack([basis, 1.0 - np.cos(RATE * blocks.time)])
    fitted = basis @ np.linalg.lstsq(basis, blocks.force, rcond=None)[0]
    velocity = np.cumsum(blocks.force - fitted, axis=0) * blocks.length
    return float(np.abs(velocity - velocity.mean(axis=0)).max())


def _cone(lat: float, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vertical after ``time`` on the axes, fixed in inertial space, that were east, north, up at time 0."""
    s, c, angle = math.sin(lat), math.cos(lat), RATE * time
    return np.column_stack([c * np.sin(angle), c * s * (1.0 - np.cos(angle)), 1.0 - c * c * (1.0 - np.cos(angle))])


def _first_guess(blocks: _Blocks) -> NDArray[np.float64]:
    """``rot_b0g0``: columns east, north, up at time 0 on b0; east is where the specific force is going."""
    start, slope = np.linalg.lstsq(_trend(blocks.time), blocks.force, rcond=None)[0]
    up = start / np.linalg.norm(start)
    east = slope - up * (up @ slope)
    if np.linalg.norm(east) < 1e-12:  # noiseless and at the pole
        east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    return np.column_stack([east, np.cross(up, east), up])


@dataclass(frozen=True)
class _Fit:
    """Trend of the two series (east, north) and their attitude part at the end; variances are those of one axis."""

    level: NDArray[np.float64]
    slope: NDArray[np.float64]
    end: NDArray[np.float64]
    slope_variance: float
    end_variance: float
    end_slope_covariance: float


class _Noise:
    """Covariance of a series of block means: four processes with their intensities.

    Parameters
    ----------
    blocks : _Blocks
    intensity : ndarray, shape (4,)
        Of white noise, random walk, jolts and waves.
    jolt_variance : ndarray, shape (n + 1,)
        Of each jolt, at the borders of the blocks: its intensity, more where it was far larger than the rest.
    """

    def __init__(self, blocks: _Blocks, intensity: NDArray[np.float64], jolt_variance: NDArray[np.float64]) -> None:
        self._x = _trend(blocks.time)
        self._end = np.array([1.0, blocks.total])
        self._walk = intensity[1] * np.minimum.outer(blocks.time, blocks.time)
        self._walk_end = intensity[1] * blocks.time
        self._walk_total = intensity[1] * blocks.total
        kernels = _kernels(blocks, jolt_variance / intensity[2])
        covariance = sum(s * k for s, k in zip(intensity, kernels, strict=True))
        self._factor = linalg.cho_factor(covariance, lower=True)
        self._weighted = linalg.cho_solve(self._factor, self._x)
        self._trend_covariance = np.linalg.inv(self._x.T @ self._weighted)

    @classmethod
    def of(cls, blocks: _Blocks, series: NDArray[np.float64], limits: NDArray[np.float64]) -> "_Noise":
        """Intensities from the series, shape (n, 2), by restricted maximum likelihood ([2]_).

        ``limits``, shape (2,), is white noise and walk as the sensors' fast noise predicts them: their values unless
        the data contradicts that, since a short alignment hardly shows the walk; then, for the walk, its upper limit.

        Jolts come in bursts (a door, a person sitting down): they are given the heavy tails of Student's
        distribution, by expectation maximization over the scale of each ([3]_).
        """
        scale = np.ones(len(blocks.time) + 1)
        free = min(
            (_restricted_maximum_likelihood(blocks, series, scale, start, limits, ()) for start in _STARTS),
            key=lambda fit: fit[0],
        )
        for fixed in ((0, 1), (1,), ()):
            likelihood, intensity = (
                _restricted_maximum_likelihood(blocks, series, scale, free[1], limits, fixed) if fixed else free
            )
            if likelihood - free[0] < _CONTRADICTION:
                break
        for _ in range(_EXPECTATION_ROUNDS):
            energy = cls(blocks, intensity, intensity[2] * scale)._jolt_energy(series, intensity[2] * scale)
            before = scale
            scale = (_STUDENT_FREEDOM + energy / intensity[2]) / (_STUDENT_FREEDOM + 2.0)
            if np.abs(np.log(scale / before)).max() < _SETTLED:
                break
            _, intensity = _restricted_maximum_likelihood(blocks, series, scale, intensity, limits, fixed)
        return cls(blocks, intensity, intensity[2] * scale)

    def _jolt_energy(self, series: NDArray[np.float64], variance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected squared length of each jolt over its two axes, given the series, shape (n + 1,)."""
        gain = _differences(len(series)) * variance
        projected = linalg.cho_solve(self._factor, gain)
        projected -= self._weighted @ (self._trend_covariance @ (self._weighted.T @ gain))
        jolts = projected.T @ series
        return (jolts**2).sum(axis=1) + 2.0 * (variance - (gain * projected).sum(axis=0))

    def fit(self, series: NDArray[np.float64]) -> _Fit:
        """Generalized least squares for the trend; attitude at the end by kriging of the random walk."""
        level, slope = self._trend_covariance @ (self._weighted.T @ series)
        rest = linalg.cho_solve(self._factor, series - self._x @ np.array([level, slope]))
        gain = linalg.cho_solve(self._factor, self._walk_end)
        left = self._end - self._x.T @ gain
        return _Fit(
            level,
            slope,
            level + slope * self._end[1] + self._walk_end @ rest,
            float(self._trend_covariance[1, 1]),
            float(self._walk_total - self._walk_end @ gain + left @ self._trend_covariance @ left),
            float((left @ self._trend_covariance)[1]),
        )

    def attitude_part(self, series: NDArray[np.float64], fit: _Fit) -> NDArray[np.float64]:
        """What of the series is attitude (trend and random walk), shape (n, 2); the rest is acceleration."""
        trend = self._x @ np.array([fit.level, fit.slope])
        return trend + self._walk @ linalg.cho_solve(self._factor, series - trend)


def _differences(n: int) -> NDArray[np.float64]:
    """From values at the borders of n blocks to their changes over the blocks, shape (n, n + 1)."""
    return np.eye(n, n + 1, k=1) - np.eye(n, n + 1)


def _kernels(blocks: _Blocks, jolt_scale: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Covariances per unit intensity: white, random walk, jolts, waves; each shape (n, n)."""
    n = len(blocks.time)
    first = _differences(n)
    second = first @ _differences(n + 1)
    walk = np.minimum.outer(blocks.time, blocks.time)
    return [np.eye(n), walk, (first * jolt_scale) @ first.T, second @ second.T]


def _restricted_maximum_likelihood(
    blocks: _Blocks,
    series: NDArray[np.float64],
    jolt_scale: NDArray[np.float64],
    start: NDArray[np.float64],
    limits: NDArray[np.float64],
    fixed: tuple[int, ...],
) -> tuple[float, NDArray[np.float64]]:
    """Negative log-likelihood, and the intensities of the four processes that make it least.

    ``start`` is intensities, or shares of the variance where it has the sum 1; those that are ``fixed`` (0 white
    noise, 1 walk) stay at their limits.
    """
    kernels = _kernels(blocks, jolt_scale)
    x = _trend(blocks.time)
    base = np.linalg.qr(x)[0]
    residual = series - base @ (base.T @ series)
    variance = float((residual**2).mean()) + 1e-20  # a noiseless simulation
    if abs(start.sum() - 1.0) < 1e-9:
        start = start * variance / [np.diag(k).mean() for k in kernels]

    def negative_likelihood(log_intensity: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        intensity = np.exp(log_intensity)
        covariance = sum(s * k for s, k in zip(intensity, kernels, strict=True))
        factor, _ = linalg.lapack.dpotrf(covariance, lower=1)
        inverse, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        weighted = inverse @ x
        information = x.T @ weighted
        projection = inverse - weighted @ np.linalg.solve(information, weighted.T)
        py = projection @ residual
        log_det = 2.0 * np.log(np.diag(factor)).sum() + np.linalg.slogdet(information)[1]
        value = log_det + 0.5 * (residual * py).sum()
        gradient = [
            s * ((projection * k).sum() - 0.5 * (py * (k @ py)).sum()) for s, k in zip(intensity, kernels, strict=True)
        ]
        return float(value), np.array(gradient)

    # A floor keeps the matrix regular; a start near it, where the gradient vanishes, would stay there
    unit = np.log([variance / np.diag(k).mean() for k in kernels])
    low = unit - _LOG_RANGE
    high = unit + 4.0
    low[0] = unit[0] - _LOG_RANGE_WHITE
    limit = np.maximum(np.log(limits + 1e-300), low[:2])
    high[:2] = np.minimum(high[:2], limit + [_ACCEL_EXCESS, 0.0])
    for process in fixed:
        low[process] = high[process] = limit[process]
    best = optimize.minimize(
        negative_likelihood,
        np.clip(np.maximum(np.log(start), unit - 9.0), low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
    )
    return float(best.fun), np.exp(best.x)
