"""Sections: values in SI units."""

import math

import pytest

from ins_nav.config.configuration import Configuration
from ins_nav.config.sections import StopDetectorSection


def test_values_are_in_si_units() -> None:
    """By hand: 3600 °/h is 1 °/s; 60 °/√h is 1 °/√s; 1e3 mg and 1e6 µg are g of 9.80665 m/s²."""
    found = Configuration.from_overrides(
        {
            "imu.sampling": "instantaneous",
            "imu.mounting_rpy_deg": [0, 90, 180],
            "imu.gyro_bias_stddev_deg_per_hour": 3600,
            "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 3600,
            "imu.gyro_noise_deg_per_sqrt_hour": 60,
            "imu.accel_bias_stddev_mg": 1e3,
            "imu.accel_bias_walk_mg_per_sqrt_hour": 1e3,
            "imu.accel_noise_ug_per_sqrt_hz": 1e5,
            "initial.heading_deg": -90,
            "aiding.max_delay": 3,
            "publish.rate": 50,
        }
    )
    degree, g = math.pi / 180.0, 9.80665
    assert found.imu.instantaneous
    assert found.imu.mounting_rpy == pytest.approx((0.0, math.pi / 2.0, math.pi))
    assert found.imu.gyro_bias_stddev == pytest.approx(degree)
    assert found.imu.gyro_bias_walk == pytest.approx(degree / 60.0)
    assert found.imu.gyro_noise == pytest.approx(degree)
    assert found.imu.accel_bias_stddev == pytest.approx(g)
    assert found.imu.accel_bias_walk == pytest.approx(g / 60.0)
    assert found.imu.accel_noise == pytest.approx(0.1 * g)
    assert found.initial.heading == pytest.approx(-math.pi / 2.0) and math.isnan(found.initial.latitude)
    assert found.aiding.max_delay_ns == 3_000_000_000
    assert found.publish.period_ns == 20_000_000
    assert Configuration.from_overrides().publish.period_ns == 0
    assert StopDetectorSection(zupt1_after=2.0).zupt1_after_ns == 2_000_000_000
