"""GNSS position: lever arm, slow error, height that is not measured, the pole."""

import math

import aid_messages
import numpy as np
import pytest
from aid_harness import (
    ARM,
    COVARIANCE,
    LAT,
    LON,
    SOLUTION,
    STATE,
    ZERO,
    aids_of,
    at,
    flight,
    observed,
    of,
    own_of,
    state_at,
)
from scipy.spatial.transform import Rotation

from ins_nav.aiding.gnss import Gnss, GnssParameters, GnssReceiver
from ins_nav.estimation.error_model import Vector
from ins_nav.estimation.observation import Solution
from ins_nav.estimation.state_layout import POSITION, SIZE
from ins_nav.mechanization import nav_state


def a_gnss(arm: Vector) -> Gnss:
    return Gnss(GnssParameters(lever_arm=arm))


def test_fix_at_the_antenna_has_no_innovation() -> None:
    """A lever arm of 2 m forward: the antenna is there."""
    found = aids_of({"gnss.lever_arm": [2.0, 0.0, 0.0]})["gnss"]
    away = nav_state.corrected(STATE, (2.0 * math.cos(0.4), 2.0 * math.sin(0.4), 0.0))
    there = nav_state.geodetic(away)
    seen = found.measure(SOLUTION, own_of(), observed("gnss", there.lat, there.lon, there.height))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-6  # the Earth is round: 2 m squared over its radius


def test_slow_error_of_a_fix_is_removed() -> None:
    found = aids_of({"gnss.slow_stddev": 2.0})["gnss"]
    where = nav_state.geodetic(STATE)
    seen = found.measure(SOLUTION, own_of(1.0, -2.0, 3.0), observed("gnss", where.lat, where.lon, where.height))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [1.0, -2.0, 3.0], atol=1e-6)


def test_truth_has_no_innovation() -> None:
    motion, time = flight()
    path = motion.trajectory(100.0)
    fix = GnssReceiver(100.0, 0.0, 0.0, ARM).fixes(path, np.arange(len(path.time)), 0)
    i = round(100 * time)
    measurement = of(a_gnss(ARM), fix.lat[i], fix.lon[i], fix.height[i])(at(time)[0], np.zeros(0))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=2e-6)  # arm²/2R


def test_covariance_is_turned_to_n() -> None:
    """Sigma 1 m east, 2 m north; n is turned by 0.4 rad."""
    measurement = of(a_gnss(ARM), LAT, LON, 31.0)(Solution(state_at(), ZERO, ZERO, True, 0.0), np.zeros(0))
    assert measurement is not None
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()  # n to east-north-up
    np.testing.assert_allclose(turn @ measurement.r @ turn.T, COVARIANCE, atol=1e-12)
    assert measurement.direct == POSITION


def test_height_that_is_not_measured() -> None:
    flat = of(a_gnss(ZERO), LAT, LON, math.nan)(Solution(state_at(), ZERO, ZERO, True, 0.0), np.zeros(0))
    assert flat is not None and np.isfinite(flat.innovation).all()
    assert flat.innovation.shape == (2,) and flat.h.shape == (2, SIZE) and flat.r.shape == (2, 2)


@pytest.mark.parametrize("lat_deg", [90.0, -90.0, 89.99999])
def test_pole(lat_deg: float) -> None:
    """A fix some metres away, over the pole: the innovation is those metres."""
    state = nav_state.initial_state(math.radians(lat_deg), 0.3, 5.0, ZERO, (0.0, 0.0, 0.0, 1.0))
    moved = nav_state.corrected(state, (30.0, -40.0, 7.0))
    where = nav_state.geodetic(moved)
    solution = Solution(state, ZERO, ZERO, True, 0.0)
    measurement = of(a_gnss(ZERO), where.lat, where.lon, where.height)(solution, np.zeros(0))
    np.testing.assert_allclose(measurement.innovation, [-30.0, 40.0, -7.0], atol=1e-3)


def test_place_to_align_at() -> None:
    aid = a_gnss(ARM)
    place = aid.place(aid.observe(aid_messages.FIX(0, 0, 60.0, 30.0, math.nan, (1.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0))))
    assert place.lat == math.radians(60.0) and math.isnan(place.height)
    # the variance of a height that is not measured is ignored
    assert place.stddev == (2.0, 2.0, 3.0) and place.lever_arm == ARM
