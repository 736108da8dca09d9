"""Quaternions on scalars against scipy."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import attitude
from ins_nav.mechanization.attitude import Quaternion

ANGLES = st.floats(-math.pi, math.pi)
NUMBERS = st.floats(-1e3, 1e3)
PARTS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 1e-3)
QUATERNIONS = PARTS.map(attitude.normalized)


def _angle(p: Quaternion | Rotation, q: Quaternion | Rotation) -> float:
    """Between two attitudes, rad."""
    p, q = (x if isinstance(x, Rotation) else Rotation.from_quat(x) for x in (p, q))
    return float((p * q.inv()).magnitude())


@given(PARTS)
def test_normalized_has_unit_length_and_the_same_direction(parts: Quaternion) -> None:
    q = attitude.normalized(parts)
    np.testing.assert_allclose(math.hypot(*q), 1.0, rtol=1e-15)
    np.testing.assert_allclose(np.array(q) * math.hypot(*parts), parts, atol=1e-15)


@given(st.tuples(ANGLES, ANGLES, ANGLES), st.sampled_from([1.0, 1e-2, 1e-3, 6e-4, 1e-6, 1e-12, 0.0]))
def test_from_rotation_vector(vector: tuple[float, float, float], size: float) -> None:
    x, y, z = (size * component for component in vector)  # on both sides of the border of the series
    q = attitude.from_rotation_vector(x, y, z)
    # rounding
    np.testing.assert_allclose(q, Rotation.from_rotvec([x, y, z]).as_quat(), rtol=1e-13, atol=1e-16)


@given(QUATERNIONS, QUATERNIONS)
def test_multiply_and_conjugate(p: Quaternion, q: Quaternion) -> None:
    assert _angle(attitude.multiply(p, q), Rotation.from_quat(p) * Rotation.from_quat(q)) < 1e-14
    assert _angle(attitude.conjugate(p), Rotation.from_quat(p).inv()) < 1e-14
    np.testing.assert_allclose(attitude.multiply(p, attitude.conjugate(p)), (0.0, 0.0, 0.0, 1.0), atol=1e-15)


@given(QUATERNIONS, st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_rotate(q: Quaternion, vector: tuple[float, float, float]) -> None:
    turned = attitude.rotate(q, *vector)
    # a few roundings of the vector's length
    np.testing.assert_allclose(turned, Rotation.from_quat(q).apply(vector), atol=1e-14 * (1.0 + math.hypot(*vector)))


@given(ANGLES, ANGLES, ANGLES)
def test_from_euler_is_yaw_pitch_roll_about_moving_axes(roll: float, pitch: float, yaw: float) -> None:
    assert _angle(attitude.from_euler(roll, pitch, yaw), Rotation.from_euler("ZYX", [yaw, pitch, roll])) < 1e-14


@given(ANGLES, st.floats(-1.57, 1.57), ANGLES)
def test_to_euler_gives_the_angles_back(roll: float, pitch: float, yaw: float) -> None:
    back = attitude.to_euler(attitude.from_euler(roll, pitch, yaw))
    # 0.0008 rad from the vertical the angles are a thousand times less certain than the quaternion
    error = [math.remainder(a - b, 2.0 * math.pi) for a, b in zip(back, (roll, pitch, yaw), strict=True)]
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


@given(QUATERNIONS)
def test_to_euler_loses_nothing_of_any_attitude(q: Quaternion) -> None:
    roll, pitch, yaw = attitude.to_euler(q)
    assert abs(roll) <= math.pi and abs(pitch) <= 0.5 * math.pi + 1e-15 and abs(yaw) <= math.pi
    assert _angle(attitude.from_euler(roll, pitch, yaw), q) < 1e-14


@given(ANGLES, ANGLES, st.sampled_from([0.0, 1e-15, 1e-9, 1e-7, 1e-4]), st.sampled_from([-1.0, 1.0]))
def test_to_euler_at_the_vertical(roll: float, yaw: float, off: float, side: float) -> None:
    """Bow straight up or down: roll and yaw are not unique there, the attitude is."""
    q = attitude.from_euler(roll, side * (0.5 * math.pi - off), yaw)
    assert _angle(attitude.from_euler(*attitude.to_euler(q)), q) < 1e-14


@given(st.floats(-10.0, 10.0))
def test_heading(yaw: float) -> None:
    heading = attitude.heading_from_yaw(yaw)
    assert 0.0 <= heading <= 2.0 * math.pi
    forward = attitude.rotate(attitude.from_euler(0.0, 0.0, yaw), 1.0, 0.0, 0.0)
    np.testing.assert_allclose(forward, (math.sin(heading), math.cos(heading), 0.0), atol=1e-14)
    back = attitude.heading_from_yaw(heading)
    assert abs(math.remainder(back - yaw, 2.0 * math.pi)) < 1e-14
