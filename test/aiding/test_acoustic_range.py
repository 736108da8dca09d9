"""Ranges to beacons: moored and floating, one way and two ways, with a large sigma of position."""

import math

import aid_messages
import numpy as np
import pytest
from aid_harness import ARM, LAT, LON, NAN, SOLUTION, STATE, aids_of, at, flight, observed, of, own_of, point
from scipy.spatial.transform import Rotation

from ins_nav.aiding.acoustic_range import AcousticRange, RangeParameters
from ins_nav.aiding.base import Observation, OwnStates, Unusable
from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.geometry import from_earth
from ins_nav.estimation.state_layout import HORIZONTAL_POSITION
from ins_nav.mechanization import earth, nav_state


def _moored(**overrides: object) -> dict[str, object]:
    return {
        "range.beacons": "a, b2",
        "range.a.latitude_deg": 55.701,
        "range.a.longitude_deg": 37.6,
        "range.a.height": 50.0,
        **overrides,
    }


def test_range_to_a_moored_beacon() -> None:
    found = aids_of(_moored())
    assert {"range/a", "range/b2", "beacon/b2/fix"} <= found.keys() and "beacon/a/fix" not in found
    away = np.subtract(
        nav_state.position_ecef(STATE), earth.geodetic_to_ecef(math.radians(55.701), math.radians(37.6), 50.0)
    )
    distance = float(np.linalg.norm(away))
    seen = found["range/a"].measure(
        SOLUTION, own_of(0.0, 0.0), observed("range/a", distance - 1.0, covariance=np.eye(1))
    )
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [1.0], atol=1e-6)
    np.testing.assert_allclose(seen.r, [[1.0]])


def test_uncertain_position_increases_the_variance_of_a_range() -> None:
    """To second order, against draws of the position across the direction."""
    found = aids_of(_moored())["range/a"]
    p = np.diag([10.0, 15.0, 5.0]) ** 2
    away = np.subtract(
        nav_state.position_ecef(STATE), earth.geodetic_to_ecef(math.radians(55.701), math.radians(37.6), 50.0)
    )
    distance = float(np.linalg.norm(away))
    unsure = SOLUTION._replace(position_covariance=p)
    seen = found.measure(unsure, own_of(0.0, 0.0), observed("range/a", distance, covariance=np.zeros((1, 1))))
    assert seen is not None
    on_n = Rotation.from_quat(STATE[7:11]).inv().apply(away)
    drawn = np.random.default_rng(0).multivariate_normal(on_n, p, 200_000)
    direction = on_n / distance
    bent = np.linalg.norm(drawn, axis=1) - distance - (drawn - on_n) @ direction
    # 0.5 % by the number of draws, 5 % of the variance by the third order
    assert seen.innovation[0] == pytest.approx(bent.mean(), rel=0.02)
    assert seen.r[0, 0] == pytest.approx(bent.var(), rel=0.1)


def test_range_to_a_beacon_that_floats() -> None:
    """The range is to the place of the emission: over 1500 m sound travels for 1 s, the beacon moves by 2 m."""
    found = aids_of({"range.beacons": "ship", "range.beacon_speed": 2.0})
    ranges, fixes = found["range/ship"], found["beacon/ship/fix"]
    assert ranges.shares == "beacon/ship/fix"
    own = np.zeros(2 + 6)
    with pytest.raises(Unusable, match="the beacon's place is unknown"):
        ranges.measure(SOLUTION, own_of(*own), observed("range/ship", 5.0))
    lat, lon = math.radians(55.7), math.radians(37.6)
    meridian, _ = earth.principal_radii(math.sin(lat))
    place = lat + 1500.0 / (meridian + 150.0), lon, 150.0
    fix = fixes.measure(SOLUTION, own_of(*own[2:]), Observation(0, "beacon/ship/fix", place, np.eye(3)))
    assert fix is not None and not fix.h.any()
    np.testing.assert_array_equal(fix.innovation, np.zeros(3))
    north = earth.enu_axes(lat, lon)[:, 1]
    own[5:] = -2.0 * north
    arrived = observed("range/ship", 1480.0, covariance=np.eye(1) * 0.25)
    seen = ranges.measure(SOLUTION, own_of(*own), arrived)
    assert seen is not None and seen.own is not None and seen.shares == ("beacon/ship/fix",)
    # the chord is shorter by 4 mm; velocity is correlated over 30 s, so a second ago its mean was 1.6 % less
    assert seen.innovation[0] == pytest.approx(1500.0 + 2.0 * 1480.0 / 1500.0 - 1480.0, abs=0.04)
    assert seen.r[0, 0] == pytest.approx(0.25)
    # against differences
    for i in range(8):
        step = np.eye(8)[i] * 1e-2
        one, other = (ranges.measure(SOLUTION, own_of(*(own + x)), arrived) for x in (step, -step))
        assert one is not None and other is not None
        assert seen.own[0, i] == pytest.approx((one.innovation[0] - other.innovation[0]) / 2e-2, abs=1e-5)


def test_ranges_to_two_beacons_are_searched_together() -> None:
    """Position error 50 m: together they determine a place, as a measurement with the states of both."""
    place = {"range.b2.latitude_deg": 55.70108, "range.b2.longitude_deg": 37.6016, "range.b2.height": 60.0}
    aids = aids_of(_moored(**place, **{"range.bias_stddev": 1.0}))
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
        range_ = observed(name, float(np.linalg.norm(away)), covariance=0.01 * np.eye(1))
        try:
            found = aids[name].measure(unsure, own, range_)
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
        found = aids_of({"range.beacons": "ship", "range.two_way": two_way})["range/ship"]
        assert isinstance(found, AcousticRange) and found.observe(message).stamp_ns == stamp_ns


def test_truth_has_no_innovation() -> None:
    beacon = LAT + 3e-5, LON - 2e-5, -80.0
    distance = float(np.linalg.norm(point(flight()[1]) - earth.geodetic_to_ecef(*beacon)))
    aid = AcousticRange(RangeParameters(lever_arm=ARM, two_way=True), Beacon(beacon, 0.0), "a")
    measurement = of(aid, 1.02 * distance - 3.0)(at(flight()[1])[0], np.array([0.02, -3.0]))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)


@pytest.mark.parametrize("distance", [0.0, -1.0, NAN, math.inf, 0.5, 300.0])
def test_ranges_beyond_the_limits_are_rejected(distance: float) -> None:
    aid = aids_of(_moored())["range/a"]
    with pytest.raises(Unusable, match="rejected"):
        aid.read(aid_messages.RANGE(0, distance, 1.0, (1.0, 250.0)))
    assert aid.read(aid_messages.RANGE(0, 300.0, 1.0, (0.0, 0.0))).value == (300.0,)  # limits not filled in
