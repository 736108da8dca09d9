"""Velocity log: axes, mounting, scale, a log without bottom."""

import math

import aid_messages
import numpy as np
import pytest
from aid_harness import (
    ARM,
    NAN,
    SOLUTION,
    STATE,
    ZERO,
    aids_of,
    at,
    flight,
    observed,
    of,
    own_of,
    point_velocity,
    state_at,
)
from scipy.spatial.transform import Rotation

from ins_nav.aiding.base import Unusable
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.estimation.observation import Solution
from ins_nav.mechanization import nav_state

RPY = (0.1, -0.2, 0.7)


def test_log_uses_the_measured_axes() -> None:
    found = aids_of()["log"]
    forward, left, _ = nav_state.velocity_body(STATE)
    seen = found.measure(SOLUTION, own_of(0.0, 0.0, 0.0), observed("log", NAN, left - 0.25, NAN))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.25], atol=1e-12)
    assert found.measure(SOLUTION, own_of(0.0, 0.0, 0.0), observed("log", NAN, NAN, NAN)) is None
    turned = aids_of({"log.mounting_rpy_deg": [0.0, 0.0, 90.0]})["log"]
    seen = turned.measure(SOLUTION, own_of(0.0, 0.0, 0.0), observed("log", left, -forward, 0.0))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-12


def test_zeros_are_no_evidence_against_the_solution() -> None:
    """A log without bottom reports zeros on every axis."""
    found = aids_of()["log"]
    for zeros in ((0.0, NAN, NAN), (0.0, 0.0, 0.0), (0.0, 0.1, NAN)):
        measurement = found.measure(SOLUTION, own_of(0.0, 0.0, 0.0), observed("log", *zeros))
        assert measurement is not None
        assert measurement.valid_within == (math.inf if 0.1 in zeros else 0.0)


def test_truth_has_no_innovation() -> None:
    """At the end of the arm, against differences of the simulated motion."""
    solution, _, rot_eb = at(flight()[1])
    rot_sb = Rotation.from_euler("ZYX", RPY[::-1]).as_matrix().T
    x, y, z = rot_sb @ rot_eb.T @ point_velocity(flight()[1])
    own = scale, a_y, a_z = 0.02, -0.03, 0.05
    reads = ((1 + scale) * x + a_y * z - a_z * y, (1 + scale) * y + a_z * x, (1 + scale) * z - a_y * x)
    log = VelocityLog(LogParameters(lever_arm=ARM, mounting_rpy=RPY))
    measurement = of(log, *reads)(solution, np.array(own))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)  # of the difference


def test_axes_with_different_covariances() -> None:
    solution = Solution(state_at(), ZERO, ZERO, True, 0.0)
    rows = np.arange(9.0).reshape(3, 3)
    log = of(VelocityLog(LogParameters()), 1.0, math.nan, 2.0, covariance=rows)(solution, np.zeros(3))
    assert log is not None and log.own is not None
    assert log.innovation.shape == (2,) and log.own.shape == (2, 3)
    np.testing.assert_array_equal(log.r, [[0.0, 2.0], [6.0, 8.0]])


@pytest.mark.parametrize(
    "velocity", [(0.0, 0.0, 0.1), (-32.768,) * 3, (NAN, NAN, NAN), (200.0, 0.0, 0.0), (math.inf, NAN, NAN)]
)
def test_a_log_without_bottom_is_no_measurement(velocity: tuple[float, float, float]) -> None:
    message = aid_messages.MESSAGES["log"][1](0, velocity)
    with pytest.raises(Unusable, match="is no measurement: rejected"):
        VelocityLog(LogParameters()).read(message)


def test_one_axis_without_bottom_is_not_measured() -> None:
    reading = VelocityLog(LogParameters()).read(aid_messages.MESSAGES["log"][1](0, (1.0, -32.768, 0.0)))
    assert reading.value[0] == 1.0 and math.isnan(reading.value[1]) and reading.value[2] == 0.0


def test_calibration_is_in_the_units_of_the_parameters() -> None:
    aid = VelocityLog(LogParameters())
    found = aid.calibration([(0.01, 1e-4), (0.002, 1e-3), (-0.003, 2e-3), (0.2, 0.1)])
    assert tuple(found) == aid.CALIBRATION
    assert found["log.yaw_deg"] == pytest.approx(math.degrees(-0.003))
    assert found["log.misalignment_stddev_deg"] == pytest.approx(math.degrees(2e-3))
