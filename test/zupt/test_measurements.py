"""Measurements at stops: Jacobians against differences, any heading, the residual rate of the paper's equations."""

import math

import numpy as np
import pytest
from aid_harness import COVARIANCE, LAT, ZERO, state_at
from scipy.spatial.transform import Rotation

from ins_nav.estimation.error_model import Array, ErrorModel
from ins_nav.estimation.observation import Solution
from ins_nav.estimation.state_layout import COSINE, GYRO_BIAS, HEADING, SIZE
from ins_nav.mechanization import earth, nav_state
from ins_nav.zupt.measurements import ResidualRate, ZeroVelocity
from ins_nav.zupt.zupt_equations import StopMeasurement

MODEL = ErrorModel(vertical=True, gyro_noise=0.0, accel_noise=0.0)
STEPS = np.array([1.0] * 3 + [0.1] * 3 + [1e-4] * 3 + [1e-4] * 3 + [1e-3] * 3)


def at_rest() -> nav_state.NavState:
    state = state_at()
    return nav_state.NavState(*state[:4], *ZERO, *state[7:])


def innovation(state: nav_state.NavState) -> Array:
    return ZeroVelocity().measure(Solution(state, ZERO, ZERO, True, 0.0), 0.01).innovation


def test_columns_of_zero_velocity() -> None:
    """Against central differences through `ErrorModel.apply`."""
    h = ZeroVelocity().measure(Solution(at_rest(), ZERO, ZERO, True, 0.0), 0.01).h
    for i, step in enumerate(STEPS):
        z = []
        for sign in (-1.0, 1.0):
            x = np.zeros(SIZE)
            x[i] = sign * step
            z.append(innovation(MODEL.apply(x, at_rest(), ZERO, ZERO)[0]))
        np.testing.assert_allclose(h[:, i], (z[0] - z[1]) / (2.0 * step), atol=1e-6)


@pytest.mark.parametrize("gamma", [1.0, -2.5, math.pi])
def test_zero_velocity_says_nothing_of_heading(gamma: float) -> None:
    x = np.zeros(SIZE)
    x[HEADING], x[COSINE] = math.sin(gamma), 1.0 - math.cos(gamma)
    state, *_ = MODEL.apply(x, at_rest(), ZERO, ZERO)
    h = ZeroVelocity().measure(Solution(at_rest(), ZERO, ZERO, True, 0.0), 0.01).h
    np.testing.assert_allclose(innovation(at_rest()) - innovation(state), h @ x, atol=1e-12)


def test_standing() -> None:
    """Zero velocity is no innovation."""
    q = tuple(Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_quat())
    state = nav_state.initial_state(LAT, 0.6, 30.0, ZERO, q)
    solution = Solution(state, nav_state.earth_rate_body(state), ZERO, False, 0.0)
    np.testing.assert_allclose(ZeroVelocity().measure(solution, 0.01).innovation, 0.0)


@pytest.mark.parametrize("vertical", [False, True])
def test_rest_rate(vertical: bool) -> None:
    """What the equations of ZUPT make of a drift, a bias since corrected and a wrong heading is ``h x``."""
    rot_sb = Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_matrix()
    k, gamma = earth.RATE * math.cos(LAT), 1e-3
    drift, then, now = np.array([[1.0, -2.0, 3.0], [0.5, 0.0, 1.0], [0.8, -1.0, 2.0]]) * 1e-6
    # `ins_nav.zupt.zupt_equations`: the solution's heading is less than the true one by its azimuth error, its yaw more
    rate = rot_sb @ (drift - then) + k * np.array([-math.sin(gamma), math.cos(gamma) - 1.0, 0.0])
    stop = StopMeasurement(rot_sb, rate, COVARIANCE, k, np.zeros(3))
    solution = Solution(state_at(), ZERO, tuple(now.tolist()), False, 0.0)
    measurement = ResidualRate(vertical).measure(solution, stop, tuple(then.tolist()))
    x = np.zeros(SIZE)
    x[GYRO_BIAS], x[HEADING] = now - drift, gamma
    # the square of the heading's error: k * gamma² / 2 of some 1e-6
    np.testing.assert_allclose(measurement.innovation, measurement.h @ x, atol=k * gamma**2)
    np.testing.assert_array_equal(measurement.r, COVARIANCE[2:, 2:] if vertical else COVARIANCE)
