"""The filters beside the main one: nothing changes without a fault; invalid numbers reach none of them."""

import math

import numpy as np
from filter_harness import Run, bench, standing

from ins_nav.estimation.fault_hypotheses import Verdict
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE


def test_the_main_filter_is_as_without_the_others() -> None:
    """Bit for bit: the others only watch."""
    alone, watched = (Run(bench(), standing(), 3, watched=flag) for flag in (False, True))
    for second in range(1, 31):
        for run in (alone, watched):
            run.advance(second)
            run.gnss(second)
    assert alone.state == watched.state
    np.testing.assert_array_equal(alone.filter.p, watched.filter.p)


def test_not_a_number_changes_nothing() -> None:
    run = Run(bench(), standing(), 3, watched=True)
    for second in range(1, 6):
        run.advance(second)
        run.gnss(second)
    before = [each.p for each in run.bank.separation.filters]
    bad = Measurement(np.array([math.nan, 0.0]), np.eye(2, SIZE), np.eye(2), POSITION)
    update, verdict = run.bank.update("gnss", "gnss", 6 * 10**9, bad)
    assert not update.accepted and update.reason == "not a number" and verdict is Verdict.NONE
    assert all(p is each.p for p, each in zip(before, run.bank.separation.filters, strict=True))


def test_a_disturbance_is_of_all_filters() -> None:
    run = Run(bench(), standing(), 3, watched=True)
    run.advance(1)
    run.gnss(1)
    before = [each.p[0, 0] for each in (run.filter, *run.bank.separation.filters)]
    run.bank.disturb(np.zeros(3), np.zeros(3), np.full(3, 2.0))
    after = [each.p[0, 0] for each in (run.filter, *run.bank.separation.filters)]
    np.testing.assert_allclose(np.subtract(after, before), 4.0)
