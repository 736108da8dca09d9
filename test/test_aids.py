"""Aids: settings and covariances from parameters, and what each makes of a message."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ins_nav import aids, strapdown
from ins_nav.aids import Observation, Record, Settings
from ins_nav.error_filter import Solution, Update
from ins_nav.parameters import checked_values

NAN = math.nan
STATE = strapdown.initial_state(
    math.radians(55.7), math.radians(37.6), 150.0, (3.0, 4.0, 0.0), (0.0, 0.0, math.sin(0.2), math.cos(0.2))
)
SOLUTION = Solution(STATE, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), True, 0.0)


def _settings(name: str = "gnss", **overrides: float) -> Settings:
    return Settings.of(name, checked_values({f"{name}.{key}": value for key, value in overrides.items()}))


def _seen(name: str, *value: float, covariance: np.ndarray | None = None) -> Observation:
    size = len(value)
    return Observation(1, name, value, 0, np.eye(size) if covariance is None else covariance)


# Settings


def test_settings_are_those_of_the_parameters() -> None:
    values = checked_values(
        {
            "log.enabled": False,
            "log.default_stddev": 0.4,
            "log.min_stddev": 0.02,
            "log.lever_arm": [1, -2, 3],
            "log.delay": 0.25,
            "log.gate": 1e-3,
        }
    )
    assert Settings.of("log", values) == Settings(False, 0.4, 0.02, (1.0, -2.0, 3.0), 250_000_000, 1e-3)


def test_only_enabled_aids_are_made() -> None:
    assert set(aids.make(checked_values({}))) == set(aids.TOPICS)
    off = {f"{name}.enabled": False for name in aids.TOPICS}
    assert aids.make(checked_values(off)) == {}
    assert set(aids.make(checked_values(off | {"log.enabled": True}))) == {"log"}


def test_own_states() -> None:
    made = aids.make(checked_values({"gnss.slow_stddev": 2.0, "gnss.slow_time": 50.0, "log.scale_stddev": 0.03}))
    drift = made["gnss"].states
    # first order: stationary deviation is walk * sqrt(time / 2)
    assert len(drift) == 3 and drift[0].walk * math.sqrt(drift[0].correlation_time / 2.0) == pytest.approx(2.0)
    assert [state.stddev for state in made["log"].states] == pytest.approx([0.03, *[math.radians(0.5)] * 2])
    assert aids.make(checked_values({}))["gnss"].states == made["depth"].states == ()


# Covariance


def test_given_covariance_is_used_as_it_is() -> None:
    matrix = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -0.5], [0.5, -0.5, 16.0]])
    np.testing.assert_array_equal(_settings().covariance(matrix.ravel().tolist(), 3), matrix)


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
    np.testing.assert_array_equal(_settings(default_stddev=2.0).covariance(given_, 3), 4.0 * np.eye(3))


def test_default_is_no_less_than_the_least() -> None:
    assert _settings(default_stddev=0.1, min_stddev=0.5).covariance((), 1) == pytest.approx(0.25)


def test_covariance_that_is_not_positive_keeps_its_diagonal() -> None:
    rows = (1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(_settings().covariance(rows, 3), np.eye(3))


def test_too_small_a_covariance_is_not_believed() -> None:
    used = _settings(min_stddev=0.1).covariance(np.diag([1e-12, 1e-4, 1.0]).ravel().tolist(), 3)
    np.testing.assert_allclose(used.diagonal(), [0.01, 0.01, 1.0], rtol=1e-12)


def test_axes_not_measured_leave_the_others_theirs() -> None:
    rows = (0.04, NAN, 0.0, NAN, NAN, 0.0, 0.0, 0.0, -1.0)
    used = _settings("log", default_stddev=0.2).covariance(rows, 3, [1, 2])
    np.testing.assert_allclose(used, np.diag([0.04, 0.04, 0.04]))


@given(st.lists(st.floats(), min_size=9, max_size=9), st.sets(st.integers(0, 2)))
def test_covariance_is_positive_whatever_is_given(rows: list[float], missing: set[int]) -> None:
    used = _settings(min_stddev=0.1).covariance(rows, 3, sorted(missing))
    assert np.isfinite(used).all() and np.array_equal(used, used.T)
    # rounding of the eigenvalues, relative to the largest
    assert np.linalg.eigvalsh(used)[0] > -1e-14 * used.max() and used.diagonal().min() >= 0.01 * (1.0 - 1e-12)


# Measurements


def test_fix_at_the_antenna_has_no_innovation() -> None:
    """A lever arm of 2 m forward: the antenna is there."""
    made = aids.make(checked_values({"gnss.lever_arm": [2.0, 0.0, 0.0]}))["gnss"]
    away = strapdown.corrected(STATE, (2.0 * math.cos(0.4), 2.0 * math.sin(0.4), 0.0))
    there = strapdown.geodetic(away)
    seen = made.measure(SOLUTION, np.zeros(0), _seen("gnss", there.lat, there.lon, there.height))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-6  # the Earth is round: 2 m squared over its radius


def test_slow_error_of_a_fix_is_taken_out() -> None:
    made = aids.make(checked_values({"gnss.slow_stddev": 2.0}))["gnss"]
    where = strapdown.geodetic(STATE)
    seen = made.measure(SOLUTION, np.array([1.0, -2.0, 3.0]), _seen("gnss", where.lat, where.lon, where.height))
    assert seen is not None and seen.own is not None
    np.testing.assert_allclose(seen.innovation, [1.0, -2.0, 3.0], atol=1e-6)


def test_velocity_without_up() -> None:
    made = aids.make(checked_values({}))["gnss_velocity"]
    full = made.measure(SOLUTION, np.zeros(0), _seen("gnss_velocity", 3.0, 4.0, 0.5))
    flat = made.measure(SOLUTION, np.zeros(0), _seen("gnss_velocity", 3.0, 4.0, NAN))
    assert full is not None and flat is not None
    np.testing.assert_allclose(full.innovation, [0.0, 0.0, -0.5], atol=1e-12)
    np.testing.assert_allclose(flat.innovation, [0.0, 0.0], atol=1e-12)
    assert flat.r.shape == (2, 2) and flat.h.shape[0] == 2


def test_log_takes_the_axes_that_are_there() -> None:
    made = aids.make(checked_values({}))["log"]
    forward, left, _ = strapdown.velocity_body(STATE)
    seen = made.measure(SOLUTION, np.zeros(3), _seen("log", NAN, left - 0.25, NAN))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.25], atol=1e-12)
    assert made.measure(SOLUTION, np.zeros(3), _seen("log", NAN, NAN, NAN)) is None
    turned = aids.make(checked_values({"log.mounting_rpy_deg": [0.0, 0.0, 90.0]}))["log"]
    seen = turned.measure(SOLUTION, np.zeros(3), _seen("log", left, -forward, 0.0))
    assert seen is not None and np.abs(seen.innovation).max() < 1e-12


def test_depth_counts_from_the_surface() -> None:
    values = {"depth.surface_height": 160.0, "depth.lever_arm": [0.0, 0.0, -1.0]}
    made = aids.make(checked_values(values))["depth"]
    # the gauge is 1 m below the IMU at 150 m: 11 m under a surface at 160 m
    seen = made.measure(SOLUTION, np.zeros(0), _seen("depth", 11.0, covariance=np.array([[0.04]])))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.0], atol=1e-9)
    np.testing.assert_allclose(seen.r, [[0.04]])


def test_order_is_by_stamp_then_by_content_and_not_by_arrival() -> None:
    first = Observation(5, "gnss", (1.0,), 7, np.eye(1))
    second = Observation(5, "gnss_velocity", (0.0,), 3, np.eye(1))
    assert sorted([second, first]) == [first, second]


def test_record_counts() -> None:
    record = Record()
    good = Update("gnss", 7, (1.0,), (1.0,), 0.1, True, "")
    record.take(good)
    record.take(Update("gnss", 9, (9.0,), (1.0,), 5.0, False, "outside the gate"))
    assert (record.accepted, record.rejected, record.accepted_ns) == (1, 1, 7)
    assert record.last is not None and not record.last.accepted
