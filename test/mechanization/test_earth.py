"""Earth: against PROJ, pyins and the potential of the ellipsoid itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import legendre

from ins_nav.mechanization import earth

pyins_earth = pytest.importorskip("pyins.earth")
GEODETIC_TO_ECEF = pytest.importorskip("pyproj").Transformer.from_crs("EPSG:4979", "EPSG:4978")
LATITUDES = st.floats(-90.0, 90.0)
LONGITUDES = st.floats(-180.0, 180.0)
HEIGHTS = st.floats(-11e3, 40e3)


@given(LATITUDES, LONGITUDES, HEIGHTS)
def test_position_is_that_of_proj(lat: float, lon: float, height: float) -> None:
    position = earth.geodetic_to_ecef(math.radians(lat), math.radians(lon), height)
    # two roundings of an Earth radius: 1e-9 m each
    np.testing.assert_allclose(position, GEODETIC_TO_ECEF.transform(lat, lon, height), rtol=0, atol=5e-9)


@given(LATITUDES)
def test_radii_are_those_of_pyins(lat: float) -> None:
    meridian, prime_vertical, _ = pyins_earth.principal_radii(lat, 0.0)
    # pyins rounds its constants to 1e-11 of their size
    assert earth.principal_radii(math.sin(math.radians(lat))) == pytest.approx((meridian, prime_vertical), rel=1e-10)


@given(LATITUDES, LONGITUDES, HEIGHTS)
def test_axes_and_radii_are_the_derivatives_of_position(lat: float, lon: float, height: float) -> None:
    lat, lon = math.radians(lat), math.radians(lon)
    axes = earth.enu_axes(lat, lon)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) > 0.0
    meridian, prime_vertical = earth.principal_radii(math.sin(lat))
    step = 1e-5

    def change(dlat: float, dlon: float, dheight: float) -> np.ndarray:
        ahead = earth.geodetic_to_ecef(lat + dlat, lon + dlon, height + dheight)
        return ahead - earth.geodetic_to_ecef(lat - dlat, lon - dlon, height - dheight)

    # 64 m steps: truncation 64 m * step² / 6 = 1e-9 m, rounding 4e-9 m
    arc = (prime_vertical + height) * math.cos(lat)
    np.testing.assert_allclose(change(0.0, step, 0.0), 2.0 * step * arc * axes[:, 0], atol=1e-8)
    np.testing.assert_allclose(change(step, 0.0, 0.0), 2.0 * step * (meridian + height) * axes[:, 1], atol=1e-8)
    np.testing.assert_allclose(change(0.0, 0.0, 10.0), 20.0 * axes[:, 2], atol=1e-8)


def _potential(position: np.ndarray) -> float:
    """Of normal gravity: the ellipsoid's even zonal harmonics (NIMA TR8350.2, 3-73 and 5-2), and rotation."""
    radius = float(np.linalg.norm(position))
    e2, j2 = earth.ECCENTRICITY_SQUARED, 1.082629821313e-3
    series = np.zeros(13)
    for n in range(1, 7):
        j = (-1) ** (n + 1) * 3.0 * e2**n / ((2 * n + 1) * (2 * n + 3)) * (1.0 - n + 5.0 * n * j2 / e2)
        series[2 * n] = j * (earth.SEMI_MAJOR_AXIS / radius) ** (2 * n)
    gravitation = earth.GM / radius * (1.0 - legendre.legval(position[2] / radius, series))
    return float(gravitation + 0.5 * earth.RATE**2 * (position[0] ** 2 + position[1] ** 2))


@pytest.mark.parametrize("height", [-1000.0, 0.0, 150.0, 10e3])
@pytest.mark.parametrize("lat", [-90.0, -45.0, 0.0, 30.0, 60.0, 89.0])
def test_gravity_is_the_gradient_of_the_potential(lat: float, height: float) -> None:
    lat = math.radians(lat)
    position, axes = earth.geodetic_to_ecef(lat, 0.4, height), earth.enu_axes(lat, 0.4)
    step = 20.0  # rounding 6e7 * 1e-16 / 20 = 3e-10, truncation g (step / R)² = 1e-10
    east, north, up = (
        (_potential(position + step * axis) - _potential(position - step * axis)) / (2.0 * step) for axis in axes.T
    )
    # the formula's linear term neglects the flattening squared: 1.13e-10 1/s² measured (7e-8 of gravity at 10 km)
    assert earth.normal_gravity(math.sin(lat), height) == pytest.approx(-up, abs=1e-9 + 1.2e-10 * abs(height))
    # a constant of three digits: 0.8 % of 8e-5 m/s² at 10 km measured
    linear = earth.NORTH_GRAVITY_PER_METRE * height * math.sin(2.0 * lat)
    assert north == pytest.approx(linear, abs=1e-9 + 7e-11 * abs(height))
    assert east == pytest.approx(0.0, abs=1e-9)


def test_functions_take_arrays() -> None:
    lat = np.radians([-90.0, 0.0, 37.0, 90.0])
    height = np.array([0.0, 1.0, 2.0, 3.0])
    gravity = earth.normal_gravity(np.sin(lat), height)
    positions = earth.geodetic_to_ecef(lat, 0.1, height)
    for i in range(len(lat)):
        assert gravity[i] == pytest.approx(earth.normal_gravity(math.sin(lat[i]), height[i]), rel=1e-15)
        np.testing.assert_allclose(positions[i], earth.geodetic_to_ecef(lat[i], 0.1, height[i]), atol=1e-9)
    # of the poles and the equator, from the definition of WGS-84
    np.testing.assert_allclose(gravity[[0, 1]], [earth.POLAR_GRAVITY, earth.EQUATORIAL_GRAVITY], atol=4e-6)
    np.testing.assert_allclose(np.abs(positions[[0, 3], 2]), [6356752.3142, 6356755.3142], atol=1e-4)


def test_gravity_under_water() -> None:
    """The gradient measured in deep water is 0.222 mGal/m, that of the free air 0.309 mGal/m."""
    heights = np.array([200.0, 100.0, 99.0, -900.0])
    in_air, in_water = earth.normal_gravity(0.5, heights), earth.normal_gravity(0.5, heights, 100.0)
    np.testing.assert_array_equal(in_water[:2], in_air[:2])
    assert in_water[2] - in_water[1] == pytest.approx(0.222e-5, rel=0.01)
    assert in_air[2] - in_air[1] == pytest.approx(0.309e-5, rel=0.01)
    assert (in_air[3] - in_water[3]) / 9.80665 == pytest.approx(88e-6, rel=0.01)
    assert earth.known_surface(math.nan) == earth.NO_WATER and earth.known_surface(-3.0) == -3.0
