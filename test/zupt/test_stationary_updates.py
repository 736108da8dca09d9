"""Stops as measurements: when a sample is one of a stop, and what an earlier measurement leaves of the information."""

import math

import numpy as np
import pytest

from ins_nav.aiding.parameters import configuration
from ins_nav.estimation.innovation_gate import GATE, limit
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import GYRO_BIAS, HORIZONTAL_VELOCITY, SIZE
from ins_nav.event_log import EventLog
from ins_nav.mechanization.nav_state import initial_state
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


UNKNOWN, SHAKES = math.log(2.0), math.log(70.0)
"""`Change.stillness` after a gap; of a carrier that has shaken for 140 s of driving."""


@pytest.mark.parametrize(
    ("speed_stddev", "stillness", "speed", "stddev", "used", "doubted"),
    [
        pytest.param(12.7, SHAKES, 0.4, 1.9, True, False, id="minutes of a shaking drive: stillness decides"),
        pytest.param(30.0, UNKNOWN, 0.4, 1.9, False, False, id="after a gap: waits for a more certain speed"),
        pytest.param(30.0, UNKNOWN, 0.4, 0.3, True, False, id="after a gap: the solution is certain of rest"),
        pytest.param(30.0, UNKNOWN, 12.0, 1.9, False, True, id="after a gap: the solution is certain of motion"),
        pytest.param(30.0, SHAKES, 12.0, 1.9, False, True, id="stillness against a certain motion"),
        pytest.param(0.2, UNKNOWN, 1.0, 0.02, True, False, id="the detector is certain: the filter's sigma is wrong"),
        pytest.param(0.2, UNKNOWN, 9.0, 0.02, False, True, id="the detector is certain, the solution is far away"),
    ],
)
def test_a_stop_counts_by_the_odds_of_rest(
    speed_stddev: float, stillness: float, speed: float, stddev: float, used: bool, doubted: bool
) -> None:
    updates = _updates(None)
    updates.change(Change(True, 0, 2 * NS, speed_stddev, stillness))
    p = np.zeros((SIZE, SIZE))
    p[HORIZONTAL_VELOCITY, HORIZONTAL_VELOCITY] = stddev**2 * np.eye(2)
    state = initial_state(0.9, 0.4, 0.0, (speed, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    sample, still = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = [name for i in range(30) for name, _ in updates.add(2 * NS + i * NS // 10, sample, sample, state, still, p)]
    assert bool(found) == used
    assert updates.is_active(5 * NS) != doubted


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


def _gain(p: Array, m: Measurement) -> Array:
    return np.asarray(np.linalg.solve(m.h @ p @ m.h.T + m.r, m.h @ p).T)


def test_a_measurement_repeated_adds_nothing() -> None:
    m, before = _measurement(np.diag([1e-20, 4e-20, 9e-20])), _covariance(np.array([1e-16, 1e-16, 1e-18]))
    m = m._replace(innovation=np.array([1e-10, 2e-10, -3e-10]))
    now, x = _updated(before, m), _gain(before, m) @ m.innovation
    again, _ = without_known(m._replace(innovation=m.innovation - m.h @ x), before, now, m.innovation)
    np.testing.assert_array_equal(again.innovation, 0.0)
    # the share that stays
    np.testing.assert_allclose(_updated(now, again), now, rtol=1e-5, atol=1e-28)


@pytest.mark.parametrize("factor", [1.2, 4.0, 100.0])
def test_with_a_worse_measurement_of_the_same_data_it_counts_as_if_alone(factor: float) -> None:
    """Covariance and estimate: the filter is corrected by the worse one, then by the new part of the better one."""
    r = np.array([[4e-20, 1e-20, 0.0], [1e-20, 2e-20, 0.0], [0.0, 0.0, 1e-20]])
    worse, better = np.array([[3e-9, -1e-9, 2e-9], [2.5e-9, -1.2e-9, 2.1e-9]])
    before, alone = _covariance(np.array([1e-16, 2e-16, 1e-18])), _measurement(r)._replace(innovation=better)
    x = _gain(before, _measurement(factor * r)) @ worse
    now = _updated(before, _measurement(factor * r))
    new, _ = without_known(alone._replace(innovation=better - alone.h @ x), before, now, better)
    # the floor of the inverse, 1e-6 of the noise, over the part that is new, a sixth at least
    np.testing.assert_allclose(_updated(now, new), _updated(before, alone), rtol=1e-4, atol=1e-25)
    found = x + _gain(now, new) @ new.innovation
    np.testing.assert_allclose(found[GYRO_BIAS], (_gain(before, alone) @ better)[GYRO_BIAS], rtol=1e-4)


def test_a_contradicted_estimate_before_does_not_bias_the_present_one() -> None:
    """A drift has changed by 1000 of its sigmas, and the filter, widened, has followed."""
    m, before, step = _measurement(1e-20 * np.eye(3)), _covariance(np.full(3, 2e-18)), np.array([0.0, 0.0, 1.4e-6])
    new, gate = without_known(m, before, before, step)
    # 1e-10 is the sigma of the measurement
    np.testing.assert_allclose(new.innovation, 0.0, atol=1e-12)
    # before the filter has followed, its estimate is no information
    new, gate = without_known(m._replace(innovation=step), before, 0.5 * before, step)
    np.testing.assert_array_equal(new.innovation, step)
    assert gate == GATE  # the filter's, which rejects it or widens


def test_the_gate_is_that_of_the_whole_measurement() -> None:
    """Two estimates of the same data that differ by 1.5 of their sigmas agree, however little of them is new."""
    m, before = _measurement(1e-20 * np.eye(3))._replace(innovation=np.full(3, 1.5e-10)), _covariance(np.full(3, 1e-16))
    now = _covariance(np.full(3, 1.05e-20))
    new, gate = without_known(m, before, now, m.innovation)
    s = new.h @ now @ new.h.T + new.r
    assert new.innovation @ np.linalg.solve(s, new.innovation) > limit(3, GATE)  # it would be rejected
    assert gate == 0.0


def test_what_another_process_has_widened_is_no_information() -> None:
    m, before = _measurement(1e-20 * np.eye(3)), _covariance(np.full(3, 1e-18))
    new, _ = without_known(m, before, 4.0 * before, np.zeros(3))
    np.testing.assert_allclose(new.r, m.r, rtol=1e-9)
