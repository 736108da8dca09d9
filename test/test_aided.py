"""The filter around the mechanization, offline: consistency, order of arrival, feedback, stops, bad input."""

import functools
import itertools
import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ins_nav import messages, strapdown
from ins_nav.aided import AidedNavigator
from ins_nav.bags import BagReader, message
from ins_nav.error_filter import Measurement
from ins_nav.error_model import HEADING, SIZE, azimuth
from ins_nav.feedback import Feedback
from ins_nav.messages import stamp_of
from ins_nav.navigator import Navigator, Phase
from ins_nav.process import main
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import Simulation, simulate

BOTH = ("--nodes", "ins_node", "alignment_node")
NS = 1_000_000_000
PLACE = {"initial.latitude_deg": 55.7, "initial.longitude_deg": 37.6, "initial.height": 150.0}
SHORT = {"alignment.duration": 20.0, "alignment.fine_duration": 40.0}
FOG = {
    "imu.gyro_bias_stddev_deg_per_hour": 0.2,
    "imu.gyro_noise_deg_per_sqrt_hour": 0.009,
    "imu.accel_bias_stddev_mg": 0.51,
    "imu.accel_noise_ug_per_sqrt_hz": 102.0,
}
"""What the sensors of the rocking scenarios have."""

Event = tuple[int, int, str, tuple[Any, ...]]
"""Stamp of arrival, number, kind, arguments."""


@functools.cache
def _drive(seed: int = 3, duration: float = 110.0) -> Simulation:
    """24 s standing, then driving; 50 Hz, a stop after some 100 s."""
    return simulate("vehicle", seed, duration=duration, rate=50.0, stand_time=24.0)


def _imu(s: Simulation) -> list[Event]:
    values = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    return [(stamp, 0, "imu", (stamp, *row)) for stamp, row in zip(s.stamps_ns.tolist(), values, strict=True)]


def _aids(s: Simulation, names: Iterable[str] = ("fix",), delay: float = 0.0, shuffle: float = 0.0) -> list[Event]:
    """Observations at the stamps of the fixes; they come late by ``delay`` and up to ``shuffle`` more, s."""
    rng, late = np.random.default_rng(5), random.Random(7)
    index = {stamp: i for i, stamp in enumerate([s.start_ns, *s.stamps_ns.tolist()])}
    covariance = tuple(np.diag(np.square(s.fixes.stddev)).ravel().tolist())
    events: list[Event] = []
    for stamp, lat, lon, height in zip(*(x.tolist() for x in s.fixes[:4]), strict=True):
        where = strapdown.geodetic(_truth(s, index[stamp]))
        velocity, noise = np.array(where.velocity_g), rng.normal(0.0, 0.1, (2, 3))
        body = Rotation.from_quat(where.q_gb).inv().apply(velocity)
        rows = tuple((0.01 * np.eye(3)).ravel().tolist())
        content = {
            "fix": (stamp, 0, math.degrees(lat), math.degrees(lon), height, covariance),
            "velocity": (stamp, tuple((velocity + noise[0]).tolist()), rows),
            "log": (stamp, tuple((body + noise[1]).tolist()), rows),
        }
        for name in names:
            comes = stamp + round((delay + late.uniform(0.0, shuffle)) * 1e9)
            events.append((comes, 1 + len(events), name, content[name]))
    return events


def _truth(s: Simulation, i: int) -> strapdown.State:
    t = s.trajectory
    rot_eg = Rotation.from_quat(t.q_eb[i]) * Rotation.from_quat(t.q_nb[i]).inv()
    velocity = rot_eg.inv().apply(t.velocity_e[i])
    return strapdown.initial_state(t.lat[i], t.lon[i], t.height[i], tuple(velocity), tuple(t.q_nb[i]))  # type: ignore[arg-type]


@dataclass
class Fed:
    """Both navigators, fed as `ins_process` does it."""

    parameters: dict[str, Any]
    aided: AidedNavigator = field(init=False)
    ins: Navigator = field(init=False)
    feedback: list[Feedback] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.aided, self.ins = AidedNavigator(self.parameters), Navigator(self.parameters)

    def feed(self, *streams: list[Event], ins: bool = False) -> "Fed":
        feeds = {
            "imu": self.aided.add_imu,
            "fix": self.aided.add_fix,
            "velocity": self.aided.add_gnss_velocity,
            "log": self.aided.add_log,
            "depth": self.aided.add_depth,
            "zupt": self.aided.call_zupt,
        }
        for _, _, kind, arguments in sorted(itertools.chain(*streams), key=lambda event: event[:2]):
            feeds[kind](*arguments)
            new = self.aided.drain()
            self.feedback += new
            if ins:
                for feedback in new:
                    self.ins.follow(feedback)
                if kind == "imu":
                    self.ins.add_imu(*arguments)
                elif kind == "fix":
                    self.ins.add_fix(*arguments)
        self.said += [report.text for report in self.aided.health.drain()]
        return self

    @property
    def counts(self) -> dict[str, int]:
        return self.aided.health.counts


def _same(a: Sequence[Feedback], b: Sequence[Feedback]) -> bool:
    """Bit for bit."""
    return len(a) == len(b) and all(
        x._replace(covariance=None) == y._replace(covariance=None)  # type: ignore[arg-type]
        and np.array_equal(x.covariance, y.covariance)
        for x, y in zip(a, b, strict=True)
    )


def _error(feedback: Feedback, s: Simulation) -> np.ndarray:
    """Position on n, velocity as `ins_nav.error_model` has it, attitude; computed less true."""
    i = int(np.searchsorted(s.stamps_ns, feedback.stamp_ns)) + 1
    t, state = s.trajectory, feedback.state
    to_n = Rotation.from_quat(state[7:11]).inv()
    position = to_n.apply(np.subtract(strapdown.position_ecef(state), t.position_e[i]))
    turn = Rotation.from_quat(state[0:4]) * (to_n * Rotation.from_quat(t.q_eb[i])).inv()
    velocity = np.array(state[4:7]) - turn.apply(to_n.apply(t.velocity_e[i]))
    return np.concatenate([position, velocity, turn.as_rotvec()])


def _nees(feedback: Feedback, s: Simulation, *states: int) -> float:
    error = _error(feedback, s)[list(states)]
    return float(error @ np.linalg.solve(feedback.covariance[np.ix_(states, states)], error))


# Consistency


@functools.cache
def _runs(count: int = 10) -> list[tuple[Simulation, Fed]]:
    runs = []
    for seed in range(count):
        s = _drive(seed)
        runs.append((s, Fed({**SHORT}).feed(_imu(s), _aids(s))))
    return runs


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
        squares += [_nees(f, s, *states) / len(states) for f in driving[:: len(driving) // 8]]
    assert low < np.mean(squares) < high
    # one in a hundred, at most, beyond its 99.99 % limit
    assert np.mean(np.array(squares) * len(states) > chi2.isf(1e-4, len(states))) < 0.01


def test_fine_alignment_improves_heading() -> None:
    """Driving with satellite position shows heading; 20 s of rest leave it uncertain by half a degree."""
    for s, fed in _runs(3):
        first, last = fed.feedback[0], fed.feedback[-1]
        assert last.covariance[8, 8] < 0.2**2 * first.covariance[8, 8]
        assert abs(_error(last, s)[8]) < 4.0 * math.sqrt(last.covariance[8, 8])
        assert fed.aided.records["gnss"].rejected <= 1  # one in 10,000 by chance


def test_log_and_velocity_find_their_errors_too() -> None:
    s = _drive()
    fed = Fed({**SHORT}).feed(_imu(s), _aids(s, ("fix", "velocity", "log")))
    for name in ("gnss", "gnss_velocity", "log"):
        assert fed.aided.records[name].accepted > 80 and fed.aided.records[name].rejected <= 1
    (scale, sigma), *_ = fed.aided.own_states("log")
    # the simulated log has no scale error; some 70 s at 12 m/s with 0.1 m/s a second
    assert sigma < 0.003 and abs(scale) < 4.0 * sigma
    assert fed.aided.own_states("gnss") == fed.aided.own_states("gnss_velocity") == []
    assert _nees(fed.feedback[-1], s, 3, 4) < chi2.isf(1e-4, 2)


@pytest.mark.parametrize("name", ["static", "rocking", "swell_alignment"])
def test_a_base_that_does_not_travel(name: str) -> None:
    motion = {"static": {}, "rocking": {"rocking_time": 200.0}, "swell_alignment": {}}[name]
    s = simulate(name, 4, duration=110.0, rate=50.0, **motion)
    noise = FOG if name != "static" else {}
    parameters = {"alignment.duration": 60.0, "alignment.fine_duration": 90.0, **noise}
    fed = Fed(parameters).feed(_imu(s), _aids(s))
    assert fed.counts == {} and fed.aided.phase is Phase.NAVIGATING
    for feedback in fed.feedback[4::8]:
        assert _nees(feedback, s, 0, 1, 2) < chi2.isf(1e-4, 3)
        assert _nees(feedback, s, 3, 4) < chi2.isf(1e-4, 2)
        assert _nees(feedback, s, 6, 7, 8) < chi2.isf(1e-4, 3)
    assert ("zero velocity" in fed.aided.records) == (name != "swell_alignment")  # surge is no rest


# Phases


def test_fine_alignment_ends_by_time() -> None:
    s = _drive()
    fed = Fed({**SHORT}).feed(_imu(s)[:1900], _aids(s)[:37])
    assert fed.aided.phase is Phase.FINE and not any(f.aligned for f in fed.feedback)
    # 38 s less the settling time
    assert fed.aided.fine_time == pytest.approx(38.0 - 2.2, abs=0.2)
    assert fed.aided.time_left == pytest.approx(40.0 - fed.aided.fine_time)
    fed.feed(_imu(s)[1900:2500], _aids(s)[37:50])
    assert fed.aided.phase is Phase.NAVIGATING and fed.aided.time_left == 0.0
    first = next(f for f in fed.feedback if f.aligned)
    assert (first.stamp_ns - s.start_ns) * 1e-9 == pytest.approx(40.0, abs=0.2)
    assert any(
        "fine alignment ended after 40 s" in text and "fine_duration (40 s) reached" in text for text in fed.said
    )


def test_fine_alignment_ends_by_sigma() -> None:
    s = _drive()
    fed = Fed({"alignment.duration": 20.0, "alignment.fine_heading_deg": 0.2}).feed(_imu(s), _aids(s))
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
    imu, fixes = _imu(s), _aids(s)
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
    s = _drive()
    fed = Fed({**SHORT, "aiding.until_aligned": True}).feed(_imu(s), _aids(s))
    record = fed.aided.records["gnss"]
    # from 20 s to 40 s, once a second; the phase ends at a look ten times a second
    assert 19 <= record.accepted <= 21 and record.rejected == 0
    sigma = [math.sqrt(f.covariance[0, 0]) for f in fed.feedback if f.aligned]
    assert sigma[-1] > 2.0 * sigma[0]
    assert _nees(fed.feedback[-1], s, 0, 1) < chi2.isf(1e-4, 2)


# Stops


def _standing(policy: str, duration: float = 90.0, **more: Any) -> tuple[Simulation, Fed]:
    s = simulate("static", 5, duration=duration, rate=50.0)
    return s, Fed({**PLACE, **SHORT, "aiding.stops": policy, **more})


def test_stops_as_updates() -> None:
    s, fed = _standing("updates")
    fed.feed(_imu(s))
    held, rest = fed.aided.records["zero velocity"], fed.aided.records["rest"]
    # a second each from 20 s to 87.8 s; yaw once a minute
    assert 66 <= held.accepted <= 68 and (rest.accepted, rest.rejected) == (1, 0)
    for feedback in fed.feedback[::10]:
        # the noise of the IMU is known and velocity is measured as zero: far within
        assert np.abs(_error(feedback, s)[3:5]).max() < 3.0 * math.sqrt(feedback.covariance[3, 3])
        assert math.sqrt(feedback.covariance[3, 3]) < 0.03


def test_stops_ignored() -> None:
    s, fed = _standing("none")
    fed.feed(_imu(s))
    assert fed.aided.records == {}
    assert fed.feedback[-1].covariance[3, 3] > fed.feedback[0].covariance[3, 3]


def _call(s: Simulation, seconds: float) -> Event:
    stamp = s.start_ns + round(seconds * 1e9)
    return (stamp, 9, "zupt", (stamp,))


def test_stops_as_zupt_calls_only() -> None:
    s, fed = _standing("zupt")
    fed.feed(_imu(s), [_call(s, 60.0)])
    held, rest = fed.aided.records["zero velocity"], fed.aided.records["rest"]
    assert (held.accepted, rest.accepted, rest.rejected) == (1, 1, 0)
    assert len(rest.last.innovation) == 3  # type: ignore[union-attr]
    drift = [np.sqrt(f.covariance.diagonal()[9:12]) for f in fed.feedback]
    # 40 s of rest say little of horizontal drift to a navigation-grade IMU, but nothing is lost
    assert (drift[-1] <= drift[0] * 1.05).all()
    s, quiet = _standing("zupt")
    assert quiet.feed(_imu(s)).aided.records == {}


def test_zupt_calls_do_not_count_twice() -> None:
    """Rest since the last call is what a call measures: the second, 4 s later, has nothing to say."""
    worse = {"imu.gyro_bias_stddev_deg_per_hour": 1.0, "initial.heading_deg": 30.0}
    results = []
    for calls in ((60.0,), (60.0, 64.0), (60.0, 60.1, 60.2)):
        s, fed = _standing("zupt", 75.0, **worse)
        fed.feed(_imu(s), [_call(s, at) for at in calls])
        assert fed.aided.records["rest"].accepted == 1
        results.append(np.sqrt(fed.feedback[-1].covariance.diagonal()[9:12]))
    # level's drifts, from 1 °/h; the vertical one is lost in neither
    assert results[0].min() < 0.1 * math.radians(1.0) / 3600.0
    # a second of zero velocity more, and no more than that: new data would be worth a quarter of the sigma
    for again in results[1:]:
        np.testing.assert_allclose(again, results[0], rtol=0.02)


def test_zupt_call_knows_that_heading_was_corrected_since() -> None:
    """Heading is 5° wrong until something tells it during the stop: Earth's rate has no more of that to show."""
    s, fed = _standing("zupt", 70.0, **{"initial.heading_deg": 35.0, "initial.heading_stddev_deg": 2.9})
    imu = _imu(s)
    fed.feed(imu[:1500])
    h = np.zeros((1, SIZE))
    h[0, HEADING] = 1.0
    told = Measurement(np.array([-math.radians(5.0)]), h, np.array([[1e-6]]), slice(HEADING, HEADING + 1))
    fed.aided._update("compass", fed.aided.settled_ns, told, 1e-9)
    fed.feed(imu[1500:], [_call(s, 60.0)])
    rest = fed.aided.records["rest"].last
    assert rest is not None and rest.accepted
    # 5° would be 0.74 °/h
    assert abs(rest.innovation[0]) < 4.0 * rest.sigma[0] < math.radians(0.6) / 3600.0


def test_zupt_call_just_before_the_start_of_a_drive() -> None:
    """What the call is about settles when the vehicle has left already."""
    s = _drive()
    fed = Fed({"alignment.duration": 10.0, "aiding.stops": "zupt"}).feed(_imu(s), _aids(s), [_call(s, 25.0)])
    assert fed.aided.records["rest"].accepted == 1


# Order of arrival


@functools.cache
def _in_order() -> tuple[Feedback, ...]:
    s = _drive()
    return tuple(Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s, ("fix", "velocity", "log"))).feedback)


@pytest.mark.parametrize(("delay", "shuffle"), [(0.0, 1.0), (0.5, 0.0), (1.9, 0.0), (0.5, 1.3)])
def test_order_of_arrival_does_not_matter(delay: float, shuffle: float) -> None:
    s = _drive()
    aids = _aids(s, ("fix", "velocity", "log"), delay, shuffle)
    comes = [event[0] for event in aids]
    assert (comes != sorted(comes)) == (shuffle > 0.0)
    fed = Fed({**SHORT, **PLACE}).feed(_imu(s), aids)
    assert _same(fed.feedback, _in_order())
    assert fed.counts == {}


def test_observations_of_one_stamp_in_any_order() -> None:
    s = _drive()
    aids = [(comes, -number, *rest) for comes, number, *rest in _aids(s, ("fix", "velocity", "log"))]
    fed = Fed({**SHORT, **PLACE}).feed([(comes, -1000, *rest) for comes, _, *rest in _imu(s)], aids)  # type: ignore[misc]
    assert _same(fed.feedback, _in_order())


def test_what_comes_too_late_is_left_out_and_told() -> None:
    s = _drive()
    fed = Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s, delay=2.6))
    # one a second after alignment, but the last two have not come yet
    assert fed.counts == {"gnss late": pytest.approx(88, abs=2)}
    assert "gnss" not in fed.aided.records
    assert any("gnss/fix: 2.60 s behind imu/data_raw, left out: raise aiding.max_delay" in text for text in fed.said), (
        fed.said
    )
    patient = Fed({**SHORT, **PLACE, "aiding.max_delay": 3.0}).feed(_imu(s), _aids(s, delay=2.6))
    assert patient.counts == {} and patient.aided.records["gnss"].accepted > 80


def test_stamps_of_another_clock_are_told() -> None:
    s = _drive()
    ahead = [(at, n, kind, (values[0] + 10 * NS, *values[1:])) for at, n, kind, values in _aids(s)]
    fed = Fed({**SHORT, **PLACE}).feed(_imu(s), ahead)
    assert fed.counts["gnss ahead"] >= 80 and "gnss" not in fed.aided.records
    assert any(
        "gnss/fix: 10.0 s ahead of imu/data_raw, left out: both must be stamped by one clock" in t for t in fed.said
    )


def test_delay_is_taken_off() -> None:
    """Stamped on arrival, 0.4 s after they were measured: 5 m at the speed of the drive."""
    s = _drive()
    later = [(at, n, kind, (values[0] + 400_000_000, *values[1:])) for at, n, kind, values in _aids(s)]
    right = Fed({**SHORT, **PLACE, "gnss.delay": 0.4}).feed(_imu(s), later)
    assert _same(right.feedback, Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s)).feedback)
    wrong = Fed({**SHORT, **PLACE}).feed(_imu(s), later)
    away = [[np.linalg.norm(_error(f, s)[:2]) for f in fed.feedback[-60:-20]] for fed in (right, wrong)]
    assert np.mean(away[1]) > 3.0 * np.mean(away[0])


def test_repeated_messages_count_once() -> None:
    s = _drive()
    aids = _aids(s)
    fed = Fed({**SHORT, **PLACE}).feed(_imu(s), aids, [(at + 1, *rest) for at, *rest in aids])  # type: ignore[misc]
    assert _same(fed.feedback, Fed({**SHORT, **PLACE}).feed(_imu(s), aids).feedback)
    assert fed.counts["gnss repeated"] >= 85


def test_first_observation_may_come_before_the_sample_that_ends_alignment() -> None:
    """Live, topics overtake each other: the fix that follows alignment may come before its last sample."""
    s = _drive()
    late = [(at + 1_500_000_000, *rest) for at, *rest in _imu(s)]
    fed = Fed({**SHORT, **PLACE}).feed(late, _aids(s, ("fix", "velocity", "log")))  # type: ignore[arg-type]
    assert _same(fed.feedback, _in_order())


def test_messages_without_value() -> None:
    s = _drive()
    bad: list[Event] = []
    for n, (at, _, _, values) in enumerate(_aids(s)):
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
    fed = Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s), bad)
    assert _same(fed.feedback, Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s)).feedback)
    assert set(fed.counts) == {
        "no fix",
        "invalid fixes",
        "gnss_velocity unusable",
        "log unusable",
        "depth unusable",
    }


def test_fixes_without_height_are_horizontal() -> None:
    s = _drive()
    flat = [(at, n, kind, (*values[:4], math.nan, values[5])) for at, n, kind, values in _aids(s)]
    fed, full = Fed({**SHORT}).feed(_imu(s), flat), Fed({**SHORT}).feed(_imu(s), _aids(s))
    assert fed.aided.filter is not None and full.aided.filter is not None
    assert fed.aided.records["gnss"].accepted == full.aided.records["gnss"].accepted
    sigma, other = (np.sqrt(x.aided.filter.p.diagonal()[:3]) for x in (fed, full))
    # height: nobody knows it, and a ground vehicle's tells nothing of the rest
    assert sigma[2] > 900.0 and other[2] < 3.0
    np.testing.assert_allclose(sigma[:2], other[:2], rtol=0.02)


def test_a_restart_forgets_what_the_filter_knew() -> None:
    """Stamps jump back: alignment begins with the uncertainty that parameters give."""
    s = _drive()
    fed = Fed({**SHORT, **PLACE, "imu.gyro_bias_stddev_deg_per_hour": 1.0}).feed(_imu(s)[:4500], _aids(s))
    aided = fed.aided
    assert aided.filter is not None
    given = math.radians(1.0 / 3600.0)
    assert math.sqrt(aided.gyro_bias_covariance[2, 2]) < 0.999 * given
    (_, _, _, values) = _imu(s)[0]
    for n in range(3):
        aided.add_imu(values[0] + n * 20_000_000, *values[1:])
    assert aided.filter is None
    assert math.sqrt(aided.gyro_bias_covariance[2, 2]) == pytest.approx(given, rel=1e-9)


def test_a_filter_that_begins_late_aligns_finely() -> None:
    """What `ins_node` has by itself is coarse."""
    s = _drive()
    navigator = Navigator({**SHORT, **PLACE})
    for _, _, _, values in _imu(s)[:1500]:
        navigator.add_imu(*values)
    assert navigator.phase is Phase.NAVIGATING
    solution = navigator.solution()
    assert solution is not None and not solution[0].aligned


def test_zero_covariance_is_the_default() -> None:
    s = _drive()
    zero = [(at, n, kind, (*values[:5], (0.0,) * 9)) for at, n, kind, values in _aids(s)]
    none = [(at, n, kind, values[:5]) for at, n, kind, values in _aids(s)]
    assert _same(
        Fed({**SHORT, **PLACE}).feed(_imu(s), zero).feedback, Fed({**SHORT, **PLACE}).feed(_imu(s), none).feedback
    )


def test_numbers_that_overflow_are_rejected() -> None:
    s = _drive()
    huge = [(at, n, "velocity", (values[0], (1e200, (-1) ** n * 1e160, math.nan))) for at, n, _, values in _aids(s)]
    with np.errstate(over="ignore", invalid="ignore"):
        fed = Fed({**SHORT, **PLACE}).feed(_imu(s), huge)
    assert fed.aided.records["gnss_velocity"].accepted == 0
    assert all(map(math.isfinite, fed.feedback[-1].state))


# Following


@functools.cache
def _followed() -> Fed:
    s = _drive()
    return Fed({**SHORT, **PLACE}).feed(_imu(s), _aids(s), ins=True)


def _follower(given: Iterable[tuple[int, Feedback]], without: Iterable[int] = ()) -> Navigator:
    """A navigator over the drive that is given each feedback when the sample of a stamp was taken."""
    ins, waiting, missing = Navigator({**SHORT, **PLACE}), sorted(given, key=lambda item: item[0]), set(without)
    for at, _, _, values in _imu(_drive()):
        while waiting and waiting[0][0] < at:
            ins.follow(waiting.pop(0)[1])
        if at not in missing:
            ins.add_imu(*values)
    return ins


def _on_time(feedback: Sequence[Feedback]) -> list[tuple[int, Feedback]]:
    return [(f.apply_ns - 400_000_000, f) for f in feedback]


def _rerun(ins: Navigator, feedback: Feedback) -> strapdown.State:
    """The feedback's state, carried on over the samples since."""
    state = feedback.state
    before = ins._without_bias(ins._history.at(feedback.stamp_ns).raw)
    for entry in ins._history.between(feedback.stamp_ns, ins.stamp_ns):
        sample = ins._without_bias(entry.raw)
        state = strapdown.step(state, before, sample, False, False)
        before = sample
    return state


def test_follower_goes_on_from_the_feedback_bit_for_bit() -> None:
    fed = _followed()
    newest = [f for f in fed.feedback if f.apply_ns <= fed.ins.stamp_ns][-1]
    assert fed.ins._history.at(newest.stamp_ns).state == newest.state
    assert fed.ins.state == _rerun(fed.ins, newest)
    assert (fed.ins.gyro_bias, fed.ins.accel_bias) == (newest.gyro_bias, newest.accel_bias)
    assert fed.ins.phase is Phase.NAVIGATING
    # of the present: what is uncertain has grown in some 3 s, velocity of 0.1 m/s the position too
    assert fed.ins.covariance is not None
    own = [0, 1, 3, 4, 6, 7, 8]
    ratio = np.sqrt(fed.ins.covariance.diagonal()[own] / newest.covariance.diagonal()[own])
    assert (ratio > 0.99).all() and (ratio < 1.5).all()
    # nothing else corrects meanwhile
    assert fed.ins.health.counts == {} and fed.ins.stops.passive


def test_feedback_takes_effect_exactly_at_its_time() -> None:
    s, feedback = _drive(), _followed().feedback
    plain, ins = Navigator({**SHORT, **PLACE}), Navigator({**SHORT, **PLACE})
    first = feedback[0]
    for at, _, _, values in _imu(s):
        if at > first.apply_ns:
            break
        if at == first.stamp_ns + 2_400_000_000:  # as soon as it is there
            ins.follow(first)
        plain.add_imu(*values)
        ins.add_imu(*values)
        assert (ins.state == plain.state) == (at < first.apply_ns or ins.state is None)
    assert ins.state == _rerun(ins, first) and ins.phase is Phase.FINE


@pytest.mark.parametrize(
    ("name", "count"),
    [("late", "feedback late"), ("lost", ""), ("repeated", "feedback repeated"), ("swapped", "feedback repeated")],
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
        assert ins.health.counts[count] == len(on_time) // 2
    assert ins.state == expected.state == _rerun(ins, last)
    assert set(ins.health.counts) == ({count} if count else set())
    # carried on over other steps, of half a second at most: 0.35 s of growth of some 3 s
    sigma, other = (np.sqrt(n.accuracy.covariance.diagonal()) for n in (ins, expected))
    np.testing.assert_allclose(sigma, other, rtol=0.05)


def test_feedback_that_is_too_old_is_left_out_and_told() -> None:
    feedback = _followed().feedback
    ins = _follower([(f.apply_ns + 12 * NS, f) for f in feedback])
    assert ins.state == _follower([]).state
    assert ins.health.counts["feedback lost"] >= 60  # one a second of driving
    assert any("of which nothing is remembered" in report.text for report in ins.health.drain())


def test_sample_lost_where_a_feedback_belongs() -> None:
    """It is left out; the next one counts."""
    feedback = _followed().feedback
    middle = feedback[len(feedback) // 2]
    ins = _follower(_on_time(feedback), [middle.stamp_ns])
    assert ins.health.counts == {"gaps": 1, "samples lost": 1, "feedback lost": 1}
    newest = [f for f in feedback if f.apply_ns <= ins.stamp_ns][-1]
    assert ins.state == _rerun(ins, newest)


def test_feedback_of_another_time_never_blocks_what_follows() -> None:
    """From before a restart: ahead of the samples now."""
    feedback = _followed().feedback
    stray = feedback[20]._replace(stamp_ns=feedback[20].stamp_ns + 60 * NS, apply_ns=feedback[20].apply_ns + 60 * NS)
    ins = _follower([*_on_time(feedback), (feedback[20].apply_ns, stray)])
    assert ins.health.counts == {"feedback ahead": 1}
    assert ins.state == _follower(_on_time(feedback)).state


def test_feedback_is_no_use_without_a_solution() -> None:
    ins = Navigator({**SHORT, **PLACE})
    for feedback in _followed().feedback:
        ins.follow(feedback)
    assert ins.state is None and ins.solution() is None
    for _, _, _, values in _imu(_drive())[:1100]:
        ins.add_imu(*values)
    assert ins.state is not None


def test_restart_begins_with_the_biases_given() -> None:
    ins = _follower(_on_time(_followed().feedback))
    assert ins.stops.accel_bias == ins.accel_bias != (0.0, 0.0, 0.0)
    for k in (0, 1):
        ins.add_imu(ins.stamp_ns + 100 * NS + k * NS // 50, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8)
    assert ins.restarts == 1 and ins.stops.accel_bias == ins.accel_bias == (0.0, 0.0, 0.0)


def test_alignment_again_forgets_what_was_fed_back() -> None:
    feedback = _followed().feedback
    ins = _follower(_on_time(feedback))
    ins.align()
    assert ins.covariance is None and ins.solution() is None


def test_feedback_message_there_and_back() -> None:
    feedback = _followed().feedback[-1]
    out = message("std_msgs/msg/Float64MultiArray")
    messages.fill_feedback(out, feedback)
    assert len(out.data) == sum(size for _, size in messages.FEEDBACK)
    back = messages.read_feedback(out)
    assert back is not None and _same([back], [feedback])


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:-1],
        lambda data: [],
        lambda data: [math.nan, *data[1:]],
        lambda data: [*data[:20], math.inf, *data[21:]],
        lambda data: [0.0] * len(data),
        lambda data: [*data[:-1], -1.0],
        lambda data: [*data[:4], 1.5, *data[5:]],
    ],
)
def test_malformed_feedback_messages_are_none(change: Any) -> None:
    out = message("std_msgs/msg/Float64MultiArray")
    messages.fill_feedback(out, _followed().feedback[-1])
    out.data = change(list(out.data))
    assert messages.read_feedback(out) is None


# A filter that begins later


def _restarted(at: float, solutions: Sequence[float] = (40.0,)) -> tuple[Simulation, AidedNavigator, list[Feedback]]:
    """`alignment_node` begins at a time, s, and hears of a solution at others."""
    s = _drive()
    ins, aided = Navigator({**SHORT, **PLACE}), AidedNavigator({**SHORT, **PLACE})
    fixes = {event[0]: event[3] for event in _aids(s)}
    feedback: list[Feedback] = []
    for stamp, _, _, values in _imu(s):
        time = (stamp - s.start_ns) * 1e-9
        ins.add_imu(*values)
        if time >= at:
            if stamp in fixes:
                aided.add_fix(*fixes[stamp])
            aided.add_imu(*values)
            feedback += aided.drain()
        solution = ins.solution()
        if solution is not None and any(abs(time - t) < 1e-3 for t in solutions):
            aided.adopt(*solution)
    return s, aided, feedback


def test_filter_that_begins_later_adopts_the_solution() -> None:
    s, aided, feedback = _restarted(35.0)
    assert "goes on from the solution of ins_node" in [report.text for report in aided.health.drain()]
    assert (feedback[0].stamp_ns - s.start_ns) * 1e-9 == pytest.approx(41.0, abs=0.6)
    for f in feedback:
        assert _nees(f, s, 0, 1, 2) < chi2.isf(1e-4, 3) and _nees(f, s, 3, 4) < chi2.isf(1e-4, 2)
    assert math.sqrt(feedback[-1].covariance[0, 0]) < 0.6


def test_even_motion_is_no_stop_for_a_filter_that_begins_in_it() -> None:
    """Begun at 12 m/s on an even road: the IMU alone cannot tell."""
    _, aided, _ = _restarted(35.0)
    assert aided.health.counts["stops doubted"] >= 1
    assert "rest" not in aided.records and "zero velocity" not in aided.records


def test_solution_is_adopted_once_and_only_where_its_sample_is_known() -> None:
    s, aided, _ = _restarted(35.0, (30.0, 34.0, 36.0, 50.0))
    assert (aided._began_ns - s.start_ns) * 1e-9 == pytest.approx(36.0)
    # one that has seen the whole alignment makes its own
    s, aided, _ = _restarted(0.0, (20.0, 20.5, 25.0))
    assert (aided._began_ns - s.start_ns) * 1e-9 == pytest.approx(20.0, abs=0.05)


def test_adopting_at_rest_goes_on_with_the_stop() -> None:
    """Even a velocity that is wrong, and is corrected in the middle of the second over which its mean is taken."""
    s, fed = _standing("updates", 60.0)
    ins = Navigator({**SHORT, **PLACE})
    for at, _, _, values in _imu(s):
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
                fed.aided.add_gnss_velocity(at, (0.0, 0.0, 0.0), tuple((1e-4 * np.eye(3)).ravel().tolist()))
    record = fed.aided.records["zero velocity"]
    assert record.accepted > 10 and record.rejected == 0


def test_unknown_heading_goes_out_as_an_angle() -> None:
    s = _drive()
    unknown = {"initial.heading_deg": 150.0, "initial.heading_stddev_deg": 180.0}
    fed = Fed({**SHORT, **PLACE, **unknown}).feed(_imu(s)[:500])
    # uniform over the circle: 180° / √3
    assert math.degrees(math.sqrt(fed.feedback[0].covariance[8, 8])) == pytest.approx(104.0, abs=0.2)


# Messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("aided") / "bag"
    # what the filter has no states for left out: in a turn a misaligned gyro tilts the level by more than its sigma
    ideal = {f"imu.gyro_{name}": 0.0 for name in ("scale_stddev_ppm", "misalignment_stddev_arcsec")}
    write_bag(simulate("vehicle", 6, duration=150.0, rate=50.0, stand_time=24.0, **ideal), path)
    return path


def _series(path: Path, topic: str) -> dict[int, Any]:
    with BagReader(path) as reader:
        return {stamp_of(m): m for m in map(reader.deserialize, reader.messages([topic]))}


def _v(v: Any) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


def _r(q: Any) -> Rotation:
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def test_covariances_of_the_messages(bag: Path, tmp_path: Path) -> None:
    """Each on its own axes: the errors of the fields, normalized by the covariance beside them."""
    out = tmp_path / "out"
    assert main([str(bag), "-o", str(out), "--param", "alignment.duration:=20", *BOTH]) == 0
    odometry, imu, fix = (_series(out, t) for t in ("odometry", "imu/data", "fix"))
    true_odometry, true_fix = (_series(bag, t) for t in ("truth/odometry", "truth/fix"))
    begin = min(odometry)
    squares: dict[str, list[float]] = {name: [] for name in ("position", "attitude", "twist", "fix")}
    for stamp in sorted(odometry.keys() & true_odometry.keys()):
        if stamp < begin + 10 * NS or stamp % NS:
            continue
        o, t, f, tf, i = odometry[stamp], true_odometry[stamp], fix[stamp], true_fix[stamp], imu[stamp]
        pose, twist = (np.reshape(x.covariance, (6, 6)) for x in (o.pose, o.twist))
        assert np.linalg.eigvalsh(pose)[0] > 0.0 and (twist.diagonal() >= 0.0).all()
        errors = {
            "position": (_v(o.pose.pose.position) - _v(t.pose.pose.position), pose[:3, :3]),
            "attitude": ((_r(o.pose.pose.orientation) * _r(t.pose.pose.orientation).inv()).as_rotvec(), pose[3:, 3:]),
            "twist": ((_v(o.twist.twist.linear) - _v(t.twist.twist.linear))[:2], twist[:2, :2]),
        }
        north = math.radians(f.latitude - tf.latitude) * 6.39e6
        east = math.radians(f.longitude - tf.longitude) * 6.39e6 * math.cos(math.radians(tf.latitude))
        place = np.reshape(f.position_covariance, (3, 3))
        assert f.position_covariance_type == 3
        errors["fix"] = (np.array([east, north, f.altitude - tf.altitude]), place)
        for name, (error, covariance) in errors.items():
            squares[name].append(float(error @ np.linalg.solve(covariance, error)) / len(error))
        # one tangent plane within some 100 m: map and east-north-up are alike
        np.testing.assert_allclose(place, pose[:3, :3], rtol=1e-3, atol=1e-3)
        # meridians converge by 2e-5 rad on the way, which turns as much of heading's variance, 1e-4, into others
        np.testing.assert_allclose(np.reshape(i.orientation_covariance, (3, 3)), pose[3:, 3:], rtol=0.01, atol=2e-9)
        assert np.diag(np.reshape(i.angular_velocity_covariance, (3, 3))).min() > 0.0
        assert np.diag(np.reshape(i.linear_acceleration_covariance, (3, 3))).min() > 0.0
    # one run, whose errors are alike for 10 s; the solution has gone on for some 3 s since its covariance
    for values in squares.values():
        assert 0.05 < np.mean(values) < 2.5, {name: np.mean(v) for name, v in squares.items()}
    diagnostics = list(_series(out, "diagnostics").values())[-1]
    assert [status.name for status in diagnostics.status] == ["ins_process: navigation", "ins_process: alignment"]
    values = {item.key: item.value for item in diagnostics.status[1].values}
    assert {"phase", "position sigma", "heading sigma", "time left by prediction"} <= values.keys()
    assert {"gnss: accepted, rejected", "gnss: innovation", "gnss: test ratio", "gnss: last accepted"} <= values.keys()
    assert "±" in values["gnss: innovation"] and values["phase"] == "fine"


def _filled(state: strapdown.State, covariance: np.ndarray, origin: strapdown.MapFrame) -> messages.SolutionMessages:
    ins = Navigator({"navigation.vertical_channel": True})
    ins.state, ins.map, ins.changes = state, origin, 1
    ins.accuracy.begin(0, state, covariance, (0.0, 0.0))
    out = messages.SolutionMessages(
        message("nav_msgs/msg/Odometry"), message("sensor_msgs/msg/Imu"), message("sensor_msgs/msg/NavSatFix"), ins
    )
    assert out.due()
    out.fill()
    return out


def test_frames_of_the_covariances_far_from_the_origin() -> None:
    """1000 km off, n turned by 40° and the body by 70° against it: each variance is where its error is large."""
    origin = strapdown.MapFrame(math.radians(60.0), math.radians(10.0), 0.0)
    here = strapdown.initial_state(
        math.radians(62.0), math.radians(30.0), 0.0, (10.0, 0.0, 0.0),
        (0.0, 0.0, math.sin(math.radians(35.0)), math.cos(math.radians(35.0))),
    )  # fmt: skip
    half = math.radians(20.0)
    q_en = (Rotation.from_quat(here[7:11]) * Rotation.from_quat([0.0, 0.0, math.sin(half), math.cos(half)])).as_quat()
    state = (*here[:7], *map(float, q_en), 0.0)
    assert azimuth(state) == pytest.approx((math.cos(2.0 * half), math.sin(2.0 * half)))
    along = np.zeros((15, 15))
    for k in (0, 3, 6):
        along[k : k + 3, k : k + 3] = np.diag([1e-2, 1e-4, 4e-4])  # all along the first axis of n
    out = _filled(state, along, origin)
    direction_g = Rotation.from_euler("Z", 40.0, degrees=True).apply([1.0, 0.0, 0.0])
    direction_b = Rotation.from_quat(state[0:4]).inv().apply([1.0, 0.0, 0.0])
    pose, twist = (np.reshape(x.covariance, (6, 6)) for x in (out.odometry.pose, out.odometry.twist))
    for matrix, direction in (
        (np.reshape(out.fix.position_covariance, (3, 3)), direction_g),
        (np.reshape(out.imu.orientation_covariance, (3, 3)), direction_g),
        (twist[:3, :3], direction_b),
    ):
        assert direction @ matrix @ direction == pytest.approx(1e-2)
        assert np.trace(matrix) == pytest.approx(1.05e-2)
    # in the map: a step along the first axis of n, taken there
    step = 100.0
    moved = strapdown.corrected(state, (step, 0.0, 0.0))
    direction_m = np.subtract(origin.position(moved), origin.position(state)) / step
    assert direction_m @ pose[:3, :3] @ direction_m == pytest.approx(1e-2, abs=1e-6)
    assert direction_m @ pose[3:, 3:] @ direction_m == pytest.approx(1e-2, abs=1e-6)


def test_no_change_is_missed_at_a_low_rate(bag: Path, tmp_path: Path) -> None:
    """Covariances and biases go out with the next solution, whichever sample brought the change."""
    out = tmp_path / "out"
    few = ("--param", "alignment.duration:=20", "--param", "publish.rate:=0.7")
    assert main([str(bag), "-o", str(out), *few, *BOTH]) == 0
    odometry = list(_series(out, "odometry").values())
    variances = {o.pose.covariance[0] for o in odometry[3:]}
    assert len(variances) == len(odometry) - 3
    with BagReader(out) as reader:
        # nothing is found in the first 4.4 s: until it is settled, and has had its time to arrive
        assert reader.topics["/imu/bias"].count >= len(odometry) - 3


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


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers near the largest overflow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    st.lists(_EVENT, min_size=5, max_size=40),
    st.sampled_from(["updates", "zupt", "none"]),
    st.booleans(),
    st.booleans(),
)
def test_nothing_that_comes_makes_it_fail(
    events: list[tuple[Any, ...]], stops: str, vertical: bool, unknown_heading: bool
) -> None:
    parameters = {
        "aiding.stops": stops,
        "initial.heading_deg": 30.0,
        "initial.heading_stddev_deg": 180.0 if unknown_heading else 1.0,
        "alignment.level_duration": 2.0,
        "navigation.vertical_channel": vertical,
        "gnss.slow_stddev": 1.0 if vertical else 0.0,
        **({} if unknown_heading else PLACE),
    }
    aided, ins = AidedNavigator(parameters), Navigator(parameters)
    now, k = 1_700_000_000 * NS, 0
    for kind, *values in [("good", 0), ("imu", 150), *events, ("imu", 100)]:
        if kind == "imu":
            for _ in range(values[0]):
                now, k = now + 20_000_000, (k + 1) % len(_level())
                aided.add_imu(now, *_level()[k])
                for feedback in aided.drain():
                    ins.follow(feedback)
                ins.add_imu(now, *_level()[k])
        elif kind == "good":
            for navigator in (aided, ins):
                navigator.add_fix(now + values[0] * 1_000_000, 0, 55.7, 37.6, 150.0, (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0))
        elif kind == "fix":
            for navigator in (aided, ins):
                navigator.add_fix(now + values[0], *values[1:])
        elif kind == "velocity":
            aided.add_gnss_velocity(now + values[0], *values[1:])
        elif kind == "log":
            aided.add_log(now + values[0], *values[1:])
        elif kind == "depth":
            aided.add_depth(now + values[0], *values[1:])
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
                ins.follow(feedback._replace(stamp_ns=feedback.stamp_ns + values[0], apply_ns=now + values[1]))
        for navigator in (aided, ins):
            assert navigator.state is None or all(map(math.isfinite, navigator.state))
        if aided.filter is not None:
            assert np.isfinite(aided.filter.p).all()
            # rounding, relative to what was there before an exact measurement
            assert aided.filter.p.diagonal().min() >= -1e-12
        messages.diagnostics(ins)
        messages.alignment_diagnostics(aided)
