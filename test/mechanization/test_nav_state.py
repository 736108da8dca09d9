"""The navigation state: what it is composed of, corrections, the map frame."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import attitude, earth, nav_state

PLACES = st.tuples(st.floats(-90.0, 90.0), st.floats(-179.999, 179.999), st.floats(-1000.0, 20e3))


ATTITUDES = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@given(PLACES, st.tuples(*[st.floats(-300.0, 300.0)] * 3), ATTITUDES)
def test_state_gives_back_what_it_was_made_of(
    place: tuple[float, float, float], velocity: tuple[float, float, float], angles: tuple[float, float, float]
) -> None:
    """At the poles, too."""
    lat, lon, height = math.radians(place[0]), math.radians(place[1]), place[2]
    q_gb = attitude.from_euler(*angles)
    state = nav_state.initial_state(lat, lon, height, velocity, q_gb)
    found = nav_state.geodetic(state)
    assert found.lat == pytest.approx(lat, abs=1e-15)
    assert found.height == height
    # near a pole longitude and azimuth are uncertain, but together: compare what they mean
    to_earth = earth.enu_axes(found.lat, found.lon)
    true = earth.enu_axes(lat, lon)
    np.testing.assert_allclose(to_earth @ found.velocity_g, true @ velocity, atol=1e-12 * 300.0)
    rot_eb = to_earth @ Rotation.from_quat(found.q_gb).as_matrix()
    np.testing.assert_allclose(rot_eb, true @ Rotation.from_quat(q_gb).as_matrix(), atol=1e-13)
    np.testing.assert_allclose(nav_state.position_ecef(state), earth.geodetic_to_ecef(lat, lon, height), atol=1e-8)
    # body axes
    rot_gb = Rotation.from_quat(q_gb)
    np.testing.assert_allclose(nav_state.velocity_body(state), rot_gb.inv().apply(velocity), atol=1e-11)
    rate = rot_gb.inv().apply(earth.RATE * np.array([0.0, math.cos(lat), math.sin(lat)]))
    np.testing.assert_allclose(nav_state.earth_rate_body(state), rate, atol=1e-19 + 1e-14 * earth.RATE)


@settings(max_examples=30)
@given(PLACES, st.tuples(*[st.floats(-50e3, 50e3)] * 2), ATTITUDES)
def test_map_is_the_tangent_plane_at_its_origin(
    place: tuple[float, float, float], away: tuple[float, float], angles: tuple[float, float, float]
) -> None:
    lat, lon, height = math.radians(place[0]), math.radians(place[1]), place[2]
    frame = nav_state.MapFrame(lat, lon, height)
    q_gb = attitude.from_euler(*angles)
    here = nav_state.initial_state(lat, lon, height, (0.0, 0.0, 0.0), q_gb)
    np.testing.assert_allclose(frame.position(here), 0.0, atol=1e-8)
    assert (Rotation.from_quat(frame.attitude(here)) * Rotation.from_quat(q_gb).inv()).magnitude() < 1e-13
    # elsewhere: the same from matrices
    there_lat = max(-1.57, min(1.57, lat + away[0] / 6.4e6))
    there_lon = lon + away[1] / 6.4e6
    there = nav_state.initial_state(there_lat, there_lon, 50.0, (0.0, 0.0, 0.0), q_gb)
    axes = earth.enu_axes(lat, lon)
    offset = earth.geodetic_to_ecef(there_lat, there_lon, 50.0) - earth.geodetic_to_ecef(lat, lon, height)
    np.testing.assert_allclose(frame.position(there), axes.T @ offset, atol=1e-7)
    rot_mb = axes.T @ earth.enu_axes(there_lat, there_lon) @ Rotation.from_quat(q_gb).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(frame.attitude(there)).as_matrix(), rot_mb, atol=1e-13)


@given(PLACES, st.tuples(*[st.floats(-20.0, 20.0)] * 3), ATTITUDES, st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_corrected(
    place: tuple[float, float, float],
    away: tuple[float, float, float],
    angles: tuple[float, float, float],
    rotation: tuple[float, float, float],
) -> None:
    """At the poles, too; n is turned about the vertical beforehand, so that it is not east-north-up."""
    lat, lon, height = math.radians(place[0]), math.radians(place[1]), place[2]
    state = nav_state.initial_state(lat, lon, height, (3.0, -4.0, 0.5), attitude.from_euler(*angles))
    q_en = attitude.multiply(state[7:11], attitude.from_rotation_vector(0.0, 0.0, 1.0))  # type: ignore[arg-type]
    state = (*state[:7], *q_en, height)
    found = nav_state.corrected(state, away, (0.1, -0.2, 0.3), rotation)
    axes = Rotation.from_quat(q_en)
    moved = axes.inv().apply(np.subtract(nav_state.position_ecef(found), nav_state.position_ecef(state)))
    # a step along a tangent leaves the Earth by its square over twice the radius, 6e-5 m; 0.3 % of it, were the
    # Earth a sphere, are 6e-2 m
    np.testing.assert_allclose(moved, away, atol=2e-4)
    turn = (axes.inv() * Rotation.from_quat(found[7:11])).as_rotvec()
    assert turn[2] == pytest.approx(0.0, abs=1e-15)  # n goes along without turning about the vertical
    np.testing.assert_allclose(found[4:7], [3.1, -4.2, 0.8], rtol=1e-15)
    on_n = (Rotation.from_quat(found[:4]) * Rotation.from_quat(state[:4]).inv()).as_rotvec()
    np.testing.assert_allclose(on_n, rotation, atol=1e-14)
    for q in (found[:4], found[7:11]):
        assert math.hypot(*q) == pytest.approx(1.0, abs=1e-15)


def test_corrected_by_nothing_is_the_same() -> None:
    state = nav_state.initial_state(1.0, 0.5, 100.0, (3.0, 4.0, 0.0), attitude.from_euler(0.1, -0.2, 2.0))
    np.testing.assert_allclose(nav_state.corrected(state), state, rtol=1e-15, atol=1e-16)  # norms are renewed
