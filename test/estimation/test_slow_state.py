"""An absent state has neither a prior nor a process noise."""

import math

from ins_nav.estimation.slow_state import ABSENT, SlowState


def test_a_constant_by_default() -> None:
    assert ABSENT == SlowState(0.0)
    assert SlowState(2.0).walk == 0.0 and math.isinf(SlowState(2.0).correlation_time)
