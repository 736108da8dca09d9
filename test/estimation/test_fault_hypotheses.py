"""Which is at fault, a source or the solution: jumps, ramps, reflections, wrong starts, an IMU that fails."""

import math

import numpy as np
import pytest
from filter_harness import Run, bench, standing

from ins_nav.estimation.fault_hypotheses import Verdict
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE
from ins_nav.mechanization import nav_state


def lost(seed: int) -> Run:
    """A solution 3 km off, at 4 m/s, whose sigmas are 1 m and 0.05 m/s."""
    run = Run(bench(), standing(), seed, stddev=(1.0, 0.05, 1e-4), heading_stddev=math.radians(1.0), watched=True)
    run.state = nav_state.corrected(run.state, (2400.0, -1800.0, 0.0), (3.0, -2.5, 0.0))
    return run


def sigmas(run: Run, second: int) -> float:
    """Greatest error over sigma of horizontal position, velocity and tilt."""
    states = [0, 1, 3, 4, 6, 7]
    return float((np.abs(run.error(second)) / np.sqrt(np.maximum(run.filter.p.diagonal()[:SIZE], 1e-30)))[states].max())


def test_failure_during_dead_reckoning() -> None:
    """An hour without fixes, then fixes 3 km away: as many hours of failures as of fixes count, and fixes win."""
    run = lost(0)
    right = Measurement(np.zeros(2), np.eye(2, SIZE), np.eye(2), POSITION)
    assert run.update("gnss", -3600 * 10**9, right).accepted
    for second in range(1, 101):
        run.advance(second)
        run.gnss(second)
    failed = [second for second, verdict in run.verdicts if verdict is Verdict.FAILED]
    assert len(failed) == 1 and failed[0] < 30
    assert np.hypot(*run.error(100)[:2]) < 3.0
    assert sigmas(run, 100) < 4.0


@pytest.mark.parametrize("rate", [0.0, 0.1, 0.5])
def test_fixes_that_jump_are_excluded(rate: float) -> None:
    """40 s of fixes that jump by 30 m and drift, after a minute of good ones: the solution stays, also afterwards."""
    run = Run(bench(), standing(), 3, watched=True)
    for second in range(1, 151):
        run.advance(second)
        bad = 60 < second <= 100
        update = run.gnss(second, offset=(30.0 + rate * (second - 60), -20.0) if bad else (0.0, 0.0))
        assert update.accepted != bad
        assert np.abs(run.error(second)[:2]).max() < 5.0
        if bad and second > 61:
            levels = run.bank.protection_level()
            assert levels.horizontal > np.hypot(*run.error(second)[:2])
    assert all(verdict is Verdict.EXCLUDED for _, verdict in run.verdicts)
    assert not run.bank.hypotheses.suspects


def test_a_jump_that_lasts_is_bounded_by_the_protection_level() -> None:
    """Fixes stay 50 m off: rejected until a failure of the solution explains them better, and bounded all along."""
    run = Run(bench(), standing(), 3, watched=True)
    for second in range(1, 300):
        run.advance(second)
        run.gnss(second, offset=(50.0, 0.0) if second > 60 else (0.0, 0.0))
        if second > 60:
            assert np.hypot(*run.error(second)[:2]) < run.bank.protection_level().horizontal


def test_nonsense_is_never_accepted() -> None:
    """Fixes anywhere within 200 km, for 200 s: they do not agree, and none hits by chance."""
    run = Run(bench(), standing(), 4, watched=True)
    for second in range(1, 201):
        run.advance(second)
        assert not run.gnss(second, offset=run.rng.uniform(-200e3, 200e3, 2)).accepted
        assert sigmas(run, second) < 5.0


def test_an_accelerometer_that_fails() -> None:
    """0.3 m/s² from one moment on: the solution is replaced within 20 s, bounded till then; error and sigma agree."""
    run = Run(bench(), standing(), 5, watched=True)
    run.samples[60 * 100 :, 4] += 0.3
    for second in range(1, 241):
        run.advance(second)
        run.gnss(second)
        assert np.hypot(*run.error(second)[:2]) < run.bank.protection_level().horizontal
    failed = [second for second, verdict in run.verdicts if verdict is Verdict.FAILED]
    assert len(failed) == 1 and 60 < failed[0] < 80
    assert Verdict.RECOVERED in [verdict for _, verdict in run.verdicts]
    assert np.hypot(*run.error(240)[:2]) < 3.0
    assert sigmas(run, 240) < 4.0


def test_no_verdict_without_a_fault() -> None:
    for seed in range(3):
        run = Run(bench(), standing(), seed, watched=True)
        for second in range(1, 201):
            run.advance(second)
            run.gnss(second)
        assert not run.verdicts
