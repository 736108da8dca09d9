"""A floating beacon, tracked by the filter with a true covariance; a moored one."""

import math

import numpy as np
import pytest

from ins_nav.aiding.beacon import Beacon
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import ErrorModel
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import SIZE
from ins_nav.mechanization import earth, nav_state

LAT, LON = 0.97, 0.6
SECOND = 10**9
NONE = (0.0, 0.0, 0.0)
MODEL = ErrorModel(vertical=True, gyro_noise=1e-6, accel_noise=1e-4)
STATE = nav_state.initial_state(LAT, LON, 0.0, NONE, (0.0, 0.0, 0.0, 1.0))


def _filter(beacon: Beacon) -> ErrorFilter:
    return ErrorFilter(MODEL, (1.0,) * 3, (0.1,) * 3, 1e-6 * np.eye(3), {"ship": beacon.states})


def _geodetic(east: float, north: float) -> tuple[float, float, float]:
    meridian, prime_vertical = earth.principal_radii(math.sin(LAT))
    return LAT + north / meridian, LON + east / (prime_vertical * math.cos(LAT)), 0.0


def _fix(
    kalman: ErrorFilter,
    beacon: Beacon,
    east: float,
    north: float,
    stddev: float,
    ago: float = 0.0,
    stamp_ns: int = 0,
) -> None:
    fix = beacon.measure(kalman.own("ship"), stamp_ns, _geodetic(east, north), stddev**2 * np.eye(3), ago)
    assert kalman.update("ship", 0, fix).accepted
    kalman.feed_back(STATE, NONE, NONE)


def _place(kalman: ErrorFilter, beacon: Beacon, ago: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """East and north of its past place, and their covariance."""
    axes = earth.enu_axes(LAT, LON)[:, :2]
    # what was not fed back yet is still an error of the states in use
    own = kalman.own("ship") - kalman.x[-6:]
    place = beacon.at(own, ago)
    assert place is not None
    way = np.vstack([beacon.columns(axis, ago) for axis in axes.T])
    return axes.T @ (place - earth.geodetic_to_ecef(LAT, LON, 0.0)), way @ kalman.own_covariance("ship") @ way.T


def test_moored() -> None:
    beacon = Beacon((LAT, LON, -50.0), 1.0)
    assert beacon.moored and beacon.states == () and beacon.columns(np.ones(3), 1.0).size == 0
    beacon.restart()
    np.testing.assert_array_equal(beacon.at(np.zeros(0), 5.0), earth.geodetic_to_ecef(LAT, LON, -50.0))


def test_no_place_before_the_first_fix_and_after_a_restart() -> None:
    beacon = Beacon(None, 1.0)
    assert beacon.at(np.zeros(6), 0.0) is None
    _fix(_filter(beacon), beacon, 3.0, 4.0, 1.0)
    assert beacon.at(np.zeros(6), 0.0) is not None
    beacon.restart()
    assert beacon.at(np.zeros(6), 0.0) is None


def test_track_round_a_circle_has_a_true_covariance() -> None:
    """1 m/s round 50 m, fixes of 0.5 m each second; compared half a second after each, and in the past."""
    rng = np.random.default_rng(0)
    squares = []
    for _ in range(5):
        beacon = Beacon(None, 1.0 / math.sqrt(2.0))
        kalman, phase = _filter(beacon), rng.uniform(0.0, 6.3)
        for second in range(100):
            angle = phase + second / 50.0
            here = 50.0 * np.array([math.cos(angle), math.sin(angle)])
            _fix(kalman, beacon, *(here + 0.5 * rng.standard_normal(2)), 0.5)
            kalman.propagate(STATE, STATE, 0.5)
            if second > 20:
                for ago in (0.0, 0.5):
                    found, covariance = _place(kalman, beacon, ago)
                    angle = phase + (second + 0.5 - ago) / 50.0
                    off = found - 50.0 * np.array([math.cos(angle), math.sin(angle)])
                    squares.append(off @ np.linalg.solve(covariance, off) / 2.0)
            kalman.propagate(STATE, STATE, 0.5)
    # 800 squares, neighbours alike for some 5 s: 6 %; a circle is smoother than a process with such a velocity
    assert 0.6 < float(np.sqrt(np.mean(squares))) < 1.1


def test_sigma_grows_with_time() -> None:
    sigmas = []
    for seconds in (0, 1, 10, 100):
        beacon = Beacon(None, 1.0)
        kalman = _filter(beacon)
        _fix(kalman, beacon, 0.0, 0.0, 1.0)
        for _ in range(10 * seconds):
            kalman.propagate(STATE, STATE, 0.1)
        sigmas.append(math.sqrt(_place(kalman, beacon)[1][0, 0]))
    # velocity unknown by 1 m/s: at first as time, then as its root: 2 tau^2 (t / tau - 1 + exp(-t / tau))
    least = [math.hypot(1.0, math.sqrt(1800.0 * (t / 30.0 - 1.0 + math.exp(-t / 30.0)))) for t in (0, 1, 10, 100)]
    assert sigmas == pytest.approx(least, rel=2e-3)


def test_a_late_fix_has_the_information_of_one_in_time() -> None:
    """10 s late, the only fix of a beacon: equal to an update in time and propagation since."""
    found = []
    for late in (False, True):
        beacon = Beacon(None, 2.0)
        kalman = _filter(beacon)
        if not late:
            _fix(kalman, beacon, 7.0, -3.0, 0.5)
        for _ in range(100):
            kalman.propagate(STATE, STATE, 0.1)
        if late:
            _fix(kalman, beacon, 7.0, -3.0, 0.5, 10.0)
        place, covariance = _place(kalman, beacon)
        np.testing.assert_allclose(place, [7.0, -3.0], atol=1e-3)
        found.append(covariance)
    # steps of 0.1 s against the integral; the prior is 10 km
    np.testing.assert_allclose(found[1], found[0], rtol=5e-3, atol=1e-2)


def test_late_fixes_among_ranges_have_a_true_covariance() -> None:
    """20 s late once a second: the error of the way since is nearly the same for successive fixes."""
    speed, tau, step, late = 1.0, 30.0, 0.25, 20.0
    squares = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        kept = math.exp(-step / tau)
        velocity = speed * rng.standard_normal(2)
        way = [np.zeros(2)]
        for _ in range(1000):
            way.append(way[-1] + step * velocity)
            velocity = kept * velocity + speed * math.sqrt(1.0 - kept**2) * rng.standard_normal(2)
        beacon = Beacon(None, speed)
        kalman, axes = _filter(beacon), earth.enu_axes(LAT, LON)
        for i, here in enumerate(way):
            then = i - round(late / step)
            if then >= 0 and i % 4 == 0:
                place = way[then] + 0.5 * rng.standard_normal(2)
                _fix(kalman, beacon, *place, 0.5, late, round(then * step * SECOND))
            elif then >= 0 and i % 20 == 7:  # a measure of its place along one axis
                side = i // 20 % 2
                found = _place(kalman, beacon)[0][side]
                z = np.array([found - here[side] + 0.5 * rng.standard_normal()])
                columns = beacon.columns(axes[:, side], 0.0)[None]
                kalman.feed_back(STATE, NONE, NONE)
                kalman.update("ship", 0, Measurement(z, np.zeros((1, SIZE)), np.array([[0.25]]), None, columns))
                kalman.feed_back(STATE, NONE, NONE)
            if i * step > 60.0 and i % 4 == 2:
                found, covariance = _place(kalman, beacon)
                squares.append((found - here) @ np.linalg.solve(covariance, found - here) / 2.0)
            kalman.propagate(STATE, STATE, step)
    # some 20 independent places of two components: 11 %
    assert 0.7 < math.sqrt(np.mean(squares)) < 1.4
