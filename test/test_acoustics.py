"""A beacon that floats: followed, with a variance that is true; one that is moored."""

import math

import numpy as np
import pytest

from ins_nav import earth
from ins_nav.acoustics import Beacon

LAT, LON = 0.97, 0.6
SECOND = 10**9


def test_moored() -> None:
    beacon = Beacon((LAT, LON, -50.0), 1.0)
    place = beacon.at(5)
    assert place is not None and place[1] == 0.0
    np.testing.assert_array_equal(place[0], earth.geodetic_to_ecef(LAT, LON, -50.0))


def test_nothing_is_known_before_the_first_fix() -> None:
    assert Beacon(None, 1.0).at(0) is None


def _geodetic(east: float, north: float) -> tuple[float, float, float]:
    meridian, prime_vertical = earth.principal_radii(math.sin(LAT))
    return LAT + north / meridian, LON + east / (prime_vertical * math.cos(LAT)), 0.0


def test_followed_round_a_circle_with_a_true_variance() -> None:
    """1 m/s round 50 m, fixes of 0.5 m each second; looked at between them and a second before the last."""
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(10):
        beacon = Beacon(None, 1.0 / math.sqrt(2.0))
        phase = rng.uniform(0.0, 6.3)
        for second in range(200):
            angle = phase + second / 50.0
            place = _geodetic(*(50.0 * np.array([math.cos(angle), math.sin(angle)]) + 0.5 * rng.standard_normal(2)))
            beacon.take(second * SECOND, *place, 0.25 * np.eye(3))
            at = second + rng.uniform(-0.5, 0.8)
            angle = phase + at / 50.0
            found = beacon.at(round(at * SECOND))
            assert found is not None
            true = earth.geodetic_to_ecef(*_geodetic(50.0 * math.cos(angle), 50.0 * math.sin(angle)))
            if second > 20:
                off = earth.enu_axes(LAT, LON).T @ (found[0] - true)
                ratios.append(off[:2] / math.sqrt(found[1]))
    # 3600 ratios, neighbours alike for some 5 s: 3 %; a circle is smoother than a process with such a velocity
    assert 0.75 < float(np.sqrt(np.mean(np.square(ratios)))) < 1.05


def test_the_variance_grows_with_age() -> None:
    sigmas = []
    for second in (0, 1, 10, 100):
        beacon = Beacon(None, 1.0)
        beacon.take(0, LAT, LON, 0.0, np.eye(3))
        first, again = beacon.at(second * SECOND), beacon.at(second * SECOND)
        assert first is not None and again is not None
        assert again[1] == 2.0 * first[1]  # the same error once more
        sigmas.append(math.sqrt(first[1]))
    # velocity unknown by 1 m/s: at first as time, then as its root
    assert sigmas[:2] == pytest.approx([1.0, math.sqrt(2.0)], rel=0.01)
    assert 8.0 < sigmas[2] < 10.1 and 50.0 < sigmas[3] < 80.0
    still = Beacon(None, 0.0)
    for second in range(4):
        still.take(second * SECOND, LAT, LON, 0.0, np.eye(3))
    place = still.at(1000 * SECOND)
    assert place is not None and place[1] == pytest.approx(0.25)
