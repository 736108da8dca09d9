"""The covariance of the solution is that of its errors: while driving, at stops, after them, at the present."""

import functools
import math
from typing import NamedTuple

import numpy as np
import pytest
from navigators import Ins
from scipy.spatial.transform import Rotation

from ins_nav.aiding.parameters import configuration
from ins_nav.estimation.covariance_propagation import CovariancePropagation, covariance_of, error_model, filter_of
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.imu_condition import HiddenErrors, ImuCondition
from ins_nav.mechanization.replay_buffer import ReplayBuffer
from ins_nav.mechanization.stamped_rows import StampedRows
from ins_nav.mechanization.strapdown import SAMPLE_SIZE
from ins_nav.simulation.scenarios import Simulation, simulate

pytestmark = pytest.mark.xdist_group("covariance_propagation")  # they share _drives and _turns

Array = np.ndarray
NS = 1_000_000_000
HZ = 20.0
"""Enough: the errors are those of sensors and of the start."""
IDEAL = {
    f"imu.{sensor}_{name}": 0.0
    for sensor in ("gyro", "accel")
    for name in ("scale_stddev_ppm", "misalignment_stddev_arcsec")
}
"""Without errors that have no states in the error model."""
HEADING = math.radians(0.5)
STATE = nav_state.initial_state(math.radians(55.7), math.radians(37.6), 150.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
NOISE = (6e-7, 1e-4)
"""rad/√s and m/s/√s: of a navigation grade IMU."""


class Row(NamedTuple):
    """A moment of a run."""

    error: Array
    """(15,), as `ins_nav.estimation.error_model` has it."""
    covariance: Array


def _error(n: Ins, s: Simulation, i: int) -> Array:
    t, state = s.trajectory, n.state
    assert state is not None
    to_n = Rotation.from_quat(state[7:11]).inv()
    position = to_n.apply(np.subtract(nav_state.position_ecef(state), t.position_e[i]))
    turn = Rotation.from_quat(state[0:4]) * (to_n * Rotation.from_quat(t.q_eb[i])).inv()
    velocity = np.array(state[4:7]) - turn.apply(to_n.apply(t.velocity_e[i]))
    biases = np.subtract([*n.gyro_bias, *n.accel_bias], [*s.gyro_bias, *s.accel_bias])
    return np.concatenate([position, velocity, turn.as_rotvec(), biases])


def _run(s: Simulation, seed: int, times: tuple[float, ...], calls: tuple[float, ...] = ()) -> list[Row]:
    """Initial place and heading with errors of their sigmas; ZUPT-1 called at some times."""
    rng, p = np.random.default_rng(seed), s.parameters
    north, east = rng.normal(0.0, 1.0, 2) / 6.38e6
    heading = math.radians(p["heading_deg"]) + rng.normal(0.0, HEADING)
    n = Ins(
        {
            "initial.latitude_deg": p["lat_deg"] + math.degrees(north),
            "initial.longitude_deg": p["lon_deg"] + math.degrees(east) / math.cos(math.radians(p["lat_deg"])),
            "initial.height": p["height"],
            "initial.heading_deg": math.degrees(heading),
            "initial.heading_stddev_deg": math.degrees(HEADING),
            "alignment.level_duration": 10.0,
            "aiding.height_walk": 0.0,
        }
    )
    rows, looks, called = [], {round(time * HZ) for time in times}, {round(time * HZ) for time in calls}
    samples = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    for i, (stamp, sample) in enumerate(zip(s.stamps_ns.tolist(), samples, strict=True), 1):
        n.add_imu(stamp, *sample)
        if i in called:
            done, text = n.zupt1()
            assert done, text
        if i in looks:
            assert n.covariance is not None
            rows.append(Row(_error(n, s, i), n.covariance))
    return rows


DRIVE = (20.0, 40.0, 60.0, 80.0, 100.0, 112.0, 122.0, 130.0, 150.0)
"""At rest; drives from 24 s on; a stop from 110 s on, detected from 114 s on; drives from 134 s on."""


@functools.cache
def _drives() -> list[list[Row]]:
    drives = []
    for seed in range(12):
        s = simulate("vehicle", seed, duration=150.0, rate=HZ, stand_time=24.0, **IDEAL)
        drives.append(_run(s, seed, DRIVE))
    return drives


TURN = (60.0, 70.0, 140.0, 145.0, 160.0, 180.0, 200.0, 220.0)
"""Stands; turns at 65 s; stands from 85 s on, ZUPT-1 at 135 s; drives from 145 s on."""


@functools.cache
def _turns() -> list[list[Row]]:
    turns = []
    for seed in range(12):
        s = simulate(
            "zupt1_two_positions", seed, duration=220.0, rate=HZ, first_stop=65.0, second_stop=60.0,
            **IDEAL, **{"imu.preset": "navigation", "imu.gyro_bias_deg_per_hour": (0.0, 0.0, 0.0)},
        )  # fmt: skip
        turns.append(_run(s, seed, TURN, (60.0, 135.0)))
    return turns


def _rms(runs: list[list[Row]], look: int, *states: int) -> float:
    """Of error over sigma, over runs and states."""
    values = [run[look].error[i] / math.sqrt(run[look].covariance[i, i]) for run in runs for i in states]
    return math.sqrt(float(np.mean(np.square(values))))


# Consistency


@pytest.mark.parametrize("look", range(len(DRIVE)))
def test_sigmas_of_a_drive_are_those_of_its_errors(look: int) -> None:
    """The RMS of 24 normal numbers over their sigmas is 1 ± 0.14, of 12 ± 0.2: three times that are allowed."""
    runs, time = _drives(), DRIVE[look]
    assert 0.56 < _rms(runs, look, 0, 1) < 1.44
    assert 0.56 < _rms(runs, look, 6, 7) < 1.44
    assert 0.4 < _rms(runs, look, 8) < 1.6
    # the sway of a base at rest is aiding.stop_velocity_stddev until some seconds have measured that it is less
    assert (0.56 if time in (80.0, 100.0, 112.0, 150.0) else 0.0) < _rms(runs, look, 3, 4) < 1.44


@pytest.mark.parametrize("look", range(len(TURN)))
def test_sigmas_around_zupt1_are_those_of_its_errors(look: int) -> None:
    runs, time = _turns(), TURN[look]
    assert 0.56 < _rms(runs, look, 0, 1) < 1.44
    assert 0.56 < _rms(runs, look, 6, 7) < 1.44
    assert 0.4 < _rms(runs, look, 8) < 1.6
    assert 0.65 < _rms(runs, look, 9, 10, 11) < 1.35  # of 36: 1 ± 0.12
    assert (0.56 if time > 170.0 else 0.0) < _rms(runs, look, 3, 4) < 1.44


def test_zupt1_shrinks_heading_and_drifts_and_stops_shrink_velocity() -> None:
    for run in _turns():
        before, after = run[1].covariance.diagonal(), run[2].covariance.diagonal()
        # zero velocity at position 1 has reduced 0.5° to 0.22° by then; a minute at each of two positions
        assert after[8] < 0.85**2 * before[8]
        assert after[9:12].max() < before[9:12].max()
    for run in _drives():
        before, after = run[5].covariance.diagonal(), run[6].covariance.diagonal()
        # the first seconds have the sigma aiding.stop_velocity_stddev
        assert (after[3:5] < 0.4**2 * before[3:5]).all()


def test_covariances_are_positive_semidefinite() -> None:
    for run in [*_drives(), *_turns()]:
        for _, covariance in run:
            sigma = np.sqrt(covariance.diagonal())
            known = np.flatnonzero(sigma)  # vertical velocity without a vertical channel and walk of height
            correlation = (covariance / np.outer(sigma, sigma).clip(1e-300))[np.ix_(known, known)]
            np.testing.assert_allclose(correlation, correlation.T, atol=1e-12)
            assert np.linalg.eigvalsh(correlation)[0] > -1e-9  # rounding
            assert len(known) == 14


# Height


def test_height_walks_and_vertical_velocity_with_it() -> None:
    s = simulate("static", 0, duration=112.0, rate=HZ)
    n = Ins(_PLACE | {"aiding.height_walk": 0.2})
    samples = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
    for stamp, sample in zip(s.stamps_ns.tolist(), samples, strict=True):
        n.add_imu(stamp, *sample)
    p = n.covariance
    assert p is not None
    # 100 s after the alignment, to the last half second
    assert p[2, 2] == pytest.approx(1.0 + 100.0 * 0.2**2, abs=0.03)
    assert p[5, 5] == pytest.approx(0.2**2)


_PLACE = {
    "initial.latitude_deg": 55.7,
    "initial.longitude_deg": 37.6,
    "initial.height": 150.0,
    "initial.heading_deg": 30.0,
    "alignment.level_duration": 12.0,
}


# The parts


def _covariance(heading: float = 0.01) -> Array:
    """A full one: random correlations."""
    rng = np.random.default_rng(1)
    sigma = np.array([1.0] * 3 + [0.1] * 3 + [1e-4, 1e-4, heading] + [1e-7] * 3 + [1e-3] * 3)
    factor = rng.standard_normal((15, 40)) / math.sqrt(40.0)
    return np.asarray(factor @ factor.T * np.outer(sigma, sigma))


def _filter(covariance: Array, **parameters: object) -> ErrorFilter:
    return filter_of(error_model(configuration({"navigation.vertical_channel": True, **parameters}), NOISE), covariance)


def test_a_filter_has_its_initial_covariance() -> None:
    p = _covariance()
    np.testing.assert_allclose(covariance_of(_filter(p)), p, rtol=1e-12)


@pytest.mark.parametrize("degrees", [5.0, 40.0, 180.0])
def test_a_filter_of_an_unknown_heading(degrees: float) -> None:
    p = _covariance(math.radians(degrees))
    back = covariance_of(_filter(p))
    # one angle, of at most the sigma of a uniform one: small ones return to the second order of the cosine
    stddev = min(math.sqrt(p[8, 8]), math.pi / math.sqrt(3.0))
    assert math.sqrt(back[8, 8]) == pytest.approx(stddev, rel=0.5 if degrees < 100.0 else 1e-9)
    keep = [i for i in range(15) if i != 8]
    np.testing.assert_allclose(back[np.ix_(keep, keep)], p[np.ix_(keep, keep)], rtol=1e-12)
    sigma = np.sqrt(back.diagonal())
    assert np.linalg.eigvalsh(back / np.outer(sigma, sigma))[0] > 0.0


def test_noise_of_the_parameters_precedes_learnt_noise() -> None:
    given: dict[str, object] = {"imu.gyro_noise_deg_per_sqrt_hour": 0.06, "imu.accel_noise_ug_per_sqrt_hz": 100.0}
    learnt, known = (error_model(configuration(v), NOISE).noise(STATE, STATE, 2.0) for v in ({}, given))
    assert learnt[6, 6] == pytest.approx(2.0 * NOISE[0] ** 2) and learnt[3, 3] == pytest.approx(2.0 * NOISE[1] ** 2)
    assert known[6, 6] == pytest.approx(2.0 * math.radians(1e-3) ** 2)
    assert known[3, 3] == pytest.approx(2.0 * (100e-6 * 9.80665) ** 2)


def _begun(
    covariance: Array | None = None, condition: ImuCondition | None = None, **parameters: object
) -> CovariancePropagation:
    known = configuration({"navigation.vertical_channel": True, **parameters})
    accuracy = CovariancePropagation(known, condition or ImuCondition(np.eye(3)))
    accuracy.begin(0, STATE, _covariance() if covariance is None else covariance, NOISE)
    return accuracy


def _standing(seconds: float) -> ReplayBuffer:
    samples = StampedRows(SAMPLE_SIZE)
    history = ReplayBuffer(samples, False, True)
    for i in range(round(seconds * 50.0) + 1):
        samples.append(i * NS // 50, (0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8))
        if i == 0:
            history.begin(STATE)
    history.between(0, seconds * NS).states[:] = STATE
    return history


def _gone_on(accuracy: CovariancePropagation, seconds: float) -> CovariancePropagation:
    for i in range(1, round(seconds * 50.0) + 1):
        accuracy.advance(i * NS // 50, STATE)
    return accuracy


def test_a_correction_of_the_past_is_propagated_to_the_present() -> None:
    """As if it had been applied at its stamp, independent of the propagation before."""
    late, given = _gone_on(_begun(), 6.0), 0.25 * _covariance()
    late.rewind(3 * NS, STATE)
    late.replace(given)
    late.catch_up(STATE, _standing(6.0))
    once = _filter(given)
    once.propagate(STATE, STATE, 3.0)
    np.testing.assert_allclose(late.covariance, covariance_of(once), rtol=1e-3, atol=1e-18)


def test_a_correction_that_replaces_another_leaves_no_trace_of_it() -> None:
    """The second is of an earlier stamp: the covariance between them comes from the second alone."""
    history, given = _standing(6.0), 0.25 * _covariance()
    once, twice = _gone_on(_begun(), 6.0), _gone_on(_begun(), 6.0)
    twice.rewind(4 * NS, STATE)
    twice.replace(1e-2 * _covariance())
    twice.catch_up(STATE, history)
    assert twice.covariance[3, 3] < 0.1 * once.covariance[3, 3]
    for accuracy in (once, twice):
        accuracy.rewind(3 * NS, STATE)
        accuracy.replace(given)
        accuracy.catch_up(STATE, history)
    np.testing.assert_array_equal(twice.covariance, once.covariance)


def test_a_rewind_without_a_correction_changes_nothing() -> None:
    plain, rewound = _gone_on(_begun(), 6.0), _gone_on(_begun(), 6.0)
    rewound.rewind(4 * NS, STATE)
    rewound.catch_up(STATE, _standing(6.0))
    # the steps of the propagation end elsewhere
    np.testing.assert_allclose(rewound.covariance, plain.covariance, rtol=1e-6, atol=1e-20)


def test_samples_that_turn_out_to_hide_errors() -> None:
    """Known late, as if known at the time; a correction since then contains them."""
    hidden = HiddenErrors(2 * NS, 4 * NS, np.array([0.0, 0.0, 1e-8]), np.array([1e-4, 0.0, 0.0]))
    conditions = [ImuCondition(np.eye(3)) for _ in range(3)]
    late, known, corrected = (_begun(condition=condition) for condition in conditions)
    conditions[1].add(hidden)
    late, known = _gone_on(late, 5.0), _gone_on(known, 5.0)
    plain = late.covariance
    conditions[0].add(hidden)
    late.renew(_standing(5.0))
    assert late.hidden == 1
    np.testing.assert_allclose(late.covariance, known.covariance, rtol=1e-3, atol=1e-18)
    grown = late.covariance - plain
    assert grown[8, 8] == pytest.approx(2e-8, rel=0.01) and grown[3, 3] == pytest.approx(2e-4, rel=0.01)
    corrected = _gone_on(corrected, 5.0)
    corrected.rewind(4 * NS, STATE)
    corrected.replace(_covariance())
    corrected.catch_up(STATE, _standing(5.0))
    before = corrected.covariance
    conditions[2].add(hidden)
    corrected.renew(_standing(5.0))
    np.testing.assert_allclose(corrected.covariance, before, rtol=1e-6, atol=1e-20)


def test_noise_learnt_too_large_is_unlearnt() -> None:
    condition = ImuCondition(np.eye(3))
    accuracy = _begun(condition=condition)
    condition.noise_limits = 0.5 * NOISE[0], 1e-3 * NOISE[1]
    _gone_on(accuracy, 1.0)
    assert accuracy.white_noise == pytest.approx((math.sqrt(0.5) * NOISE[0], math.sqrt(20.0) * 1e-3 * NOISE[1]))
    condition.noise_limits = math.inf, math.inf
    _gone_on(accuracy, 2.0)
    assert accuracy.white_noise[0] < NOISE[0]


def test_a_correction_with_an_unknown_heading_opens_it() -> None:
    """Its sigma stays that of an angle, large or small before."""
    accuracy = _gone_on(_begun(), 6.0)
    accuracy.rewind(3 * NS, STATE)
    accuracy.replace(_covariance(math.radians(180.0)))
    accuracy.catch_up(STATE, _standing(6.0))
    assert math.sqrt(accuracy.covariance[8, 8]) == pytest.approx(math.pi / math.sqrt(3.0))
    accuracy.rewind(5 * NS, STATE)
    accuracy.replace(_covariance(math.radians(0.1)))
    accuracy.catch_up(STATE, _standing(6.0))
    assert math.sqrt(accuracy.covariance[8, 8]) == pytest.approx(
        math.sqrt(_covariance(math.radians(0.1))[8, 8]), rel=1e-4
    )  # a second of correlated drift


def test_steps_are_short_where_the_body_turns() -> None:
    def changes(rate: float) -> int:
        accuracy = _begun()
        before = accuracy.count
        for i in range(1, 501):
            half = 0.5 * rate * i / 50.0
            accuracy.advance(i * NS // 50, (0.0, 0.0, math.sin(half), math.cos(half), *STATE[4:]))
        return accuracy.count - before

    assert changes(0.0) == changes(0.1) == 20
    assert changes(2.0) == 100
