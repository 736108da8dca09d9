"""Signs, axes and unit at rest: each fault is named, in both hemispheres and at any attitude; a good IMU passes."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.alignment.axes_check import axes_fault
from ins_nav.alignment.gravity_cone import Blocks, GravityCone
from ins_nav.mechanization.earth import RATE

G, H, COUNT = 9.81, 0.02, 3000
PER_HOUR = math.radians(1.0) / 3600.0
LATITUDES = [55.7, -34.0]
Fault = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _blocks(
    rpy: tuple[float, float, float],
    latitude: float,
    fault: Fault | None = None,
    noise: float = 0.01 * PER_HOUR,
    bias: float = 0.0,
    rocking: float = 0.0,
    seed: int = 0,
) -> Blocks:
    """A minute of a base at an attitude (yaw, pitch, roll in degrees); noise of the gyros in rad/s over a second."""
    rng = np.random.default_rng(seed)
    lat = math.radians(latitude)
    attitude = Rotation.from_euler("ZYX", rpy, degrees=True)
    earth = attitude.inv().apply([0.0, RATE * math.cos(lat), RATE * math.sin(lat)])
    rate = earth + bias + noise / math.sqrt(H) * rng.standard_normal((COUNT, 3))
    rate += rocking * np.cos(0.7 * H * np.arange(COUNT))[:, None]
    force = attitude.inv().apply([0.0, 0.0, G]) + 0.01 * rng.standard_normal((COUNT, 3))
    if fault is not None:
        rate, force = fault(rate, force)
    cone = GravityCone(COUNT * H)
    samples = [(H, *row) for row in np.c_[rate, force].tolist()]
    for previous, sample in zip([samples[0], *samples], samples, strict=False):
        cone.add(previous, sample, False)
    return cone.blocks()


def _fault(blocks: Blocks, latitude: float, bias_stddev: float = 0.05) -> str:
    return axes_fault(blocks, math.radians(latitude), bias_stddev * PER_HOUR)


@pytest.mark.parametrize("latitude", [*LATITUDES, 0.0, 89.0])
@pytest.mark.parametrize("rpy", [(30.0, 2.0, -1.0), (-120.0, 0.0, 180.0), (75.0, 80.0, 10.0)])
def test_a_good_imu_passes_at_any_attitude(rpy: tuple[float, float, float], latitude: float) -> None:
    assert _fault(_blocks(rpy, latitude), latitude) == ""


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("yaw", [10.0, 140.0, -100.0])
def test_an_inverted_force_is_named(yaw: float, latitude: float) -> None:
    blocks = _blocks((yaw, 2.0, -1.0), latitude, lambda rate, force: (rate, -force))
    assert "linear_acceleration points down at rest" in _fault(blocks, latitude)


@pytest.mark.parametrize("latitude", LATITUDES)
def test_inverted_rates_are_named(latitude: float) -> None:
    blocks = _blocks((30.0, 2.0, -1.0), latitude, lambda rate, force: (-rate, force))
    assert "angular_velocity or linear_acceleration has the wrong sign" in _fault(blocks, latitude)


@pytest.mark.parametrize(("order", "name"), [([0, 2, 1], "y and z"), ([2, 1, 0], "x and z")])
def test_swapped_axes_are_named(order: list[int], name: str) -> None:
    """The swap of x and y does not show at rest and level."""
    blocks = _blocks((160.0, 2.0, -1.0), 55.7, lambda rate, force: (rate[:, order], force))
    assert f"are axes {name} of one of the two swapped?" in _fault(blocks, 55.7)


def test_axes_in_another_order_are_refused() -> None:
    blocks = _blocks((100.0, 2.0, -1.0), 55.7, lambda rate, force: (rate[:, [1, 2, 0]], force))
    assert "not on the same axes" in _fault(blocks, 55.7)


def test_degrees_per_second_are_named() -> None:
    blocks = _blocks((30.0, 2.0, -1.0), 55.7, lambda rate, force: (np.degrees(rate), force))
    assert "degrees per second" in _fault(blocks, 55.7)


@pytest.mark.parametrize("inverted", [1.0, -1.0])
def test_gyros_too_coarse_for_the_earth_rate_are_not_checked(inverted: float) -> None:
    """By their noise, by the sigma of their bias, and by a bias far over it."""

    def fault(rate: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return inverted * rate, force

    attitude = (30.0, 2.0, -1.0)
    assert _fault(_blocks(attitude, 55.7, fault, noise=30.0 * PER_HOUR), 55.7) == ""
    assert _fault(_blocks(attitude, 55.7, fault), 55.7, bias_stddev=3.0) == ""
    assert _fault(_blocks(attitude, 55.7, fault, bias=100.0 * PER_HOUR), 55.7) == ""


def test_a_rocking_base_is_not_checked() -> None:
    blocks = _blocks((30.0, 2.0, -1.0), 55.7, lambda rate, force: (-rate, force), rocking=0.05)
    assert _fault(blocks, 55.7) == ""


def test_false_alarms() -> None:
    """300 alignments with the noise at which the test just applies: 1e-4 a test is stated."""
    noise = 0.4 * PER_HOUR * math.sqrt(60.0)
    assert [_fault(_blocks((7.0 * i, 2.0, -1.0), 55.7, noise=noise, seed=i), 55.7) for i in range(300)] == [""] * 300
