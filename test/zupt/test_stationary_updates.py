"""Stops as measurements: when a sample is one of a stop, and what an earlier measurement leaves of the information."""

import numpy as np
import pytest

from ins_nav.aiding.parameters import configuration
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import GYRO_BIAS, SIZE
from ins_nav.event_log import EventLog
from ins_nav.stop_detection.detector import Change
from ins_nav.zupt.measurements import without_known
from ins_nav.zupt.stationary_updates import MARGIN_NS, StationaryUpdates

Array = np.ndarray
NS = 1_000_000_000


def _updates(stopped_since_ns: int | None) -> StationaryUpdates:
    known = configuration({})
    updates = StationaryUpdates(known.imu, known.zupt, known.aiding, EventLog())
    updates.begin(stopped_since_ns)
    return updates


def test_a_sample_is_one_of_a_stop_from_a_second_after_it_began() -> None:
    updates = _updates(None)
    assert not updates.is_active(100 * NS)
    updates.change(Change(True, 100 * NS, 102 * NS))
    assert not updates.is_active(101 * NS)
    assert updates.is_active(101 * NS + 1) and updates.is_active(500 * NS)


def test_a_stop_ends_a_margin_before_its_detected_end() -> None:
    updates = _updates(None)
    updates.change(Change(True, 100 * NS, 102 * NS))
    updates.change(Change(False, 120 * NS, 121 * NS))
    assert updates.is_active(120 * NS - MARGIN_NS)
    assert not updates.is_active(120 * NS - MARGIN_NS + 1)


def test_the_stop_that_lasts_when_the_filter_starts_counts_at_once() -> None:
    updates = _updates(100 * NS)
    assert not updates.is_active(100 * NS) and updates.is_active(100 * NS + 1)


# Information of the same data


def _measurement(r: Array) -> Measurement:
    h = np.zeros((3, SIZE))
    h[:, GYRO_BIAS] = -np.eye(3)
    return Measurement(np.zeros(3), h, r, GYRO_BIAS)


def _covariance(variances: Array) -> Array:
    p = np.zeros((SIZE, SIZE))
    p[GYRO_BIAS, GYRO_BIAS] = np.diag(variances)
    return p


def _updated(p: Array, m: Measurement) -> Array:
    return np.asarray(p - p @ m.h.T @ np.linalg.solve(m.h @ p @ m.h.T + m.r, m.h @ p))


def test_a_measurement_repeated_adds_nothing() -> None:
    m, before = _measurement(np.diag([1e-20, 4e-20, 9e-20])), _covariance(np.array([1e-16, 1e-16, 1e-18]))
    now = _updated(before, m)
    again = _updated(now, without_known(m, before, now))
    # the share that stays
    np.testing.assert_allclose(again, now, rtol=1e-5, atol=1e-28)


@pytest.mark.parametrize("factor", [1.0, 4.0, 100.0])
def test_with_a_worse_measurement_of_the_same_data_it_counts_as_if_alone(factor: float) -> None:
    r = np.array([[4e-20, 1e-20, 0.0], [1e-20, 2e-20, 0.0], [0.0, 0.0, 1e-20]])
    before = _covariance(np.array([1e-16, 2e-16, 1e-18]))
    now = _updated(before, _measurement(factor * r))
    both = _updated(now, without_known(_measurement(r), before, now))
    np.testing.assert_allclose(both, _updated(before, _measurement(r)), rtol=1e-4, atol=1e-25)


def test_what_another_process_has_widened_is_no_information() -> None:
    m, before = _measurement(1e-20 * np.eye(3)), _covariance(np.full(3, 1e-18))
    np.testing.assert_allclose(without_known(m, before, 4.0 * before).r, m.r, rtol=1e-9)
