"""The ZUPT services: refusals, and calls and events in any order."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigators import Ins
from zupt_harness import DRIFT, HZ, KNOWN, PERFECT, TWO, Fed, paper, two_positions

from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.scenarios import simulate

# Refusals


def test_not_navigating_yet() -> None:
    fed = Fed(paper(), KNOWN).to(10.0)
    for service in ("zupt1", "zupt2"):
        sentence = "no navigation solution yet: coarse, 25 % of alignment done; call again when navigating"
        assert getattr(fed.navigator, service)() == (False, sentence)
    assert fed.navigator.state is None


@pytest.mark.parametrize("service", ["zupt1", "zupt2"])
def test_moving_is_refused(service: str) -> None:
    fed = Fed(two_positions(), TWO).to(45.0)
    sentence = fed.refused(service)
    assert sentence.startswith("moving for 1")
    assert "stand still until stopped is true (speed since the last stop 5.0" in sentence


@pytest.mark.parametrize("service", ["zupt1", "zupt2"])
def test_a_stop_too_short_is_refused(service: str) -> None:
    fed = Fed(two_positions(), TWO).to(64.0)
    sentence = fed.refused(service)
    assert sentence.startswith("stop too short: 5.") and "at least 8.3 s are needed; stand still" in sentence


def test_rocking_too_much_is_refused() -> None:
    fed = Fed(paper(rocking_amplitude_deg=5.0, period=5.0), KNOWN | {"zupt.max_rocking_deg": 2.0}).to(100.0)
    # roll and pitch a quarter of a period apart: the size of the tilt is the amplitude all the time
    assert fed.refused("zupt2") == (
        "rocking too much: 5.0° RMS, zupt.max_rocking_deg is 2; wait until the vehicle is calmer and call again"
    )


def test_no_turn_between_the_positions_is_refused() -> None:
    fed = Fed(paper(), KNOWN).to(60.0)
    fed.call("zupt1")
    assert fed.to(80.0).refused("zupt1").startswith("no turn between the positions: yaw differs by 0.0°, at least 20°")
    fed.call("zupt2")  # which the refused call does not hinder


def test_a_drift_that_changed_between_the_positions_is_refused() -> None:
    s = two_positions()
    step = np.where(np.arange(len(s.stamps_ns)) < 200.0 * 50.0, 0.0, 1e-6)[:, None]
    fed = Fed(replace(s, angular_velocity=s.angular_velocity + step * [0.0, 0.0, 1.0]), TWO).to(175.0)
    fed.call("zupt1")
    for time, call in ((250.0, "zupt2"), (300.0, "")):  # and without a call, from yaw at rest
        other = fed.to(time).fork()
        if call:
            other.call(call)
            other.settle()
        sigma = math.sqrt(other.navigator.gyro_bias_covariance[2, 2])
        # 1e-4 of the step, and 30 times what the fit of a stop without noise leaves
        assert abs(other.bias[2] - DRIFT[2] - 1e-6) < min(3.0 * sigma, 1e-10)
    sentence = fed.to(330.0).refused("zupt1")
    assert sentence.startswith("inconsistent: no drift and azimuth explain both stops (chi-square ")
    assert "its drift changed between them; this is position 1 now" in sentence
    assert "z +0.227" in fed.call("zupt2")  # position 1 stays, and the rest goes on


def test_even_motion_that_looks_like_rest_is_doubted() -> None:
    """After a gap the detector knows nothing, but the solution does."""
    s = simulate("vehicle", 0, duration=80.0, stand_time=20.0, rate=HZ, **PERFECT)
    fed = Fed(s, {"initial.heading_deg": 30.0}).to(34.0).to(36.0, skip=True).to(42.0)  # at 12 m/s, straight on
    assert fed.navigator.detector.stopped
    assert fed.navigator.events.counts["stops doubted"] == 1
    assert fed.navigator.delayed.records["zero velocity"].last.stamp_ns < fed.s.start_ns + 25 * 10**9
    assert fed.velocity() < 0.01
    sentence = fed.refused("zupt2")
    assert sentence.startswith("moving: the IMU seems to rest, but the solution moves at 12.0 m/s; if the vehicle does")
    assert fed.to(80.0).position() < 0.2  # the slow start's 1e-3 m/s at most, for a minute


# Whatever comes


@pytest.mark.parametrize("heading", [{}, {"initial.heading_deg": 45.0, "initial.heading_stddev_deg": 0.0}])
def test_gyros_said_to_have_no_bias_at_all(heading: dict[str, float]) -> None:
    """The parameter allows it."""
    fed = Fed(paper(), heading | {"imu.gyro_bias_stddev_deg_per_hour": 0.0}).to(100.0)
    fed.call("zupt1")
    fed.call("zupt2")


def test_going_on_from_a_state_of_the_past_with_nothing_changed() -> None:
    fed = Fed(two_positions(), TWO).to(47.0)
    n = fed.navigator.realtime
    before, buffer = n.state, n.buffer
    for back_ns in (11_000_000_000, 3_000_000_000, 0):
        entry = buffer.at(n.stamp_ns - back_ns)
        assert buffer.reintegrate(entry.stamp_ns, entry.state, n.compensation) == before


_STEPS = st.one_of(
    st.tuples(st.just("drive"), st.integers(1, 300)),
    st.tuples(st.just("stand"), st.integers(1, 300)),
    st.tuples(st.just("sway"), st.integers(1, 300)),
    st.tuples(st.sampled_from(["zupt1", "zupt2"]), st.just(0)),
    st.tuples(st.sampled_from(["zupt1", "zupt2"]), st.just(0)),
    st.tuples(st.just("align"), st.just(0)),
    st.tuples(st.just("gap"), st.integers(1, 1500)),
    st.tuples(st.just("nan"), st.integers(1, 5)),
    st.tuples(st.just("restart"), st.just(0)),
)


@functools.cache
def _pieces() -> dict[str, list[list[float]]]:
    drive = simulate("vehicle", 0, duration=120.0, stand_time=0.0, rate=25.0)
    sway = simulate("rocking", 0, duration=120.0, rate=25.0, roll_amplitude_deg=2.0, **{"imu.preset": "navigation"})
    stand = simulate("static", 0, duration=120.0, rate=25.0, heading_deg=170.0)
    pieces = {"drive": drive, "sway": sway, "stand": stand}
    return {name: np.c_[s.angular_velocity, s.linear_acceleration].tolist() for name, s in pieces.items()}


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.lists(_STEPS, max_size=12), st.sampled_from([0.001, 0.01, 10.0]), st.booleans())
def test_any_order_of_calls_and_events(steps: list[tuple[str, int]], stddev: float, vertical: bool) -> None:
    """Never raises, never leaves anything that is not finite, navigates again after a restart."""
    n = Ins(
        {
            "initial.latitude_deg": 55.7,
            "initial.longitude_deg": 37.6,
            "initial.height": 150.0,
            "initial.heading_deg": 30.0,
            "initial.heading_stddev_deg": 1.0,
            "imu.gyro_bias_stddev_deg_per_hour": stddev,
            "imu.max_gap": 40.0,
            "navigation.vertical_channel": vertical,
        }
    )
    stamp, at = 1_700_000_000_000_000_000, dict.fromkeys(_pieces(), 0)

    def feed(name: str, count: int) -> None:
        nonlocal stamp
        rows = _pieces()[name]
        for _ in range(count):
            stamp += 40_000_000
            n.add_imu(stamp, *rows[at[name] % len(rows)])
            at[name] += 1
        values = [*n.gyro_bias, *(n.state or ()), *n.attitude_covariance.ravel(), *n.gyro_bias_covariance.ravel()]
        assert all(map(math.isfinite, values))

    feed("stand", 150)
    for what, count in steps:
        if what in _pieces():
            feed(what, count)
        elif what == "gap":
            stamp += 40_000_000 * count
        elif what == "nan":
            for _ in range(count):
                stamp += 40_000_000
                n.add_imu(stamp, math.nan, 0.0, 0.0, 0.0, 0.0, 9.8)
        elif what == "restart":
            stamp -= 3_600_000_000_000
        else:
            getattr(n, what)()
    stamp -= 3_600_000_000_000
    feed("stand", 400)
    assert n.phase is Phase.NAVIGATING
    done, text = n.zupt2()
    assert done, text


def test_a_heading_given_is_not_taken_again() -> None:
    fed = Fed(two_positions(), TWO).to(250.0)  # turned by 120° since the start
    before = fed.rotation()[2]
    fed.navigator.align()
    fed.to(262.0)
    assert fed.navigator.phase is Phase.NAVIGATING
    # the solution's own heading, not the 45.2° of the start: drift of 1e-7 rad/s for 12 s
    assert fed.rotation()[2] == pytest.approx(before, abs=1.0)
