"""A stop analysed: the drifts of the ZUPT paper's run, standing, rocking, turned between, and with noise."""

import functools
import itertools
import math

import numpy as np
import pytest
from rocking_base import Rocking, first_attitude, rocking_base
from scipy import stats
from scipy.spatial.transform import Rotation

from ins_nav.mechanization.earth import RATE
from ins_nav.mechanization.nav_state import initial_state
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.zupt.stationary_rates import StationaryRates, StationaryRatesResult
from ins_nav.zupt.zupt_equations import StopMeasurement, ZuptError, zupt1, zupt1_linear, zupt1_nonlinear, zupt2

Array = np.ndarray

LAT_DEG, HEADING_DEG, HZ = 60.0, 45.0, 200.0
START, END = 40.0, 200.0
DRIFT = np.array([1e-7, -1e-7, 1e-7])
"""rad/s; all as in the paper."""
K = RATE * math.cos(math.radians(LAT_DEG))
ARC_SECOND = math.radians(1.0 / 3600.0)
GYRO_NOISE, ACCEL_NOISE = math.radians(0.001) / 60.0, 10e-6 * 9.80665
"""0.001 °/√h in rad/√s, 10 µg/√Hz in m/s²/√Hz."""
TURNING = 20.0
"""How long the turn between two stops takes, s."""


@functools.cache
def _run(scenario: str = "static", **parameters: float) -> Simulation:
    paper = {"lat_deg": LAT_DEG, "heading_deg": HEADING_DEG, "duration": END, "rate": HZ, "height": 0.0}
    return simulate(scenario, 0, **{**paper, **parameters}, **{"imu.preset": "perfect"})


def _rocking(amplitude_deg: float, period: float) -> Simulation:
    amplitudes = {"roll_amplitude_deg": amplitude_deg, "pitch_amplitude_deg": amplitude_deg}
    return _run("rocking", rocking_time=2.0 * END, period=period, **amplitudes)


def _rest(
    s: Simulation, azimuth: float = 0.0, noise: np.random.Generator | None = None, end: float = END
) -> StationaryRates:
    """Rest from START to ``end``, on axes S turned clockwise by ``azimuth`` from the true ones."""
    tr, hz = s.trajectory, s.parameters["rate"]
    first, last = round(START * hz), round(end * hz)
    gyro, accel = s.angular_velocity + DRIFT, s.linear_acceleration
    if noise is not None:
        gyro = gyro + GYRO_NOISE * math.sqrt(hz) * noise.standard_normal(gyro.shape)
        accel = accel + ACCEL_NOISE * math.sqrt(hz) * noise.standard_normal(accel.shape)
    samples = np.c_[np.full(len(gyro), 1.0 / hz), gyro, accel][first - 1 : last].tolist()
    q = (Rotation.from_euler("z", azimuth) * Rotation.from_quat(tr.q_nb[first])).as_quat()
    rest = StationaryRates(
        initial_state(float(tr.lat[first]), float(tr.lon[first]), 0.0, (0.0, 0.0, 0.0), tuple(q.tolist()))
    )
    for previous, sample in itertools.pairwise(samples):
        rest.add(previous, sample, False)
    return rest


def _two_rests(
    stops: tuple[Simulation, Simulation], azimuth: float, noise: np.random.Generator | None = None
) -> tuple[StationaryRatesResult, StationaryRatesResult, StopMeasurement, float]:
    """Rests before and after a turn; the first's measurement seen from the present; the azimuth of S then.

    S is turned by the drift about the vertical all the time; in the turn, about the vertical, that is the third.
    """
    one = _rest(stops[0], azimuth, noise).result()
    length = END - START + TURNING
    two = _rest(stops[1], azimuth + DRIFT[2] * length, noise).result()
    m = one.measurement
    gain = m.azimuth_gain + [0.0, 0.0, TURNING] + two.measurement.azimuth_gain
    present = azimuth + DRIFT[2] * length + float(two.measurement.azimuth_gain @ DRIFT)
    return one, two, StopMeasurement(m.rot_sb, m.rate, m.covariance, m.horizontal_rate, gain), present


def _self_aligned() -> float:
    """Azimuth left by a self-alignment at heading 45°: the east drift is taken for the Earth's rate, (2)."""
    yaw = math.radians(90.0 - HEADING_DEG)
    east = DRIFT[0] * math.cos(yaw) - DRIFT[1] * math.sin(yaw)
    return math.asin(east / K)


def test_zupt2_in_the_papers_run() -> None:
    s = _run()
    result = _rest(s).result()
    found = zupt2(result.measurement)
    np.testing.assert_allclose(found.drift, DRIFT, rtol=1e-3)  # required; 4e-8 measured
    assert result.rocking < 1e-6
    assert result.measurement.horizontal_rate == pytest.approx(K)
    error = (Rotation.from_quat(result.q_gb) * Rotation.from_quat(s.trajectory.q_nb[-1]).inv()).as_rotvec()
    # level by gravity, though drift has turned the gyros by 3 arc seconds; yaw has run off by the drift
    np.testing.assert_allclose(error, [0.0, 0.0, DRIFT[2] * (END - START)], atol=0.05 * ARC_SECOND)


@pytest.mark.parametrize("rate", [25.0, 123.0])
def test_rates_whose_samples_do_not_fill_half_a_second(rate: float) -> None:
    # blocks differ in length: with the mean length for all, the Earth's turn by 6e-5 rad/s passes for drift
    found = zupt2(_rest(_run(rate=rate)).result().measurement)
    np.testing.assert_allclose(found.drift, DRIFT, rtol=1e-3)  # as required at 200 Hz


@pytest.mark.parametrize("rocking_deg", [1.0, 3.0, 5.0])
@pytest.mark.parametrize("period", [5.0, 11.0])
def test_zupt2_rocking(rocking_deg: float, period: float) -> None:
    result = _rest(_rocking(rocking_deg, period)).result()
    np.testing.assert_allclose(zupt2(result.measurement).drift, DRIFT, rtol=5e-3)  # required; 5e-4 measured at most
    # roll and pitch a quarter of a period apart: the tilt's size is the amplitude all the time, to 2nd order
    assert math.degrees(result.rocking) == pytest.approx(rocking_deg, rel=0.01)


@pytest.mark.parametrize(("turn_deg", "height"), [(90.0, 0.0), (180.0, 0.0), (90.0, 500.0)])
def test_zupt1_after_a_self_alignment_and_a_turn(turn_deg: float, height: float) -> None:
    # at 500 m gravity is off the ellipsoid's normal by 4e-7 rad: 3e-11 rad/s, far beyond sigma without noise
    stops = _run(height=height), _run(height=height, heading_deg=HEADING_DEG + turn_deg)
    one, two, first, present = _two_rests(stops, _self_aligned())
    assert abs(one.measurement.rate[0]) < 1e-3 * DRIFT[0]  # the premise: absorbed by the azimuth
    for method in (zupt1, zupt1_linear):
        found = method(first, two.measurement)
        np.testing.assert_allclose(found.drift, DRIFT, rtol=5e-3)  # required
        assert found.azimuth == pytest.approx(present, abs=2.0 * ARC_SECOND)  # required


def test_nonlinear_zupt1_with_a_tilted_second_position() -> None:
    _, two, first, present = _two_rests(
        (_run(), _run(heading_deg=HEADING_DEG + 120.0, pitch_deg=-40.0)), _self_aligned()
    )
    found = zupt1_nonlinear(first, two.measurement)
    np.testing.assert_allclose(found.drift, DRIFT, rtol=1e-2)  # required
    # an error of 1 % of one drift, 1e-9 rad/s, is this much of the Earth's horizontal rate
    assert found.azimuth == pytest.approx(present, abs=0.01 * DRIFT[0] / K)


def test_errors_with_noise_are_as_the_covariances_say() -> None:
    # as good a test at 50 Hz as at 200: the densities of the noise are the same
    stops = _run(rate=50.0), _run(rate=50.0, heading_deg=HEADING_DEG + 180.0)
    zupt2_errors, zupt1_squares = [], []
    for seed in range(10):
        one, two, first, present = _two_rests(stops, 0.0, np.random.default_rng(seed))
        for rest in (one, two):
            by_one = zupt2(rest.measurement)
            zupt2_errors.append((by_one.drift - DRIFT) / np.sqrt(np.diag(by_one.covariance)[:3]))
        found = zupt1(first, two.measurement)
        error = np.array([*(found.drift - DRIFT), found.azimuth - present])
        zupt1_squares.append(error @ np.linalg.solve(found.covariance, error))
    # 20 seeds of noise: sums of squares of normal deviates, but for once in 1000 times
    for total, count in ((np.sum(np.square(zupt2_errors)), 60), (np.sum(zupt1_squares), 40)):
        low, high = stats.chi2.ppf([0.0005, 0.9995], count)
        assert low < total < high


def test_a_stop_too_short_is_refused() -> None:
    with pytest.raises(ZuptError, match=r"stop too short: 2\.0 s of at least 6 s; stand still"):
        _rest(_run(), end=START + 2.0).result()


@pytest.mark.parametrize("apart", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("start", [0.0, 0.5])
@pytest.mark.parametrize("period", [5.0, 11.0])
def test_a_short_stop_on_a_rocking_base(period: float, start: float, apart: float) -> None:
    """60 s are not whole periods: rate and attitude must be means with the same weights."""
    duration, rate = 62.0, 50.0
    samples = rocking_base(Rocking(5.0, period, apart, start), DRIFT, duration, rate)
    rows = np.column_stack([np.full(len(samples), 1.0 / rate), samples]).tolist()
    q = Rotation.from_euler("ZYX", first_attitude(Rocking(5.0, period, apart, start), rate)).as_quat()
    rest = StationaryRates(initial_state(math.radians(60.0), 0.5, 0.0, (0.0, 0.0, 0.0), tuple(q.tolist())))
    for previous, sample in itertools.pairwise(rows):
        rest.add(previous, sample, False)
    m = rest.result().measurement
    off = m.rate - m.rot_sb @ DRIFT
    # 1e-10 is the error of the model; 8e-10 with a plain mean of attitude
    assert abs(off[2]) < 3e-10
    np.testing.assert_array_less(np.abs(off), 3.0 * np.sqrt(np.diag(m.covariance) + 1e-20))
