"""Coarse alignment on the cone of gravity: level and heading without initial angles, standing or rocking.

Specific force is averaged over short blocks in inertial space (`gravity_cone`). On the axes of the solution
the blocks' deviations from the cone are two series, east and north, each a constant (level), a slope (north: heading;
east: a rate that is not the Earth's) and noise, identified from the data (`noise_model`): white noise of the
accelerometers, random walk of attitude from the gyros, jolts of velocity, waves and swell.

References
----------
.. [1] Vavilova, Golovan, Kozlov, Papusha, fine alignment of an AUV's INS on a rocking base: reference [10] there.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.alignment.axes_check import axes_fault
from ins_nav.alignment.gravity_cone import Blocks, GravityCone, cone_path
from ins_nav.alignment.noise_model import TrendFit, TrendNoise, trend_basis
from ins_nav.errors import InsNavError
from ins_nav.estimation.state_layout import ATTITUDE, BIASES, SENSED, SOLUTION_SIZE
from ins_nav.mechanization.attitude import Quaternion
from ins_nav.mechanization.earth import RATE, normal_gravity
from ins_nav.mechanization.strapdown import Sample

_MIN_BLOCKS = 12
_GRAVITY_TOLERANCE = 0.5
"""m/s²: 50 mg, beyond any accelerometer's bias."""
_DEGREES = (
    "angular velocity agrees with the turning of gravity only as degrees per second: publish angular_velocity in rad/s"
)
_TURNED, _SETTLED = 0.01, 1e-4
"""rad: limits of a correction of the axes: above the first the noise is identified again, below the second the
iteration ends (tilt counts ten times)."""
_REST_SPEED = 0.01
"""m/s: below this RMS the base stands, and velocity is zero rather than estimated. No sigma is smaller."""


class AlignmentError(InsNavError):
    """Alignment is impossible with this data; the text names the reason and the remedy."""


class MovedError(AlignmentError):
    """The base moved off: data from before are unusable."""


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
        Of its worst axis, m/s.
    gravity_ratio : float
        Measured specific force over normal gravity.
    rate_error : float
        Estimated horizontal rate less that of the Earth at this latitude, rad/s: the north gyro's bias.
    gyro_noise, accel_noise : float
        White noise of an axis, rad/√s and m/s/√s.
    heading_noise : float
        Sigma of heading without the contribution of the gyros' biases, rad.
    by_bias : ndarray, shape (3, 6)
        Jacobian of the attitude error by errors of these biases.
    joint : ndarray, shape (9, 9)
        Covariance of attitude and of the biases of gyros and accelerometers (computed less true, body axes; rad/s and
        m/s²) together: errors of level contain the accelerometers' biases, that of heading the east gyro's. A filter
        that starts from this result needs the correlations.
    """

    q_gb: Quaternion
    covariance: NDArray[np.float64]
    velocity_g: tuple[float, float, float]
    velocity_stddev: float
    gravity_ratio: float
    rate_error: float
    gyro_noise: float
    accel_noise: float
    heading_noise: float
    by_bias: NDArray[np.float64]
    joint: NDArray[np.float64]

    @property
    def heading_stddev(self) -> float:
        """rad."""
        return math.sqrt(self.covariance[2, 2])


class CoarseAlignment:
    """Accumulates IMU samples and solves for attitude.

    Parameters
    ----------
    duration : float
        Intended length, s; sets the length of the blocks.
    gyro_bias_stddev, accel_bias_stddev : float
        Sigmas of a constant bias, rad/s and m/s². Biases are unobservable here: the east gyro's is an error of
        heading, the accelerometers' of level. Added to the covariance.
    max_speed : float
        A base whose velocity, less what rocking explains, goes beyond this has moved off, m/s.

    Attributes
    ----------
    cone : GravityCone
        The accumulated samples.
    """

    def __init__(
        self, duration: float, gyro_bias_stddev: float = 0.0, accel_bias_stddev: float = 0.0, max_speed: float = 2.0
    ) -> None:
        self.cone = GravityCone(duration)
        self._gyro_bias_stddev = gyro_bias_stddev
        self._accel_bias_stddev = accel_bias_stddev
        self._max_speed = max_speed

    @property
    def time(self) -> float:
        """Length of the accumulated data, s."""
        return self.cone.time

    def add(self, previous: Sample, sample: Sample, instantaneous: bool) -> None:
        """Add one sample; ``previous`` is the one before, as in `ins_nav.mechanization.strapdown.step`.

        Raises
        ------
        MovedError
            When the base moves off.
        AlignmentError
            When specific force is not that of an IMU at rest in m/s².
        """
        if self.cone.add(previous, sample, instantaneous):
            self._check(self.cone.blocks())

    @property
    def run_left(self) -> float:
        """Time in which the data is neither checked nor complete, s."""
        return min(self.cone.block_left, self.cone.duration - self.cone.time)

    def add_run(self, previous: Sample, samples: NDArray[np.float64], instantaneous: bool) -> None:
        """Add samples, shape (n, 7), within `run_left`, as `add` would one after the other; compiled."""
        self.cone.add_block(previous, samples, instantaneous)

    def _check(self, blocks: Blocks) -> None:
        """Raise unless this is an IMU at rest or rocking."""
        size = float(np.linalg.norm(blocks.force[-1]))
        if len(blocks.time) == 1 and abs(size - 1.0) < 0.2:
            raise AlignmentError(
                f"specific force is {size:.2f} at rest, so it is in g: publish linear_acceleration in m/s² (x 9.80665)"
            )
        if len(blocks.time) < _MIN_BLOCKS:
            return
        speed = blocks.apparent_speed()
        if speed > self._max_speed:
            if self._gyro_in_degrees(speed):
                raise AlignmentError(_DEGREES)
            raise MovedError(
                f"the base moved off after {self.cone.time:.1f} s (speed {speed:.1f} m/s, limit "
                f"alignment.max_speed {self._max_speed:g}): stand still, or rock without travelling"
            )

    def _check_turning(self, gravity: float, normal: float) -> None:
        """Raise when specific force has the right magnitude but its direction does not follow the gyros."""
        size = self.cone.mean_size()
        if abs(size - normal) > _GRAVITY_TOLERANCE or size - gravity < _GRAVITY_TOLERANCE:
            return
        if self._gyro_in_degrees(self.cone.blocks().apparent_speed()):
            raise AlignmentError(_DEGREES)
        raise AlignmentError(
            "angular velocity does not turn with the direction of specific force: "
            "check the unit and the axes (x forward, y left, z up) of both"
        )

    def _gyro_in_degrees(self, speed: float) -> bool:
        """Whether the same data is far more consistent with the gyros' output read as degrees per second."""
        if not self.cone.complete:
            return False  # the data was consistent in radians for long enough
        return self.cone.in_degrees().apparent_speed() < 0.1 * speed

    def solve(self, lat: float, height: float, heading: float | None = None, heading_stddev: float = 0.0) -> Alignment:
        """Attitude at the last sample.

        Parameters
        ----------
        lat, height : float
            Geodetic latitude, rad, and ellipsoidal height, m.
        heading, heading_stddev : float, optional
            Known heading and its sigma, rad: only level is estimated then.

        Raises
        ------
        AlignmentError
            Too little data, a latitude too near the pole, implausible specific force or rates.
        """
        if len(self.cone) < _MIN_BLOCKS:
            raise AlignmentError(
                f"{self.cone.time:.2f} s with {len(self.cone)} samples or blocks of them, {_MIN_BLOCKS} are needed: "
                "align for longer"
            )
        blocks = self.cone.blocks()
        self._check(blocks)
        mean_cone = cone_path(lat, blocks.time).mean(axis=0)  # the mean of unit vectors is shorter than 1
        gravity = float(np.linalg.norm(blocks.force.mean(axis=0)) / np.linalg.norm(mean_cone))
        normal = normal_gravity(math.sin(lat), height)
        if abs(gravity - normal) > _GRAVITY_TOLERANCE:
            self._check_turning(gravity, normal)
            raise AlignmentError(
                f"mean specific force is {gravity:.3f} m/s², gravity here {normal:.3f}: check the unit of "
                "linear_acceleration, and that gravity is not removed from it"
            )
        fault = axes_fault(blocks, lat, self._gyro_bias_stddev)
        if fault:
            raise AlignmentError(fault)
        horizontal_rate = RATE * math.cos(lat)
        if heading is None and horizontal_rate < 0.01 * RATE:
            raise AlignmentError(
                f"latitude {math.degrees(lat):.3f}° is too near the pole to find north: give initial.heading_deg"
            )

        rot_b0g0 = _first_guess(blocks)
        limits = self.cone.noise_limits(gravity)
        deviation = _deviation(blocks, rot_b0g0, gravity, lat)
        noise = TrendNoise.of(blocks.time, blocks.total, deviation[:, :2], limits)
        for _ in range(4):
            fit = noise.fit(deviation[:, :2])
            turn = math.atan2(fit.slope[1], horizontal_rate + fit.slope[0]) if heading is None else 0.0
            rot_b0g0 = rot_b0g0 @ Rotation.from_rotvec([-fit.level[1], fit.level[0], turn]).as_matrix()
            deviation = _deviation(blocks, rot_b0g0, gravity, lat)
            change = max(abs(turn), 10.0 * np.abs(fit.level).max())
            if change > _TURNED:
                noise = TrendNoise.of(blocks.time, blocks.total, deviation[:, :2], limits, noise)
            elif change < _SETTLED:
                break
        fit = noise.fit(deviation[:, :2])
        found_rate = float(horizontal_rate + fit.slope[0])
        # Noise as large as the rate makes the estimated rate too large: the heading's sigma falls with the geometric
        # mean of it and the true one (the concentration of a direction under noise, von Mises')
        rate = math.sqrt(horizontal_rate * abs(found_rate)) if heading is None else math.inf

        # Attitude at the last sample: the vertical of the end, not that of the fit's start
        rot_g0b = (Rotation.from_quat(self.cone.q_b0b).inv() * Rotation.from_matrix(rot_b0g0)).inv()
        tilt = Rotation.from_rotvec([-fit.end[1], fit.end[0], 0.0]).inv()
        axis = np.array([0.0, math.cos(lat), math.sin(lat)])
        rot_gb = Rotation.from_rotvec(-RATE * self.cone.time * axis) * tilt * rot_g0b

        covariance = self._covariance(fit, gravity, lat, rate)
        turn = excess = 0.0
        if heading is None:
            self._check_rate(fit, found_rate, horizontal_rate, lat, covariance)
        else:
            forward = rot_gb.as_matrix()[:, 0]
            turn = math.atan2(forward[0], forward[1]) - heading
            excess = self._excess(fit, horizontal_rate)
            covariance[:2, :2] += np.eye(2) * excess**2
            covariance[2, 2] = heading_stddev**2
            rot_gb = Rotation.from_rotvec([0.0, 0.0, turn]) * rot_gb
        # by the Earth's rate, not the found one: the equation of residual rates at rest has the same Jacobian, and the
        # difference of the two would be information on heading that the data does not have
        by_bias = self._by_bias(rot_gb, gravity, lat, horizontal_rate if heading is None else math.inf)
        white, walk = noise.sensor_noise(deviation[:, :2], limits)
        velocity, velocity_stddev = self._end_velocity(blocks, noise, deviation, fit, gravity, lat, rot_b0g0, limits)
        yaw = turn - RATE * math.sin(lat) * self.cone.time  # since time 0, and to the given heading
        east, north, up = Rotation.from_rotvec([0.0, 0.0, yaw]).apply(velocity)
        turned = math.sqrt(covariance[2, 2]) * math.hypot(*velocity[:2])
        mistaken = 0.5 * self.cone.time * gravity * excess  # an acceleration mistaken for tilt
        velocity_stddev = math.hypot(velocity_stddev, turned, mistaken)
        q = rot_gb.as_quat()
        return Alignment(
            (float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            covariance,
            (float(east), float(north), float(up)),
            velocity_stddev,
            gravity / normal,
            found_rate - horizontal_rate,
            math.sqrt(float(walk)),
            gravity * math.sqrt(float(white) * blocks.length),
            math.sqrt(fit.slope_variance) / rate if heading is None else heading_stddev,
            by_bias,
            self._joint(covariance, by_bias, gravity, lat, rate),
        )

    def _by_bias(self, rot_gb: Rotation, gravity: float, lat: float, rate: float) -> NDArray[np.float64]:
        """Jacobian of the attitude error by errors of the biases, shape (3, 6)."""
        turns = Rotation.from_quat(self.cone.q_b0b).inv() * Rotation.from_quat(self.cone.blocks().q_b0b)
        east, north, _ = rot_gb.as_matrix() @ turns.as_matrix().mean(axis=0)  # of the body, on average
        by_bias = np.zeros((3, 6))
        by_bias[0, 3:], by_bias[1, 3:] = -north / gravity, east / gravity
        by_bias[2] = np.concatenate([-east, RATE * math.sin(lat) / gravity * east]) / rate
        return by_bias

    def _joint(
        self, attitude: NDArray[np.float64], by_bias: NDArray[np.float64], gravity: float, lat: float, rate: float
    ) -> NDArray[np.float64]:
        """Covariance of attitude and biases together, shape (9, 9)."""
        biases = np.diag([self._gyro_bias_stddev**2] * 3 + [self._accel_bias_stddev**2] * 3)
        tilt, up = self._accel_bias_stddev / gravity, RATE * math.sin(lat)
        counted = np.diag([tilt**2, tilt**2, (self._gyro_bias_stddev**2 + (up * tilt) ** 2) / rate**2])
        joint = np.zeros((SOLUTION_SIZE, SOLUTION_SIZE))
        joint[ATTITUDE, ATTITUDE] = attitude - counted + by_bias @ biases @ by_bias.T
        joint[ATTITUDE, BIASES] = by_bias @ biases
        joint[BIASES, ATTITUDE] = joint[ATTITUDE, BIASES].T
        joint[BIASES, BIASES] = biases
        return joint[SENSED, SENSED]

    def _covariance(self, fit: TrendFit, gravity: float, lat: float, rate: float) -> NDArray[np.float64]:
        tilt = self._accel_bias_stddev / gravity
        level = fit.end_variance + tilt**2
        # a tilt east by the accelerometer's bias turns with the Earth about the vertical: a false rate north
        up = (fit.slope_variance + self._gyro_bias_stddev**2 + (RATE * math.sin(lat) * tilt) ** 2) / rate**2
        up += (self._gyro_bias_stddev / rate) ** 4  # second order: the product of the errors of rate and azimuth
        cross = -fit.end_slope_covariance / rate  # north deviation is minus the turn about east
        return np.array([[level, 0.0, cross], [0.0, level, 0.0], [cross, 0.0, up]])

    def _excess(self, fit: TrendFit, horizontal_rate: float) -> float:
        """Error of the level, rad, implied by a rotation of gravity that is neither the Earth's nor the gyros'.

        A slow surge in a short alignment causes it, and is indistinguishable from a level that drifts.
        """
        stddev = math.sqrt(fit.slope_variance + self._gyro_bias_stddev**2)
        error = float(np.hypot(*fit.slope)) - 2.0 * horizontal_rate  # the axes' azimuth is not that of the cone here
        return 0.5 * self.cone.time * error if error > 3.0 * stddev else 0.0

    def _check_rate(
        self, fit: TrendFit, found: float, expected: float, lat: float, covariance: NDArray[np.float64]
    ) -> None:
        """Refuse heading, or increase its sigma, when the rate of gravity's rotation is not the Earth's."""
        degrees_per_hour = math.degrees(found) * 3600.0
        text = (
            f"gravity turns at {degrees_per_hour:.2f} °/h, the Earth at latitude {math.degrees(lat):.2f}° "
            f"at {math.degrees(expected) * 3600.0:.2f} °/h"
        )
        stddev = math.sqrt(fit.slope_variance + self._gyro_bias_stddev**2)
        error = abs(found - expected)
        if found < 0.1 * expected and error > 3.0 * stddev:
            raise AlignmentError(
                f"{text}: the gyros do not measure the Earth's rate (a simulated IMU, a dead zone?): "
                "give initial.heading_deg"
            )
        if error > 3.0 * stddev:  # a bias beyond the parameters: the east gyro's is probably as large
            covariance[2, 2] += (error / found) ** 2
        if covariance[2, 2] > math.radians(30.0) ** 2:
            raise AlignmentError(
                f"{text}: heading would be uncertain by {math.degrees(math.sqrt(covariance[2, 2])):.0f}°; "
                "align for longer, use better gyros, or give initial.heading_deg"
            )

    def _end_velocity(
        self,
        blocks: Blocks,
        noise: TrendNoise,
        deviation: NDArray[np.float64],
        fit: TrendFit,
        gravity: float,
        lat: float,
        rot_b0g0: NDArray[np.float64],
        limits: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], float]:
        """Velocity at the end of a base that surges and heaves without travelling: east and north at time 0, up.

        Also its standard deviation, without the azimuth's part.
        """
        unit = gravity * blocks.length
        horizontal, variance = noise.velocity(deviation[:, :2], fit)
        heave = deviation[:, 2:]
        seeming = np.cumsum(heave - heave.mean(), axis=0)
        if unit * math.sqrt((horizontal**2).sum(axis=1).mean() + (seeming**2).mean()) < _REST_SPEED:
            return np.zeros(3), _REST_SPEED
        heave_noise = TrendNoise.of(blocks.time, blocks.total, heave, limits)
        vertical, heave_variance = heave_noise.velocity(heave, heave_noise.fit(heave))
        rest = self.cone.rest_time
        vertical_now = cone_path(lat, np.array([self.cone.time - 0.5 * rest]))[0] + [*fit.end, 0.0]
        last = unit * np.concatenate([horizontal[-1], vertical[-1]])
        last += np.array(self.cone.rest) @ rot_b0g0 - gravity * rest * vertical_now
        stddev = math.hypot(unit * math.sqrt(max(variance, heave_variance)), _REST_SPEED)
        return last, stddev


def _first_guess(blocks: Blocks) -> NDArray[np.float64]:
    """``rot_b0g0``: columns east, north, up at time 0 on b0; east is the direction of change of specific force."""
    start, slope = np.linalg.lstsq(trend_basis(blocks.time), blocks.force, rcond=None)[0]
    up = start / np.linalg.norm(start)
    east = slope - up * (up @ slope)
    if np.linalg.norm(east) < 1e-12:  # noiseless and at the pole
        east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    return np.column_stack([east, np.cross(up, east), up])


def _deviation(blocks: Blocks, rot_b0g0: NDArray[np.float64], gravity: float, lat: float) -> NDArray[np.float64]:
    """Specific force over gravity less the vertical of its time: east, north at time 0, and along the vertical.

    Heave acts along the vertical, which describes the cone: it must not appear as an east acceleration that grows.
    """
    force = blocks.force @ rot_b0g0 / gravity
    vertical = cone_path(lat, blocks.time)
    along = (force * vertical).sum(axis=1, keepdims=True)
    return np.column_stack([(force - along * vertical)[:, :2], along - 1.0])
