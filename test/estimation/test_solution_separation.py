"""Solution separation: filters that follow the main one are exact; false alarms, faults, protection levels."""

import copy
import math
from typing import Any

import numpy as np
import pytest
from filter_harness import Run, bench, standing

from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE, VELOCITY


@pytest.mark.parametrize("heading_stddev_deg", [1.0, 100.0])
def test_a_filter_that_follows_another_is_the_filter(heading_stddev_deg: float) -> None:
    """With the same measurements its errors stay zero and its covariance that of the filter it follows."""
    run = Run(bench(), standing(), 3, heading_stddev=math.radians(heading_stddev_deg))
    follower = copy.copy(run.filter)

    def propagate(*arguments: Any) -> None:
        follower.propagate(*arguments)
        run.filter.propagate(*arguments)

    run.propagate = propagate
    for second in range(1, 61):
        run.advance(second)
        measurement = horizontal(run, second, POSITION, 1.0)
        h = follower.design("fix", measurement)
        follower.correct(h, measurement.r, measurement.innovation - h @ follower.x)
        run.filter.update("fix", second * 10**9, measurement)
        run.feed_back()
        follower.follow(run.filter.fed_back)
        # rounding of the covariances, over 60 updates
        assert follower.x == pytest.approx(run.filter.x, abs=1e-7)
        assert follower.p == pytest.approx(run.filter.p, rel=1e-6, abs=1e-9)


def horizontal(run: Run, second: int, states: slice, stddev: float, wrong: float = 0.0) -> Measurement:
    """Measurement of the first two of three states, with noise; the first wrong by so much."""
    h = np.zeros((2, SIZE))
    h[:, states.start : states.start + 2] = np.eye(2)
    noise = stddev * run.rng.standard_normal(2) - [wrong, 0.0]
    return Measurement(run.error(second)[states][:2] + noise, h, stddev**2 * np.eye(2), states)


def aided(seed: int, offset: float = 0.0, begin: int = 100) -> tuple[list[float], list[float], list[float], list[str]]:
    """A base with fixes of 1 m and 0.2 m/s velocities: errors, sigmas, protection levels, sources that contradict."""
    run = Run(bench(), standing(), seed, heading_stddev=math.radians(2.0), watched=True)
    errors, sigmas, levels, sources = [], [], [], []
    for second in range(1, 241):
        run.advance(second)
        for source, states, stddev in (("fix", POSITION, 1.0), ("velocity", VELOCITY, 0.2)):
            wrong = offset if source == "fix" and second > begin else 0.0
            run.update(source, second * 10**9, horizontal(run, second, states, stddev, wrong))
        errors.append(float(np.hypot(*run.error(second)[:2])))
        sigmas.append(float(np.sqrt(run.filter.p[0, 0] + run.filter.p[1, 1])))
        levels.append(run.bank.protection_level().horizontal)
        sources += [each.source for each in run.bank.separation.contradictions()]
    return errors, sigmas, levels, sources


def test_no_alarm_without_a_fault() -> None:
    for seed in range(4):
        errors, _, levels, sources = aided(seed)
        assert not sources  # 4 x 240 tests at 1e-7
        assert (np.array(errors) < levels).all()
        assert max(levels[30:]) < 25.0  # the velocities alone: 5 sigmas of 0.2 m/s · √240 s


@pytest.mark.parametrize("offset", [2.0, 3.0])
def test_a_fault_within_the_gate_is_bounded(offset: float) -> None:
    """Fixes jump by less than the gate rejects: the error exceeds its sigma, not its protection level."""
    errors, sigmas, levels, _ = aided(1, offset)
    assert max(e / s for e, s in zip(errors[100:], sigmas[100:], strict=True)) > 3.0
    assert (np.array(errors) < levels).all()
