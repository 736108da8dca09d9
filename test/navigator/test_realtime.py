"""The engine: phases, position, alignment again, and that no input whatever leaves a state that is not finite."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from navigation_harness import FREE, HEADING, HERE, Fed, Values, city_drive, distance_to, imu_messages
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import nav_state
from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.scenarios import simulate

# Phases and position


def test_a_drive_from_start_to_end() -> None:
    fed = Fed(**HERE, **{"alignment.duration": 15.0})
    messages = imu_messages()
    assert fed.navigator.phase is Phase.WAITING
    fed.feed(messages[:1])
    assert (fed.navigator.phase, fed.navigator.state) == (Phase.COARSE, None)
    fed.feed(messages[1:750])
    assert fed.navigator.progress == pytest.approx(0.5, abs=0.01)
    fed.feed(messages[750:])
    assert fed.navigator.phase is Phase.NAVIGATING and fed.navigator.progress == 1.0
    assert fed.navigator.stamp_ns == messages[-1][0]
    assert fed.solutions == len(messages) - 1500  # one a sample, from the sample that ends the alignment on
    # perfect sensors: the plumb line's 1e-7 rad make g * 1e-7 * t² / 2 = 6 mm, and 100 Hz leave as much
    assert distance_to(fed.geodetic(), city_drive(), -1) < 0.03
    np.testing.assert_allclose(fed.geodetic().velocity_g[:2], city_drive().trajectory.velocity_n[-1, :2], atol=1e-3)
    tilt = Rotation.from_quat(city_drive().trajectory.q_nb[-1]) * Rotation.from_quat(fed.geodetic().q_gb).inv()
    assert tilt.magnitude() < 1e-5
    (line,) = fed.said
    assert line.startswith("aligned in 15.0 s: heading 30.000° (sigma 0.") and line.endswith("; navigating")
    assert fed.counts == {}
    assert fed.navigator.map is not None
    np.testing.assert_allclose(np.diag(fed.navigator.attitude_covariance) > 0.0, True)


def test_instantaneous_samples() -> None:
    s = simulate(
        "vehicle",
        0,
        duration=120.0,
        stand_time=20.0,
        rate=100.0,
        **{"imu.preset": "perfect"},
        **{"imu.sampling": "instantaneous"},
    )
    values = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    messages = [(int(stamp), tuple(row)) for stamp, row in zip(s.stamps_ns, values, strict=True)]
    right = Fed(**HERE, **HEADING, **FREE, **{"imu.sampling": "instantaneous"}).feed(messages)
    assert distance_to(right.geodetic(), s, -1) < 0.1  # 0.04 m measured: straight lines between samples at 100 Hz
    assert right.navigator.state != Fed(**HERE, **HEADING).feed(messages).navigator.state


# Bad input


def _navigating(bad: Sequence[tuple[int, Values]], at: int) -> Fed:
    """The drive with something put in before sample ``at``."""
    fed = Fed(**HERE, **HEADING)
    messages = imu_messages()
    fed.feed(messages[:at])
    fed.feed(bad)
    return fed.feed(messages[at:])


def _undisturbed(at: int = 0) -> Fed:
    return Fed(**HERE, **HEADING).feed(imu_messages())


NOW = 5000
"""In the middle of a turn."""


@pytest.mark.parametrize(
    ("stamp_ns", "values", "kind"),
    [
        (0, (math.nan, 0.0, 0.0, 0.0, 0.0, 9.8), "not finite"),
        (0, (0.0, 0.0, 0.0, math.inf, 0.0, 9.8), "not finite"),
        (0, (0.0, 0.0, 200.0, 0.0, 0.0, 9.8), "rate out of range"),
        (0, (0.0, 0.0, 0.0, 0.0, 0.0, 1e6), "force out of range"),
        (-10_000_000, (0.0, 0.0, 0.0, 0.0, 0.0, 9.8), "repeated stamps"),
        (-50_000_000, (0.0, 0.0, 0.0, 0.0, 0.0, 9.8), "backward stamps"),
        (-3_600_000_000_000, (0.0, 0.0, 0.0, 0.0, 0.0, 9.8), "stamp outliers"),
        (3_600_000_000_000, (0.0, 0.0, 0.0, 0.0, 0.0, 9.8), "stamp outliers"),
        (None, (0.0, 0.0, 0.0, 0.0, 0.0, 9.8), "zero stamps"),
    ],
)
def test_one_bad_sample_among_the_good_ones_changes_nothing(stamp_ns: int | None, values: Values, kind: str) -> None:
    stamp = 0 if stamp_ns is None else imu_messages()[NOW][0] + stamp_ns
    fed = _navigating([(stamp, values)], NOW)
    assert fed.counts == {kind: 1}
    assert fed.said[1].startswith("imu/data_raw: ")
    assert fed.navigator.state == _undisturbed().navigator.state


def _without(lost: Sequence[int]) -> Fed:
    messages = imu_messages()
    missing = set(lost)
    return Fed(**HERE, **HEADING).feed([m for i, m in enumerate(messages) if i not in missing])


def _difference(fed: Fed) -> tuple[float, float]:
    """From the undisturbed end: horizontally, m, and attitude, rad."""
    a, b = fed.navigator.state, _undisturbed().navigator.state
    assert a is not None and b is not None
    tilt = Rotation.from_quat(a[0:4]) * Rotation.from_quat(b[0:4]).inv()
    return math.dist(nav_state.position_ecef(a), nav_state.position_ecef(b)), float(tilt.magnitude())


def test_lost_samples_cost_little() -> None:
    """One in a hundred, in turns and brakings too: bridged by the mean of its neighbours."""
    fed = _without(range(2100, 11900, 100))
    assert fed.counts == {"gaps": 98, "samples lost": 98}
    position, tilt = _difference(fed)
    # the second derivative of rate and force times interval cubed: 1.3e-3 m and 1e-6 rad measured
    assert position < 0.01
    assert tilt < 1e-5


def test_gap_of_two_seconds_is_bridged() -> None:
    fed = _without(range(2300, 2500))  # accelerating straight on
    assert fed.navigator.phase is Phase.NAVIGATING
    # after the gap even motion looks like rest, but the solution knows better
    assert fed.counts == {"long gaps": 1, "samples lost": 200, "stops doubted": 1}
    assert any("gap of 2.010 s, about 200 samples lost, bridged" in line for line in fed.said)
    position, tilt = _difference(fed)
    # two seconds of a start, 2 m/s², taken for a straight line: 0.5 m/s off for 95 s, 50 m measured
    assert position < 100.0
    assert tilt < 0.01


def test_ten_hertz_with_jitter_has_no_gaps() -> None:
    """Stamps off by 10 ms: intervals over a tenth of a second are not gaps at 10 Hz, from the first sample on."""
    s = simulate("static", 0, duration=30.0, rate=10.0)
    fed = Fed(**HERE, **{"alignment.duration": 20.0})
    rows = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    fed.feed(
        [(int(t) + (i % 3) * 5_000_000, tuple(row)) for i, (t, row) in enumerate(zip(s.stamps_ns, rows, strict=True))]
    )
    assert fed.counts == {}
    assert "aligned in 20" in fed.said[0]
