"""The innovation gate: jumps, outliers, noise larger than given, a solution that diverges."""

import copy
import math

import numpy as np
import pytest
from filter_harness import Run, bench, standing

from ins_nav.estimation.innovation_gate import AGREEING, PATIENCE
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE
from ins_nav.mechanization import nav_state


def lost(seed: int) -> Run:
    """A solution with errors of 3 km and 4 m/s, and sigmas of 1 m and 0.05 m/s."""
    run = Run(bench(), standing(), seed, stddev=(1.0, 0.05, 1e-4), heading_stddev=math.radians(1.0))
    run.state = nav_state.corrected(run.state, (2400.0, -1800.0, 0.0), (3.0, -2.5, 0.0))
    return run


@pytest.mark.parametrize("accepted_before", [True, False])
def test_jump_after_dead_reckoning(accepted_before: bool) -> None:
    """Accepted within 10 fixes, position and velocity right soon after, level and heading unchanged."""
    run = lost(0)
    if accepted_before:  # an hour ago
        right = Measurement(np.zeros(2), np.eye(2, SIZE), np.eye(2), POSITION)
        assert run.filter.update("gnss", -3600 * 10**9, right).accepted
    updates = []
    for second in range(1, 61):
        run.advance(second)
        updates.append(run.gnss(second))
    accepted = [u.accepted for u in updates]
    assert accepted.index(True) == AGREEING - 1 < 10
    assert updates[AGREEING - 1].reason and updates[AGREEING - 1].test_ratio > 1.0
    assert all(accepted[AGREEING - 1 :])
    x = run.error(60)
    assert np.abs(x[:2]).max() < 3.0
    assert np.abs(x[3:5]).max() < 0.5
    assert np.abs(x[6:8]).max() < 1e-3  # 1e-4 at the start; 3 km over the radius of the Earth is 5e-4
    assert abs(math.degrees(run.heading_error_now(60))) < 4.0


def test_reflected_signals_are_rejected() -> None:
    """40 s of fixes 30 m off that agree with each other, after a minute of good ones."""
    run = Run(bench(), standing(), 3)
    for second in range(1, 151):
        run.advance(second)
        bad = 60 < second <= 100
        update = run.gnss(second, offset=(30.0 + 0.1 * second, -20.0) if bad else (0.0, 0.0))
        assert update.accepted != bad
        assert update.reason == ("outside the gate" if bad else "")
        assert np.abs(run.error(second)[:2]).max() < 5.0
    assert PATIENCE > 40.0


def test_a_lasting_jump_overrides_the_gate_after_the_time_out() -> None:
    run = Run(bench(), standing(), 3)
    accepted = []
    for second in range(1, 200):
        run.advance(second)
        accepted.append(run.gnss(second, offset=(50.0, 0.0) if second > 60 else (0.0, 0.0)).accepted)
    assert accepted.index(False) == 60
    assert accepted.index(True, 60) == 60 + PATIENCE - 1
    assert all(accepted[round(60 + PATIENCE) - 1 :])


def test_inconsistent_fixes_are_never_accepted() -> None:
    """Fixes anywhere within 200 km, for 200 s: they do not agree, and none hits by chance."""
    run = Run(bench(), standing(), 4)
    for second in range(1, 201):
        run.advance(second)
        update = run.gnss(second, offset=run.rng.uniform(-200e3, 200e3, 2))
        assert not update.accepted


@pytest.mark.parametrize("gate", [0.05, 0.01])
def test_gate_rejects_with_its_probability(gate: float) -> None:
    run, rng = Run(bench(), standing(), 0), np.random.default_rng(0)
    start, count, rejected = run.filter, 4000, 0
    for _ in range(count):
        measurement = Measurement(2.0 * rng.standard_normal(3), np.eye(3, SIZE), 3.0 * np.eye(3), POSITION)
        rejected += not copy.copy(start).update("aid", 0, measurement, gate).accepted
    assert rejected / count == pytest.approx(gate, abs=4.0 * math.sqrt(gate / count))


def test_noise_larger_than_its_covariance() -> None:
    """Fixes with three times their sigma: estimated so, and accepted soon; outliers do not count as noise."""
    run, rng = Run(bench(), standing(), 3), np.random.default_rng(1)
    factors, accepted = [], 0
    for second in range(1, 201):
        run.advance(second)
        update = run.gnss(second, offset=tuple(rng.normal(0.0, 2.8, 2) + (100.0 if second % 5 == 0 else 0.0)))
        factors.append(update.noise_factor)
        accepted += update.accepted
    assert 140 <= accepted <= 160  # four fifths of 200
    # nine times the variance; the median of 41 is known to a third, and contains the filter's part
    assert 4.0 < float(np.median(factors[50:])) < 14.0
    run = Run(bench(), standing(), 3)
    for second in range(1, 201):
        run.advance(second)
        assert run.gnss(second).noise_factor == 1.0


def test_a_diverging_filter_is_corrected_before_the_time_out() -> None:
    """A solution whose error grows faster than its sigma."""
    run = Run(bench(), standing(), 3)
    accepted = []
    for second in range(1, 121):
        run.advance(second)
        off = 0.3 * max(0, second - 60) ** 1.5
        accepted.append(run.gnss(second, offset=(off, 0.0)).accepted)
    out = accepted.index(False)
    assert 60 <= out < 90 and True in accepted[out : out + 45]
