"""The ZUPT services and the filter behind them: drifts and azimuth on a call."""

import functools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from aid_messages import FIX
from rocking_base import Rocking, rocking_base
from zupt_harness import (
    ARC_SECOND,
    BIASED,
    DEG_PER_HOUR,
    DRIFT,
    KNOWN,
    NO_WALK,
    ON_CALL,
    ONE_METRE,
    SETTLED,
    TWO,
    WIDE,
    Fed,
    driven,
    paper,
    two_positions,
)

from ins_nav.messages.solution import fill_bias
from ins_nav.navigator.front_end import Phase
from ins_nav.navigator.system import NavigationSystem
from ins_nav.recordings.bags import message
from ins_nav.simulation.motion import Route
from ins_nav.simulation.scenarios import Simulation

# ZUPT-2


def test_zupt2_in_the_papers_run() -> None:
    fed = Fed(paper(), KNOWN | ON_CALL).to(200.0)
    yaw_before = fed.rotation()[2]
    text = fed.call("zupt2")
    assert text.startswith("gyro drifts in °/h: x -0.0206 ± 0.0000, y -0.0206 ± 0.0000, z +0.0206 ± 0.0000")
    assert yaw_before == pytest.approx(1e-7 * 160.0 / ARC_SECOND, rel=0.02)  # and 0.05 by the way east
    fed.settle()
    np.testing.assert_allclose(fed.bias, DRIFT, rtol=1e-3)  # required
    fed.within_sigmas()
    start = fed.rotation()
    # 150 m up gravity is off the ellipsoid's normal by 1e-7 rad, 0.022 arc seconds: the level that gravity gives
    np.testing.assert_allclose(start, 0.0, atol=0.05)
    for time in range(210, 261, 10):
        fed.to(float(time))
        # what is left of the drifts, 1e-3 of them, for a minute
        np.testing.assert_allclose(fed.rotation(), start, atol=2e-3)
        # 12.5 mm/s before; the level left, 2.5e-7 rad, for a minute
        assert fed.velocity() < 3e-4
    assert fed.navigator.services.solved == 1


@pytest.mark.parametrize(
    ("rocking", "rate", "aided", "fixes", "zero_velocity"),
    [
        (Rocking(0.0), 25.0, True, True, False),
        (Rocking(1.0, 5.0, 0.7, 0.0), 50.0, False, False, True),
        (Rocking(1.0, 11.0, 2.0, 0.5), 25.0, True, False, False),
        (Rocking(3.0, 3.0, 1.6, 0.3), 100.0, True, False, True),
        (Rocking(5.0, 11.0, 2.0, 0.5), 50.0, True, True, True),
        (Rocking(5.0, 11.0, 0.7, 0.75), 50.0, False, False, False),
    ],
)
def test_zupt2_on_a_rocking_base(rocking: Rocking, rate: float, aided: bool, fixes: bool, zero_velocity: bool) -> None:
    """Rates as low as coning allows: 0.3 % of the drift at 3° and 3 s at 50 Hz, a sixteenth of that at 100 Hz."""
    system = paper_run(rocking, rate, aided, fixes, zero_velocity)
    error = np.array(system.realtime.gyro_bias) - DRIFT
    sigma = np.sqrt(np.diag(system.realtime.gyro_bias_covariance))
    np.testing.assert_array_less(np.abs(error), 5e-3 * np.abs(DRIFT))  # required
    np.testing.assert_array_less(np.abs(error), 3.0 * sigma)


def test_the_answer_is_the_same_with_aids_and_without() -> None:
    """And so is what the filter makes of it, to the sigma of fixes that say nothing of drifts."""
    rocking = Rocking(3.0, 5.0, 1.0, 0.4)
    answers, biases = [], []
    for aided, fixes in ((False, False), (True, False), (True, True)):
        system = paper_run(rocking, 25.0, aided, fixes, False, 100.0)
        answers.append([report.text for report in system.events.drain() if report.text.startswith("zupt2: ")])
        biases.append(system.realtime.gyro_bias)
    assert len(answers[0]) == 1 and answers[0] == answers[1]
    np.testing.assert_allclose(biases[0], biases[1], atol=1e-13)
    found = [re.findall(r"[+-][0-9.]+", answer[0]) for answer in answers]
    np.testing.assert_allclose(np.array(found[2], float), np.array(found[0], float), atol=1.5e-4)  # last digit
    np.testing.assert_allclose(biases[2], biases[0], atol=1e-3 * 1e-7)


def paper_run(
    rocking: Rocking, rate: float, aided: bool, fixes: bool, zero_velocity: bool, call: float = 200.0
) -> NavigationSystem:
    """The paper's run on a rocking base, until the call is in the solution."""
    system = NavigationSystem(KNOWN | {"zupt.zero_velocity": zero_velocity, **NO_WALK}, aided=aided)
    start_ns, step_ns = 1_000_000_000_000, round(1e9 / rate)
    rng = np.random.default_rng(1)
    system.add("gnss/fix", FIX(start_ns, 0, 60.0, 30.0, 0.0, ONE_METRE))
    for i, row in enumerate(rocking_base(rocking, DRIFT, call + SETTLED, rate).tolist(), 1):
        stamp_ns = start_ns + i * step_ns
        if fixes and i % round(rate) == 0:
            north, east = np.degrees(rng.normal(0.0, 1.0, 2) / 6.4e6)
            system.add("gnss/fix", FIX(stamp_ns, 0, 60.0 + north, 30.0 + 2.0 * east, 0.0, ONE_METRE))
        system.add_imu(stamp_ns, *row)
        if i == round(call * rate):
            done, text = system.zupt2()
            assert done, text
    return system


@pytest.mark.parametrize("zero_velocity", [False, True])
def test_a_second_call_at_a_stop_is_as_if_it_were_the_first(zero_velocity: bool) -> None:
    once = Fed(paper(), KNOWN | {"zupt.zero_velocity": zero_velocity}).to(60.0)
    twice = once.fork()
    twice.call("zupt2")
    texts = []
    for fed in (once, twice):
        texts.append(fed.to(120.0).call("zupt2"))
        fed.settle()
        np.testing.assert_allclose(fed.bias, DRIFT, rtol=2e-3)
    assert texts[0] == texts[1]  # measured from the same samples
    assert once.navigator.services.solved == 1 and twice.navigator.services.solved == 2
    sigmas = [np.sqrt(np.diag(fed.navigator.gyro_bias_covariance)) for fed in (once, twice)]
    # the same data: information is not counted twice
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.05)
    np.testing.assert_allclose(once.rotation(), twice.rotation(), atol=2e-3)


@pytest.mark.parametrize("preset", ["perfect", "navigation"])
@pytest.mark.parametrize("after", [12.0, 20.0, 80.0])
def test_a_call_some_samples_later_gives_the_same(after: float, preset: str) -> None:
    """Live a service comes a little later than in `ins_process`."""
    fed = Fed(_short_drive(preset), KNOWN | {"alignment.level_duration": 5.0}).to(25.0)
    detector = fed.navigator.detector
    assert detector.stopped
    since = (detector.since_ns - fed.s.start_ns) * 1e-9
    offline, live = fed.to(since + after).fork(), fed.to(since + after + 0.08)
    assert live.call("zupt2") == offline.call("zupt2")
    offline.to(since + after + 6.0)
    live.to(since + after + 6.0)
    # the filter measures the stop at the end of the same whole second
    assert live.navigator.gyro_bias == offline.navigator.gyro_bias
    np.testing.assert_array_equal(live.rotation(), offline.rotation())


@functools.cache
def _short_drive(preset: str) -> Simulation:
    def route(r: Route) -> None:
        r.hold(10.0)
        r.reach(3.0, 5.0)
        r.reach(0.0, 5.0)
        r.hold(90.0)

    return driven(route, **BIASED, **{"imu.preset": preset}, rate=50.0)


def test_services_use_samples_without_the_further_errors_of_the_imu() -> None:
    """Scale factors of 1000 ppm turn the Earth's rate into 7e-8 rad/s: 0.7 of a drift."""
    s = _short_drive("perfect")
    fed = Fed(replace(s, angular_velocity=1.001 * s.angular_velocity), SCALED).to(20.0)
    realtime = fed.navigator.realtime
    realtime._compensate(realtime.gyro_bias, realtime.accel_bias, (1e-3, 1e-3, 1e-3))
    found = re.findall(r" ([+-][0-9.]+) ±", fed.to(105.0).call("zupt2"))
    # level is that of gravity; digits of the text
    np.testing.assert_allclose(np.array(found, float), DRIFT / DEG_PER_HOUR, atol=2e-4)


SCALED = KNOWN | ON_CALL | {"alignment.level_duration": 5.0, "imu.gyro_scale_stddev_ppm": 1000.0}


def test_zupt2_after_self_alignment_observes_no_heading() -> None:
    """Heading has absorbed the east drift; the same data cannot separate the two."""
    wide = {"imu.accel_bias_stddev_mg": 0.0, "imu.gyro_bias_stddev_deg_per_hour": 0.1}
    fed = Fed(paper("zupt1_two_positions", duration=410.0), wide | NO_WALK).to(190.0)
    before = fed.navigator.attitude_covariance[2, 2]
    fed.call("zupt2")
    fed.settle()
    # by the part of the drift about the vertical only
    assert fed.navigator.attitude_covariance[2, 2] > 0.9 * before


def test_covariances_after_zupt2() -> None:
    fed = Fed(paper(), KNOWN | ON_CALL).to(100.0)
    before = fed.navigator.changes
    fed.call("zupt2")
    fed.settle()
    n = fed.navigator
    assert n.changes == before + 1
    # without noise: far less than the 0.05 °/h before
    assert np.all(np.diag(n.gyro_bias_covariance) < (2e-3 * DEG_PER_HOUR) ** 2)
    bias = message("sensor_msgs/msg/Imu")
    fill_bias(bias, n, "base_link")
    assert bias.orientation_covariance[0] == -1.0
    np.testing.assert_array_equal(bias.angular_velocity_covariance, n.gyro_bias_covariance.ravel())
    assert (bias.angular_velocity.x, bias.angular_velocity.y, bias.angular_velocity.z) == n.gyro_bias


def test_drifts_beyond_their_sigma_are_reported() -> None:
    narrow = {"imu.gyro_bias_stddev_deg_per_hour": 1e-3}  # the drifts are 20 times that
    text = Fed(paper(), KNOWN | ON_CALL | narrow).to(200.0).call("zupt2")
    assert text.endswith(
        "; more than imu.gyro_bias_stddev_deg_per_hour (or its random walk since the last stop) allows: set it to what "
        "the gyros have"
    )
    assert "x -0.020" in text


# ZUPT-1


@pytest.mark.parametrize("zero_velocity", [False, True])
@pytest.mark.parametrize("turn_deg", [90.0, 180.0])
def test_zupt1_after_self_alignment_and_a_turn(turn_deg: float, zero_velocity: bool) -> None:
    fed = Fed(
        paper("zupt1_two_positions", turn_deg=turn_deg, duration=410.0), WIDE | {"zupt.zero_velocity": zero_velocity}
    ).to(190.0)
    # the east drift, by the horizontal rate of the Earth, is none here: sin 45° - sin 45°; yaw has run off since
    assert fed.rotation()[2] > 2.0
    text = fed.call("zupt1")
    assert text.startswith("position 1 recorded after 18") and fed.navigator.services.solved == 0
    off = fed.to(405.0).rotation()[2]
    reported = re.search(r"heading corrected by (\S+)° ± (\S+)°", fed.call("zupt1"))
    assert reported is not None
    # left is positive there, clockwise is positive here
    assert float(reported[1]) == pytest.approx(off / 3600.0, abs=3.0 * float(reported[2]))
    fed.settle()
    np.testing.assert_allclose(fed.bias, DRIFT, rtol=5e-3)  # required
    fed.within_sigmas()
    assert abs(fed.rotation()[2]) < 2.0  # arc seconds, required
    np.testing.assert_allclose(fed.rotation()[:2], 0.0, atol=0.1)
    assert 3.0 * math.sqrt(fed.navigator.attitude_covariance[2, 2]) > abs(fed.rotation()[2]) * ARC_SECOND


@functools.cache
def _in_position_2() -> Fed:
    """`zupt1` has been called once; not to be fed: fork it."""
    fed = Fed(two_positions(), TWO | ON_CALL).to(175.0)
    assert "(heading known to 0.5" in fed.call("zupt1")
    return fed.to(338.0)


def test_zupt1_from_two_stops_on_the_way() -> None:
    fed = _in_position_2().fork()
    assert fed.rotation()[2] == pytest.approx(-720.0, abs=10.0)  # the first call corrects nothing
    assert "heading corrected by -0.19" in fed.call("zupt1")
    # and again: this is position 1 now
    fed.to(343.0)
    np.testing.assert_allclose(fed.bias, DRIFT, rtol=5e-3)  # required
    fed.within_sigmas()
    assert abs(fed.rotation()[2]) < 2.0  # required
    assert "position 1 recorded after 1" in fed.call("zupt1")


def test_zupt2_between_the_positions_is_allowed_for() -> None:
    """The first position was seen with another bias, and before the axes were turned back."""
    fed = Fed(two_positions(), TWO | {"initial.heading_deg": 45.0}).to(150.0)
    fed.call("zupt1")
    fed.to(175.0).call("zupt2")
    fed.to(338.0).call("zupt1")
    fed.settle()
    np.testing.assert_allclose(fed.bias, DRIFT, rtol=5e-3)
    assert abs(fed.rotation()[2]) < 2.0


def test_alignment_again_forgets_position_1() -> None:
    fed = Fed(paper("zupt1_two_positions", duration=410.0), KNOWN).to(100.0)
    fed.call("zupt2")
    fed.settle()
    fed.call("zupt1")
    fed.settle()
    frame, bias = fed.navigator.map, fed.navigator.gyro_bias
    fed.navigator.align()
    fed.to(155.0)
    assert fed.navigator.phase is Phase.NAVIGATING
    assert "position 1 recorded" in fed.call("zupt1")  # not "no turn between the positions"
    assert fed.navigator.map is frame
    np.testing.assert_allclose(fed.bias, bias, rtol=2e-3)


def test_a_restart_forgets_everything() -> None:
    fed = Fed(paper(), KNOWN).to(100.0)
    fed.call("zupt2")
    fed.call("zupt1")
    n = fed.navigator
    frame = n.map
    again = Fed(paper(), KNOWN)
    again.navigator = n  # its stamps go back by 100 s
    again.to(1.0)
    assert n.restarts == 1 and n.phase is Phase.COARSE
    assert n.gyro_bias == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(n.gyro_bias_covariance, np.eye(3) * (0.05 * DEG_PER_HOUR) ** 2)
    assert n.services.solved == 0
    again.to(100.0)
    assert n.map is not None and n.map is not frame
    assert "position 1 recorded" in again.call("zupt1")
    first = Fed(paper(), KNOWN).to(100.0)
    # the second round begins with the sample that was kept until the next confirmed it
    assert again.call("zupt2") == first.call("zupt2")
    first.settle()
    again.settle()
    np.testing.assert_allclose(n.gyro_bias, first.bias, rtol=1e-3)
