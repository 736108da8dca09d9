"""From coarse alignment to the filter: the lever arm of the position and the least velocity."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ins_nav.alignment.coarse_alignment import Alignment
from ins_nav.alignment.handover import after_alignment
from ins_nav.estimation.imu_error import ImuErrors
from ins_nav.estimation.state_layout import ATTITUDE, POSITION, SENSED, SOLUTION_SIZE, VELOCITY
from ins_nav.mechanization.nav_state import initial_state

STATE = initial_state(0.9, 0.6, 10.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def alignment(velocity_stddev: float, level: float, heading: float) -> Alignment:
    joint = np.zeros((SOLUTION_SIZE, SOLUTION_SIZE))[SENSED, SENSED]
    joint[:3, :3] = np.diag(np.square([level, level, heading]))
    by_bias = np.zeros((3, 6))
    return cast(Alignment, SimpleNamespace(velocity_stddev=velocity_stddev, joint=joint, by_bias=by_bias))


def covariance(lever_arm_g: tuple[float, float, float], velocity_stddev: float = 0.02) -> Any:
    return after_alignment(alignment(velocity_stddev, 1e-3, 0.1), STATE, (1.0, 1.0, 2.0), lever_arm_g, ImuErrors())


def test_without_a_lever_arm_nothing_is_correlated() -> None:
    p = covariance((0.0, 0.0, 0.0))
    expected = [1.0, 1.0, 4.0, *[0.02**2] * 3, 1e-6, 1e-6, 1e-2, *[0.0] * (len(p) - 9)]
    np.testing.assert_allclose(p, np.diag(expected))


def test_a_lever_arm_turns_with_the_error_of_attitude() -> None:
    """10 m to the east of the IMU and a heading error of 0.1 rad: the position error is 1 m to the north."""
    arm = np.array([10.0, 0.0, 0.0])
    p = covariance(tuple(arm))
    assert p[1, 1] == pytest.approx(1.0 + 1.0)
    # a computed attitude turned by phi turns the arm by phi x arm; the IMU is the place less the arm
    rng = np.random.default_rng(0)
    phi = rng.standard_normal((200_000, 3)) * [1e-3, 1e-3, 0.1]
    position = rng.standard_normal((200_000, 3)) * [1.0, 1.0, 2.0] - np.cross(phi, arm)
    drawn = np.cov(np.hstack([position, phi]), rowvar=False)
    index = np.r_[POSITION, ATTITUDE]
    # correlations of 200 000 draws: 1 / sqrt(200 000) = 0.0022, four of them
    scale = np.sqrt(np.outer(drawn.diagonal(), drawn.diagonal()))
    np.testing.assert_allclose(p[np.ix_(index, index)] / scale, drawn / scale, atol=0.01)


def test_velocity_is_never_exact() -> None:
    assert (covariance((0.0, 0.0, 0.0), velocity_stddev=0.0)[VELOCITY, VELOCITY].diagonal() == 1e-6).all()
