"""Limits of a stop."""

import math
from dataclasses import replace

import pytest

from ins_nav.config.configuration import Configuration
from ins_nav.stop_detection.stop_limits import StopLimits


def test_defaults_are_those_of_the_parameters() -> None:
    configuration = Configuration.from_overrides({})
    limits = StopLimits.of(configuration.stop, configuration.imu)
    # NaN differs from itself
    assert replace(limits, gyro_noise=0.0, accel_noise=0.0) == StopLimits(gyro_noise=0.0, accel_noise=0.0)
    assert math.isnan(limits.gyro_noise) and math.isnan(limits.accel_noise)


def test_parameters_are_in_si_units() -> None:
    configuration = Configuration.from_overrides(
        {
            "stop.max_speed": 0.3,
            "imu.gyro_noise_deg_per_sqrt_hour": 60.0,
            "imu.accel_noise_ug_per_sqrt_hz": 1000.0,
        }
    )
    limits = StopLimits.of(configuration.stop, configuration.imu)
    assert limits.max_speed == 0.3
    assert limits.gyro_noise == pytest.approx(math.radians(1.0))
    assert limits.accel_noise == pytest.approx(9.80665e-3)
