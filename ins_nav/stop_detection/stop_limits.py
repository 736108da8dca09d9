"""Limits that define a stop."""

import math
from dataclasses import dataclass
from typing import Self

from ins_nav.config.sections import ImuSection, StopSection


@dataclass(frozen=True)
class StopLimits:
    """Limits that define a stop.

    Attributes
    ----------
    window : float
        Length of the test window, s.
    min_duration : float
        Least duration of a stop, s.
    max_speed : float
        Mean over a window from which on the base travels, m/s.
    vibration : float
        Disturbance of specific force at rest, averaged over 0.1 s, standard deviation an axis, m/s².
    sway : float
        The same of angular rate, rad/s.
    false_alarm : float
        Probability that a window at rest fails a test.
    gyro_noise : float
        White noise, rad/√s; NaN: estimated at rest.
    accel_noise : float
        White noise, m/s/√s; NaN: estimated at rest.
    """

    window: float = 1.0
    min_duration: float = 2.0
    max_speed: float = 0.1
    vibration: float = 0.02
    sway: float = math.radians(0.06)
    false_alarm: float = 1e-3
    gyro_noise: float = math.nan
    accel_noise: float = math.nan

    @classmethod
    def of(cls, stop: StopSection, imu: ImuSection) -> Self:
        """Limits of a vehicle and its IMU."""
        return cls(
            max_speed=stop.max_speed,
            vibration=stop.vibration,
            sway=stop.sway,
            gyro_noise=imu.gyro_noise,
            accel_noise=imu.accel_noise,
        )
