"""Errors of inertial sensors by their datasheet.

Every error source draws from a separate stream, named after it: switching one off, or changing its size, does not
change the draws of the others. All draws depend on the seed alone.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from ins_nav.aiding.simulated import stream
from ins_nav.simulation.motion import Array
from ins_nav.simulation.trajectory import Trajectory

Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]

STANDARD_GRAVITY = 9.80665
"""The g of datasheets, m/s²."""
_MICRO_G = STANDARD_GRAVITY * 1e-6
_ARCSEC = math.radians(1.0 / 3600.0)
_NONE3: Triple = (0.0, 0.0, 0.0)
_NONE6: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TriadErrors:
    """Errors of three gyros or three accelerometers; SI, the output's unit (rad/s or m/s²) is U.

    The output is ``(1 + scale + misalignment) true + bias + walk + noise``, then quantized. The standard
    deviations are those of constants drawn once a run and added to the given ones.
    """

    bias: Triple
    """U."""
    bias_stddev: float
    """U."""
    bias_random_walk: float
    """U/√s."""
    noise: float
    """White noise density, U √s (angle or velocity random walk)."""
    scale: Triple
    """Scale factor error."""
    scale_stddev: float
    misalignment: Six
    """Shares of true y and z in output x, of x and z in output y, of x and y in output z; rad."""
    misalignment_stddev: float
    """rad."""
    quantization: float
    """Step of the accumulated output, U s."""

    def noise_stddev(self, dt: float) -> float:
        """Standard deviation of the noise of one sample, U, at the sampling interval dt, s."""
        return self.noise / math.sqrt(dt)

    def measure(self, true: Array, dt: float, seed: int, name: str) -> tuple[Array, Triple]:
        """Output of the sensors.

        The accumulated sum of the increments is quantized, so that quantization errors do not accumulate.

        Parameters
        ----------
        true : ndarray, shape (n, 3)
            True values, U.
        dt : float
            Sampling interval, s.
        seed : int
            Not negative.
        name : str
            Of the sensor, names its streams.

        Returns
        -------
        measured : ndarray, shape (n, 3)
            U.
        bias : tuple of 3 floats
            Constant part of the bias, given and drawn, U.
        """
        bias = np.array(self.bias) + self.bias_stddev * stream(seed, name + ".bias").standard_normal(3)
        scale = np.array(self.scale) + self.scale_stddev * stream(seed, name + ".scale").standard_normal(3)
        off = np.array(self.misalignment)
        off += self.misalignment_stddev * stream(seed, name + ".misalignment").standard_normal(6)
        matrix = np.eye(3) + np.diag(scale)
        matrix[~np.eye(3, dtype=bool)] += off
        out = true @ matrix.T + bias
        if self.noise:
            out += self.noise_stddev(dt) * stream(seed, name + ".noise").standard_normal(true.shape)
        if self.bias_random_walk:
            steps = stream(seed, name + ".bias_random_walk").standard_normal(true.shape)
            out += np.cumsum(self.bias_random_walk * math.sqrt(dt) * steps, axis=0)
        if self.quantization:
            counts = np.rint(np.cumsum(out, axis=0) * (dt / self.quantization))
            out = np.diff(counts, axis=0, prepend=0.0) * (self.quantization / dt)
        x, y, z = bias.tolist()
        return out, (x, y, z)


class ImuReadings(NamedTuple):
    """Output of an inertial unit, n samples."""

    angular_velocity: Array
    """(n, 3), rad/s."""
    linear_acceleration: Array
    """(n, 3), specific force, m/s²."""
    gyro_bias: Triple
    """Constant part of the gyros' bias, the random part included, rad/s."""
    accel_bias: Triple
    """The same of the accelerometers, m/s²."""


@dataclass(frozen=True)
class ImuErrors:
    """Errors of an inertial unit in the units of datasheets; see `TriadErrors` for their meaning.

    Noise is given by its density: its size a sample follows from the rate.
    """

    gyro_bias_deg_per_hour: Triple = _NONE3
    gyro_bias_stddev_deg_per_hour: float = 0.0
    gyro_bias_random_walk_deg_per_hour_per_sqrt_hour: float = 0.0
    gyro_noise_deg_per_sqrt_hour: float = 0.0
    gyro_scale_ppm: Triple = _NONE3
    gyro_scale_stddev_ppm: float = 0.0
    gyro_misalignment_arcsec: Six = _NONE6
    gyro_misalignment_stddev_arcsec: float = 0.0
    gyro_quantization_arcsec: float = 0.0
    accel_bias_ug: Triple = _NONE3
    accel_bias_stddev_ug: float = 0.0
    accel_bias_random_walk_ug_per_sqrt_hour: float = 0.0
    accel_noise_ug_per_sqrt_hz: float = 0.0
    accel_scale_ppm: Triple = _NONE3
    accel_scale_stddev_ppm: float = 0.0
    accel_misalignment_arcsec: Six = _NONE6
    accel_misalignment_stddev_arcsec: float = 0.0
    accel_quantization_mm_per_s: float = 0.0

    @property
    def gyro(self) -> TriadErrors:
        """Of the gyros, rad/s."""
        deg_per_hour = math.radians(1.0) / 3600.0
        return TriadErrors(
            bias=_scaled3(self.gyro_bias_deg_per_hour, deg_per_hour),
            bias_stddev=self.gyro_bias_stddev_deg_per_hour * deg_per_hour,
            bias_random_walk=self.gyro_bias_random_walk_deg_per_hour_per_sqrt_hour * deg_per_hour / 60.0,
            noise=math.radians(self.gyro_noise_deg_per_sqrt_hour) / 60.0,
            scale=_scaled3(self.gyro_scale_ppm, 1e-6),
            scale_stddev=self.gyro_scale_stddev_ppm * 1e-6,
            misalignment=_scaled6(self.gyro_misalignment_arcsec, _ARCSEC),
            misalignment_stddev=self.gyro_misalignment_stddev_arcsec * _ARCSEC,
            quantization=self.gyro_quantization_arcsec * _ARCSEC,
        )

    @property
    def accel(self) -> TriadErrors:
        """Of the accelerometers, m/s²."""
        return TriadErrors(
            bias=_scaled3(self.accel_bias_ug, _MICRO_G),
            bias_stddev=self.accel_bias_stddev_ug * _MICRO_G,
            bias_random_walk=self.accel_bias_random_walk_ug_per_sqrt_hour * _MICRO_G / 60.0,
            noise=self.accel_noise_ug_per_sqrt_hz * _MICRO_G,
            scale=_scaled3(self.accel_scale_ppm, 1e-6),
            scale_stddev=self.accel_scale_stddev_ppm * 1e-6,
            misalignment=_scaled6(self.accel_misalignment_arcsec, _ARCSEC),
            misalignment_stddev=self.accel_misalignment_stddev_arcsec * _ARCSEC,
            quantization=self.accel_quantization_mm_per_s * 1e-3,
        )

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> "ImuErrors":
        """From the parameters ``imu.*`` of a simulation."""
        return cls(**{f.name: parameters[f"imu.{f.name}"] for f in fields(cls)})


PRESETS = {
    "perfect": ImuErrors(),
    # ring-laser gyros
    "navigation": ImuErrors(
        gyro_bias_stddev_deg_per_hour=0.01,
        gyro_noise_deg_per_sqrt_hour=0.002,
        gyro_scale_stddev_ppm=5.0,
        gyro_misalignment_stddev_arcsec=5.0,
        accel_bias_stddev_ug=50.0,
        accel_noise_ug_per_sqrt_hz=10.0,
        accel_scale_stddev_ppm=50.0,
        accel_misalignment_stddev_arcsec=5.0,
    ),
    # fibre-optic gyros of an underwater vehicle. Per sample at 400 Hz: 0.003 deg/s and 0.02 m/s²
    "fog_auv": ImuErrors(
        gyro_bias_stddev_deg_per_hour=0.2,
        gyro_noise_deg_per_sqrt_hour=0.003 / math.sqrt(400.0) * 60.0,
        accel_bias_stddev_ug=0.005 / _MICRO_G,
        accel_noise_ug_per_sqrt_hz=0.02 / math.sqrt(400.0) / _MICRO_G,
    ),
    "tactical": ImuErrors(
        gyro_bias_stddev_deg_per_hour=1.0,
        gyro_bias_random_walk_deg_per_hour_per_sqrt_hour=0.5,
        gyro_noise_deg_per_sqrt_hour=0.1,
        gyro_scale_stddev_ppm=150.0,
        gyro_misalignment_stddev_arcsec=30.0,
        accel_bias_stddev_ug=1000.0,
        accel_bias_random_walk_ug_per_sqrt_hour=50.0,
        accel_noise_ug_per_sqrt_hz=60.0,
        accel_scale_stddev_ppm=300.0,
        accel_misalignment_stddev_arcsec=30.0,
    ),
    "mems": ImuErrors(
        gyro_bias_stddev_deg_per_hour=200.0,
        gyro_bias_random_walk_deg_per_hour_per_sqrt_hour=20.0,
        gyro_noise_deg_per_sqrt_hour=0.3,
        gyro_scale_stddev_ppm=2000.0,
        gyro_misalignment_stddev_arcsec=200.0,
        accel_bias_stddev_ug=5000.0,
        accel_bias_random_walk_ug_per_sqrt_hour=300.0,
        accel_noise_ug_per_sqrt_hz=150.0,
        accel_scale_stddev_ppm=2000.0,
        accel_misalignment_stddev_arcsec=200.0,
    ),
}
"""Inertial units by class; the biases, scale factors and misalignments of a unit are drawn from the seed."""


def measure_imu(parameters: Mapping[str, Any], trajectory: Trajectory, seed: int) -> ImuReadings:
    """Output of the inertial unit that the parameters describe, along the trajectory; seed not negative."""
    dt = 1.0 / parameters["rate"]
    if parameters["imu.sampling"] == "averaged":
        rate, force = trajectory.delta_theta / dt, trajectory.delta_velocity / dt
    else:
        rate, force = trajectory.rate[1:], trajectory.specific_force[1:]
    errors = ImuErrors.of(parameters)
    angular_velocity, gyro_bias = errors.gyro.measure(rate, dt, seed, "gyro")
    linear_acceleration, accel_bias = errors.accel.measure(force, dt, seed, "accel")
    return ImuReadings(angular_velocity, linear_acceleration, gyro_bias, accel_bias)


def _scaled3(values: Triple, factor: float) -> Triple:
    return values[0] * factor, values[1] * factor, values[2] * factor


def _scaled6(values: Six, factor: float) -> Six:
    a, b, c, d, e, f = (value * factor for value in values)
    return a, b, c, d, e, f
