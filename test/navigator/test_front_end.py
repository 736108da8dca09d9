"""The front end: position and mounting, alignment and its repetition, units, jumps of the stamps."""

import math
from typing import Any

import aid_messages
import numpy as np
import pytest
from navigation_harness import FREE, HEADING, HERE, Fed, city_drive, distance_to, imu_messages
from navigators import Ins
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import attitude, earth
from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.scenarios import simulate


def test_heading_given() -> None:
    fed = Fed(**HERE, **HEADING, **FREE).feed(imu_messages())
    assert "heading 30.000° (given)" in fed.said[0] and "aligned in 2.0 s" in fed.said[0]
    # level found in 2 s; the same floor
    assert distance_to(fed.geodetic(), city_drive(), -1) < 0.05


def test_position_from_the_first_valid_fix() -> None:
    fed = Fed(**HEADING)
    n = fed.navigator
    fed.feed(imu_messages("static")[:100])
    aid_messages.add(n, "fix", 1, -1, 10.0, 10.0, 10.0)
    aid_messages.add(n, "fix", 2, 0, math.nan, 10.0, 10.0)
    aid_messages.add(n, "fix", 3, 0, 95.0, 10.0, 10.0)
    aid_messages.add(n, "fix", 4, 0, 10.0, math.inf, 10.0)
    fed.feed(imu_messages("static")[100:300])
    assert n.state is None and n.phase is Phase.COARSE
    assert fed.counts == {"gnss no fix": 1, "gnss invalid": 3, "waiting for position": 100}
    assert "gnss/fix: no fix (status < 0)" in fed.said
    assert any("gnss/fix: position (nan, 10.0, " in x for x in fed.said)
    (waiting,) = [line for line in fed.said if "no position" in line]
    assert "publish gnss/fix or set initial.latitude_deg" in waiting
    aid_messages.add(n, "fix", 5, 0, 55.7, 37.6, 150.0)
    fed.feed(imu_messages("static")[300:310])
    assert fed.solutions == 10
    assert math.degrees(fed.geodetic().lat) == pytest.approx(55.7, abs=1e-6)
    assert fed.geodetic().height == 150.0


def test_fix_without_height() -> None:
    fed = Fed(**HEADING)
    aid_messages.add(fed.navigator, "fix", 5, 0, 55.7, 37.6, math.nan)
    fed.feed(imu_messages("static"))
    assert abs(fed.geodetic().height) < 1e-3  # the error of a tangent as long as the corrections at the stop
    assert fed.counts == {"no height": 1}


ARM = (1.5, -0.5, 2.0)
"""m, from the IMU to the antenna, body."""


def _with_antenna(**parameters: Any) -> tuple[Fed, np.ndarray]:
    """Stands at a heading of 30°, an antenna off the IMU; and what is found less the antenna's place, n, m."""
    fed = Fed(**HEADING, **{"gnss.lever_arm": list(ARM)}, **parameters)
    aid_messages.add(fed.navigator, "fix", 5, 0, 55.7, 37.6, 150.0, tuple((0.04 * np.eye(3)).ravel().tolist()))
    fed.feed(imu_messages("static")[:300])
    place = earth.geodetic_to_ecef(math.radians(55.7), math.radians(37.6), 150.0)
    where = fed.geodetic()
    found = earth.geodetic_to_ecef(where.lat, where.lon, where.height)
    axes = earth.enu_axes(math.radians(55.7), math.radians(37.6))
    return fed, np.subtract(found, place) @ axes


def test_first_fix_is_the_place_of_the_antenna() -> None:
    fed, off = _with_antenna()
    s, c = math.sin(math.radians(30.0)), math.cos(math.radians(30.0))  # forward is s, c; left -c, s on east, north
    arm = [ARM[0] * s - ARM[1] * c, ARM[0] * c + ARM[1] * s, ARM[2]]
    np.testing.assert_allclose(off, np.negative(arm), atol=1e-3)  # level of the sensors: 5e-5 rad on 2 m
    n = fed.navigator
    assert n.map is not None and n.state is not None
    np.testing.assert_allclose(n.map.position(n.state), 0.0, atol=1e-3)
    # a heading wrong by its sigma of 1° turns the arm; 0.2 m is the antenna's
    p = n.accuracy.covariance
    across = np.array([-arm[1], arm[0]])
    np.testing.assert_allclose(p[0:2, 8], -across * math.radians(1.0) ** 2, rtol=0.01)
    np.testing.assert_allclose(
        p[0:2, 0:2], 0.04 * np.eye(2) + np.outer(across, across) * math.radians(1.0) ** 2, atol=1e-4
    )


def test_a_place_given_is_that_of_the_imu() -> None:
    _, off = _with_antenna(**HERE)
    np.testing.assert_allclose(off, 0.0, atol=1e-3)


def test_place_of_a_second_alignment_is_that_of_the_imu() -> None:
    """It is the present solution's, with its covariance."""
    fed, _ = _with_antenna()
    n, before, sigma = fed.navigator, fed.geodetic(), np.sqrt(fed.navigator.accuracy.covariance.diagonal()[:3])
    n.align()
    assert n.covariance is None
    fed.feed(imu_messages("static")[300:600])
    # height walks on for the second since it is aligned
    now = np.sqrt(n.accuracy.covariance.diagonal()[:3])
    np.testing.assert_allclose(now, [max(sigma[:2])] * 2 + [math.hypot(sigma[2], 0.3)], rtol=0.1)
    # at rest; the last zero velocity was half a second before
    after = fed.geodetic()
    assert (after.lat, after.lon) == (pytest.approx(before.lat, abs=1e-10), pytest.approx(before.lon, abs=1e-10))


def test_position_parameters_go_before_fixes() -> None:
    fed = Fed(**HERE, **HEADING)
    aid_messages.add(fed.navigator, "fix", 5, 0, 10.0, 10.0, 10.0)
    fed.feed(imu_messages("static"))
    assert math.degrees(fed.geodetic().lat) == pytest.approx(55.7, abs=1e-6)


def test_waiting_for_a_position_for_long() -> None:
    """Many times the alignment: memory is bounded, and the alignment better for it."""
    n = Ins({"alignment.duration": 5.0})
    s = simulate("static", 0, duration=70.0, rate=50.0)
    values = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    for stamp, row in zip(s.stamps_ns[:-1], values[:-1], strict=True):
        n.add_imu(int(stamp), *row)
    assert n.state is None and n.progress == 1.0
    assert len(n._alignment.cone._blocks) < 240
    assert len(n._alignment.cone._samples) <= 60 * 50 + 1  # noise is judged by a minute
    aid_messages.add(n, "fix", 0, 0, 55.7, 37.6, 150.0)
    assert n.add_imu(int(s.stamps_ns[-1]), *values[-1])
    heading = attitude.heading_from_yaw(attitude.to_euler(n.state[0:4])[2])  # type: ignore[index]
    assert math.degrees(heading) == pytest.approx(30.0, abs=0.5)  # bias of 0.01 deg/h and noise: 0.1° each


def test_align_again() -> None:
    """From the place of the present solution."""
    fed = Fed(**HERE, **HEADING, **FREE).feed(imu_messages()[:5000])
    assert fed.navigator.phase is Phase.NAVIGATING
    before = fed.geodetic()
    text = fed.navigator.align()
    assert text == "alignment started: stand still, or rock without travelling, for 2 s"
    assert (fed.navigator.phase, fed.navigator.state, fed.navigator.progress) == (Phase.COARSE, None, 0.0)
    still = [(imu_messages()[4999][0] + k * 10_000_000, imu_messages()[i][1]) for k, i in enumerate(range(500, 800), 1)]
    fed.feed(still)
    assert fed.navigator.phase is Phase.NAVIGATING
    after = fed.geodetic()
    assert (after.lat, after.lon) == (pytest.approx(before.lat, abs=1e-9), pytest.approx(before.lon, abs=1e-9))
    # before the first sample there is nothing to align
    navigator = Ins(HERE)
    navigator.align()
    assert navigator.phase is Phase.WAITING


def test_moving_off_while_aligning_is_told_and_alignment_begins_again() -> None:
    fed = Fed(**HERE, **{"alignment.duration": 30.0}).feed(imu_messages()[:4000])
    assert fed.navigator.state is None
    assert fed.counts["alignment restarts"] >= 1
    assert "alignment from imu/data_raw: the base moved off after" in fed.said[0]


def test_fix_used_is_not_older_than_the_alignment() -> None:
    """A vehicle that gets a fix, drives off before it is aligned, and aligns elsewhere."""
    fed = Fed(**HEADING)
    aid_messages.add(fed.navigator, "fix", 1, 0, 55.6, 37.5, 150.0)
    fed.navigator.align()
    aid_messages.add(fed.navigator, "fix", 2, 0, 55.7, 37.6, 150.0)
    fed.feed(imu_messages("static"))
    assert math.degrees(fed.geodetic().lat) == pytest.approx(55.7, abs=1e-6)


def test_mounting_and_known_biases() -> None:
    """The same drive on an IMU that is turned over and biased."""
    mounting = Rotation.from_euler("ZYX", [30.0, -20.0, 170.0], degrees=True)
    gyro, accel = np.array([10.0, -20.0, 5.0]), np.array([1.0, 2.0, -3.0])
    w, f = city_drive().angular_velocity, city_drive().linear_acceleration
    w = mounting.inv().apply(w + np.radians(gyro) / 3600.0)
    f = mounting.inv().apply(f + accel * 9.80665e-3)
    messages = [(stamp, tuple(row)) for (stamp, _), row in zip(imu_messages(), np.c_[w, f].tolist(), strict=True)]
    parameters = {
        "imu.mounting_rpy_deg": [170.0, -20.0, 30.0],
        "imu.gyro_bias_deg_per_hour": gyro.tolist(),
        "imu.accel_bias_mg": accel.tolist(),
    }
    parameters |= FREE
    fed, plain = (
        Fed(**HERE, **HEADING, **parameters).feed(messages),
        Fed(**HERE, **HEADING, **FREE).feed(imu_messages()),
    )
    # rounding of the turned values
    assert fed.navigator.state is not None and plain.navigator.state is not None
    np.testing.assert_allclose(fed.navigator.state, plain.navigator.state, atol=1e-7)
    np.testing.assert_allclose(fed.navigator.specific_force, imu_messages()[-1][1][3:], atol=1e-12)
    np.testing.assert_allclose(fed.navigator.angular_velocity, imu_messages()[-1][1][:3], atol=1e-12)


def test_gap_while_aligning_starts_the_alignment_again() -> None:
    messages = imu_messages("static")
    fed = Fed(**HERE, **{"alignment.duration": 10.0})
    fed.feed(messages[:800]).feed(messages[1000:2005])
    assert fed.counts == {"long gaps": 1, "samples lost": 200, "alignment restarts": 1}
    assert any("coarse alignment starts again after a gap of 2.010 s in imu/data_raw" in line for line in fed.said)
    assert fed.navigator.phase is Phase.NAVIGATING
    assert "aligned in 10.0 s" in fed.said[-1]


def test_gap_beyond_the_limit_starts_again() -> None:
    fed = Fed(**HERE, **HEADING, **{"imu.max_gap": 5.0})
    fed.feed(imu_messages("static")[:1000])
    assert fed.navigator.phase is Phase.NAVIGATING
    fed.feed(imu_messages("static")[:150], shift_ns=60_000_000_000)
    assert (fed.navigator.phase, fed.navigator.state) == (Phase.COARSE, None)
    assert fed.counts == {"restarts": 1}
    fed.feed(imu_messages("static")[150:1000], shift_ns=60_000_000_000)
    assert fed.navigator.phase is Phase.NAVIGATING


def test_looped_bag_navigates_again_as_at_first() -> None:
    fed = Fed(**HERE, **HEADING)
    ends = []
    for _ in range(3):
        fed.feed(imu_messages())
        ends.append(fed.navigator.state)
    # each round but the first begins with the sample that is kept until the second confirms it
    assert fed.counts == {"restarts": 2}
    assert ends[0] == ends[1] == ends[2]
    assert len([line for line in fed.said if line.startswith("aligned in")]) == 3


def test_degrees_are_told() -> None:
    messages = [(stamp, (*(math.degrees(w) for w in v[:3]), *v[3:])) for stamp, v in imu_messages("static")]
    fed = Fed(**HERE, **{"alignment.duration": 25.0}).feed(messages)
    assert fed.navigator.state is None
    assert "degrees per second, publish it in rad/s" in fed.said[0]


def test_values_in_g_are_told_at_once() -> None:
    messages = [(stamp, (*v[:3], *(f / 9.80665 for f in v[3:]))) for stamp, v in imu_messages("static")]
    fed = Fed(**HERE).feed(messages[:200])
    assert "it is in g: publish linear_acceleration in m/s²" in fed.said[0]
    assert len(fed.said) == 1
    assert fed.navigator.state is None


@pytest.mark.parametrize("options", [{"alignment.duration": 25.0}, HEADING], ids=["heading found", "heading given"])
def test_an_inverted_force_is_refused(options: dict[str, Any]) -> None:
    """With the heading given, 2 s are enough for gyros of this class."""
    messages = [(stamp, (*v[:3], *(-f for f in v[3:]))) for stamp, v in imu_messages("static")]
    fed = Fed(**HERE, **options).feed(messages)
    assert fed.navigator.state is None
    assert "linear_acceleration points down at rest and has the wrong sign" in fed.said[0]


def test_a_base_that_is_upside_down_is_reported() -> None:
    """An IMU turned about its x axis measures consistently; the parameter of its mounting is missing."""
    messages = [(stamp, (v[0], -v[1], -v[2], v[3], -v[4], -v[5])) for stamp, v in imu_messages("static")]
    fed = Fed(**HERE, **HEADING).feed(messages[:400])
    assert fed.navigator.phase is Phase.NAVIGATING
    assert any("base_link is upside down at rest" in line and "imu.mounting_rpy_deg" in line for line in fed.said)


def test_map_stays_when_alignment_is_repeated() -> None:
    fed = Fed(**HERE, **HEADING)
    fed.feed(imu_messages("static")[:1000])
    first = fed.navigator.map
    assert first is not None
    fed.navigator.align()
    fed.feed(imu_messages("static")[1000:2000])
    assert fed.navigator.state is not None and fed.navigator.map is first
