"""Filter: consistency against simulated truth, any initial heading, gate and recovery."""

import functools
import math

import numpy as np
import pytest
from filter_harness import ACCEL_NOISE, GYRO_NOISE, RATE, ZERO, Run, bench, difference, standing
from scipy.spatial.transform import Rotation

from ins_nav.aiding.base import NO_STATES, Observation, OwnStates
from ins_nav.aiding.gnss import Gnss, GnssParameters
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import ErrorModel
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import COSINE, HEADING, POSITION, SIZE, VELOCITY
from ins_nav.mechanization import nav_state
from ins_nav.simulation.motion import Motion, Route, sinusoid
from ins_nav.simulation.trajectory import EarthMotion, Origin, Trajectory
from ins_nav.zupt.measurements import ResidualRate, ZeroVelocity
from ins_nav.zupt.zupt_equations import StopMeasurement

DEG_PER_HOUR = math.radians(1.0) / 3600.0


@functools.cache
def drive() -> Trajectory:
    """A car: stands for 10 s, then 200 s of accelerating, turning, braking."""
    route = Route(0.7)
    route.hold(10.0)
    for speed, turn in [(10.0, 1.5), (10.0, -2.5), (4.0, 1.5), (14.0, 1.5), (14.0, -1.5), (0.0, 0.0)]:
        route.reach(speed, 8.0)
        route.hold(12.0)
        route.turn(turn, 10.0)
    motion = Motion(route.time, yaw=route.yaw, speed=route.speed, roll=sinusoid(0.01, 3.0), pitch=sinusoid(0.01, 4.0))
    return EarthMotion(motion, Origin(0.97, 0.6, 10.0)).trajectory(RATE)


def nees(run: Run, second: int, states: list[int]) -> float:
    error = (run.error(second) - run.filter.x[:SIZE])[states]
    return float(error @ np.linalg.solve(run.filter.p[np.ix_(states, states)], error))


def test_paper_bench() -> None:
    """Heading at the theoretical bound after 300 s, and errors as large as their covariance."""
    errors, sizes = [], []
    for seed in range(12):
        run = Run(bench(), standing(), seed)
        for second in range(1, 301):
            run.advance(second)
            run.gnss(second)
        errors.append(math.degrees(run.heading_error_now(300)))
        sizes.append(nees(run, 300, [0, 1, 3, 4, 6, 7, 8]))
        assert math.degrees(run.filter.heading_stddev) == pytest.approx(0.31, abs=0.01)  # the bound
    # by 12 runs an RMS is known to 20 %, the mean of chi-square with 7 degrees to 1.08: 2.5 of each
    assert np.sqrt(np.mean(np.square(errors))) < 0.31 * 1.5
    assert abs(np.mean(sizes) - 7.0) < 2.7


@pytest.mark.parametrize("surge", [0.0, 1.0])
@pytest.mark.parametrize("heading_error_deg", [0.0, 90.0, 180.0])
def test_any_initial_heading(heading_error_deg: float, surge: float) -> None:
    """Initial heading 100°; a base that rocks, and one that also surges by 1 m, more than the noise of GNSS."""
    for seed in range(2):
        start = {"stddev": (1.0, 0.3, math.radians(0.3)), "heading_stddev": math.radians(100.0)}
        run = Run(bench(surge), standing(), seed, heading_error=math.radians(heading_error_deg), **start)
        for second in range(1, 251):
            run.advance(second)
            run.gnss(second)
            sigma = run.filter.heading_stddev
            if second % 50 == 0:
                assert abs(run.heading_error_now(second)) < 4.5 * sigma  # and never a wrong one with a small sigma
        assert math.degrees(sigma) < (0.5 if surge == 0.0 else 1.0)


@pytest.mark.parametrize("heading_error_deg", [0.0, 120.0, 180.0])
def test_alignment_while_driving(heading_error_deg: float) -> None:
    """Gyros of 20 deg/h do not measure the Earth: driving off observes heading, from any initial value."""
    biases = np.random.default_rng(5)
    model = ErrorModel(
        vertical=True,
        gyro_noise=math.radians(0.3) / 60.0,
        accel_noise=1.5e-3,
        gyro_bias=SlowState(20.0 * DEG_PER_HOUR, DEG_PER_HOUR / 60.0),
        accel_bias=SlowState(0.02),
    )
    run = Run(
        drive(),
        model,
        1,
        stddev=(1.0, 0.05, math.radians(0.3)),
        heading_stddev=math.radians(100.0),
        heading_error=math.radians(heading_error_deg),
        gyro_noise=math.radians(0.3) / 60.0,
        accel_noise=1.5e-3,
        gyro_bias=20.0 * DEG_PER_HOUR * biases.standard_normal(3),
        accel_bias=0.02 * biases.standard_normal(3),
    )
    for second in range(1, 101):
        run.advance(second)
        assert run.gnss(second).accepted
        sigma = math.degrees(run.filter.heading_stddev)
        if second == 9:
            assert sigma > 100.0  # at rest, sigma must not fall
        if second == 20:
            assert sigma < 5.0
            assert abs(math.degrees(run.heading_error_now(20))) < 4.0 * sigma
    assert abs(math.degrees(run.heading_error_now(100))) < 1.5  # 0.3° of sigma; a run of three sigma and more


def test_consistent_with_all_states() -> None:
    """15 states and the log's 3: squared errors over the covariance, driving, without vertical channel and with."""
    sizes = []
    for seed in range(8):
        rng = np.random.default_rng(seed + 100)
        vertical = seed % 2 == 0
        model = ErrorModel(
            vertical=vertical,
            gyro_noise=2e-5,
            accel_noise=1e-3,
            gyro_bias=SlowState(5.0 * DEG_PER_HOUR),
            accel_bias=SlowState(0.01),
        )
        log = VelocityLog(LogParameters(scale_stddev=0.02, misalignment_stddev=0.02))
        run = Run(
            drive(),
            model,
            seed,
            stddev=(1.0, 0.05, math.radians(0.2)),
            heading_stddev=math.radians(2.0),
            gyro_noise=2e-5,
            accel_noise=1e-3,
            gyro_bias=5.0 * DEG_PER_HOUR * rng.standard_normal(3),
            accel_bias=0.01 * rng.standard_normal(3),
            aids={"log": log.states},
        )
        scale, a_y, a_z = true_own = 0.02 * rng.standard_normal(3)
        for second in range(1, 181):
            run.advance(second)
            run.gnss(second)
            x, y, z = nav_state.velocity_body(run.truth(second))
            reads = np.array([(1 + scale) * x - a_z * y + a_y * z, (1 + scale) * y + a_z * x, math.nan])
            reads[:2] += 0.05 * rng.standard_normal(2)
            solution = run.filter.solution(run.state, tuple(run.previous[1:4]), run.bias[0])
            own = OwnStates(run.filter.own("log"), run.filter.own_covariance("log"))
            measurement = log.measure(solution, own, Observation(0, "log", tuple(reads), 0.0025 * np.eye(3)))
            assert measurement is not None
            run.filter.update("log", second * 10**9, measurement)
            run.feed_back()
        states = [0, 1, 3, 4, *range(6, 15)]
        error = np.r_[run.error(180)[states], (run.filter.own("log") - true_own)[[0, 2]]]
        states += [SIZE, SIZE + 2]
        sizes.append(error @ np.linalg.solve(run.filter.p[np.ix_(states, states)], error))
        assert abs(run.filter.own("log")[0] - scale) < 0.003
        assert abs(run.filter.own("log")[2] - a_z) < 0.005
    # chi-square with 15 degrees, mean of 8: 1.9 of deviation; 2.5 of these
    assert abs(np.mean(sizes) - 15.0) < 4.8


def test_height_without_vertical_channel() -> None:
    """Height is a random walk of its own: only GNSS corrects it; vertical velocity stays zero."""
    model = ErrorModel(vertical=False, gyro_noise=GYRO_NOISE, accel_noise=ACCEL_NOISE, height_walk=0.1)
    run = Run(bench(), model, 0)
    for second in range(1, 61):
        run.advance(second)
        lat, lon, height = run.path.lat[second * 100], run.path.lon[second * 100], run.path.height[second * 100]
        solution = run.filter.solution(run.state, ZERO, ZERO)
        seen = Observation(0, "gnss", (lat, lon, height + 30.0), np.eye(3))
        measurement = Gnss(GnssParameters()).measure(solution, NO_STATES, seen)
        run.filter.update("gnss", second * 10**9, measurement, gate=1e-300)
        run.feed_back()
        assert run.state[6] == 0.0
    assert run.state[11] == pytest.approx(40.0, abs=0.05)  # 0.9 to the 60th of 30 m
    # steady state of a walk of 0.1 m/√s under 1 m at 1 Hz: P = q/2 + sqrt(q²/4 + q r), less r's share
    assert run.filter.p[2, 2] == pytest.approx(0.095, abs=0.003)
    assert run.filter.p[5, 5] == 0.0


@pytest.mark.parametrize("gamma", [0.3, 3.0])
def test_feedback_transforms_the_covariance(gamma: float) -> None:
    """Draws of the true errors around an estimate; after feedback their spread is the covariance."""
    rng = np.random.default_rng(0)
    model = ErrorModel(vertical=True, gyro_noise=0.0, accel_noise=0.0)
    flt = ErrorFilter(model, (3.0,) * 3, (0.1,) * 3, np.diag([1e-6, 4e-6, 1.0]))
    root = rng.standard_normal((9, 9)) * np.array([[1.0] * 3 + [0.1] * 3 + [1e-3] * 2 + [0.05]]).T
    p = np.zeros((SIZE, SIZE))
    p[:9, :9] = root @ root.T
    x = np.zeros(SIZE)
    x[:8] = [1.0, 2.0, 3.0, 0.3, -0.2, 0.1, 1e-3, 2e-3]
    along = np.array([math.cos(gamma), math.sin(gamma)])  # of (sine, cosine), for a change of the angle
    to_states = np.eye(SIZE)
    to_states[[HEADING, COSINE], HEADING] = along
    p = to_states @ p @ to_states.T
    x[HEADING], x[COSINE] = math.sin(gamma), 1.0 - math.cos(gamma)
    flt.p, flt.x = p, x
    computed = nav_state.initial_state(0.7, 0.2, 10.0, (5.0, 3.0, 0.0), (0.02, -0.05, 0.3, math.sqrt(0.9071)))
    fed, *_ = flt.feed_back(computed, ZERO, ZERO)
    found = []
    for draw in rng.multivariate_normal(np.zeros(9), root @ root.T, 2000):
        error = x.copy()
        error[:8] += draw[:8]
        error[HEADING], error[COSINE] = math.sin(gamma + draw[8]), 1.0 - math.cos(gamma + draw[8])
        found.append(difference(fed, model.apply(error, computed, ZERO, ZERO)[0])[:9])
    sigma = np.sqrt(np.diag(flt.p)[:9])
    spread = np.cov(np.array(found).T) / np.outer(sigma, sigma)
    # by 2000 draws correlations are known to 0.03; heading's square, 0.15² / 2, adds a little
    np.testing.assert_allclose(spread, flt.p[:9, :9] / np.outer(sigma, sigma), atol=0.1)


def test_heading_opens_and_closes() -> None:
    """Sine and cosine are states from 6° of heading error on, and one angle again below 3°."""
    run = Run(bench(), standing(), 0, heading_stddev=math.radians(2.0))
    assert run.filter.p[COSINE, COSINE] == 0.0
    p = run.filter.p.copy()
    p[HEADING, HEADING] = 1.0
    run.filter.p = p
    run.advance(1)
    assert run.filter.x[COSINE] == pytest.approx(1.0 - math.exp(-0.5), rel=1e-6)
    assert run.filter.p[COSINE, COSINE] > 0.1
    assert run.filter.turn == pytest.approx(2.0 * run.filter.x[COSINE], rel=1e-6)  # E|1 - R|² of a unit vector
    h = np.zeros((1, SIZE))
    h[0, HEADING] = 1.0
    run.filter.update("heading", 0, Measurement(np.array([0.0]), h, np.array([[1e-4]]), slice(HEADING, HEADING + 1)))
    run.feed_back()
    assert run.filter.p[COSINE, COSINE] == run.filter.x[COSINE] == 0.0
    assert run.filter.heading_stddev == pytest.approx(0.01, rel=0.05)


def test_covariance_stays_positive() -> None:
    """From 1000 km to a millimetre in one update and back, hours of propagation, rows as of every aid."""
    rng = np.random.default_rng(1)
    model = ErrorModel(
        vertical=True, gyro_noise=1e-7, accel_noise=1e-6, gyro_bias=SlowState(1e-7), accel_bias=SlowState(1e-4, 1e-8)
    )
    flt = ErrorFilter(model, (1e6,) * 3, (1e3,) * 3, np.diag([1e-2, 1e-2, 3.0]), {"own": (SlowState(1.0),)})
    state = nav_state.initial_state(0.7, 0.2, 10.0, (100.0, 30.0, 0.0), (0.02, -0.05, 0.3, math.sqrt(0.9071)))
    for i in range(2000):
        flt.propagate(state, state, 1.0)
        size = int(rng.integers(1, 4))
        h = np.zeros((size, SIZE))
        block = rng.choice([POSITION, VELOCITY])
        h[:, block] = rng.standard_normal((size, 3))
        r = 1e-6 * np.eye(size)
        own = rng.standard_normal((size, 1))
        flt.update("own", i * 10**9, Measurement(np.zeros(size), h, r, block, own))
        state, *_ = flt.feed_back(state, ZERO, ZERO)
        assert (flt.p == flt.p.T).all()
        sigma = np.sqrt(np.diag(flt.p))
        used = sigma > 0.0
        correlation = flt.p[np.ix_(used, used)] / np.outer(sigma[used], sigma[used])
        # positive up to rounding in units of the deviations
        assert np.linalg.eigvalsh(correlation).min() > -1e-9


def test_biases_relax_to_their_initial_values() -> None:
    """Gauss-Markov: a correction decays with the correlation time; that of a constant stays."""
    model = standing(gyro_bias=SlowState(1e-5, 1e-7, 20.0), accel_bias=SlowState(0.1))
    own = (SlowState(1.0, 0.0, 20.0), SlowState(1.0))
    flt = ErrorFilter(model, (1.0,) * 3, (0.1,) * 3, 1e-6 * np.eye(3), {"own": own})
    state, gyro, accel = bench_state(), (1e-4, 0.0, 0.0), (0.5, 0.0, 0.0)
    flt.x = flt.x.copy()
    flt.x[[9, 12, 16, 17]] = [2e-5, 0.2, 0.3, 0.4]
    state, gyro, accel = flt.feed_back(state, gyro, accel)
    assert gyro[0] == pytest.approx(8e-5)
    for _ in range(200):
        flt.propagate(state, state, 0.1)
        _, gyro, accel = flt.feed_back(state, gyro, accel)
    assert gyro[0] == pytest.approx(1e-4 - 2e-5 * math.exp(-1.0), rel=1e-6)
    assert accel[0] == pytest.approx(0.3)
    np.testing.assert_allclose(flt.own("own"), [-0.3 * math.exp(-1.0), -0.4], rtol=1e-6)


def bench_state() -> nav_state.NavState:
    q = tuple(Rotation.from_euler("ZYX", [0.3, 0.05, -0.02]).as_quat())
    return nav_state.initial_state(0.97, 0.6, 10.0, ZERO, q)


def test_drift_from_a_stop_and_standing() -> None:
    """Two aids without states: biases known, velocity zero."""
    model = standing(gyro_bias=SlowState(DEG_PER_HOUR))
    run = Run(bench(), model, 0)
    run.state = (*run.state[:4], 0.1, 0.05, 0.0, *run.state[7:])
    drift = tuple(np.array([0.3, -0.2, 0.1]) * DEG_PER_HOUR)
    stop = StopMeasurement(np.eye(3), np.array(drift), (0.01 * DEG_PER_HOUR) ** 2 * np.eye(3), 0.0, np.zeros(3))
    for aid, measure in (
        ("drift", lambda s: ResidualRate(vertical=False).measure(s, stop, ZERO)),
        ("stop", lambda s: ZeroVelocity().measure(s, 0.001)),
    ):
        assert run.filter.update(aid, 0, measure(run.filter.solution(run.state, ZERO, run.bias[0]))).accepted
        run.feed_back()
    np.testing.assert_allclose(run.bias[0], drift, rtol=0.001)
    assert np.abs(run.state[4:7]).max() < 1e-4


def _at_rest() -> ErrorFilter:
    model = ErrorModel(vertical=True, gyro_noise=GYRO_NOISE, accel_noise=ACCEL_NOISE)
    return ErrorFilter(model, (1.0,) * 3, (0.1,) * 3, np.diag([1e-4**2, 1e-4**2, 1e-2**2]))


def _stopped(speed: float, stddev: float) -> Measurement:
    state = nav_state.initial_state(0.97, 0.6, 10.0, (speed, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return ZeroVelocity().measure(_at_rest().solution(state, ZERO, ZERO), stddev)


@pytest.mark.parametrize(("speed", "widened"), [(0.1, False), (5.0, True)])
def test_admit_widens_what_a_measurement_outside_the_gate_measures(speed: float, widened: bool) -> None:
    filter_ = _at_rest()
    before, measurement = filter_.p.copy(), _stopped(speed, 0.02)
    assert filter_.admit(measurement) == widened
    rest = [i for i in range(len(before)) if not VELOCITY.start <= i < VELOCITY.stop]
    np.testing.assert_array_equal(filter_.p[np.ix_(rest, rest)], before[np.ix_(rest, rest)])
    if widened:
        # until the normalized square has its expectation, or a step of the search beyond
        assert filter_.p[VELOCITY.start, VELOCITY.start] > 5.0**2 / 3.0 / 1.1
        assert not filter_.admit(measurement)
    else:
        np.testing.assert_array_equal(filter_.p, before)
    assert filter_.update("zero velocity", 0, measurement).accepted


def test_admit_does_nothing_for_a_measurement_of_its_unit_or_not_finite() -> None:
    filter_ = _at_rest()
    before, measurement = filter_.p.copy(), _stopped(5.0, 0.02)
    assert not filter_.admit(measurement._replace(direct=None))
    assert not filter_.admit(measurement._replace(innovation=np.full(3, math.nan)))
    np.testing.assert_array_equal(filter_.p, before)
