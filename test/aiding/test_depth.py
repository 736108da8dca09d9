"""Depth: with the surface's height given and not given."""

import numpy as np
from aid_harness import ARM, SOLUTION, aids_of, at, flight, observed, of, own_of
from scipy.spatial.transform import Rotation

from ins_nav.aiding.depth import Depth, DepthParameters


def test_depth_counts_from_the_surface() -> None:
    values = {"depth.surface_height": 160.0, "depth.lever_arm": [0.0, 0.0, -1.0]}
    found = aids_of(values)["depth"]
    # the gauge is 1 m below the IMU at 150 m: 11 m under a surface at 160 m
    seen = found.measure(SOLUTION, own_of(), observed("depth", 11.0, covariance=np.array([[0.04]])))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.0], atol=1e-9)
    np.testing.assert_allclose(seen.r, [[0.04]])


def test_depth_estimates_the_surface_that_is_not_given() -> None:
    """The first depth defines its height; the filter's state corrects it."""
    found = aids_of()["depth"]
    seen = found.measure(SOLUTION, own_of(0.0), observed("depth", 11.0, covariance=np.eye(1)))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [0.0], atol=1e-9)
    seen = found.measure(SOLUTION, own_of(0.5), observed("depth", 12.0, covariance=np.eye(1)))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [0.5], atol=1e-9)
    np.testing.assert_array_equal(seen.own, [[-1.0]])


def test_truth_has_no_innovation() -> None:
    """At the end of the arm, by the simulated motion alone."""
    solution, _, _ = at(flight()[1])
    east_north_up = Rotation.from_quat(solution.state[0:4]).apply(ARM)
    gauge = Depth(DepthParameters(lever_arm=ARM, surface_height=12.0))
    height = float(flight()[0].states(np.array([flight()[1]])).height[0]) + east_north_up[2]
    measurement = of(gauge, 12.0 - height)(solution, np.zeros(0))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-9)
