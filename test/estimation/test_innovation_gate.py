"""The innovation gate: its probability, noise larger than given."""

import copy
import math

import numpy as np
import pytest
from filter_harness import Run, bench, standing

from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE


@pytest.mark.parametrize("gate", [0.05, 0.01])
def test_gate_rejects_with_its_probability(gate: float) -> None:
    run, rng = Run(bench(), standing(), 0), np.random.default_rng(0)
    start, count, rejected = run.filter, 4000, 0
    for _ in range(count):
        measurement = Measurement(2.0 * rng.standard_normal(3), np.eye(3, SIZE), 3.0 * np.eye(3), POSITION)
        rejected += not copy.copy(start).update("aid", 0, measurement, gate).accepted
    assert rejected / count == pytest.approx(gate, abs=4.0 * math.sqrt(gate / count))


def test_noise_that_is_larger_than_it_says() -> None:
    """Fixes with three times their sigma: believed that, and none is lost for long; outliers do not count as noise."""
    run, rng = Run(bench(), standing(), 3), np.random.default_rng(1)
    factors, accepted = [], 0
    for second in range(1, 201):
        run.advance(second)
        update = run.gnss(second, offset=tuple(rng.normal(0.0, 2.8, 2) + (100.0 if second % 5 == 0 else 0.0)))
        factors.append(update.noise_factor)
        accepted += update.accepted
    assert 140 <= accepted <= 160  # four fifths of 200
    # nine times the variance; the median of 41 is known to a third, and the filter's own part is in it
    assert 4.0 < float(np.median(factors[50:])) < 14.0
    run = Run(bench(), standing(), 3)
    for second in range(1, 201):
        run.advance(second)
        assert run.gnss(second).noise_factor == 1.0
