"""Stops in the filter: zero velocity, residual rates, ZUPT calls without double counting."""

import math

import numpy as np
from aided_harness import Event, Fed, aid_events, drive, feedback_error, imu_events, standing

from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import HEADING, SIZE
from ins_nav.simulation.scenarios import Simulation


def test_stops_as_updates() -> None:
    s, fed = standing(True)
    fed.feed(imu_events(s))
    velocity, rest = fed.aided.records["zero velocity"], fed.aided.records["rest"]
    # a second each from 20 s to 87.8 s; yaw once a minute
    assert 66 <= velocity.accepted <= 68 and (rest.accepted, rest.rejected) == (1, 0)
    for feedback in fed.feedback[::10]:
        # the noise of the IMU is known and velocity is measured as zero: far within
        assert np.abs(feedback_error(feedback, s)[3:5]).max() < 3.0 * math.sqrt(feedback.covariance[3, 3])
        assert math.sqrt(feedback.covariance[3, 3]) < 0.03


def test_stops_ignored() -> None:
    s, fed = standing(False)
    fed.feed(imu_events(s))
    assert fed.aided.records == {}
    assert fed.feedback[-1].covariance[3, 3] > fed.feedback[0].covariance[3, 3]


def _call(s: Simulation, seconds: float) -> Event:
    stamp = s.start_ns + round(seconds * 1e9)
    return (stamp, 9, "zupt", (stamp,))


def test_stops_as_zupt_calls_only() -> None:
    s, fed = standing(False)
    fed.feed(imu_events(s), [_call(s, 60.0)])
    velocity, rest = fed.aided.records["zero velocity"], fed.aided.records["rest"]
    assert (velocity.accepted, rest.accepted, rest.rejected) == (1, 1, 0)
    assert len(rest.last.innovation) == 3  # type: ignore[union-attr]
    drift = [np.sqrt(f.covariance.diagonal()[9:12]) for f in fed.feedback]
    # 40 s of rest observe little of the horizontal drift of a navigation-grade IMU; nothing is lost
    assert (drift[-1] <= drift[0] * 1.05).all()
    s, quiet = standing(False)
    assert quiet.feed(imu_events(s)).aided.records == {}


def test_zupt_calls_do_not_count_twice() -> None:
    """A call measures the whole stop, less the information that the filter has from it: one 4 s later adds nothing."""
    worse = {"imu.gyro_bias_stddev_deg_per_hour": 1.0, "initial.heading_deg": 30.0}
    results = []
    for calls in ((60.0,), (60.0, 64.0), (60.0, 60.1, 60.2)):
        s, fed = standing(False, 75.0, **worse)
        fed.feed(imu_events(s), [_call(s, at) for at in calls])
        results.append(np.sqrt(fed.feedback[-1].covariance.diagonal()[9:12]))
    # level's drifts, from 1 °/h; the vertical one is lost in neither
    assert results[0].min() < 0.1 * math.radians(1.0) / 3600.0
    # 64 s instead of 60 s of yaw: 3 % of its sigma by the root of time; counted twice it would be 29 %
    for again in results[1:]:
        np.testing.assert_allclose(again, results[0], rtol=0.04)


def test_zupt_call_knows_that_heading_was_corrected_since() -> None:
    """A compass corrects heading by 5° during the stop: the call must not measure that error again."""
    s, fed = standing(False, 70.0, **{"initial.heading_deg": 35.0, "initial.heading_stddev_deg": 2.9})
    imu = imu_events(s)
    fed.feed(imu[:1500])
    h = np.zeros((1, SIZE))
    h[0, HEADING] = 1.0
    compass = Measurement(np.array([-math.radians(5.0)]), h, np.array([[1e-6]]), slice(HEADING, HEADING + 1))
    fed.aided._update("compass", fed.aided.settled_ns, compass, 1e-9)
    fed.feed(imu[1500:], [_call(s, 60.0)])
    rest = fed.aided.records["rest"].last
    assert rest is not None and rest.accepted
    # 5° would be 0.74 °/h
    assert abs(rest.innovation[0]) < min(4.0 * rest.sigma[0], math.radians(0.6) / 3600.0)


def test_zupt_call_just_before_the_start_of_a_drive() -> None:
    """The samples of the stop are settled when the vehicle has left already."""
    s = drive()
    fed = Fed({"alignment.duration": 10.0, "zupt.zero_velocity": False}).feed(
        imu_events(s), aid_events(s), [_call(s, 25.0)]
    )
    assert fed.aided.records["rest"].accepted == 1
