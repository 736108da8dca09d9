"""Errors of inertial sensors and satellite fixes, by their statistics."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import close

from ins_nav.aiding.gnss import GnssReceiver
from ins_nav.mechanization import earth
from ins_nav.simulation.motion import Motion, constant
from ins_nav.simulation.scenarios import START_NS
from ins_nav.simulation.sensors import PRESETS, ImuErrors
from ins_nav.simulation.trajectory import EarthMotion, Origin


def _still(errors: ImuErrors, seed: int = 1, n: int = 100_000, rate: float = 100.0) -> np.ndarray:
    measured, _ = errors.gyro.measure(np.zeros((n, 3)), 1.0 / rate, seed, "gyro")
    return measured


def test_noise_averages_as_white_noise() -> None:
    density = math.radians(0.3) / 60.0
    noise = _still(ImuErrors(gyro_noise_deg_per_sqrt_hour=0.3))
    for size in (1, 10, 100):
        means = noise.reshape(-1, size, 3).mean(axis=1)
        expected = density / math.sqrt(size / 100.0)
        # 3000 independent values at least: their standard deviation is known to 1.3 %, four times that
        assert means.std() == pytest.approx(expected, rel=0.053)


def test_random_walk_grows_with_the_root_of_time() -> None:
    errors = ImuErrors(gyro_bias_random_walk_deg_per_hour_per_sqrt_hour=3.0)
    ends = np.concatenate([_still(errors, seed, n=400, rate=1.0)[[99, 399]] for seed in range(200)], axis=1)
    unit = math.radians(3.0) / 3600.0 / 60.0
    # 600 values: 3 %, four times that
    assert ends[0].std() == pytest.approx(unit * 10.0, rel=0.12)
    assert ends[1].std() == pytest.approx(unit * 20.0, rel=0.12)


def test_scale_misalignment_and_bias() -> None:
    errors = ImuErrors(
        accel_bias_ug=(100.0, 0.0, -50.0),
        accel_scale_ppm=(10.0, 20.0, 30.0),
        accel_misalignment_arcsec=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    )
    measured, bias = errors.accel.measure(np.array([[1.0, 2.0, 3.0]]), 0.01, 0, "accel")
    arcsec, micro_g = math.radians(1 / 3600), 9.80665e-6
    expected = [
        1.0 * 1.00001 + arcsec * (1 * 2.0 + 2 * 3.0) + 100 * micro_g,
        2.0 * 1.00002 + arcsec * (3 * 1.0 + 4 * 3.0),
        3.0 * 1.00003 + arcsec * (5 * 1.0 + 6 * 2.0) - 50 * micro_g,
    ]
    np.testing.assert_allclose(measured[0], expected, rtol=1e-14)
    np.testing.assert_allclose(bias, [100 * micro_g, 0.0, -50 * micro_g])


def test_quantization_loses_nothing() -> None:
    dt, step = 0.005, math.radians(1 / 3600)
    true = np.random.default_rng(0).normal(1e-5, 1e-4, (20_000, 3))  # increments well below the step
    measured, _ = ImuErrors(gyro_quantization_arcsec=1.0).gyro.measure(true, dt, 0, "gyro")
    counts = measured * dt / step
    close(counts, np.rint(counts), atol=1e-9)
    error = np.cumsum(measured - true, axis=0) * dt
    assert np.abs(error).max() <= 0.5 * step * (1 + 1e-9)


def test_streams_are_independent() -> None:
    everything = PRESETS["tactical"]
    less = ImuErrors(gyro_noise_deg_per_sqrt_hour=0.1)
    only_noise = _still(less, n=1000)
    bias_and_noise = _still(ImuErrors(gyro_noise_deg_per_sqrt_hour=0.1, gyro_bias_stddev_deg_per_hour=1.0), n=1000)
    close(np.diff(bias_and_noise, axis=0), np.diff(only_noise, axis=0), atol=1e-17)
    np.testing.assert_array_equal(_still(everything), _still(everything))
    assert not np.array_equal(_still(everything, seed=1), _still(everything, seed=2))
    gyro, accel = (e.measure(np.zeros((9, 3)), 1.0, 0, n)[0] for e, n in ((less.gyro, "gyro"), (less.gyro, "accel")))
    assert not np.array_equal(gyro, accel)


def test_paper_figures_of_fog_auv() -> None:
    errors = PRESETS["fog_auv"]
    assert math.degrees(errors.gyro.noise_stddev(1 / 400)) == pytest.approx(0.003)
    assert errors.accel.noise_stddev(1 / 400) == pytest.approx(0.02)
    assert math.degrees(errors.gyro.bias_stddev) * 3600 == pytest.approx(0.2)
    assert errors.accel.bias_stddev == pytest.approx(0.005)


@pytest.mark.parametrize("lat_deg", [-90.0, 0.0, 55.7, 89.99999])
def test_fixes_scatter_about_the_antenna(lat_deg: float) -> None:
    motion = Motion(2000.0, yaw=constant(0.4), roll=constant(0.3), pitch=constant(-0.2))
    t = EarthMotion(motion, Origin(math.radians(lat_deg), -2.0, 300.0)).trajectory(1.0)
    arm = (1.0, -2.0, 3.0)
    fixes = GnssReceiver(1.0, 2.0, 3.0, arm).fixes(t, START_NS + np.arange(2001) * 10**9, seed=3)
    place = earth.geodetic_to_ecef(fixes.lat, fixes.lon, fixes.height)
    error_e = place - t.position_e - Rotation.from_quat(t.q_eb).apply(arm)
    error = error_e @ earth.enu_axes(math.radians(lat_deg), -2.0)
    # 2001 fixes: mean to 0.045 m and 0.067 m, standard deviation to 1.6 %, four times that
    close(error.mean(axis=0), 0.0, atol=0.27)
    np.testing.assert_allclose(error.std(axis=0), [2.0, 2.0, 3.0], rtol=0.064)
    assert len(fixes.stamps_ns) == 2001
    quiet = GnssReceiver(0.5, 0.0, 0.0, arm).fixes(t, START_NS + np.arange(2001) * 10**9, seed=3)
    place = earth.geodetic_to_ecef(quiet.lat, quiet.lon, quiet.height)
    expected = (t.position_e + Rotation.from_quat(t.q_eb).apply(arm))[::2]
    # offset laid on the ellipsoid to d²/2R, 14 m² / 1.3e7 m
    close(place, expected, atol=3e-6)
    np.testing.assert_array_equal(np.diff(quiet.stamps_ns), 2 * 10**9)
