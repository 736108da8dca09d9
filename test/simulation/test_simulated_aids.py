"""Simulated aids against differences of the motion, plane geometry and statistics; the mission `auv_dive`."""

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.aiding import measurements
from ins_nav.cli.simulate import main
from ins_nav.errors import InsNavError
from ins_nav.estimation.error_model import SlowState
from ins_nav.estimation.observation import Solution
from ins_nav.mechanization import earth, nav_state
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.aids import SimulatedAids, measure_aids
from ins_nav.simulation.motion import Motion, constant, integral_of_profile, sinusoid, smooth_profile
from ins_nav.simulation.parameters import SHARED, resolved
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import START_NS, Simulation, simulate
from ins_nav.simulation.trajectory import EarthMotion, Origin, Trajectory

NS = 10**9
ORIGIN = Origin(math.radians(55.7), math.radians(37.6), -20.0)
EXACT: dict[str, Any] = {
    "gnss.rate": 5.0,
    "gnss.velocity_rate": 5.0,
    "gnss.velocity_stddev": 0.0,
    "log.rate": 5.0,
    "log.noise_stddev": 0.0,
    "depth.rate": 5.0,
    "depth.noise_stddev": 0.0,
    "pressure.rate": 5.0,
    "pressure.noise_stddev": 0.0,
    "beacon.names": "down, vessel",
    "beacon.positions": (0.0, 0.0, -120.0, 300.0, 400.0, -2.0),
    "beacon.radii": (0.0, 50.0),
    "beacon.fix_rates": (0.0, 1.0),
    "beacon.fix_stddev": 0.0,
    "range.rate": 5.0,
    "range.noise_stddev": 0.0,
}
ARM = (1.0, -2.0, 3.0)
_close = functools.partial(np.testing.assert_allclose, rtol=0)


@functools.cache
def _swimmer() -> EarthMotion:
    """Something that turns about all axes while it goes on, 20 m below the ellipsoid."""
    motion = Motion(
        60.0,
        speed=constant(1.5) + sinusoid(0.3, 13.0),
        yaw=constant(0.7) + sinusoid(0.5, 17.0),
        pitch=sinusoid(0.2, 11.0),
        roll=sinusoid(0.3, 9.0),
        z=sinusoid(2.0, 19.0),
    )
    return EarthMotion(motion, ORIGIN)


@functools.cache
def _path() -> Trajectory:
    return _swimmer().trajectory(20.0)


def _measure(seed: int = 0, trajectory: Trajectory | None = None, **changes: Any) -> SimulatedAids:
    t = _path() if trajectory is None else trajectory
    p = resolved("test", SHARED, {**EXACT, "rate": 1.0 / t.interval, **changes})
    return measure_aids(p, t, START_NS + np.rint(t.time * NS).astype(np.int64), seed)


@functools.cache
def _straight(pitch: float = 0.0) -> Trajectory:
    """20 s to the north at 2 m/s."""
    motion = Motion(20.0, speed=constant(2.0), yaw=constant(0.5 * math.pi), pitch=constant(pitch))
    return EarthMotion(motion, ORIGIN).trajectory(10.0)


def _seconds(stamps_ns: np.ndarray) -> np.ndarray:
    return (stamps_ns - START_NS) / NS


def _velocity_by_difference(times: np.ndarray) -> np.ndarray:
    """Of the place ARM points at, Earth-fixed, m/s: central difference of 4th order."""
    h = 0.05

    def place(t: np.ndarray) -> np.ndarray:
        s = _swimmer().states(t)
        return np.asarray(s.position_e + Rotation.from_quat(s.q_eb).apply(ARM))

    ahead, back = place(times + h) - place(times - h), place(times + 2 * h) - place(times - 2 * h)
    return np.asarray((8.0 * ahead - back) / (12.0 * h))


@pytest.mark.parametrize(
    ("rpy_deg", "expected"),
    [
        ((0.0, 0.0, 0.0), [2.0, 0.0, 0.0]),
        ((0.0, 0.0, 90.0), [0.0, -2.0, 0.0]),  # its x axis points left: forward is to its right
        ((180.0, 0.0, 0.0), [2.0, 0.0, 0.0]),
        ((0.0, 90.0, 0.0), [0.0, 0.0, 2.0]),  # bow down: its x axis points down, its z axis forward
    ],
)
def test_log_mounting(rpy_deg: tuple[float, float, float], expected: list[float]) -> None:
    log = _measure(trajectory=_straight(), **{"log.mounting_rpy_deg": rpy_deg}).log
    # a plane 20 m below the ellipsoid is level: what is left is its scale, 40 m / Earth's radius
    _close(log.velocity, np.tile(expected, (101, 1)), atol=2e-5)


def test_log_reads_the_velocity_of_its_place() -> None:
    log = _measure(**{"log.lever_arm": ARM, "log.mounting_rpy_deg": (10.0, -20.0, 30.0)}).log
    times = _seconds(log.stamps_ns)[1:-1]
    body = Rotation.from_quat(_swimmer().states(times).q_eb)
    sensor = body * Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True)
    # h^4 / 30 times the fifth derivative: 6e-6 / 30 * 3 m * (2 pi / 9 s)^5 * 0.3 rad = 3e-8 m/s; the rounding of
    # places to 1e-9 m over 0.05 s
    _close(log.velocity[1:-1], sensor.inv().apply(_velocity_by_difference(times)), atol=2e-7)
    # the lever arm counts: it swings by some 0.3 m/s
    assert np.abs(log.velocity - _measure().log.velocity).max() > 0.2


def test_log_scale_and_misalignment() -> None:
    true = _measure().log.velocity
    log = _measure(**{"log.scale": 0.01, "log.misalignment_deg": (1.0, -2.0)}).log
    a_y, a_z = math.radians(1.0), math.radians(-2.0)
    matrix = np.array([[1.01, -a_z, a_y], [a_z, 1.01, 0.0], [-a_y, 0.0, 1.01]])  # of ins_nav.aiding.measurements.Log
    _close(log.velocity, true @ matrix.T, atol=1e-14)
    assert (log.scale, log.misalignment) == (0.01, (a_y, a_z))
    drawn = [
        _measure(seed, _straight(), **{"log.scale_stddev": 0.002, "log.misalignment_stddev_deg": 0.1}).log
        for seed in range(200)
    ]
    # 200 values: their standard deviation is known to 5 %, four times that
    assert np.std([log.scale for log in drawn]) == pytest.approx(0.002, rel=0.2)
    assert np.degrees(np.std([log.misalignment for log in drawn])) == pytest.approx(0.1, rel=0.15)


def test_log_noise() -> None:
    noise: dict[str, Any] = {"log.noise_stddev": 0.03, "log.noise_per_speed": 0.02, "log.rate": 20.0}
    log = _measure(**noise)
    exact = _measure(**{"log.rate": 20.0}).log.velocity
    speed = np.linalg.norm(exact, axis=1)
    _close(log.log.stddev, np.hypot(0.03, 0.02 * speed), atol=1e-15)
    # 3603 values: 1.2 %, four times that
    assert ((log.log.velocity - exact) / log.log.stddev[:, None]).std() == pytest.approx(1.0, rel=0.047)


def test_log_through_water() -> None:
    still, log = _measure().log, _measure(**{"log.current": (0.5, -0.2)}).log
    at = Rotation.from_quat(_swimmer().states(_seconds(log.stamps_ns)).q_nb)
    _close(at.apply(still.velocity - log.velocity), np.tile([0.5, -0.2, 0.0], (301, 1)), atol=1e-14)


@pytest.mark.parametrize("lost", ["nan", "zeros", "silent"])
def test_log_loses_the_bottom(lost: str) -> None:
    window: dict[str, Any] = {"log.lost_start": 10.0, "log.lost_duration": 5.0, "log.noise_stddev": 0.01}
    whole = _measure(**{"log.noise_stddev": 0.01}).log
    once = _measure(**window, **{"log.lost": lost}).log
    gone = (_seconds(whole.stamps_ns) >= 10.0) & (_seconds(whole.stamps_ns) < 15.0)
    if lost == "silent":
        np.testing.assert_array_equal(once.stamps_ns, whole.stamps_ns[~gone])
        np.testing.assert_array_equal(once.velocity, whole.velocity[~gone])
    else:
        np.testing.assert_array_equal(once.stamps_ns, whole.stamps_ns)
        np.testing.assert_array_equal(once.velocity[~gone], whole.velocity[~gone])
        np.testing.assert_array_equal(once.velocity[gone], math.nan if lost == "nan" else 0.0)
    again = _measure(**window, **{"log.lost_period": 20.0}).log
    seconds = _seconds(again.stamps_ns)
    gone = (seconds >= 10.0) & ((seconds - 10.0) % 20.0 < 5.0)
    np.testing.assert_array_equal(np.isnan(again.velocity[:, 0]), gone)
    assert gone.sum() == 75  # 10, 30 and 50 s


def test_log_outliers() -> None:
    some: dict[str, Any] = {"log.outlier_share": 0.2, "log.outlier_span": (1.0, 2.0), "log.rate": 20.0}
    off = np.linalg.norm(_measure(**some).log.velocity - _measure(**{"log.rate": 20.0}).log.velocity, axis=1)
    wrong = off > 1e-9
    # 1201 readings: 240 wrong, with a standard deviation of 14, four times that
    assert 184 < wrong.sum() < 296
    assert 1.0 - 1e-9 < off[wrong].min() < 1.1 < 1.9 < off[wrong].max() < 2.0 + 1e-9


def test_depth_and_pressure() -> None:
    surface = -15.0
    t = _path()
    aids = _measure(**{"depth.surface_height": surface, "depth.lever_arm": ARM, "pressure.lever_arm": (0, 0, -1)})
    axes = earth.enu_axes(t.lat[0], t.lon[0])
    at = np.arange(0, 1201, 4)
    # up at the start is up everywhere on these 100 m: 1e-5 rad of the lever arm, 100 m / Earth's radius of the way
    up = (t.position_e[at] + Rotation.from_quat(t.q_eb[at]).apply(ARM) - t.position_e[0]) @ axes[:, 2]
    _close(aids.depth.value, surface - t.height[0] - up, atol=2e-3)
    assert aids.depth.value.mean() == pytest.approx(2.0, abs=0.5)  # 5 m down, the gauge 3 m up
    straight = _measure(trajectory=_straight(), **{"pressure.lever_arm": (0.0, 0.0, -1.0)})
    # 20 m and the lever arm's 1 m, of water of 1025 kg/m³ at 9.81567 m/s² (international formula, 55.7°)
    _close(straight.pressure.value, 101_325.0 + 1025.0 * 9.81567 * 21.0, atol=0.5)
    _close(straight.depth.value, 20.0, atol=1e-4)
    bow_down = _measure(trajectory=_straight(math.radians(30.0)), **{"depth.lever_arm": (2.0, 0.0, 0.0)})
    _close(bow_down.depth.value, 21.0, atol=1e-4)  # a gauge in the bow is deeper then


@pytest.mark.parametrize("name", ["depth", "pressure"])
def test_a_gauge_errs_and_lies(name: str) -> None:
    parameters: dict[str, Any] = {
        f"{name}.noise_stddev": 0.5,
        f"{name}.bias": 2.0,
        f"{name}.bias_stddev": 1.0,
        f"{name}.lie_start": 40.0,
        f"{name}.lie_duration": 10.0,
        f"{name}.lie_offset": 30.0,
    }
    gauge, exact = getattr(_measure(3, **parameters), name), getattr(_measure(), name)
    assert (gauge.stddev, exact.bias) == (0.5, 0.0)
    error = gauge.value - exact.value - gauge.bias
    lies = (_seconds(gauge.stamps_ns) >= 40.0) & (_seconds(gauge.stamps_ns) < 50.0)
    assert lies.sum() == 50
    error[lies] -= 30.0
    # 301 values: mean to 0.03, standard deviation to 4 %; four times that
    assert error.mean() == pytest.approx(0.0, abs=0.12)
    assert error.std() == pytest.approx(0.5, rel=0.17)
    biases = [getattr(_measure(seed, _straight(), **parameters), name).bias for seed in range(100)]
    # 100 values: mean to 0.1, standard deviation to 7 %; four times that
    assert np.mean(biases) == pytest.approx(2.0, abs=0.4)
    assert np.std(biases) == pytest.approx(1.0, rel=0.3)


def test_ranges_are_distances() -> None:
    aids = _measure(**{"range.lever_arm": ARM, "depth.surface_height": -15.0})
    t, at = _path(), np.arange(0, 1201, 4)
    offset = Rotation.from_quat(t.q_nb[at]).apply(ARM)
    axes = np.stack([earth.enu_axes(lat, lon) for lat, lon in zip(t.lat[at], t.lon[at], strict=True)])
    here = earth.geodetic_to_ecef(t.lat[at], t.lon[at], t.height[at]) + np.einsum("nij,nj->ni", axes, offset)
    below = earth.geodetic_to_ecef(ORIGIN.lat, ORIGIN.lon, -15.0 - 120.0)
    # a double resolves an Earth radius to 1e-9 m
    _close(aids.ranges["down"].distance, np.linalg.norm(here - below, axis=1), atol=1e-8)
    vessel = aids.ranges["vessel"]
    there = earth.geodetic_to_ecef(vessel.beacon.lat, vessel.beacon.lon, vessel.beacon.height)
    _close(vessel.distance, np.linalg.norm(here - there, axis=1), atol=1e-8)
    np.testing.assert_array_equal(vessel.beacon.stamps_ns, vessel.stamps_ns)
    # in the tangent plane at the origin; 500 m away it is 0.02 m above the water, and scale is wrong by 1e-5 of it
    origin_e = earth.geodetic_to_ecef(ORIGIN.lat, ORIGIN.lon, -15.0)
    on_plane = (there - origin_e) @ earth.enu_axes(ORIGIN.lat, ORIGIN.lon)
    angle = _seconds(vessel.stamps_ns) / 50.0  # 1 m/s on 50 m
    expected = np.column_stack([300.0 + 50.0 * np.cos(angle), 400.0 + 50.0 * np.sin(angle), np.full(301, -2.0)])
    _close(on_plane, expected, atol=0.03)


def test_beacons_transmit_their_fixes() -> None:
    aids = _measure()
    assert list(aids.beacon_fixes) == ["vessel"]
    fixes, beacon = aids.beacon_fixes["vessel"], aids.ranges["vessel"].beacon
    np.testing.assert_array_equal(fixes.stamps_ns, beacon.stamps_ns[::5])
    for sent, true in zip(fixes[1:4], beacon[1:4], strict=True):
        _close(sent, true[::5], atol=1e-15)  # as written: no noise
    noisy = _measure(1, **{"beacon.fix_stddev": 2.0, "beacon.fix_rates": 20.0})
    assert set(noisy.beacon_fixes) == {"down", "vessel"}
    down = noisy.beacon_fixes["down"]
    away = earth.geodetic_to_ecef(down.lat, down.lon, down.height) - earth.geodetic_to_ecef(
        ORIGIN.lat, ORIGIN.lon, -120.0
    )
    # 3603 values: 1.2 %, four times that
    assert away.std() == pytest.approx(2.0, rel=0.047)
    assert down.stddev == (2.0, 2.0, 2.0)


def test_range_errors() -> None:
    exact = _measure().ranges["vessel"].distance
    scaled = _measure(**{"range.scale": -0.01, "range.bias": 3.0}).ranges["vessel"]
    _close(scaled.distance, 0.99 * exact + 3.0, atol=1e-12)
    assert (scaled.scale, scaled.bias) == (-0.01, 3.0)
    both = _measure(2, **{"range.bias_stddev": 1.0, "range.scale_stddev": 1e-3}).ranges
    assert both["down"].bias != both["vessel"].bias
    assert both["down"].scale == both["vessel"].scale != 0.0  # the water is the same
    noisy = _measure(**{"range.noise_stddev": 0.5, "range.rate": 20.0}).ranges["vessel"]
    error = noisy.distance - _measure(**{"range.rate": 20.0}).ranges["vessel"].distance
    # 1201 values: 2 %, four times that
    assert error.std() == pytest.approx(noisy.stddev, rel=0.082)
    assert not noisy.outlier.any()


def test_range_outliers() -> None:
    plain = _measure(**{"range.rate": 20.0, "range.noise_stddev": 0.5}).ranges["vessel"]
    wrong = _measure(**{"range.rate": 20.0, "range.noise_stddev": 0.5, "range.outlier_share": 0.2}).ranges["vessel"]
    off = wrong.distance - plain.distance
    np.testing.assert_array_equal(off[~wrong.outlier], 0.0)
    size = np.abs(off[wrong.outlier])
    # 1201 ranges: 240 wrong, with a standard deviation of 14; 90 % too long, to 2 %; four times that
    assert 184 < len(size) < 296
    assert (10.0 <= size).all() and (size <= 300.0).all()
    assert np.mean(off[wrong.outlier] > 0.0) == pytest.approx(0.9, abs=0.08)
    near = _measure(**{"range.outlier_share": 1.0, "range.outlier_span": (200.0, 300.0)}).ranges["down"]
    assert near.distance.min() == 0.0  # 100 m less 200 m


def test_replies_come_late_and_not_from_everywhere() -> None:
    ranges = _measure(**{"range.delay_speed": 1500.0}).ranges["vessel"]
    late = (ranges.stamps_ns - ranges.beacon.stamps_ns) / NS
    _close(late, ranges.distance / 1500.0, atol=1e-9)
    assert late.min() > 0.2
    limited = _measure(**{"range.max": 470.0}).ranges
    assert limited["vessel"].distance.max() <= 470.0 < ranges.distance.max()
    assert len(limited["vessel"].distance) == (ranges.distance <= 470.0).sum()
    assert len(limited["down"].distance) == 301


def test_gnss_velocity_is_that_of_the_antenna() -> None:
    gnss = _measure(**{"gnss.lever_arm": ARM}).gnss_velocity
    times = _seconds(gnss.stamps_ns)[1:-1]
    s = _swimmer().states(times)
    axes = np.stack([earth.enu_axes(lat, lon) for lat, lon in zip(s.lat, s.lon, strict=True)])
    expected = np.einsum("nij,ni->nj", axes, _velocity_by_difference(times))
    _close(gnss.velocity[1:-1], expected, atol=2e-7)  # as of the log
    noisy = _measure(**{"gnss.lever_arm": ARM, "gnss.velocity_stddev": 0.1}).gnss_velocity
    # 903 values: 2.4 %, four times that
    assert (noisy.velocity - gnss.velocity).std() == pytest.approx(noisy.stddev, rel=0.1)


def test_gnss_is_lost_under_water() -> None:
    under: dict[str, Any] = {"depth.surface_height": -20.0, "gnss.lost_depth": 0.3, "gnss.lever_arm": (0.0, 0.0, 0.5)}
    all_of_them, some = _measure(), _measure(**under)
    t, at = _path(), np.arange(0, 1201, 4)
    antenna = t.height[at] + Rotation.from_quat(t.q_nb[at]).apply([0.0, 0.0, 0.5])[:, 2]
    seen = antenna >= -20.3
    assert 50 < seen.sum() < 250
    assert len(all_of_them.fixes.lat) == 301
    np.testing.assert_array_equal(some.fixes.stamps_ns, all_of_them.fixes.stamps_ns[seen])
    np.testing.assert_array_equal(some.gnss_velocity.stamps_ns, all_of_them.gnss_velocity.stamps_ns[seen])
    whole = _measure(**under | {"gnss.lost_depth": 100.0})
    np.testing.assert_array_equal(some.fixes.lat, whole.fixes.lat[seen])  # the noise stays


def test_the_filter_means_the_same() -> None:
    """The filter's formulas at the true state: nothing is left of the innovation."""
    rpy_deg = (10.0, -20.0, 30.0)
    mounted: dict[str, Any] = {"log.lever_arm": ARM, "log.mounting_rpy_deg": rpy_deg, "log.scale": 0.01}
    mounted |= {
        "log.misalignment_deg": (1.0, -2.0),
        "log.current": (0.5, -0.2),
        "depth.lever_arm": ARM,
        "depth.surface_height": -15.0,
    }
    mounted |= {"range.lever_arm": ARM, "range.scale": 0.01, "range.bias": 3.0, "gnss.lever_arm": ARM}
    aids, t = _measure(**mounted), _path()
    roll, pitch, yaw = map(math.radians, rpy_deg)
    log = measurements.Log((roll, pitch, yaw), ARM, current=SlowState(1.0))
    depth, gnss = measurements.Depth(ARM), aids.gnss_velocity
    ranged, beacon = aids.ranges["vessel"], measurements.BeaconRange(ARM)
    none = np.zeros((3, 3))
    for k in (1, 100, 250):
        at = 4 * k
        state = nav_state.initial_state(t.lat[at], t.lon[at], t.height[at], tuple(t.velocity_n[at]), tuple(t.q_nb[at]))
        solution = Solution(state, tuple(t.rate[at]), (0.0, 0.0, 0.0), True, 0.0)
        there = earth.geodetic_to_ecef(ranged.beacon.lat[k], ranged.beacon.lon[k], ranged.beacon.height[k])
        seen = (
            log.measure(solution, (0.01, *aids.log.misalignment, 0.5, -0.2), tuple(aids.log.velocity[k]), none),
            depth.measure(solution, aids.depth.value[k], 0.0, -15.0),
            beacon.measure(solution, (0.01, 3.0), there, ranged.distance[k], 0.0),
            measurements.GnssVelocity(ARM).measure(solution, tuple(gnss.velocity[k]), none),
        )
        for measurement in seen:
            assert measurement is not None
            _close(measurement.innovation, 0.0, atol=5e-9)  # a double resolves an Earth radius to 1e-9 m


NOISY: dict[str, Any] = {
    "log.noise_stddev": 0.01,
    "log.scale_stddev": 0.01,
    "log.misalignment_stddev_deg": 1.0,
    "log.current_stddev": 0.1,
    "depth.noise_stddev": 0.05,
    "depth.bias_stddev": 0.1,
    "pressure.noise_stddev": 500.0,
    "beacon.fix_stddev": 1.0,
    "range.noise_stddev": 0.5,
    "range.bias_stddev": 1.0,
    "range.outlier_share": 0.1,
    "gnss.velocity_stddev": 0.1,
}


def _values(aids: SimulatedAids) -> dict[str, np.ndarray]:
    return {
        "fixes": aids.fixes.lat,
        "gnss_velocity": aids.gnss_velocity.velocity,
        "log": aids.log.velocity,
        "depth": aids.depth.value,
        "pressure": aids.pressure.value,
        "down": aids.ranges["down"].distance,
        "vessel": aids.ranges["vessel"].distance,
        "beacon": aids.beacon_fixes["vessel"].lat,
    }


def test_everything_repeats_from_its_seed() -> None:
    first, same, other = (_values(_measure(seed, **NOISY)) for seed in (5, 5, 6))
    for name, values in first.items():
        np.testing.assert_array_equal(values, same[name])
        assert not np.array_equal(values, other[name])


@pytest.mark.parametrize(
    ("change", "touched"),
    [
        ({"log.outlier_share": 0.5}, {"log"}),
        ({"log.rate": 1.0}, {"log"}),
        ({"depth.noise_stddev": 0.0}, {"depth"}),
        ({"pressure.rate": 0.0}, {"pressure"}),
        ({"gnss.rate": 0.0}, {"fixes"}),
        ({"gnss.velocity_rate": 1.0}, {"gnss_velocity"}),
        ({"beacon.fix_stddev": 0.1}, {"beacon"}),
        ({"range.bias_stddev": 0.1}, {"down", "vessel"}),
        ({"beacon.names": "x, vessel"}, {"down"}),
    ],
)
def test_streams_are_apart(change: dict[str, Any], touched: set[str]) -> None:
    before = _measure(5, **NOISY)
    after = _measure(5, **NOISY | change)
    if "x" in after.ranges:
        after.ranges["down"] = after.ranges.pop("x")
    changed = _values(after)
    for name, values in _values(before).items():
        assert np.array_equal(values, changed[name]) == (name not in touched), name


def test_outliers_do_not_touch_the_noise() -> None:
    plain, wrong = (_measure(5, **NOISY | {"range.outlier_share": s}).ranges["vessel"] for s in (0.0, 0.3))
    np.testing.assert_array_equal(plain.distance[~wrong.outlier], wrong.distance[~wrong.outlier])
    fewer = _measure(5, **NOISY).ranges["vessel"]
    assert not (fewer.outlier & ~wrong.outlier).any()  # a larger share: the same and more
    np.testing.assert_array_equal(fewer.distance[fewer.outlier], wrong.distance[fewer.outlier])


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"log.rate": 50.0}, "log.rate 50 Hz is above the IMU's rate; lower it"),
        ({"range.rate": 50.0}, "range.rate 50 Hz is above"),
        ({"beacon.positions": (1.0, 2.0)}, "2 numbers for 2 beacons; give three a beacon"),
        ({"beacon.radii": (1.0, 2.0, 3.0)}, "beacon.radii: 3 numbers for 2 beacons"),
        ({"beacon.names": "a, a"}, "a name twice"),
        ({"beacon.names": "a, 1/b"}, "'1/b' cannot be part of a topic"),
        ({"range.outlier_span": (30.0, 10.0)}, "give the smaller number first"),
        ({"log.lost": "off"}, "one of nan, zeros, silent"),
        ({"beacon.names": 7.0}, "7.0 is not text"),
        ({"beacon.positions": "[1, 2, x]"}, "not a list of numbers"),
        ({"log.lost_duraton": 1.0}, "did you mean log.lost_duration"),
    ],
)
def test_wrong_parameters_are_explained(parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        _measure(**parameters)


def test_lists_are_read_as_they_are_written() -> None:
    for names, positions in (
        ("[a, b]", "[0, 0, -120, 300, 400, -2]"),
        (["a", "b"], [0, 0, -120.0, 300, 400, -2]),
        ("a,b", "0, 0, -120, 300, 400, -2"),
    ):
        assert list(_measure(**{"beacon.names": names, "beacon.positions": positions}).ranges) == ["a", "b"]
    nothing = _measure(**{"beacon.names": "", "beacon.positions": "[]", "beacon.radii": 0.0, "beacon.fix_rates": "0"})
    assert (nothing.ranges, nothing.beacon_fixes) == ({}, {})


def test_nothing_is_there_unless_asked_for() -> None:
    aids = simulate("static", duration=5.0).aids
    assert len(aids.fixes.lat) == 6
    assert not any(len(x.stamps_ns) for x in (aids.gnss_velocity, aids.log, aids.depth, aids.pressure))
    assert (aids.ranges, aids.beacon_fixes) == ({}, {})


def test_integral_of_a_profile() -> None:
    changes = [(1.0, 2.0, 0.3), (3.0, 1.0, -0.1)]
    rate, integral = smooth_profile(0.2, changes), integral_of_profile(0.2, changes)
    t = np.array([0.0, 0.5, 1.7, 3.4, 4.0, 50.0])
    for order in range(3):
        _close(integral(t, order + 1), rate(t, order), atol=1e-13)  # rounding of terms of 10
    # the smooth step is symmetric: half of the way in a change is at the mean of its ends
    _close(integral(t)[[0, 1, 4, 5]], [0.0, 0.1, 0.2 + 0.5 + 0.1, 0.8 - 4.6], atol=1e-14)


DIVE: dict[str, Any] = {"rate": 10.0, "imu.preset": "perfect"}


@functools.cache
def _dive(**changes: Any) -> Simulation:
    return simulate("auv_dive", 1, **DIVE, **changes)


def test_dive_goes_down_and_comes_back() -> None:
    s = _dive()
    t = s.trajectory
    assert t.time[-1] == 300.0 + 120.0 + 3600.0 + 120.0
    below = (t.time > 420.0 + 200.0) & (t.time < 4020.0 - 200.0)
    _close(t.height[below], -50.0, atol=1e-9)
    # as long as it goes on, aside from the slopes
    _close(np.linalg.norm(t.velocity_n[below], axis=1), 1.5, atol=2e-4)  # the plane's scale, 1e-4 at 600 m
    swell = 0.5 * 0.3 + 1e-9
    surface = ((t.time > 310.0) & (t.time < 420.0)) | (t.time > 4020.0)
    assert np.abs(t.height[surface]).max() <= swell
    assert 0.4 < np.abs(t.height[t.time < 300.0]).max() <= 0.5 + 1e-9
    body = Rotation.from_quat(t.q_nb)
    pitch = body.as_euler("ZYX", degrees=True)[:, 1]
    _close(pitch[below], 0.0, atol=1e-9)
    diving = (t.time > 505.0) & (t.time < 560.0)  # the swell is gone
    _close(pitch[diving], 12.0, atol=1e-6)  # bow down
    # it goes where its bow points; the plane bends by 1e-4 rad
    v = body[np.flatnonzero(diving)].inv().apply(t.velocity_n[diving])
    _close(v[:, 1:], 0.0, atol=1e-3)


def test_dive_runs_parallel_legs() -> None:
    t = _dive().trajectory
    place = (t.position_e - t.position_e[0]) @ earth.enu_axes(t.origin.lat, t.origin.lon)
    yaw = np.unwrap(Rotation.from_quat(t.q_nb).as_euler("ZYX")[:, 0])
    rate = np.gradient(yaw, t.time)  # meridians converge: 4e-7 rad/s
    on_leg = (np.abs(rate) < 1e-6) & (t.time > 430.0) & (t.time < 4000.0)
    starts = np.flatnonzero(np.diff(on_leg.astype(int)) == 1) + 1
    legs = [k for k in starts if on_leg[k : k + 1500].all()]
    assert len(legs) >= 13
    legs = legs[1:]  # the first begins in the swell
    along = np.array([math.cos(yaw[legs[0]]), math.sin(yaw[legs[0]])])
    across = np.array([-along[1], along[0]])
    offsets = place[legs, :2] @ across
    _close(np.abs(np.diff(offsets)), 30.0, atol=0.03)  # yaw off by the meridians' convergence, 7e-5 rad of 300 m
    assert np.abs(offsets[-1] - offsets[0]) == pytest.approx(30.0 * (len(legs) - 1), abs=0.1)  # always on
    assert np.ptp(place[legs, :2] @ along) == pytest.approx(300.0, abs=1.0)  # 0.3 s of the turns' smooth ends


def test_dive_has_no_gnss_under_water_but_the_other_aids() -> None:
    s = _dive()
    seconds = _seconds(s.fixes.stamps_ns)
    gap = np.argmax(np.diff(seconds))
    np.testing.assert_array_equal(np.diff(seconds)[[gap - 1, gap + 1]], 1.0)
    assert 420.0 < seconds[gap] < 435.0
    assert 4005.0 < seconds[gap + 1] < 4020.0
    assert (np.diff(np.delete(seconds, range(gap + 1))) == 1.0).all()  # none is missing before and after
    assert (np.diff(seconds[: gap + 1]) == 1.0).all()
    assert len(s.aids.log.velocity) == len(s.aids.depth.value) == 5 * 4140 + 1
    assert len(s.aids.ranges["vessel"].distance) == 4140 // 5 + 1
    assert 40.0 < s.aids.ranges["vessel"].distance.min() < s.aids.ranges["vessel"].distance.max() < 700.0
    assert s.aids.depth.value.max() == pytest.approx(50.0, abs=0.4)  # noise, the lever arm in the swell


def test_dive_aligns_in_swell_with_a_turn() -> None:
    short: dict[str, Any] = {"duration": 310.0}
    yaw = {
        deg: np.unwrap(Rotation.from_quat(_dive(**short, turn_deg=deg).trajectory.q_nb).as_euler("ZYX")[:, 0])
        for deg in (0.0, 180.0, -90.0)
    }
    for deg, angle in yaw.items():
        # meridians converge by 1e-7 rad within the swell
        assert math.degrees(angle[2900] - angle[0]) == pytest.approx(deg, abs=1e-4)
        _close(np.degrees(angle[:1501]), 60.0, atol=1e-4)
    roll = Rotation.from_quat(_dive(**short, turn_deg=0.0).trajectory.q_nb).as_euler("ZYX", degrees=True)[:, 2]
    # sampled every 0.1 s of 11 s
    assert np.abs(roll[:3000]).max() == pytest.approx(5.0, rel=2e-3)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"depth": 500.0, "dive_time": 600.0}, "dive_time 600 s is too short for 500 m: give 3157 s or more"),
        ({"height": 120.0}, "height 120 m is not that of the water, depth.surface_height 0 m; give both"),
        ({"turn_start": 290.0}, "goes beyond alignment_time 300 s"),
    ],
)
def test_a_dive_that_cannot_be_is_explained(parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        simulate("auv_dive", **DIVE, **parameters)


def test_a_short_shallow_dive() -> None:
    lake: dict[str, Any] = {"height": 120.0, "depth.surface_height": 120.0}
    s = simulate("auv_dive", **DIVE, **lake, depth=2.0, dive_time=60.0, alignment_time=30.0, turn_deg=0.0)
    assert s.trajectory.height.min() == pytest.approx(118.0, abs=1e-9)
    assert np.abs(s.trajectory.height[-100:] - 120.0).max() < 0.16
    assert s.aids.depth.value.max() == pytest.approx(2.0, abs=0.4)  # noise, and the gauge 0.1 m up
    assert 150 < len(s.fixes.lat) < 330 - 30


def test_redrawn_along_the_same_trajectory() -> None:
    short: dict[str, Any] = {"rate": 10.0, "duration": 60.0}
    first = simulate("auv_dive", 1, **short)
    again, fresh = first.redrawn(2), simulate("auv_dive", 2, **short)
    assert again.trajectory is first.trajectory
    np.testing.assert_array_equal(again.angular_velocity, fresh.angular_velocity)
    np.testing.assert_array_equal(again.linear_acceleration, fresh.linear_acceleration)
    np.testing.assert_array_equal(again.stamps_ns, fresh.stamps_ns)
    np.testing.assert_array_equal(again.aids.log.velocity, fresh.aids.log.velocity)
    np.testing.assert_array_equal(again.fixes.lat, fresh.fixes.lat)
    assert (again.seed, again.gyro_bias) == (2, fresh.gyro_bias)
    assert again.parameters == fresh.parameters
    changed = first.redrawn(1, **{"log.scale": 0.01, "imu.gyro_noise_deg_per_sqrt_hour": 0.0})
    assert changed.aids.log.scale == pytest.approx(first.aids.log.scale + 0.01, abs=1e-15)
    assert changed.parameters["log.scale"] == 0.01
    np.testing.assert_array_equal(changed.aids.depth.value, first.aids.depth.value)
    for name in ("depth", "imu.preset", "rate"):
        with pytest.raises(InsNavError, match=f"{name} cannot change along a trajectory; simulate auv_dive anew"):
            first.redrawn(1, **{name: 3.0})
    with pytest.raises(InsNavError, match=r"did you mean log\.scale"):
        first.redrawn(1, **{"log.scal": 3.0})


def test_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more: dict[str, Any] = {"gnss.velocity_rate": 1.0, "pressure.rate": 2.0, "log.lost_duration": 1.0}
    s = simulate("auv_dive", 4, rate=10.0, duration=20.0, **more)
    total = write_bag(s, tmp_path / "bag")
    messages: dict[str, list[Any]] = {}
    with BagReader(tmp_path / "bag") as reader:
        types = {name: info.msgtype for name, info in reader.topics.items()}
        counts = {name: info.count for name, info in reader.topics.items()}
        stamps = []
        for raw in reader.messages():
            stamps.append(raw.stamp_ns)
            messages.setdefault(raw.topic, []).append(reader.deserialize(raw))
            at = messages[raw.topic][-1].header.stamp
            assert at.sec * NS + at.nanosec == raw.stamp_ns
    assert stamps == sorted(stamps)
    assert len(stamps) == total
    aids = {
        "/gnss/velocity": ("geometry_msgs/msg/TwistWithCovarianceStamped", 21),
        "/log": ("geometry_msgs/msg/TwistWithCovarianceStamped", 101),
        "/depth": ("geometry_msgs/msg/PoseWithCovarianceStamped", 101),
        "/pressure": ("sensor_msgs/msg/FluidPressure", 41),
        "/range/vessel": ("sensor_msgs/msg/Range", 5),
        "/beacon/vessel/fix": ("sensor_msgs/msg/NavSatFix", 21),
        "/truth/beacon/vessel/fix": ("sensor_msgs/msg/NavSatFix", 5),
    }
    assert {name: (types[name], counts[name]) for name in aids} == aids
    assert len(counts) == len(aids) + 5

    def last(topic: str) -> Any:
        return messages[topic][-1]

    log = last("/log")
    assert log.header.frame_id == "log_link"
    v = log.twist.twist.linear
    np.testing.assert_array_equal([v.x, v.y, v.z], s.aids.log.velocity[-1])
    assert log.twist.covariance[7] == s.aids.log.stddev[-1] ** 2 > 1e-4
    assert math.isnan(messages["/log"][0].twist.twist.linear.x)
    velocity = last("/gnss/velocity")
    assert velocity.twist.twist.linear.y == s.aids.gnss_velocity.velocity[-1, 1]
    assert velocity.twist.covariance[14] == 0.05**2
    depth = last("/depth")
    assert depth.pose.pose.position.z == -s.aids.depth.value[-1]
    assert depth.pose.covariance[14] == 0.05**2
    pressure = last("/pressure")
    assert (pressure.fluid_pressure, pressure.variance) == (s.aids.pressure.value[-1], 500.0**2)
    ranged = last("/range/vessel")
    assert ranged.range == np.float32(s.aids.ranges["vessel"].distance[-1])
    assert (ranged.variance, ranged.min_range, ranged.max_range) == (0.25, 0.0, 5000.0)
    fix, true = last("/beacon/vessel/fix"), last("/truth/beacon/vessel/fix")
    assert fix.latitude == math.degrees(s.aids.beacon_fixes["vessel"].lat[-1])
    assert fix.position_covariance[0] == 0.25
    assert true.altitude == s.aids.ranges["vessel"].beacon.height[-1]

    command = ["auv_dive", "-o", str(tmp_path / "other"), "--param", "duration:=5", "--param", "rate:=10"]
    assert main([*command, "--param", "beacon.names:=[north]", "--param", "beacon.positions:=[0, 0, -30]"]) == 0
    # it circles by 50 m, and begins in the east
    assert "beacon north at first: 55.7000000°, 37.6007" in capsys.readouterr().out
