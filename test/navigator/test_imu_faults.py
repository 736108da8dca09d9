"""Faults of the IMU that its monitors find: the covariance contains what they hide; what noise teaches is unlearnt."""

import functools
import math

import numpy as np
import pytest
from navigation_harness import HEADING, HERE, Fed, Values

from ins_nav.estimation.state_layout import HEADING as YAW
from ins_nav.mechanization import attitude, nav_state
from ins_nav.messages.diagnostics import diagnostics
from ins_nav.simulation.scenarios import Simulation, simulate

STAND = 20.0
START_HEADING = {**HEADING, "initial.heading_deg": 30.0, "initial.heading_stddev_deg": 0.1}


@functools.cache
def _drive() -> Simulation:
    return simulate("vehicle", 0, duration=90.0, stand_time=STAND, rate=100.0)


def _messages(values: np.ndarray) -> list[tuple[int, Values]]:
    return [(int(stamp), tuple(row)) for stamp, row in zip(_drive().stamps_ns, values.tolist(), strict=True)]


def _values() -> np.ndarray:
    return np.c_[_drive().angular_velocity, _drive().linear_acceleration]


def _heading_error(fed: Fed, i: int) -> float:
    """rad, of the real-time solution."""
    state = fed.navigator.state
    assert state is not None
    yaw = attitude.to_euler(nav_state.geodetic(state).q_gb)[2]
    return abs(math.remainder(yaw - attitude.to_euler(tuple(_drive().trajectory.q_nb[i].tolist()))[2], 2.0 * math.pi))


@pytest.mark.parametrize("begin", [25.0, 40.0, 55.0])
def test_a_frozen_gyro_widens_heading_in_both_navigators(begin: float) -> None:
    """10 s of a drive with turns, no aids: without the monitor 10 to 60 degrees at a sigma of 0.1."""
    values = _values()
    first = round(begin * 100.0)
    values[first : first + 1000, 2] = values[first - 1, 2]
    fed = Fed(**HERE, **START_HEADING).feed(_messages(values)[: first + 1400])
    assert fed.counts["frozen axes"] >= 8
    assert any("angular_velocity.z at" in line and "frozen for" in line for line in fed.said)
    covariance = fed.navigator.covariance
    assert covariance is not None
    error = _heading_error(fed, first + 1399)
    assert error < 3.0 * math.sqrt(covariance[YAW, YAW])
    filtered = fed.navigator.delayed.filter
    assert filtered is not None and error < 3.0 * filtered.heading_stddev
    level, _, status = diagnostics(fed.navigator.realtime, 0)
    assert level == 2 and int(status["frozen axes"]) >= 8


def test_an_axis_without_measurements_prevents_alignment() -> None:
    values = _values()
    values[:, 1] = 0.0
    fed = Fed(**HERE, **START_HEADING).feed(_messages(values)[:1500])
    assert fed.navigator.state is None
    assert any("angular_velocity.y never changes" in line for line in fed.said)


def test_noise_that_alignment_learnt_of_an_engine_is_unlearnt() -> None:
    """The engine runs for 4 s of standing: 50 times the sensors' noise; 10 s later the sensors' own is in use."""
    values = _values()
    rng = np.random.default_rng(1)
    values[:400] += np.r_[np.full(3, 50.0 * 6e-6), np.full(3, 50.0 * 1e-3)] * rng.standard_normal((400, 6))
    fed = Fed(**HERE, **START_HEADING)
    fed.feed(_messages(values)[:350])
    engine = fed.navigator.accuracy.white_noise
    fed.feed(_messages(values)[350:1500])
    quiet = Fed(**HERE, **START_HEADING).feed(_messages(_values())[:1500]).navigator.accuracy.white_noise
    for before, after, usual in zip(engine, fed.navigator.accuracy.white_noise, quiet, strict=True):
        assert after < 0.3 * before
        assert after < 5.0 * usual  # 1/f noise of accelerometers is allowed for
