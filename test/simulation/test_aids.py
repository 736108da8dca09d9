"""Simulated aids against differences of the motion, plane geometry and statistics."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import NS, ORIGIN, close, measure, of_beacons, path, seconds_of, swimmer

from ins_nav.aiding.acoustic_range import AcousticRange, RangeParameters
from ins_nav.aiding.base import Aid, Observation, OwnStates
from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.depth import Depth, DepthParameters
from ins_nav.aiding.gnss_velocity import GnssVelocity, GnssVelocityParameters
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.estimation.observation import Solution
from ins_nav.mechanization import earth, nav_state
from ins_nav.simulation.motion import Motion, constant
from ins_nav.simulation.scenarios import simulate
from ins_nav.simulation.trajectory import EarthMotion, Trajectory

ARM = (1.0, -2.0, 3.0)


@functools.cache
def _straight(pitch: float = 0.0) -> Trajectory:
    """20 s to the north at 2 m/s."""
    motion = Motion(20.0, speed=constant(2.0), yaw=constant(0.5 * math.pi), pitch=constant(pitch))
    return EarthMotion(motion, ORIGIN).trajectory(10.0)


def _velocity_by_difference(times: np.ndarray) -> np.ndarray:
    """Of the place ARM points at, Earth-fixed, m/s: central difference of 4th order."""
    h = 0.05

    def place(t: np.ndarray) -> np.ndarray:
        s = swimmer().states(t)
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
    log = measure(trajectory=_straight(), **{"log.mounting_rpy_deg": rpy_deg})["log"]
    # a plane 20 m below the ellipsoid is level but for its scale, 40 m / Earth's radius
    close(log.velocity, np.tile(expected, (101, 1)), atol=2e-5)


def test_log_reads_the_velocity_of_its_place() -> None:
    log = measure(**{"log.lever_arm": ARM, "log.mounting_rpy_deg": (10.0, -20.0, 30.0)})["log"]
    times = seconds_of(log.stamps_ns)[1:-1]
    body = Rotation.from_quat(swimmer().states(times).q_eb)
    sensor = body * Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True)
    # h^4 / 30 times the fifth derivative: 6e-6 / 30 * 3 m * (2 pi / 9 s)^5 * 0.3 rad = 3e-8 m/s; the rounding of
    # places to 1e-9 m over 0.05 s
    close(log.velocity[1:-1], sensor.inv().apply(_velocity_by_difference(times)), atol=2e-7)
    # the lever arm counts: it swings by some 0.3 m/s
    assert np.abs(log.velocity - measure()["log"].velocity).max() > 0.2


def test_log_scale_and_misalignment() -> None:
    true = measure()["log"].velocity
    log = measure(**{"log.scale": 0.01, "log.misalignment_deg": (1.0, -2.0)})["log"]
    a_y, a_z = math.radians(1.0), math.radians(-2.0)
    matrix = np.array([[1.01, -a_z, a_y], [a_z, 1.01, 0.0], [-a_y, 0.0, 1.01]])  # of ins_nav.aiding.velocity_log
    close(log.velocity, true @ matrix.T, atol=1e-14)
    assert (log.scale, log.misalignment) == (0.01, (a_y, a_z))
    drawn = [
        measure(seed, _straight(), **{"log.scale_stddev": 0.002, "log.misalignment_stddev_deg": 0.1})["log"]
        for seed in range(200)
    ]
    # 200 values: their standard deviation is known to 5 %, four times that
    assert np.std([log.scale for log in drawn]) == pytest.approx(0.002, rel=0.2)
    assert np.degrees(np.std([log.misalignment for log in drawn])) == pytest.approx(0.1, rel=0.15)


def test_log_noise() -> None:
    noise: dict[str, Any] = {"log.noise_stddev": 0.03, "log.noise_per_speed": 0.02, "log.rate": 20.0}
    log = measure(**noise)
    exact = measure(**{"log.rate": 20.0})["log"].velocity
    speed = np.linalg.norm(exact, axis=1)
    close(log["log"].stddev, np.hypot(0.03, 0.02 * speed), atol=1e-15)
    # 3603 values: 1.2 %, four times that
    assert ((log["log"].velocity - exact) / log["log"].stddev[:, None]).std() == pytest.approx(1.0, rel=0.047)


def test_log_through_water() -> None:
    still, log = measure()["log"], measure(**{"log.current": (0.5, -0.2)})["log"]
    at = Rotation.from_quat(swimmer().states(seconds_of(log.stamps_ns)).q_nb)
    close(at.apply(still.velocity - log.velocity), np.tile([0.5, -0.2, 0.0], (301, 1)), atol=1e-14)


@pytest.mark.parametrize("lost", ["nan", "zeros", "silent"])
def test_log_loses_the_bottom(lost: str) -> None:
    window: dict[str, Any] = {"log.lost_start": 10.0, "log.lost_duration": 5.0, "log.noise_stddev": 0.01}
    whole = measure(**{"log.noise_stddev": 0.01})["log"]
    once = measure(**window, **{"log.lost": lost})["log"]
    gone = (seconds_of(whole.stamps_ns) >= 10.0) & (seconds_of(whole.stamps_ns) < 15.0)
    if lost == "silent":
        np.testing.assert_array_equal(once.stamps_ns, whole.stamps_ns[~gone])
        np.testing.assert_array_equal(once.velocity, whole.velocity[~gone])
    else:
        np.testing.assert_array_equal(once.stamps_ns, whole.stamps_ns)
        np.testing.assert_array_equal(once.velocity[~gone], whole.velocity[~gone])
        np.testing.assert_array_equal(once.velocity[gone], math.nan if lost == "nan" else 0.0)
    again = measure(**window, **{"log.lost_period": 20.0})["log"]
    seconds = seconds_of(again.stamps_ns)
    gone = (seconds >= 10.0) & ((seconds - 10.0) % 20.0 < 5.0)
    np.testing.assert_array_equal(np.isnan(again.velocity[:, 0]), gone)
    assert gone.sum() == 75  # 10, 30 and 50 s


def test_log_outliers() -> None:
    some: dict[str, Any] = {"log.outlier_share": 0.2, "log.outlier_span": (1.0, 2.0), "log.rate": 20.0}
    off = np.linalg.norm(measure(**some)["log"].velocity - measure(**{"log.rate": 20.0})["log"].velocity, axis=1)
    wrong = off > 1e-9
    # 1201 readings: 240 wrong, with a standard deviation of 14, four times that
    assert 184 < wrong.sum() < 296
    assert 1.0 - 1e-9 < off[wrong].min() < 1.1 < 1.9 < off[wrong].max() < 2.0 + 1e-9


def test_depth_and_pressure() -> None:
    surface = -15.0
    t = path()
    aids = measure(**{"depth.surface_height": surface, "depth.lever_arm": ARM, "pressure.lever_arm": (0, 0, -1)})
    axes = earth.enu_axes(t.lat[0], t.lon[0])
    at = np.arange(0, 1201, 4)
    # up at the start is up everywhere on these 100 m: 1e-5 rad of the lever arm, 100 m / Earth's radius of the way
    up = (t.position_e[at] + Rotation.from_quat(t.q_eb[at]).apply(ARM) - t.position_e[0]) @ axes[:, 2]
    close(aids["depth"].value, surface - t.height[0] - up, atol=2e-3)
    assert aids["depth"].value.mean() == pytest.approx(2.0, abs=0.5)  # 5 m down, the gauge 3 m up
    straight = measure(trajectory=_straight(), **{"pressure.lever_arm": (0.0, 0.0, -1.0)})
    # 20 m and the lever arm's 1 m, of water of 1025 kg/m³ at 9.81567 m/s² (international formula, 55.7°)
    close(straight["pressure"].value, 101_325.0 + 1025.0 * 9.81567 * 21.0, atol=0.5)
    close(straight["depth"].value, 20.0, atol=1e-4)
    bow_down = measure(trajectory=_straight(math.radians(30.0)), **{"depth.lever_arm": (2.0, 0.0, 0.0)})
    close(bow_down["depth"].value, 21.0, atol=1e-4)  # a gauge in the bow is deeper then


@pytest.mark.parametrize("name", ["depth", "pressure"])
def test_errors_and_a_fault_of_a_gauge(name: str) -> None:
    parameters: dict[str, Any] = {
        f"{name}.noise_stddev": 0.5,
        f"{name}.bias": 2.0,
        f"{name}.bias_stddev": 1.0,
        f"{name}.fault_start": 40.0,
        f"{name}.fault_duration": 10.0,
        f"{name}.fault_offset": 30.0,
    }
    gauge, exact = measure(3, **parameters)[name], measure()[name]
    assert (gauge.stddev, exact.bias) == (0.5, 0.0)
    error = gauge.value - exact.value - gauge.bias
    faulty = (seconds_of(gauge.stamps_ns) >= 40.0) & (seconds_of(gauge.stamps_ns) < 50.0)
    assert faulty.sum() == 50
    error[faulty] -= 30.0
    # 301 values: mean to 0.03, standard deviation to 4 %; four times that
    assert error.mean() == pytest.approx(0.0, abs=0.12)
    assert error.std() == pytest.approx(0.5, rel=0.17)
    biases = [measure(seed, _straight(), **parameters)[name].bias for seed in range(100)]
    # 100 values: mean to 0.1, standard deviation to 7 %; four times that
    assert np.mean(biases) == pytest.approx(2.0, abs=0.4)
    assert np.std(biases) == pytest.approx(1.0, rel=0.3)


def test_ranges_are_distances() -> None:
    aids = measure(**{"range.lever_arm": ARM, "depth.surface_height": -15.0})
    t, at = path(), np.arange(0, 1201, 4)
    offset = Rotation.from_quat(t.q_nb[at]).apply(ARM)
    axes = np.stack([earth.enu_axes(lat, lon) for lat, lon in zip(t.lat[at], t.lon[at], strict=True)])
    here = earth.geodetic_to_ecef(t.lat[at], t.lon[at], t.height[at]) + np.einsum("nij,nj->ni", axes, offset)
    below = earth.geodetic_to_ecef(ORIGIN.lat, ORIGIN.lon, -15.0 - 120.0)
    # a double resolves an Earth radius to 1e-9 m
    close(aids["range/down"].distance, np.linalg.norm(here - below, axis=1), atol=1e-8)
    vessel = aids["range/vessel"]
    there = earth.geodetic_to_ecef(vessel.beacon.lat, vessel.beacon.lon, vessel.beacon.height)
    close(vessel.distance, np.linalg.norm(here - there, axis=1), atol=1e-8)
    np.testing.assert_array_equal(vessel.beacon.stamps_ns, vessel.stamps_ns)
    # in the tangent plane at the origin; 500 m away it is 0.02 m above the water, and scale is wrong by 1e-5 of it
    origin_e = earth.geodetic_to_ecef(ORIGIN.lat, ORIGIN.lon, -15.0)
    on_plane = (there - origin_e) @ earth.enu_axes(ORIGIN.lat, ORIGIN.lon)
    angle = seconds_of(vessel.stamps_ns) / 50.0  # 1 m/s on 50 m
    expected = np.column_stack([300.0 + 50.0 * np.cos(angle), 400.0 + 50.0 * np.sin(angle), np.full(301, -2.0)])
    close(on_plane, expected, atol=0.03)


def test_beacons_transmit_their_fixes() -> None:
    aids = measure()
    assert of_beacons(aids, "beacon") == {"vessel"}
    fixes, beacon = aids["beacon/vessel/fix"], aids["range/vessel"].beacon
    np.testing.assert_array_equal(fixes.stamps_ns, beacon.stamps_ns[::5])
    for sent, true in zip(fixes[1:4], beacon[1:4], strict=True):
        close(sent, true[::5], atol=1e-15)  # as written: no noise
    noisy = measure(1, **{"beacon.fix_stddev": 2.0, "beacon.fix_rates": 20.0})
    assert of_beacons(noisy, "beacon") == {"down", "vessel"}
    down = noisy["beacon/down/fix"]
    away = earth.geodetic_to_ecef(down.lat, down.lon, down.height) - earth.geodetic_to_ecef(
        ORIGIN.lat, ORIGIN.lon, -120.0
    )
    # 3603 values: 1.2 %, four times that
    assert away.std() == pytest.approx(2.0, rel=0.047)
    assert down.stddev == (2.0, 2.0, 2.0)


def test_range_errors() -> None:
    exact = measure()["range/vessel"].distance
    scaled = measure(**{"range.scale": -0.01, "range.bias": 3.0})["range/vessel"]
    close(scaled.distance, 0.99 * exact + 3.0, atol=1e-12)
    assert (scaled.scale, scaled.bias) == (-0.01, 3.0)
    both = measure(2, **{"range.bias_stddev": 1.0, "range.scale_stddev": 1e-3})
    assert both["range/down"].bias != both["range/vessel"].bias
    assert both["range/down"].scale == both["range/vessel"].scale != 0.0  # the water is the same
    noisy = measure(**{"range.noise_stddev": 0.5, "range.rate": 20.0})["range/vessel"]
    error = noisy.distance - measure(**{"range.rate": 20.0})["range/vessel"].distance
    # 1201 values: 2 %, four times that
    assert error.std() == pytest.approx(noisy.stddev, rel=0.082)
    assert not noisy.outlier.any()


def test_range_outliers() -> None:
    plain = measure(**{"range.rate": 20.0, "range.noise_stddev": 0.5})["range/vessel"]
    wrong = measure(**{"range.rate": 20.0, "range.noise_stddev": 0.5, "range.outlier_share": 0.2})["range/vessel"]
    off = wrong.distance - plain.distance
    np.testing.assert_array_equal(off[~wrong.outlier], 0.0)
    size = np.abs(off[wrong.outlier])
    # 1201 ranges: 240 wrong, with a standard deviation of 14; 90 % too long, to 2 %; four times that
    assert 184 < len(size) < 296
    assert (10.0 <= size).all() and (size <= 300.0).all()
    assert np.mean(off[wrong.outlier] > 0.0) == pytest.approx(0.9, abs=0.08)
    near = measure(**{"range.outlier_share": 1.0, "range.outlier_span": (200.0, 300.0)})["range/down"]
    assert near.distance.min() == 0.0  # 100 m less 200 m


def test_replies_come_late_and_not_from_everywhere() -> None:
    ranges = measure(**{"range.delay_speed": 1500.0})["range/vessel"]
    late = (ranges.stamps_ns - ranges.beacon.stamps_ns) / NS
    close(late, ranges.distance / 1500.0, atol=1e-9)
    assert late.min() > 0.2
    limited = measure(**{"range.max": 470.0})
    assert limited["range/vessel"].distance.max() <= 470.0 < ranges.distance.max()
    assert len(limited["range/vessel"].distance) == (ranges.distance <= 470.0).sum()
    assert len(limited["range/down"].distance) == 301


def test_gnss_velocity_is_that_of_the_antenna() -> None:
    gnss = measure(**{"gnss.lever_arm": ARM})["gnss/velocity"]
    times = seconds_of(gnss.stamps_ns)[1:-1]
    s = swimmer().states(times)
    axes = np.stack([earth.enu_axes(lat, lon) for lat, lon in zip(s.lat, s.lon, strict=True)])
    expected = np.einsum("nij,ni->nj", axes, _velocity_by_difference(times))
    close(gnss.velocity[1:-1], expected, atol=2e-7)  # as of the log
    noisy = measure(**{"gnss.lever_arm": ARM, "gnss.velocity_stddev": 0.1})["gnss/velocity"]
    # 903 values: 2.4 %, four times that
    assert (noisy.velocity - gnss.velocity).std() == pytest.approx(noisy.stddev, rel=0.1)


def test_gnss_is_lost_under_water() -> None:
    under: dict[str, Any] = {"depth.surface_height": -20.0, "gnss.lost_depth": 0.3, "gnss.lever_arm": (0.0, 0.0, 0.5)}
    all_of_them, some = measure(), measure(**under)
    t, at = path(), np.arange(0, 1201, 4)
    antenna = t.height[at] + Rotation.from_quat(t.q_nb[at]).apply([0.0, 0.0, 0.5])[:, 2]
    seen = antenna >= -20.3
    assert 50 < seen.sum() < 250
    assert len(all_of_them["gnss/fix"].lat) == 301
    np.testing.assert_array_equal(some["gnss/fix"].stamps_ns, all_of_them["gnss/fix"].stamps_ns[seen])
    np.testing.assert_array_equal(some["gnss/velocity"].stamps_ns, all_of_them["gnss/velocity"].stamps_ns[seen])
    whole = measure(**under | {"gnss.lost_depth": 100.0})
    np.testing.assert_array_equal(some["gnss/fix"].lat, whole["gnss/fix"].lat[seen])  # the noise stays


def test_the_filter_has_the_same_model() -> None:
    """The filter's formulas at the true state: the innovation is zero."""
    rpy_deg = (10.0, -20.0, 30.0)
    mounted: dict[str, Any] = {"log.lever_arm": ARM, "log.mounting_rpy_deg": rpy_deg, "log.scale": 0.01}
    mounted |= {
        "log.misalignment_deg": (1.0, -2.0),
        "log.current": (0.5, -0.2),
        "depth.lever_arm": ARM,
        "depth.surface_height": -15.0,
    }
    mounted |= {"range.lever_arm": ARM, "range.scale": 0.01, "range.bias": 3.0, "gnss.lever_arm": ARM}
    aids, t = measure(**mounted), path()
    roll, pitch, yaw = map(math.radians, rpy_deg)
    log = VelocityLog(LogParameters(lever_arm=ARM, mounting_rpy=(roll, pitch, yaw), water_track=True))
    depth = Depth(DepthParameters(lever_arm=ARM, surface_height=-15.0))
    velocity, gnss = GnssVelocity(GnssVelocityParameters(lever_arm=ARM)), aids["gnss/velocity"]
    ranged, parameters = aids["range/vessel"], RangeParameters(lever_arm=ARM, two_way=True)
    for k in (1, 100, 250):
        at = 4 * k
        state = nav_state.initial_state(t.lat[at], t.lon[at], t.height[at], tuple(t.velocity_n[at]), tuple(t.q_nb[at]))
        solution = Solution(state, tuple(t.rate[at]), (0.0, 0.0, 0.0), True, 0.0)
        place = ranged.beacon.lat[k], ranged.beacon.lon[k], ranged.beacon.height[k]
        seen: tuple[tuple[Aid[Any], tuple[float, ...], Any], ...] = (
            (log, (0.01, *aids["log"].misalignment, 0.5, -0.2), aids["log"].velocity[k]),
            (depth, (), [aids["depth"].value[k]]),
            (AcousticRange(parameters, Beacon(place, 0.0), "vessel"), (0.01, 3.0), [ranged.distance[k]]),
            (velocity, (), gnss.velocity[k]),
        )
        for aid, own, value in seen:
            states = OwnStates(np.array(own), np.zeros((len(own), len(own))))
            observation = Observation(0, aid.name, tuple(value), np.zeros((len(value), len(value))))
            measurement = aid.measure(solution, states, observation)
            assert measurement is not None
            close(measurement.innovation, 0.0, atol=5e-9)  # a double resolves an Earth radius to 1e-9 m


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


def _values(aids: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {
        "fixes": aids["gnss/fix"].lat,
        "gnss_velocity": aids["gnss/velocity"].velocity,
        "log": aids["log"].velocity,
        "depth": aids["depth"].value,
        "pressure": aids["pressure"].value,
        "down": aids["range/down"].distance,
        "vessel": aids["range/vessel"].distance,
        "beacon": aids["beacon/vessel/fix"].lat,
    }


def test_everything_repeats_from_its_seed() -> None:
    first, same, other = (_values(measure(seed, **NOISY)) for seed in (5, 5, 6))
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
def test_streams_are_independent(change: dict[str, Any], touched: set[str]) -> None:
    before = measure(5, **NOISY)
    after = measure(5, **NOISY | change)
    if "range/x" in after:
        after = dict(after) | {"range/down": after["range/x"]}
    changed = _values(after)
    for name, values in _values(before).items():
        assert np.array_equal(values, changed[name]) == (name not in touched), name


def test_outliers_do_not_change_the_noise() -> None:
    plain, wrong = (measure(5, **NOISY | {"range.outlier_share": s})["range/vessel"] for s in (0.0, 0.3))
    np.testing.assert_array_equal(plain.distance[~wrong.outlier], wrong.distance[~wrong.outlier])
    fewer = measure(5, **NOISY)["range/vessel"]
    assert not (fewer.outlier & ~wrong.outlier).any()  # a larger share: the same and more
    np.testing.assert_array_equal(fewer.distance[fewer.outlier], wrong.distance[fewer.outlier])


def test_aids_are_off_by_default() -> None:
    aids = simulate("static", duration=5.0).aids
    assert len(aids["gnss/fix"].lat) == 6
    assert not any(len(x.stamps_ns) for x in (aids["gnss/velocity"], aids["log"], aids["depth"], aids["pressure"]))
    assert of_beacons(aids, "range") == of_beacons(aids, "beacon") == set()
