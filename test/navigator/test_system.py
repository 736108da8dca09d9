"""A navigation system in one process: parameters, solution for a filter, any order of calls."""

import math

import aid_messages
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_harness import FREE, HEADING, HERE, Fed, Values, imu_messages
from navigators import Ins

from ins_nav.config.parameters import ParameterError
from ins_nav.navigator.front_end import Phase


def test_solution_for_a_filter_that_begins_later() -> None:
    fed = Fed(**HERE, **HEADING, **FREE).feed(imu_messages()[:5000])
    n = fed.navigator
    solution = n.solution()
    assert solution is not None and n.covariance is not None
    feedback, aligned_ns = solution
    np.testing.assert_array_equal(feedback.covariance, n.covariance)
    assert (feedback.stamp_ns, feedback.state, aligned_ns) == (n.stamp_ns, n.state, n.aligned_ns)
    # driven for 30 s at 12 m/s or so with a heading of 1°: 5 m, and it is heading's doing
    correlation = feedback.covariance / np.sqrt(np.outer(*[feedback.covariance.diagonal().clip(1e-300)] * 2))
    assert math.hypot(*np.sqrt(feedback.covariance.diagonal()[:2])) > 3.0
    assert math.hypot(*correlation[0:2, 8]) > 0.8


def test_unknown_parameter() -> None:
    with pytest.raises(ParameterError, match=r"did you mean alignment\.duration"):
        Ins({"alignment.durration": 1.0})


LATEST = (2**31 - 2 * 86_400) * 1_000_000_000
"""ns: two days before the last stamp that a header can have."""
_STEPS = st.one_of(
    st.just(10_000_000),
    st.integers(-30_000_000, 30_000_000),
    st.integers(-15_000_000_000, 15_000_000_000),
    st.integers(-(2**62), 2**62),
)


_ANY = st.one_of(st.floats(-20.0, 20.0), st.floats(allow_nan=True, allow_infinity=True))


_FIX = st.tuples(st.integers(-1, 2), *[st.one_of(st.floats(-90.0, 90.0), _ANY)] * 3)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(_STEPS, st.one_of(st.none(), st.tuples(*[_ANY] * 6)), st.one_of(st.none(), _FIX)), max_size=40),
    st.integers(0, 150),
    st.booleans(),
)
def test_any_input(
    steps: list[tuple[int, Values | None, tuple[int, float, float, float] | None]], start: int, vertical: bool
) -> None:
    """Never raises, never leaves a state that is not finite, recovers with good samples."""
    parameters = {"initial.heading_deg": 30.0, "alignment.level_duration": 2.0, "navigation.vertical_channel": vertical}
    fed = Fed(**parameters)
    n, messages = fed.navigator, imu_messages("static")
    fed.feed(messages[:start])
    stamp = messages[start][0]
    for step, values, fix in steps:
        stamp = min(stamp + step, LATEST)
        fed.feed([(stamp, values or messages[0][1])])
        if fix is not None:
            aid_messages.add(n, "fix", stamp, *fix)
        if n.state is not None:
            assert all(math.isfinite(x) for x in n.state)
        assert all(math.isfinite(x) for x in (*n.angular_velocity, *n.specific_force, n.progress))
    aid_messages.add(n, "fix", stamp, 0, 55.7, 37.6, 150.0)
    # a later day: a gap beyond the limit from wherever the stamps have gone
    fed.feed(messages[:100], shift_ns=max(stamp, messages[0][0]) - messages[0][0] + 86_400_000_000_000)
    assert n.phase in (Phase.COARSE, Phase.NAVIGATING)
    aid_messages.add(n, "fix", stamp, 0, 55.7, 37.6, 150.0)
    fed.feed(messages[100:260], shift_ns=max(stamp, messages[0][0]) - messages[0][0] + 86_400_000_000_000)
    assert n.phase is Phase.NAVIGATING
    assert all(math.isfinite(x) for x in n.state)  # type: ignore[union-attr]
