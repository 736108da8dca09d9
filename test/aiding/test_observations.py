"""Aids: parameters and covariances, and the measurement of each from an observation."""

import math
from collections.abc import Mapping
from typing import Any

import aid_messages
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ins_nav.aiding.acoustic_range import AcousticRange
from ins_nav.aiding.base import Aid, AidParameters, Observation, OwnStates, Record, Unusable
from ins_nav.aiding.geometry import from_earth
from ins_nav.aiding.gnss import GnssParameters
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import create_aids
from ins_nav.aiding.velocity_log import LogParameters
from ins_nav.estimation.observation import Solution, Update
from ins_nav.estimation.state_layout import HORIZONTAL_POSITION
from ins_nav.mechanization import earth, nav_state

NAN = math.nan
STATE = nav_state.initial_state(
    math.radians(55.7), math.radians(37.6), 150.0, (3.0, 4.0, 0.0), (0.0, 0.0, math.sin(0.2), math.cos(0.2))
)
SOLUTION = Solution(STATE, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), True, 0.0)


def _made(overrides: Mapping[str, object] | None = None) -> dict[str, Aid[Any]]:
    return create_aids(configuration(overrides).values)


def _own(*values: float) -> OwnStates:
    """Exactly known."""
    return OwnStates(np.array(values), np.zeros((len(values), len(values))))


def _seen(name: str, *value: float, covariance: np.ndarray | None = None) -> Observation:
    size = len(value)
    return Observation(1, name, value, np.eye(size) if covariance is None else covariance)


# Parameters


def test_values_are_those_of_the_parameters() -> None:
    values = configuration(
        {
            "log.enabled": False,
            "log.default_stddev": 0.4,
            "log.min_stddev": 0.02,
            "log.lever_arm": [1, -2, 3],
            "log.delay": 0.25,
            "log.gate": 1e-3,
            "log.patience": 30.0,
        }
    ).values
    found = LogParameters.from_values("log", values)
    assert found == LogParameters(
        enabled=False,
        default_stddev=0.4,
        min_stddev=0.02,
        lever_arm=(1.0, -2.0, 3.0),
        delay=0.25,
        gate=1e-3,
        patience=30.0,
    )


def test_every_aid_has_the_common_parameters() -> None:
    common = {row.name for row in AidParameters.rows("x")}
    for aid in _made({"range.beacons": "a"}).values():
        assert isinstance(aid.parameters, AidParameters) and aid.parameters.enabled
        if aid.name != "beacon/a/fix":  # not to be set
            rows = {row.name for row in aid.rows({})}
            assert {name.replace("x.", f"{aid.NAME}.") for name in common} <= rows


def test_own_states() -> None:
    made = _made({"gnss.slow_stddev": 2.0, "gnss.slow_time": 50.0, "log.scale_stddev": 0.03})
    drift = made["gnss"].states
    # first order: stationary deviation is walk * sqrt(time / 2)
    assert len(drift) == 3 and drift[0].walk * math.sqrt(drift[0].correlation_time / 2.0) == pytest.approx(2.0)
    assert [state.stddev for state in made["log"].states] == pytest.approx([0.03, *[math.radians(0.5)] * 2])
    assert _made()["gnss"].states == ()
    assert [state.stddev for state in made["depth"].states] == [1000.0]  # where the surface is
    made = _made({"depth.surface_height": 0.0})
    assert made["depth"].states == made["pressure"].states == ()
    values = {"log.scale": 0.01, "log.pitch_deg": -1.0, "log.yaw_deg": 2.0, "log.water_track": True}
    log = _made(values)["log"].states
    assert [state.value for state in log] == pytest.approx([0.01, math.radians(-1.0), math.radians(2.0), 0.0, 0.0])
    assert log[4].walk * math.sqrt(log[4].correlation_time / 2.0) == pytest.approx(log[4].stddev)


# Covariance


def test_given_covariance_is_used_as_it_is() -> None:
    matrix = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -0.5], [0.5, -0.5, 16.0]])
    np.testing.assert_array_equal(GnssParameters().covariance(matrix.ravel().tolist(), 3), matrix)


@pytest.mark.parametrize(
    "given_",
    [
        (),
        (0.0,) * 9,
        (NAN,) * 9,
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, NAN),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, math.inf),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, -1.0),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, 0.0),
        (-1.0,) + (0.0,) * 8,
        (1.0, 2.0),
    ],
)
def test_no_covariance_means_the_default(given_: tuple[float, ...]) -> None:
    np.testing.assert_array_equal(GnssParameters(default_stddev=2.0).covariance(given_, 3), 4.0 * np.eye(3))


def test_default_is_no_less_than_the_least() -> None:
    assert GnssParameters(default_stddev=0.1, min_stddev=0.5).covariance((), 1) == pytest.approx(0.25)


def test_covariance_that_is_not_positive_keeps_its_diagonal() -> None:
    rows = (1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(GnssParameters().covariance(rows, 3), np.eye(3))


def test_too_small_a_covariance_is_not_believed() -> None:
    used = GnssParameters(min_stddev=0.1).covariance(np.diag([1e-12, 1e-4, 1.0]).ravel().tolist(), 3)
    np.testing.assert_allclose(used.diagonal(), [0.01, 0.01, 1.0], rtol=1e-12)


def test_axes_not_measured_leave_the_others_theirs() -> None:
    rows = (0.04, NAN, 0.0, NAN, NAN, 0.0, 0.0, 0.0, -1.0)
    used = LogParameters(default_stddev=0.2).covariance(rows, 3, [1, 2])
    np.testing.assert_allclose(used, np.diag([0.04, 0.04, 0.04]))


@given(st.lists(st.floats(), min_size=9, max_size=9), st.sets(st.integers(0, 2)))
def test_covariance_is_positive_whatever_is_given(rows: list[float], missing: set[int]) -> None:
    used = GnssParameters(min_stddev=0.1).covariance(rows, 3, sorted(missing))
    assert np.isfinite(used).all() and np.array_equal(used, used.T)
    # rounding of the eigenvalues, relative to the largest
    assert np.linalg.eigvalsh(used)[0] > -1e-14 * used.max() and used.diagonal().min() >= 0.01 * (1.0 - 1e-12)


# Measurements


def test_fix_at_the_antenna_has_no_innovation() -> None:
    """A lever arm of 2 m forward: the antenna is there."""
    made = _made({"gnss.lever_arm": [2.0, 0.0, 0.0]})["gnss"]
    away = nav_state.corrected(STATE, (2.0 * math.cos(0.4), 2.0 * math.sin(0.4), 0.0))
    there = nav_state.geodetic(away)
    seen = made.measure(SOLUTION, _own(), _seen("gnss", there.lat, there.lon, there.height))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-6  # the Earth is round: 2 m squared over its radius


def test_slow_error_of_a_fix_is_taken_out() -> None:
    made = _made({"gnss.slow_stddev": 2.0})["gnss"]
    where = nav_state.geodetic(STATE)
    seen = made.measure(SOLUTION, _own(1.0, -2.0, 3.0), _seen("gnss", where.lat, where.lon, where.height))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [1.0, -2.0, 3.0], atol=1e-6)


def test_velocity_without_up() -> None:
    made = _made()["gnss_velocity"]
    full = made.measure(SOLUTION, _own(), _seen("gnss_velocity", 3.0, 4.0, 0.5))
    flat = made.measure(SOLUTION, _own(), _seen("gnss_velocity", 3.0, 4.0, NAN))
    assert full is not None and flat is not None
    np.testing.assert_allclose(full.innovation, [0.0, 0.0, -0.5], atol=1e-12)
    np.testing.assert_allclose(flat.innovation, [0.0, 0.0], atol=1e-12)
    assert flat.r.shape == (2, 2) and flat.h.shape[0] == 2


def test_log_takes_the_axes_that_are_there() -> None:
    made = _made()["log"]
    forward, left, _ = nav_state.velocity_body(STATE)
    seen = made.measure(SOLUTION, _own(0.0, 0.0, 0.0), _seen("log", NAN, left - 0.25, NAN))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.25], atol=1e-12)
    assert made.measure(SOLUTION, _own(0.0, 0.0, 0.0), _seen("log", NAN, NAN, NAN)) is None
    turned = _made({"log.mounting_rpy_deg": [0.0, 0.0, 90.0]})["log"]
    seen = turned.measure(SOLUTION, _own(0.0, 0.0, 0.0), _seen("log", left, -forward, 0.0))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-12


def test_patience_of_a_log() -> None:
    """Zeros are never accepted against the filter; of a log that was accepted before, only drifts are."""
    made = _made()["log"]
    for zeros in ((0.0, NAN, NAN), (0.0, 0.0, 0.0)):
        assert made.patience(_seen("log", *zeros), False, False) == 0.0
    moving = _seen("log", 0.0, 0.1, NAN)
    assert made.patience(moving, False, True) == made.parameters.patience == 180.0
    assert made.patience(moving, True, False) == math.inf


def test_patience_of_a_range_ends_where_position_is_known() -> None:
    made = _made({"range.beacons": "a"})["range/a"]
    assert made.patience(_seen("range/a", 5.0), True, False) == 600.0
    assert made.patience(_seen("range/a", 5.0), True, True) == 0.0


def test_depth_counts_from_the_surface() -> None:
    values = {"depth.surface_height": 160.0, "depth.lever_arm": [0.0, 0.0, -1.0]}
    made = _made(values)["depth"]
    # the gauge is 1 m below the IMU at 150 m: 11 m under a surface at 160 m
    seen = made.measure(SOLUTION, _own(), _seen("depth", 11.0, covariance=np.array([[0.04]])))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.0], atol=1e-9)
    np.testing.assert_allclose(seen.r, [[0.04]])


def test_depth_finds_the_surface_that_is_not_given() -> None:
    """The first depth says where it is; a value of the filter's own state moves it."""
    made = _made()["depth"]
    seen = made.measure(SOLUTION, _own(0.0), _seen("depth", 11.0, covariance=np.eye(1)))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [0.0], atol=1e-9)
    seen = made.measure(SOLUTION, _own(0.5), _seen("depth", 12.0, covariance=np.eye(1)))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [0.5], atol=1e-9)
    np.testing.assert_array_equal(seen.own, [[-1.0]])


def test_pressure_is_the_weight_of_water() -> None:
    values = {"pressure.surface_pressure": 100e3, "pressure.density": 1000.0, "depth.surface_height": 160.0}
    made = _made(values)["pressure"]
    weight = 1000.0 * earth.normal_gravity(math.sin(math.radians(55.7)), 150.0)
    seen = made.measure(SOLUTION, _own(), _seen("pressure", 100e3 + 10.5 * weight, covariance=np.eye(1) * 100.0))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.5], atol=1e-9)
    np.testing.assert_allclose(seen.r, [[(10.0 / weight) ** 2]])


def _moored(**overrides: object) -> dict[str, object]:
    return {
        "range.beacons": "a, b2",
        "range.a.latitude_deg": 55.701,
        "range.a.longitude_deg": 37.6,
        "range.a.height": 50.0,
        **overrides,
    }


def test_range_to_a_moored_beacon() -> None:
    made = _made(_moored())
    assert {"range/a", "range/b2", "beacon/b2/fix"} <= made.keys() and "beacon/a/fix" not in made
    away = np.subtract(
        nav_state.position_ecef(STATE), earth.geodetic_to_ecef(math.radians(55.701), math.radians(37.6), 50.0)
    )
    distance = float(np.linalg.norm(away))
    seen = made["range/a"].measure(SOLUTION, _own(0.0, 0.0), _seen("range/a", distance - 1.0, covariance=np.eye(1)))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [1.0], atol=1e-6)
    np.testing.assert_allclose(seen.r, [[1.0]])


def test_range_is_worth_less_where_the_place_is_hardly_known() -> None:
    """To second order, against draws of the position across the direction."""
    made = _made(_moored())["range/a"]
    p = np.diag([10.0, 15.0, 5.0]) ** 2
    away = np.subtract(
        nav_state.position_ecef(STATE), earth.geodetic_to_ecef(math.radians(55.701), math.radians(37.6), 50.0)
    )
    distance = float(np.linalg.norm(away))
    unsure = SOLUTION._replace(position_covariance=p)
    seen = made.measure(unsure, _own(0.0, 0.0), _seen("range/a", distance, covariance=np.zeros((1, 1))))
    assert seen is not None
    on_n = Rotation.from_quat(STATE[7:11]).inv().apply(away)
    drawn = np.random.default_rng(0).multivariate_normal(on_n, p, 200_000)
    direction = on_n / distance
    bent = np.linalg.norm(drawn, axis=1) - distance - (drawn - on_n) @ direction
    # 0.5 % by the number of draws, 5 % of the variance by the third order
    assert seen.innovation[0] == pytest.approx(bent.mean(), rel=0.02)
    assert seen.r[0, 0] == pytest.approx(bent.var(), rel=0.1)


def test_range_to_a_beacon_that_floats() -> None:
    """It is where its sound left it: 1500 m take a second, in which it goes 2 m."""
    made = _made({"range.beacons": "ship", "range.beacon_speed": 2.0})
    ranges, fixes = made["range/ship"], made["beacon/ship/fix"]
    assert ranges.shares == "beacon/ship/fix"
    own = np.zeros(2 + 6)
    with pytest.raises(Unusable, match="the beacon's place is unknown"):
        ranges.measure(SOLUTION, _own(*own), _seen("range/ship", 5.0))
    lat, lon = math.radians(55.7), math.radians(37.6)
    meridian, _ = earth.principal_radii(math.sin(lat))
    place = lat + 1500.0 / (meridian + 150.0), lon, 150.0
    fix = fixes.measure(SOLUTION, _own(*own[2:]), Observation(0, "beacon/ship/fix", place, np.eye(3)))
    assert fix is not None and not fix.h.any()
    np.testing.assert_array_equal(fix.innovation, np.zeros(3))
    north = earth.enu_axes(lat, lon)[:, 1]
    own[5:] = -2.0 * north
    arrived = _seen("range/ship", 1480.0, covariance=np.eye(1) * 0.25)
    seen = ranges.measure(SOLUTION, _own(*own), arrived)
    assert seen is not None and seen.own is not None and seen.shares == ("beacon/ship/fix",)
    # the chord is shorter by 4 mm; velocity wanders within 30 s, so a second ago it was 1.6 % less
    assert seen.innovation[0] == pytest.approx(1500.0 + 2.0 * 1480.0 / 1500.0 - 1480.0, abs=0.04)
    assert seen.r[0, 0] == pytest.approx(0.25)
    # against differences
    for i in range(8):
        step = np.eye(8)[i] * 1e-2
        one, other = (ranges.measure(SOLUTION, _own(*(own + x)), arrived) for x in (step, -step))
        assert one is not None and other is not None
        assert seen.own[0, i] == pytest.approx((one.innovation[0] - other.innovation[0]) / 2e-2, abs=1e-5)


def test_ranges_to_two_beacons_are_searched_together() -> None:
    """Position wrong by 50 m: together they show a place, as a measurement with the states of both."""
    place = {"range.b2.latitude_deg": 55.70108, "range.b2.longitude_deg": 37.6016, "range.b2.height": 60.0}
    made = _made(_moored(**place, **{"range.bias_stddev": 1.0}))
    wrong = nav_state.corrected(STATE, (40.0, -30.0, 0.0))
    unsure = SOLUTION._replace(state=wrong, position_covariance=np.diag([50.0, 50.0, 1.0]) ** 2)
    own = OwnStates(np.zeros(2), np.diag([0.0, 1.0]))
    beacons = {"range/a": (55.701, 37.6, 50.0), "range/b2": (55.70108, 37.6016, 60.0)}
    found = None
    for i in range(12):
        name = ("range/a", "range/b2")[i % 2]
        lat, lon, height = beacons[name]
        away = np.subtract(
            nav_state.position_ecef(STATE), earth.geodetic_to_ecef(math.radians(lat), math.radians(lon), height)
        )
        range_ = _seen(name, float(np.linalg.norm(away)), covariance=0.01 * np.eye(1))
        try:
            found = made[name].measure(unsure, own, range_)
            break
        except Unusable as reason:
            assert reason.kind == "gathered"
    assert found is not None and found.own is not None and i >= 7
    others = {"range/a", "range/b2"} - {name}
    assert set(found.shares) == others and found.own.shape[1] == 4
    computed = nav_state.position_ecef(wrong)
    dx, dy, _ = from_earth(wrong, np.subtract(computed, nav_state.position_ecef(STATE)))
    h, p = np.hstack([found.h[:, HORIZONTAL_POSITION], found.own]), np.diag([2500.0, 2500.0, 0.0, 1.0, 0.0, 1.0])
    error = p @ h.T @ np.linalg.solve(h @ p @ h.T + found.r, found.innovation)
    np.testing.assert_allclose(error, [dx, dy, 0.0, 0.0, 0.0, 0.0], atol=0.5)  # the ranges are exact


def test_range_of_two_ways_is_of_the_middle_of_its_time() -> None:
    message = aid_messages.RANGE(2_000_000_000, 1500.0)
    for two_way, stamp_ns in ((False, 2_000_000_000), (True, 1_000_000_000)):
        made = _made({"range.beacons": "ship", "range.two_way": two_way})["range/ship"]
        assert isinstance(made, AcousticRange) and made.observe(message).stamp_ns == stamp_ns


def test_record_counts() -> None:
    record = Record()
    good = Update("gnss", 7, (1.0,), (1.0,), 0.1, True, "")
    record.count(good)
    record.count(Update("gnss", 9, (9.0,), (1.0,), 5.0, False, "outside the gate"))
    assert (record.accepted, record.rejected, record.accepted_ns) == (1, 1, 7)
    assert record.last is not None and not record.last.accepted
