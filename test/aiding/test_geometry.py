"""Formulas that measurements share."""

import numpy as np
from aid_harness import SOLUTION, STATE, state_at
from scipy.spatial.transform import Rotation

from ins_nav.aiding import geometry
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import ATTITUDE, COSINE, SIZE
from ins_nav.mechanization import earth, nav_state


def test_a_vector_turns_with_attitude_and_heading() -> None:
    h, vector = np.zeros((3, SIZE)), np.array([1.0, -2.0, 3.0])
    geometry.set_turned(h, vector)
    phi = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(h[:, ATTITUDE] @ phi, np.cross(phi, vector))
    np.testing.assert_array_equal(h[:, COSINE], [1.0, -2.0, 0.0])
    np.testing.assert_allclose(geometry.cross_matrix([1.0, -2.0, 3.0]) @ phi, np.cross(vector, phi))


def test_axes() -> None:
    """n is turned from east-north-up by 0.4 rad."""
    where = nav_state.geodetic(state_at())
    axes = earth.enu_axes(where.lat, where.lon)
    on_n = np.column_stack([geometry.from_earth(state_at(), axes[:, i]) for i in range(3)])
    np.testing.assert_allclose(on_n[:, :2], geometry.east_north(state_at()), atol=1e-12)
    np.testing.assert_allclose(on_n, Rotation.from_rotvec([0.0, 0.0, -0.4]).as_matrix(), atol=1e-12)
    covariance = np.diag([1.0, 4.0, 9.0])
    np.testing.assert_allclose(
        geometry.enu_covariance_on_n(state_at(), covariance), on_n @ covariance @ on_n.T, atol=1e-12
    )


def test_rate_to_earth() -> None:
    expected = np.subtract(SOLUTION.rate, nav_state.earth_rate_body(STATE))
    np.testing.assert_allclose(geometry.rate_to_earth(SOLUTION), expected, atol=1e-15)


def test_first_rows() -> None:
    whole = Measurement(np.arange(3.0), np.ones((3, SIZE)), np.eye(3), None, np.ones((3, 2)))
    part = geometry.first_rows(whole, 2)
    assert part.own is not None
    assert [len(x) for x in (part.innovation, part.h, part.r, part.own)] == [2] * 4 and part.r.shape == (2, 2)
