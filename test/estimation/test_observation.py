"""The record of an update: innovation, sigma, test ratio, reason."""

import math

import numpy as np
import pytest
from filter_harness import Run, bench, standing

from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE


def test_status() -> None:
    run = Run(bench(), standing(), 0)
    h, r = np.eye(2, SIZE), 3.0 * np.eye(2)
    update = run.filter.update("aid", 5, Measurement(np.array([1.0, -1.0]), h, r, POSITION))
    assert (update.aid, update.stamp_ns, update.innovation, update.sigma) == ("aid", 5, (1.0, -1.0), (2.0, 2.0))
    assert (update.accepted, update.reason) == (True, "")
    # chi-square, 2 degrees: exp(-limit / 2) = gate
    assert update.test_ratio == pytest.approx(0.5 / (-2.0 * math.log(1e-4)))
    for bad in (math.nan, math.inf):
        before = run.filter.x.copy(), run.filter.p.copy()
        update = run.filter.update("aid", 6, Measurement(np.array([bad, 0.0]), h, r, POSITION))
        assert (update.accepted, update.reason) == (False, "not a number")
        np.testing.assert_equal((run.filter.x, run.filter.p), before)
