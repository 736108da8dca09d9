"""Hypotheses of a place by ranges to one beacon: one place is found, two are two, outliers do no harm."""

import math

import numpy as np
import pytest

from ins_nav.aiding.range_search import RangeSearch, uncertain

DEPTH = 40.0


def _run(seed: int, turns: bool, outliers: float = 0.0) -> tuple[RangeSearch, np.ndarray, np.ndarray, int]:
    """Dead reckoning from a place wrong by 200 m (1 sigma), 1.5 m/s; a range of 0.5 m each 5 s."""
    rng = np.random.default_rng(seed)
    prior = 200.0**2 * np.eye(2)
    offset = 200.0 * rng.standard_normal(2)
    place = rng.uniform(-200.0, 200.0, 2) + [0.0, 250.0]
    heading, search, away = rng.uniform(0.0, 6.3), RangeSearch(), np.zeros(3)
    for k in range(120):
        if turns and k % 30 == 20:
            heading += 1.5
        place = place + 7.5 * np.array([math.cos(heading), math.sin(heading)])
        away = np.array([*(place - offset), -DEPTH])
        distance = math.hypot(*place, DEPTH) + 0.5 * rng.standard_normal()
        if rng.uniform() < outliers:
            distance += rng.uniform(10.0, 300.0)
        search.add(away, distance, 0.25, prior)
        if search.settled(away) is not None:
            return search, offset, away, k
    return search, offset, away, 120


def test_a_course_that_turns_is_found() -> None:
    ratios, taken = [], []
    for seed in range(30):
        search, offset, away, count = _run(seed, True)
        found = search.settled(away)
        if found is None:
            continue
        mean, covariance = found
        ratios.append(float((mean - offset) @ np.linalg.solve(covariance, mean - offset)))
        taken.append(count)
    assert len(ratios) >= 27 and np.median(taken) < 80
    # chi-square of two degrees: 2 on average, and 13.8 once in a thousand; the first range's noise counts twice
    assert np.mean(ratios) < 3.5 and max(ratios) < 20.0


def test_a_straight_course_leaves_two_places() -> None:
    """The mirror image suits as well: both stay, and nothing is claimed."""
    two = 0
    for seed in range(20):
        search, offset, away, _ = _run(seed, False)
        near = np.hypot(*(search.offsets - offset).T) < 60.0
        assert search.weights[near].sum() > 0.01  # the true one is there still
        found = search.settled(away)
        two += found is None
        if found is not None:  # where it was thought to be decides
            assert (found[0] - offset) @ np.linalg.solve(found[1], found[0] - offset) < 20.0
    assert two >= 5


@pytest.mark.parametrize("seed", range(5))
def test_outliers(seed: int) -> None:
    search, offset, away, _ = _run(seed, True, 0.2)
    found = search.settled(away)
    assert found is not None
    mean, covariance = found
    assert (mean - offset) @ np.linalg.solve(covariance, mean - offset) < 20.0


def test_corrections_are_followed() -> None:
    search = RangeSearch()
    search.add(np.array([300.0, 0.0, 0.0]), 300.0, 1.0, 1e4 * np.eye(2))
    before = search.offsets.copy()
    search.moved(3.0, -4.0)
    np.testing.assert_allclose(search.offsets, before - [3.0, -4.0])


def test_when_a_place_is_uncertain() -> None:
    assert uncertain(100.0**2 * np.eye(2), np.array([300.0, 0.0, -40.0]))
    assert not uncertain(10.0**2 * np.eye(2), np.array([300.0, 0.0, -40.0]))
