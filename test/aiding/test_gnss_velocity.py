"""GNSS velocity: without its vertical component, of a base that does not travel."""

import numpy as np
import pytest
from aid_harness import ARM, NAN, SOLUTION, ZERO, aids_of, at, flight, observed, of, own_of, point_velocity, state_at

from ins_nav.aiding.gnss_velocity import GnssVelocity, GnssVelocityParameters
from ins_nav.estimation.observation import Solution
from ins_nav.estimation.state_layout import COSINE, HEADING
from ins_nav.mechanization import earth, nav_state


def test_velocity_without_up() -> None:
    found = aids_of()["gnss_velocity"]
    full = found.measure(SOLUTION, own_of(), observed("gnss_velocity", 3.0, 4.0, 0.5))
    flat = found.measure(SOLUTION, own_of(), observed("gnss_velocity", 3.0, 4.0, NAN))
    assert full is not None and flat is not None
    np.testing.assert_allclose(full.innovation, [0.0, 0.0, -0.5], atol=1e-12)
    np.testing.assert_allclose(flat.innovation, [0.0, 0.0], atol=1e-12)
    assert flat.r.shape == (2, 2) and flat.h.shape[0] == 2


def test_velocity_of_a_base_at_rest_does_not_observe_heading() -> None:
    solution = Solution(state_at(), ZERO, ZERO, False, 0.5)
    measurement = of(GnssVelocity(GnssVelocityParameters()), 4.0, 7.0, 0.3)(solution, np.zeros(0))
    assert measurement is not None
    assert (measurement.h[:2, [HEADING, COSINE]] == 0.0).all()
    # its possible effect is noise: half of the velocity squared
    grown = np.trace(measurement.r[:2, :2]) - 5.0
    assert grown == pytest.approx(2.0 * 0.5 * (6.0**2 + 5.0**2))


def test_truth_has_no_innovation() -> None:
    """At the end of the arm, against differences of the simulated motion."""
    solution, _, _ = at(flight()[1])
    where = nav_state.geodetic(solution.state)
    velocity = earth.enu_axes(where.lat, where.lon).T @ point_velocity(flight()[1])
    measurement = of(GnssVelocity(GnssVelocityParameters(lever_arm=ARM)), *velocity)(solution, np.zeros(0))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)  # of the difference
