"""Errors of the IMU as blocks: the readings they describe, absent ones, considered ones in the filter."""

import math

import numpy as np
import pytest
from estimation.imu_readings import TRUE
from estimation.test_error_filter import Run, drive
from scipy.spatial.transform import Rotation

from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import ErrorModel, mean_reading
from ins_nav.estimation.imu_error import Array, ImuErrors
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import ATTITUDE, POSITION, SIZE, TILT
from ins_nav.estimation.states import kinds, rows
from ins_nav.mechanization import nav_state, strapdown

STATE = nav_state.initial_state(0.9, 0.1, 100.0, (20.0, -5.0, 0.0), (0.1, -0.2, 0.3, math.sqrt(0.86)))


def every(mounting: Array | None = None) -> ImuErrors:
    return ImuErrors([kind(stddev=1e-4) for kind in kinds()], mounting)


def test_registry() -> None:
    blocks = [kind.block for kind in kinds()]
    assert blocks == ["accel_misalignment", "accel_scale", "gyro_misalignment", "gyro_scale"]
    names = [row.name for row in rows()]
    assert len(names) == len(set(names)) and all(name.startswith("imu.") for name in names)


def test_axes_are_those_of_the_mounted_imu() -> None:
    rot = Rotation.from_euler("ZYX", [0.3, -0.1, 0.7]).as_matrix()
    both = np.kron(np.eye(2), rot)
    np.testing.assert_allclose(every(rot).columns(both @ TRUE), both @ every().columns(TRUE), atol=1e-14)


def test_absent_errors_have_no_states() -> None:
    first, *others = kinds()
    errors = ImuErrors([first(stddev=1e-4), *(kind() for kind in others)])
    assert errors.sizes == {first.block: len(first.components)}
    assert ImuErrors().size == 0 and ErrorModel(vertical=True, gyro_noise=0.0, accel_noise=0.0).size == SIZE
    assert ImuErrors().correction(()) is None and errors.correction(np.zeros(errors.size)) is None


def test_mean_reading() -> None:
    """The states at the ends of an interval determine the samples between them."""
    samples = np.array([[0.01, *TRUE[:3], *TRUE[3:]]] * 10)
    after = nav_state.NavState(*strapdown.integrate(STATE, tuple(samples[0]), samples)[-1].tolist())
    # the body turns by 0.04 rad within the interval: mean attitude is good to its square over 12 of 9.8 m/s²
    np.testing.assert_allclose(mean_reading(STATE, after, 0.1), TRUE, atol=1.2e-3)


def _filter(errors: ImuErrors) -> ErrorFilter:
    model = ErrorModel(
        vertical=True,
        gyro_noise=1e-6,
        accel_noise=1e-4,
        gyro_bias=SlowState(1e-7),
        accel_bias=SlowState(1e-4),
        imu_errors=errors,
    )
    return ErrorFilter(model, (1.0,) * 3, (0.1,) * 3, 1e-6 * np.eye(3), {"log": [SlowState(0.1)]})


def test_considered_errors_are_not_estimated() -> None:
    """Schmidt: gain zero, the prior stays, the correlations are used; the covariance is that of this gain."""
    considered, without = _filter(every()), _filter(ImuErrors())
    block = slice(SIZE, SIZE + considered.model.imu_errors.size)
    rng = np.random.default_rng(2)
    for i in range(20):
        for kalman in (considered, without):
            kalman.propagate(STATE, STATE, 1.0)
            z = np.array([0.5, -0.5, 0.2]) * rng.standard_normal()
            kalman.update("gnss", i, Measurement(z, np.eye(3, SIZE), 0.01 * np.eye(3), POSITION))
    assert (considered.x[block] == 0.0).all()
    np.testing.assert_allclose(considered.p[block, block], 1e-8 * np.eye(18), atol=1e-20)
    assert np.abs(considered.p[ATTITUDE, block]).max() > 1e-10
    assert np.linalg.eigvalsh(considered.p)[0] > -1e-18
    level = slice(6, 8)
    assert (considered.p.diagonal()[level] > 1.2 * without.p.diagonal()[level]).all()


def test_estimated_errors_are_found() -> None:
    """A joint update moves a block that is not considered, by its correlation with the measured states."""
    kinds_ = [kind(stddev=1e-4, estimated=True) for kind in kinds()]
    kalman = _filter(ImuErrors(kinds_))
    kalman.propagate(STATE, STATE, 10.0)
    kalman.update("gnss", 0, Measurement(np.array([0.5, 0.0, 0.0]), np.eye(3, SIZE), 0.01 * np.eye(3), POSITION))
    assert np.abs(kalman.x[SIZE : kalman.model.size]).max() > 0.0


RING_LASER: dict[str, float] = {"gyro_noise": math.radians(0.002) / 60.0, "accel_noise": 1e-4}
"""rad/√s and m/s/√s, the simulator's default, with the sigmas of scale factors and misalignments below."""
BIAS = 5e-8, 1e-4
"""rad/s and m/s²: accelerometers that have been calibrated, so that bias does not hide the rest."""
SIGMAS = {"gyro_scale": 5e-6, "accel_scale": 5e-5, "gyro_misalignment": 2.4e-5, "accel_misalignment": 2.4e-5}


def _level_over_sigma(seed: int, modelled: ImuErrors) -> Array:
    """Error of the level over its sigma every 10 s of a drive with fixes."""
    drawn = every()
    rng = np.random.default_rng([seed, 1])
    sigmas = np.concatenate([np.full(len(kind.components), SIGMAS[kind.block]) for kind in kinds()])
    bias = BIAS[0] * rng.standard_normal(3), BIAS[1] * rng.standard_normal(3)
    model = ErrorModel(
        vertical=False,
        gyro_bias=SlowState(BIAS[0]),
        accel_bias=SlowState(BIAS[1]),
        imu_errors=modelled,
        **RING_LASER,
    )
    run = Run(
        drive(),
        model,
        seed,
        stddev=(1.0, 0.1, 1e-4),
        heading_stddev=1e-3,
        gyro_bias=bias[0].tolist(),
        accel_bias=bias[1].tolist(),
        **RING_LASER,
    )
    true = run.samples[:, 1:] - [*bias[0], *bias[1]]
    reading = np.linalg.inv(drawn.correction(sigmas * rng.standard_normal(drawn.size)))
    run.samples[:, 1:] = true @ reading.T + [*bias[0], *bias[1]]
    found = []
    for second in range(1, int(run.path.time[-1])):
        run.advance(second)
        run.gnss(second)
        if second % 10 == 0:
            found.append(run.error(second)[TILT] / np.sqrt(run.filter.p.diagonal()[TILT]))
    return np.array(found)


def test_level_of_default_sensors() -> None:
    """Scale factors and misalignments that are considered: the level's error is as large as its sigma."""

    def rms(factor: float, seeds: int) -> float:
        errors = ImuErrors([kind(stddev=factor * SIGMAS[kind.block]) for kind in kinds()])
        return float(np.sqrt(np.mean([_level_over_sigma(seed, errors) ** 2 for seed in range(seeds)])))

    # 20 drives with some four independent levels each about two axes: the RMS is known to 0.06; three of these
    assert rms(1.0, 20) == pytest.approx(1.0, abs=0.18)
    assert rms(0.0, 4) > 1.4
