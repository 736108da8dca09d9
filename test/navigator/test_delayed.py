"""The filter around the mechanization, offline: consistency, phases, order of arrival, bad input."""

import functools
import math
from typing import Any

import aid_messages
import numpy as np
import pytest
from aided_harness import (
    FOG,
    NS,
    PLACE,
    SHORT,
    Event,
    Fed,
    aid_events,
    drive,
    feedback_error,
    feedback_nees,
    imu_events,
    same_feedback,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from navigators import Filter, Ins
from scipy.stats import chi2

from ins_nav.messages import diagnostics
from ins_nav.navigator.correction import Correction
from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.scenarios import Simulation, simulate

# Consistency


@functools.cache
def _runs(count: int = 10) -> list[tuple[Simulation, Fed]]:
    runs = []
    for seed in range(count):
        s = drive(seed)
        runs.append((s, Fed({**SHORT}).feed(imu_events(s), aid_events(s))))
    return runs


@pytest.mark.xdist_group("runs")
@pytest.mark.parametrize(
    ("states", "low", "high"),
    [
        # position: white noise of the fixes, rightly known; the errors of one run are alike for some 10 s
        ((0, 1, 2), 0.6, 1.5),
        # velocity and attitude: scale factors and misalignments of the gyros are not in the model (and small), and
        # the noise of velocity at stops is set to 20 times what it is
        ((3, 4), 0.2, 1.6),
        ((6, 7, 8), 0.4, 1.8),
    ],
)
def test_errors_are_what_the_covariance_says(states: tuple[int, ...], low: float, high: float) -> None:
    """10 drives, every 10 s of driving: the mean of the normalized squares is their number but for chance."""
    squares = []
    for s, fed in _runs():
        driving = [f for f in fed.feedback if f.stamp_ns > s.start_ns + 30 * NS]
        squares += [feedback_nees(f, s, *states) / len(states) for f in driving[:: len(driving) // 8]]
    assert low < np.mean(squares) < high
    # one in a hundred, at most, beyond its 99.99 % limit
    assert np.mean(np.array(squares) * len(states) > chi2.isf(1e-4, len(states))) < 0.01


@pytest.mark.xdist_group("runs")
def test_fine_alignment_improves_heading() -> None:
    """Driving with satellite position shows heading; 20 s of rest leave it uncertain by half a degree."""
    for s, fed in _runs(3):
        first, last = fed.feedback[0], fed.feedback[-1]
        assert last.covariance[8, 8] < 0.2**2 * first.covariance[8, 8]
        assert abs(feedback_error(last, s)[8]) < 4.0 * math.sqrt(last.covariance[8, 8])
        assert fed.aided.records["gnss"].rejected <= 1  # one in 10,000 by chance


def test_log_and_velocity_find_their_errors_too() -> None:
    s = drive()
    fed = Fed({**SHORT}).feed(imu_events(s), aid_events(s, ("fix", "velocity", "log")))
    for name in ("gnss", "gnss_velocity", "log"):
        assert fed.aided.records[name].accepted > 80 and fed.aided.records[name].rejected <= 1
    (scale, sigma), *_ = fed.aided.own_states("log")
    # the simulated log has no scale error; some 70 s at 12 m/s with 0.1 m/s a second
    assert sigma < 0.003 and abs(scale) < 4.0 * sigma
    assert fed.aided.own_states("gnss") == fed.aided.own_states("gnss_velocity") == []
    assert feedback_nees(fed.feedback[-1], s, 3, 4) < chi2.isf(1e-4, 2)


@pytest.mark.parametrize("name", ["static", "rocking", "swell_alignment"])
def test_a_base_that_does_not_travel(name: str) -> None:
    motion = {"static": {}, "rocking": {"rocking_time": 200.0}, "swell_alignment": {}}[name]
    s = simulate(name, 4, duration=110.0, rate=50.0, **motion)
    noise = FOG if name != "static" else {}
    parameters = {"alignment.duration": 60.0, "alignment.fine_duration": 90.0, **noise}
    fed = Fed(parameters).feed(imu_events(s), aid_events(s))
    assert fed.counts == {} and fed.aided.phase is Phase.NAVIGATING
    for feedback in fed.feedback[4::8]:
        assert feedback_nees(feedback, s, 0, 1, 2) < chi2.isf(1e-4, 3)
        assert feedback_nees(feedback, s, 3, 4) < chi2.isf(1e-4, 2)
        assert feedback_nees(feedback, s, 6, 7, 8) < chi2.isf(1e-4, 3)
    assert ("zero velocity" in fed.aided.records) == (name != "swell_alignment")  # surge is no rest


# Phases


def test_fine_alignment_ends_by_time() -> None:
    s = drive()
    fed = Fed({**SHORT}).feed(imu_events(s)[:1900], aid_events(s)[:37])
    assert fed.aided.phase is Phase.FINE and not any(f.aligned for f in fed.feedback)
    # 38 s less the settling time
    assert fed.aided.fine_time == pytest.approx(38.0 - 2.2, abs=0.2)
    assert fed.aided.time_left == pytest.approx(40.0 - fed.aided.fine_time)
    fed.feed(imu_events(s)[1900:2500], aid_events(s)[37:50])
    assert fed.aided.phase is Phase.NAVIGATING and fed.aided.time_left == 0.0
    first = next(f for f in fed.feedback if f.aligned)
    assert (first.stamp_ns - s.start_ns) * 1e-9 == pytest.approx(40.0, abs=0.2)
    assert any(
        "fine alignment ended after 40 s" in text and "fine_duration (40 s) reached" in text for text in fed.said
    )


def test_fine_alignment_ends_by_sigma() -> None:
    s = drive()
    fed = Fed({"alignment.duration": 20.0, "alignment.fine_heading_deg": 0.2}).feed(imu_events(s), aid_events(s))
    aligned = [f for f in fed.feedback if f.aligned]
    assert math.degrees(math.sqrt(aligned[0].covariance[8, 8])) == pytest.approx(0.2, rel=0.1)
    before = [f for f in fed.feedback if not f.aligned]
    assert all(math.degrees(math.sqrt(f.covariance[8, 8])) > 0.2 for f in before)
    assert any("its target reached" in text for text in fed.said)


def test_prediction_of_the_time_left_comes_true() -> None:
    """Rocking with a position: the sigma of heading falls, and the time left with it."""
    s = simulate("rocking", 2, duration=150.0, rate=50.0, rocking_time=200.0)
    parameters = {"alignment.duration": 20.0, "alignment.fine_heading_deg": 1.5, "alignment.fine_duration": 1000.0}
    fed = Fed({**parameters, **FOG, "imu.gyro_bias_stddev_deg_per_hour": 0.01})
    left = []
    imu, fixes = imu_events(s), aid_events(s)
    for k in range(0, len(imu), 500):
        chunk = imu[k : k + 500]
        fed.feed(chunk, [f for f in fixes if chunk[0][0] <= f[0] <= chunk[-1][0]])
        if fed.aided.phase is Phase.FINE:
            left.append((fed.aided.fine_time, fed.aided.time_left))
    assert fed.aided.phase is Phase.NAVIGATING
    ended = next((f.stamp_ns - s.start_ns) * 1e-9 for f in fed.feedback if f.aligned)
    assert all(0.0 <= remaining < 980.0 for _, remaining in left)
    # a rule of thumb, its constant that of rest: right within a factor of three from the middle on
    time, remaining = left[-1]
    assert remaining < 3.0 * (ended - time) + 10.0


def test_aids_are_for_alignment_only() -> None:
    s = drive()
    fed = Fed({**SHORT, "aiding.until_aligned": True}).feed(imu_events(s), aid_events(s))
    record = fed.aided.records["gnss"]
    # from 20 s to 40 s, once a second; the phase ends at a look ten times a second
    assert 19 <= record.accepted <= 21 and record.rejected == 0
    sigma = [math.sqrt(f.covariance[0, 0]) for f in fed.feedback if f.aligned]
    assert sigma[-1] > 2.0 * sigma[0]
    assert feedback_nees(fed.feedback[-1], s, 0, 1) < chi2.isf(1e-4, 2)


# Order of arrival


@functools.cache
def _in_order() -> tuple[Correction, ...]:
    s = drive()
    return tuple(Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s, ("fix", "velocity", "log"))).feedback)


@pytest.mark.parametrize(("delay", "shuffle"), [(0.0, 1.0), (0.5, 0.0), (1.9, 0.0), (0.5, 1.3)])
def test_order_of_arrival_does_not_matter(delay: float, shuffle: float) -> None:
    s = drive()
    aids = aid_events(s, ("fix", "velocity", "log"), delay, shuffle)
    comes = [event[0] for event in aids]
    assert (comes != sorted(comes)) == (shuffle > 0.0)
    fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), aids)
    assert same_feedback(fed.feedback, _in_order())
    assert fed.counts == {}


def test_observations_of_one_stamp_in_any_order() -> None:
    s = drive()
    aids = [(comes, -number, *rest) for comes, number, *rest in aid_events(s, ("fix", "velocity", "log"))]
    fed = Fed({**SHORT, **PLACE}).feed([(comes, -1000, *rest) for comes, _, *rest in imu_events(s)], aids)  # type: ignore[misc]
    assert same_feedback(fed.feedback, _in_order())


def test_what_comes_too_late_is_left_out_and_told() -> None:
    s = drive()
    fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s, delay=2.6))
    # one a second after alignment, but the last two have not come yet
    assert fed.counts == {"gnss late": pytest.approx(88, abs=2)}
    assert "gnss" not in fed.aided.records
    assert any("gnss/fix: 2.60 s behind imu/data_raw, rejected: raise aiding.max_delay" in text for text in fed.said), (
        fed.said
    )
    patient = Fed({**SHORT, **PLACE, "aiding.max_delay": 3.0}).feed(imu_events(s), aid_events(s, delay=2.6))
    assert patient.counts == {} and patient.aided.records["gnss"].accepted > 80


def test_stamps_of_another_clock_are_told() -> None:
    s = drive()
    ahead = [(at, n, kind, (values[0] + 10 * NS, *values[1:])) for at, n, kind, values in aid_events(s)]
    fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), ahead)
    assert fed.counts["gnss ahead"] >= 80 and "gnss" not in fed.aided.records
    assert any(
        "gnss/fix: 10.0 s ahead of imu/data_raw, rejected: both must be stamped by one clock" in t for t in fed.said
    )


def test_delay_is_taken_off() -> None:
    """Stamped on arrival, 0.4 s after they were measured: 5 m at the speed of the drive."""
    s = drive()
    later = [(at, n, kind, (values[0] + 400_000_000, *values[1:])) for at, n, kind, values in aid_events(s)]
    right = Fed({**SHORT, **PLACE, "gnss.delay": 0.4}).feed(imu_events(s), later)
    assert same_feedback(right.feedback, Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s)).feedback)
    wrong = Fed({**SHORT, **PLACE}).feed(imu_events(s), later)
    away = [[np.linalg.norm(feedback_error(f, s)[:2]) for f in fed.feedback[-60:-20]] for fed in (right, wrong)]
    assert np.mean(away[1]) > 3.0 * np.mean(away[0])


def test_repeated_messages_count_once() -> None:
    s = drive()
    aids = aid_events(s)
    fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), aids, [(at + 1, *rest) for at, *rest in aids])  # type: ignore[misc]
    assert same_feedback(fed.feedback, Fed({**SHORT, **PLACE}).feed(imu_events(s), aids).feedback)
    assert fed.counts["gnss repeated"] >= 85


def test_first_observation_may_come_before_the_sample_that_ends_alignment() -> None:
    """Live, topics overtake each other: the fix that follows alignment may come before its last sample."""
    s = drive()
    late = [(at + 1_500_000_000, *rest) for at, *rest in imu_events(s)]
    fed = Fed({**SHORT, **PLACE}).feed(late, aid_events(s, ("fix", "velocity", "log")))  # type: ignore[arg-type]
    assert same_feedback(fed.feedback, _in_order())


def test_messages_without_value() -> None:
    s = drive()
    bad: list[Event] = []
    for n, (at, _, _, values) in enumerate(aid_events(s)):
        stamp, _, lat, lon, height, covariance = values
        kinds: list[tuple[str, tuple[Any, ...]]] = [
            ("fix", (stamp + 1, -1, lat, lon, height, covariance)),
            ("fix", (stamp + 2, 0, math.nan, lon, height, covariance)),
            ("fix", (stamp + 3, 0, lat, math.inf, height, covariance)),
            ("velocity", (stamp + 5, (math.nan, 1.0, 0.0), ())),
            ("log", (stamp + 6, (math.nan,) * 3, ())),
            ("depth", (stamp + 7, math.nan, 1.0)),
            ("fix", (stamp + 8, 0, 91.0, lon, height, covariance)),
        ]
        bad += [(at, 1000 * n + i, *kind) for i, kind in enumerate(kinds)]
    fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s), bad)
    assert same_feedback(fed.feedback, Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s)).feedback)
    assert set(fed.counts) == {
        "gnss no fix",
        "gnss invalid",
        "gnss_velocity unusable",
        "log unusable",
        "depth unusable",
    }


def test_fixes_without_height_are_horizontal() -> None:
    s = drive()
    flat = [(at, n, kind, (*values[:4], math.nan, values[5])) for at, n, kind, values in aid_events(s)]
    fed, full = Fed({**SHORT}).feed(imu_events(s), flat), Fed({**SHORT}).feed(imu_events(s), aid_events(s))
    assert fed.aided.filter is not None and full.aided.filter is not None
    assert fed.aided.records["gnss"].accepted == full.aided.records["gnss"].accepted
    sigma, other = (np.sqrt(x.aided.filter.p.diagonal()[:3]) for x in (fed, full))
    # height: nobody knows it, and a ground vehicle's tells nothing of the rest
    assert sigma[2] > 900.0 and other[2] < 3.0
    np.testing.assert_allclose(sigma[:2], other[:2], rtol=0.02)


def test_a_restart_forgets_what_the_filter_knew() -> None:
    """Stamps jump back: alignment begins with the uncertainty that parameters give."""
    s = drive()
    fed = Fed({**SHORT, **PLACE, "imu.gyro_bias_stddev_deg_per_hour": 1.0}).feed(imu_events(s)[:4500], aid_events(s))
    aided = fed.aided
    assert aided.filter is not None
    given = math.radians(1.0 / 3600.0)
    assert math.sqrt(aided.filter.p[11, 11]) < 0.999 * given
    (_, _, _, values) = imu_events(s)[0]
    for n in range(3):
        aided.add_imu(values[0] + n * 20_000_000, *values[1:])
    assert aided.filter is None
    assert math.sqrt(aided.front_end.biases.covariance[2, 2]) == pytest.approx(given, rel=1e-9)


def test_a_filter_that_begins_late_aligns_finely() -> None:
    """What `ins_node` has by itself is coarse."""
    s = drive()
    navigator = Ins({**SHORT, **PLACE})
    for _, _, _, values in imu_events(s)[:1500]:
        navigator.add_imu(*values)
    assert navigator.phase is Phase.NAVIGATING
    solution = navigator.solution()
    assert solution is not None and not solution[0].aligned


def test_zero_covariance_is_the_default() -> None:
    s = drive()
    zero = [(at, n, kind, (*values[:5], (0.0,) * 9)) for at, n, kind, values in aid_events(s)]
    none = [(at, n, kind, values[:5]) for at, n, kind, values in aid_events(s)]
    assert same_feedback(
        Fed({**SHORT, **PLACE}).feed(imu_events(s), zero).feedback,
        Fed({**SHORT, **PLACE}).feed(imu_events(s), none).feedback,
    )


def test_numbers_that_overflow_are_rejected() -> None:
    s = drive()
    huge = [
        (at, n, "velocity", (values[0], (1e200, (-1) ** n * 1e160, math.nan))) for at, n, _, values in aid_events(s)
    ]
    with np.errstate(over="ignore", invalid="ignore"):
        fed = Fed({**SHORT, **PLACE}).feed(imu_events(s), huge)
    assert fed.aided.records["gnss_velocity"].accepted == 0
    assert all(map(math.isfinite, fed.feedback[-1].state))


# Bad input


@functools.cache
def _level() -> list[tuple[float, ...]]:
    s = simulate("vehicle", 1, duration=60.0, rate=50.0, stand_time=8.0)
    return [tuple(row) for row in np.c_[s.angular_velocity, s.linear_acceleration].tolist()]


_NUMBER = st.floats()
_TRIPLE = st.tuples(_NUMBER, _NUMBER, _NUMBER)
_ROWS = st.one_of(st.just(()), st.lists(_NUMBER, min_size=9, max_size=9).map(tuple))
_OFFSET = st.integers(-3 * NS, 2 * NS) | st.sampled_from([0, -20_000_000, 10**11, -(10**11), 10**18])
_EVENT = st.one_of(
    st.tuples(st.just("imu"), st.integers(1, 200)),
    st.tuples(st.just("imu"), st.integers(50, 200)),
    st.tuples(st.just("good"), st.integers(-1000, 1000)),
    st.tuples(st.just("fix"), _OFFSET, st.integers(-1, 1), _NUMBER, _NUMBER, _NUMBER, _ROWS),
    st.tuples(st.just("velocity"), _OFFSET, _TRIPLE, _ROWS),
    st.tuples(st.just("log"), _OFFSET, _TRIPLE, _ROWS),
    st.tuples(st.just("depth"), _OFFSET, _NUMBER, _NUMBER),
    st.tuples(st.just("bad imu"), _OFFSET, _NUMBER),
    st.tuples(st.just("gap"), st.sampled_from([30_000_000, NS, 9 * NS, 11 * NS, -NS // 2, -100 * NS])),
    st.tuples(st.just("align")),
    st.tuples(st.just("zupt"), _OFFSET),
    st.tuples(st.just("adopt"), _OFFSET),
    st.tuples(st.just("follow"), _OFFSET, _OFFSET),
)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers near the largest overflow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    st.lists(_EVENT, min_size=5, max_size=40),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
def test_nothing_that_comes_makes_it_fail(
    events: list[tuple[Any, ...]], zero_velocity: bool, vertical: bool, unknown_heading: bool
) -> None:
    parameters = {
        "zupt.zero_velocity": zero_velocity,
        "initial.heading_deg": 30.0,
        "initial.heading_stddev_deg": 180.0 if unknown_heading else 1.0,
        "alignment.level_duration": 2.0,
        "navigation.vertical_channel": vertical,
        "gnss.slow_stddev": 1.0 if vertical else 0.0,
        **({} if unknown_heading else PLACE),
    }
    aided, ins = Filter(parameters), Ins(parameters)
    now, k = 1_700_000_000 * NS, 0
    for kind, *values in [("good", 0), ("imu", 150), *events, ("imu", 100)]:
        if kind == "imu":
            for _ in range(values[0]):
                now, k = now + 20_000_000, (k + 1) % len(_level())
                aided.add_imu(now, *_level()[k])
                for feedback in aided.drain():
                    ins.correct(feedback)
                ins.add_imu(now, *_level()[k])
        elif kind == "good":
            for navigator in (aided, ins):
                at = now + values[0] * 1_000_000
                aid_messages.add(navigator, "fix", at, 0, 55.7, 37.6, 150.0, (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0))
        elif kind == "fix":
            for navigator in (aided, ins):
                aid_messages.add(navigator, kind, now + values[0], *values[1:])
        elif kind in ("velocity", "log", "depth"):
            aid_messages.add(aided, kind, now + values[0], *values[1:])
        elif kind == "bad imu":
            for navigator in (aided, ins):
                navigator.add_imu(now + values[0], values[1], 0.0, 0.0, 0.0, 0.0, 9.8)
        elif kind == "gap":
            now += values[0]
        elif kind == "align":
            aided.align()
            ins.align()
        elif kind == "zupt":
            ins.zupt1()
            aided.call_zupt(now + values[0])
        elif (solution := ins.solution()) is not None:
            feedback, aligned_ns = solution
            if kind == "adopt":
                aided.adopt(feedback, aligned_ns + values[0])
            else:
                ins.correct(feedback._replace(stamp_ns=feedback.stamp_ns + values[0], apply_ns=now + values[1]))
        for navigator in (aided, ins):
            assert navigator.state is None or all(map(math.isfinite, navigator.state))
        if aided.filter is not None:
            assert np.isfinite(aided.filter.p).all()
            # rounding, relative to what was there before an exact measurement
            assert aided.filter.p.diagonal().min() >= -1e-12
        diagnostics.diagnostics(ins.realtime, ins.services.solved)
        diagnostics.alignment_diagnostics(aided.delayed)
