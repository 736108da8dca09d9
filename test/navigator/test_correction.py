"""What the filter finds on its way into `ins_node`; a filter that begins later."""

import functools
import math
from collections.abc import Iterable, Sequence

import aid_messages
import numpy as np
import pytest
from aided_harness import NS, PLACE, SHORT, Fed, aid_events, drive, feedback_nees, imu_events, same_feedback, standing
from decoding import as_message
from navigators import Filter, Ins
from scipy.stats import chi2

from ins_nav.mechanization import nav_state, strapdown
from ins_nav.messages import correction_codec
from ins_nav.navigator.correction import Correction
from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.scenarios import Simulation


@functools.cache
def _followed() -> Fed:
    s = drive()
    return Fed({**SHORT, **PLACE}).feed(imu_events(s), aid_events(s), ins=True)


def _follower(given: Iterable[tuple[int, Correction]], without: Iterable[int] = ()) -> Ins:
    """A navigator over the drive that is given each feedback when the sample of a stamp was taken."""
    ins, waiting, missing = Ins({**SHORT, **PLACE}), sorted(given, key=lambda item: item[0]), set(without)
    for at, _, _, values in imu_events(drive()):
        while waiting and waiting[0][0] < at:
            ins.correct(waiting.pop(0)[1])
        if at not in missing:
            ins.add_imu(*values)
    return ins


def _on_time(feedback: Sequence[Correction]) -> list[tuple[int, Correction]]:
    return [(f.apply_ns - 400_000_000, f) for f in feedback]


def _rerun(ins: Ins, feedback: Correction) -> nav_state.NavState:
    """The feedback's state, carried on over the samples since."""
    buffer = ins.realtime.buffer
    samples = buffer.between(feedback.stamp_ns, ins.stamp_ns).samples
    compensation = ins.compensation
    states = strapdown.integrate(
        feedback.state, buffer.at(feedback.stamp_ns).raw, samples, compensation, vertical=False
    )
    return nav_state.NavState._make(states[-1].tolist())


def test_follower_goes_on_from_the_feedback_bit_for_bit() -> None:
    fed = _followed()
    newest = [f for f in fed.feedback if f.apply_ns <= fed.ins.stamp_ns][-1]
    assert fed.ins.realtime.buffer.at(newest.stamp_ns).state == newest.state
    assert fed.ins.state == _rerun(fed.ins, newest)
    assert (fed.ins.gyro_bias, fed.ins.accel_bias) == (newest.gyro_bias, newest.accel_bias)
    assert fed.ins.phase is Phase.NAVIGATING
    # of the present: what is uncertain has grown in some 3 s, velocity of 0.1 m/s the position too
    assert fed.ins.covariance is not None
    own = [0, 1, 3, 4, 6, 7, 8]
    ratio = np.sqrt(fed.ins.covariance.diagonal()[own] / newest.covariance.diagonal()[own])
    assert (ratio > 0.99).all() and (ratio < 1.5).all()
    # nothing else corrects meanwhile
    assert fed.ins.events.counts == {} and fed.ins.realtime.remote_leads


def test_feedback_takes_effect_exactly_at_its_time() -> None:
    s, feedback = drive(), _followed().feedback
    plain, ins = Ins({**SHORT, **PLACE}), Ins({**SHORT, **PLACE})
    first = feedback[0]
    for at, _, _, values in imu_events(s):
        if at > first.apply_ns:
            break
        if at == first.stamp_ns + 2_400_000_000:  # as soon as it is there
            ins.correct(first)
        plain.add_imu(*values)
        ins.add_imu(*values)
        assert (ins.state == plain.state) == (at < first.apply_ns or ins.state is None)
    assert ins.state == _rerun(ins, first) and ins.phase is Phase.FINE


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("late", "correction late"),
        ("lost", ""),
        ("repeated", "correction repeated"),
        ("swapped", "correction repeated"),
    ],
)
def test_ways_of_a_feedback_do_not_matter_in_the_end(name: str, count: str) -> None:
    fed = _followed()
    feedback = [f for f in fed.feedback if f.apply_ns <= fed.ins.stamp_ns - 3 * NS]
    *_, last = feedback
    on_time = _on_time(feedback)
    expected = _follower(on_time)
    if name == "late":
        given = [(at + 2 * NS, f) for at, f in on_time]
    elif name == "lost":
        given = on_time[-1::-3]
    elif name == "repeated":
        given = on_time + [(at + 1, f) for at, f in on_time]
    else:
        given = [(on_time[i ^ 1][0] if i ^ 1 < len(on_time) else at, f) for i, (at, f) in enumerate(on_time)]
    ins = _follower(given)
    if name == "swapped" and len(on_time) % 2 == 0:  # the last came before the one before it
        assert ins.events.counts[count] == len(on_time) // 2
    assert ins.state == expected.state == _rerun(ins, last)
    assert set(ins.events.counts) == ({count} if count else set())
    # carried on over other steps, of half a second at most: 0.35 s of growth of some 3 s
    sigma, other = (np.sqrt(n.accuracy.covariance.diagonal()) for n in (ins, expected))
    np.testing.assert_allclose(sigma, other, rtol=0.05)


def test_feedback_that_is_too_old_is_left_out_and_told() -> None:
    feedback = _followed().feedback
    ins = _follower([(f.apply_ns + 12 * NS, f) for f in feedback])
    assert ins.state == _follower([]).state
    assert ins.events.counts["correction lost"] >= 60  # one a second of driving
    assert any("which is not in the replay buffer" in report.text for report in ins.events.drain())


def test_sample_lost_where_a_feedback_belongs() -> None:
    """It is left out; the next one counts."""
    feedback = _followed().feedback
    middle = feedback[len(feedback) // 2]
    ins = _follower(_on_time(feedback), [middle.stamp_ns])
    assert ins.events.counts == {"gaps": 1, "samples lost": 1, "correction lost": 1}
    newest = [f for f in feedback if f.apply_ns <= ins.stamp_ns][-1]
    assert ins.state == _rerun(ins, newest)


def test_feedback_of_another_time_never_blocks_what_follows() -> None:
    """From before a restart: ahead of the samples now."""
    feedback = _followed().feedback
    stray = feedback[20]._replace(stamp_ns=feedback[20].stamp_ns + 60 * NS, apply_ns=feedback[20].apply_ns + 60 * NS)
    ins = _follower([*_on_time(feedback), (feedback[20].apply_ns, stray)])
    assert ins.events.counts == {"correction ahead": 1}
    assert ins.state == _follower(_on_time(feedback)).state


def test_feedback_is_no_use_without_a_solution() -> None:
    ins = Ins({**SHORT, **PLACE})
    for feedback in _followed().feedback:
        ins.correct(feedback)
    assert ins.state is None and ins.solution() is None
    for _, _, _, values in imu_events(drive())[:1100]:
        ins.add_imu(*values)
    assert ins.state is not None


def test_restart_begins_with_the_biases_given() -> None:
    ins = _follower(_on_time(_followed().feedback))
    assert ins.accel_bias != (0.0, 0.0, 0.0)
    for k in (0, 1):
        ins.add_imu(ins.stamp_ns + 100 * NS + k * NS // 50, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8)
    assert ins.restarts == 1 and ins.accel_bias == (0.0, 0.0, 0.0)


def test_alignment_again_forgets_what_was_fed_back() -> None:
    feedback = _followed().feedback
    ins = _follower(_on_time(feedback))
    ins.align()
    assert ins.covariance is None and ins.solution() is None


def test_message_there_and_back() -> None:
    correction = _followed().feedback[-1]
    back = correction_codec.read_correction(as_message(correction_codec.pack_correction(correction)))
    assert same_feedback([back], [correction])


# A filter that begins later


def _restarted(at: float, solutions: Sequence[float] = (40.0,)) -> tuple[Simulation, Filter, list[Correction]]:
    """`alignment_node` begins at a time, s, and hears of a solution at others."""
    s = drive()
    ins, aided = Ins({**SHORT, **PLACE}), Filter({**SHORT, **PLACE})
    fixes = {event[0]: event[3] for event in aid_events(s)}
    feedback: list[Correction] = []
    for stamp, _, _, values in imu_events(s):
        time = (stamp - s.start_ns) * 1e-9
        ins.add_imu(*values)
        if time >= at:
            if stamp in fixes:
                aid_messages.add(aided, "fix", *fixes[stamp])
            aided.add_imu(*values)
            feedback += aided.drain()
        solution = ins.solution()
        if solution is not None and any(abs(time - t) < 1e-3 for t in solutions):
            aided.adopt(*solution)
    return s, aided, feedback


def test_filter_that_begins_later_adopts_the_solution() -> None:
    s, aided, feedback = _restarted(35.0)
    assert "starts from the solution of ins_node" in [report.text for report in aided.events.drain()]
    assert (feedback[0].stamp_ns - s.start_ns) * 1e-9 == pytest.approx(41.0, abs=0.6)
    for f in feedback:
        assert feedback_nees(f, s, 0, 1, 2) < chi2.isf(1e-4, 3) and feedback_nees(f, s, 3, 4) < chi2.isf(1e-4, 2)
    assert math.sqrt(feedback[-1].covariance[0, 0]) < 0.6


def test_even_motion_is_no_stop_for_a_filter_that_begins_in_it() -> None:
    """Begun at 12 m/s on an even road: the IMU alone cannot tell."""
    _, aided, _ = _restarted(35.0)
    assert aided.events.counts["stops doubted"] >= 1
    assert "rest" not in aided.records and "zero velocity" not in aided.records


def test_solution_is_adopted_once_and_only_where_its_sample_is_known() -> None:
    s, aided, _ = _restarted(35.0, (30.0, 34.0, 36.0, 50.0))
    assert (aided._began_ns - s.start_ns) * 1e-9 == pytest.approx(36.0)
    # one that has seen the whole alignment makes its own
    s, aided, _ = _restarted(0.0, (20.0, 20.5, 25.0))
    assert (aided._began_ns - s.start_ns) * 1e-9 == pytest.approx(20.0, abs=0.05)


def test_adopting_at_rest_goes_on_with_the_stop() -> None:
    """Even a velocity that is wrong, and is corrected in the middle of the second over which its mean is taken."""
    s, fed = standing(True, 60.0)
    ins = Ins({**SHORT, **PLACE})
    for at, _, _, values in imu_events(s):
        ins.add_imu(*values)
        if at > s.start_ns + 30 * NS:
            fed.aided.add_imu(*values)
            solution = ins.solution()
            if at == s.start_ns + 40 * NS and solution is not None:
                (feedback, aligned_ns), wrong = solution, np.diag([0.0] * 3 + [1.0] * 3 + [0.0] * 9)
                state = (*feedback.state[:4], 1.0, -1.0, *feedback.state[6:])
                covariance = feedback.covariance + wrong
                assert fed.aided.adopt(feedback._replace(state=state, covariance=covariance), aligned_ns)
            if at == s.start_ns + 40 * NS + NS // 2:
                aid_messages.add(fed.aided, "velocity", at, (0.0, 0.0, 0.0), tuple((1e-4 * np.eye(3)).ravel().tolist()))
    record = fed.aided.records["zero velocity"]
    assert record.accepted > 10 and record.rejected == 0


def test_unknown_heading_goes_out_as_an_angle() -> None:
    s = drive()
    unknown = {"initial.heading_deg": 150.0, "initial.heading_stddev_deg": 180.0}
    fed = Fed({**SHORT, **PLACE, **unknown}).feed(imu_events(s)[:500])
    # uniform over the circle: 180° / √3
    assert math.degrees(math.sqrt(fed.feedback[0].covariance[8, 8])) == pytest.approx(104.0, abs=0.2)
