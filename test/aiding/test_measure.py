"""Aids: zero innovation at the truth, Jacobians against differences, any heading, own states."""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.aiding.acoustic_range import AcousticRange, RangeParameters
from ins_nav.aiding.base import Aid, Observation, OwnStates
from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.depth import Depth, DepthParameters
from ins_nav.aiding.gnss import Gnss, GnssParameters, GnssReceiver
from ins_nav.aiding.gnss_velocity import GnssVelocity, GnssVelocityParameters
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.estimation.error_model import Array, ErrorModel, Vector
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.state_layout import COSINE, GYRO_BIAS, HEADING, POSITION, SIZE
from ins_nav.mechanization import earth, nav_state
from ins_nav.simulation.motion import Motion, constant, sinusoid
from ins_nav.simulation.trajectory import EarthMotion, Origin
from ins_nav.zupt.measurements import ResidualRate, ZeroVelocity
from ins_nav.zupt.zupt_equations import StopMeasurement

ZERO = (0.0, 0.0, 0.0)
ARM = (2.0, -1.0, 3.0)
RPY = (0.1, -0.2, 0.7)
COVARIANCE = np.diag([1.0, 4.0, 9.0])
MODEL = ErrorModel(vertical=True, gyro_noise=0.0, accel_noise=0.0)
LAT, LON = 0.97, 0.6
BEACON = (LAT + 3e-5, LON - 2e-5, -80.0)

Measure = Callable[[Solution, Array], Measurement | None]
"""Measurement of a solution with own states in use."""


def of(aid: Aid[Any], *value: float, covariance: Array = COVARIANCE) -> Measure:
    """The measurement of an aid that reads a value; of one number the variance is the first."""
    size = len(value)

    def measure(solution: Solution, own: Array) -> Measurement | None:
        states = OwnStates(np.asarray(own), np.zeros((len(own), len(own))))
        return aid.measure(solution, states, Observation(0, aid.name, value, covariance[:size, :size]))

    return measure


def measuring_fix(arm: Vector) -> Gnss:
    return Gnss(GnssParameters(lever_arm=arm))


def a_range(beacon: tuple[float, float, float] = BEACON, arm: Vector = ARM) -> AcousticRange:
    return AcousticRange(RangeParameters(lever_arm=arm, two_way=True), Beacon(beacon, 0.0), "a")


def a_log(arm: Vector = ARM, **parameters: Any) -> VelocityLog:
    return VelocityLog(LogParameters(lever_arm=arm, **parameters))


def measuring() -> dict[str, tuple[Measure, int]]:
    """Every aid with a value it may read, and how many states of its own it has."""
    position, slow = (Gnss(GnssParameters(lever_arm=ARM, slow_stddev=sigma)) for sigma in (0.0, 1.0))
    fix, reading = (LAT + 1e-6, LON - 1e-6, 31.0), (8.0, 1.0, 0.5)
    return {
        "gnss position": (of(position, *fix), 0),
        "gnss position that wanders": (of(slow, *fix), 3),
        "gnss velocity": (of(GnssVelocity(GnssVelocityParameters(lever_arm=ARM)), 4.0, 7.0, 0.3), 0),
        "depth": (of(Depth(DepthParameters(lever_arm=ARM, surface_height=12.0, surface_stddev=1.0)), -15.0), 1),
        "log": (of(a_log(mounting_rpy=RPY), *reading), 3),
        "log, one axis": (of(a_log(mounting_rpy=RPY), 8.0, math.nan, math.nan), 3),
        "log through water": (of(a_log(mounting_rpy=RPY, water_track=True), *reading), 5),
        "log that wanders": (of(a_log(mounting_rpy=RPY, water_track=True, slow_stddev=0.1), *reading), 8),
        "range": (of(a_range(), 250.0), 2),
        "zero velocity": (lambda s, own: ZeroVelocity().measure(s, 0.01), 0),
    }


NAMES = list(measuring())
RAW_RATE = np.array([0.3, -0.2, 0.5])
OWN = np.array([0.02, -0.03, 0.05, 0.4, -0.7, 0.3, -0.2, 0.1])


def state_at() -> nav_state.NavState:
    """Under way and heeling; n turned from east-north-up by 0.4 rad."""
    q = tuple(Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_quat())
    state = nav_state.initial_state(LAT, LON, 30.0, (6.0, 5.0, 0.4), q)
    q_en = Rotation.from_quat(state[7:11]) * Rotation.from_rotvec([0.0, 0.0, 0.4])
    return (*state[:7], *map(float, q_en.as_quat()), state[11])


def where_it_measures(name: str) -> nav_state.NavState:
    state = state_at()
    return state if name != "zero velocity" else (*state[:4], *ZERO, *state[7:])


def seen(aid: Measure, state: nav_state.NavState, gyro_bias: Vector, own: Array) -> Measurement:
    rate = tuple((RAW_RATE - gyro_bias).tolist())
    measurement = aid(Solution(state, rate, gyro_bias, True, 0.0), own)
    assert measurement is not None
    return measurement


STEPS = np.array([1.0] * 3 + [0.1] * 3 + [1e-4] * 3 + [1e-4] * 3 + [1e-3] * 3)


@pytest.mark.parametrize("name", NAMES)
def test_jacobian(name: str) -> None:
    """Columns against central differences through `ErrorModel.apply`."""
    aid, count = measuring()[name]
    here = where_it_measures(name)
    own = OWN[:count]
    measurement = seen(aid, here, ZERO, own)
    numerical = np.zeros((len(measurement.innovation), SIZE - 1))
    for i, step in enumerate(STEPS):
        z = []
        for sign in (-1.0, 1.0):
            x = np.zeros(SIZE)
            x[i] = sign * step
            state, gyro_bias, _ = MODEL.apply(x, here, ZERO, ZERO)
            z.append(seen(aid, state, gyro_bias, own).innovation)
        numerical[:, i] = (z[0] - z[1]) / (2.0 * step)
    # left out: the turn of east and north with position, 2e-6 1/s at 8 m/s, and that of Earth's rate over an arm of
    # 4 m with attitude, 3e-4 m/s a radian; the range over 250 m is curved, the steps' square over that
    np.testing.assert_allclose(measurement.h[:, :COSINE], numerical, atol=5e-4, rtol=1e-6)
    np.testing.assert_allclose(measurement.h[:, :3], numerical[:, :3], atol=2e-5)
    assert (measurement.own is None) == (count == 0)
    for i in range(count):
        change = np.eye(count)[i] * 1e-4
        z = [seen(aid, here, ZERO, own + sign * change).innovation for sign in (-1.0, 1.0)]
        assert measurement.own is not None
        np.testing.assert_allclose(measurement.own[:, i], (z[1] - z[0]) / 2e-4, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "range"])
@pytest.mark.parametrize("gamma", [1.0, -2.5, math.pi])
def test_any_heading_error_is_linear(name: str, gamma: float) -> None:
    """Sine and cosine columns: not a first approximation, but what a turn by any angle changes."""
    aid, count = measuring()[name]
    here = where_it_measures(name)
    x = np.zeros(SIZE)
    x[HEADING], x[COSINE] = math.sin(gamma), 1.0 - math.cos(gamma)
    state, *_ = MODEL.apply(x, here, ZERO, ZERO)
    before, after = (seen(aid, s, ZERO, OWN[:count]) for s in (here, state))
    # Earth's rate over an arm of 4 m: 3e-4 m/s
    np.testing.assert_allclose(before.innovation - after.innovation, before.h @ x, atol=6e-4)


def test_range_with_any_heading() -> None:
    """The arm's turn over 240 m is not linear: d²/2r, 6 m of it make 0.1 m."""
    aid, count = measuring()["range"]
    x = np.zeros(SIZE)
    x[HEADING], x[COSINE] = math.sin(2.0), 1.0 - math.cos(2.0)
    state, *_ = MODEL.apply(x, state_at(), ZERO, ZERO)
    before, after = (seen(aid, s, ZERO, OWN[:count]) for s in (state_at(), state))
    np.testing.assert_allclose(before.innovation - after.innovation, before.h @ x, atol=0.1)


@functools.cache
def flight() -> tuple[EarthMotion, float]:
    motion = Motion(
        60.0,
        speed=constant(8.0),
        yaw=sinusoid(1.0, 20.0),
        z=sinusoid(3.0, 10.0),
        roll=sinusoid(0.2, 5.0),
        pitch=sinusoid(0.1, 7.0),
    )
    return EarthMotion(motion, Origin(LAT, LON, 30.0)), 23.4


def at(time: float) -> tuple[Solution, Array, Array]:
    """The truth as a solution, and Earth-fixed position, attitude matrix."""
    s = flight()[0].states(np.array([time]))
    state = nav_state.initial_state(s.lat[0], s.lon[0], s.height[0], tuple(s.velocity_n[0]), tuple(s.q_nb[0]))
    q_en = Rotation.from_quat(state[7:11]) * Rotation.from_rotvec([0.0, 0.0, 0.4])
    q_nb = Rotation.from_rotvec([0.0, 0.0, -0.4]) * Rotation.from_quat(state[0:4])
    velocity = Rotation.from_rotvec([0.0, 0.0, -0.4]).apply(state[4:7])
    turned = (*map(float, q_nb.as_quat()), *map(float, velocity), *map(float, q_en.as_quat()), state[11])
    rate = tuple(s.rate[0].tolist())
    return Solution(turned, rate, ZERO, True, 0.0), s.position_e[0], Rotation.from_quat(s.q_eb[0]).as_matrix()


def point(time: float) -> Array:
    """Earth-fixed position of the end of the arm."""
    _, position, rot_eb = at(time)
    return position + rot_eb @ ARM


def point_velocity(time: float) -> Array:
    """Earth-fixed, m/s; five-point difference."""
    h = 0.02
    a, b, c, d = (point(time + k * h) for k in (-2, -1, 1, 2))
    return (a - 8.0 * b + 8.0 * c - d) / (12.0 * h)


def test_truth_has_no_innovation() -> None:
    """Sensors at the end of the arm, from the simulated motion alone: positions and their differences in time."""
    motion, time = flight()
    solution, _, rot_eb = at(time)
    where = nav_state.geodetic(solution.state)
    path = motion.trajectory(100.0)
    fix = GnssReceiver(100.0, 0.0, 0.0, ARM).fixes(path, np.arange(len(path.time)), 0)
    i = round(100 * time)
    measurement = of(measuring_fix(ARM), fix.lat[i], fix.lon[i], fix.height[i])(solution, OWN[:0])
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=2e-6)  # arm²/2R

    velocity = earth.enu_axes(where.lat, where.lon).T @ point_velocity(time)
    measurement = of(GnssVelocity(GnssVelocityParameters(lever_arm=ARM)), *velocity)(solution, OWN[:0])
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)  # of the difference

    rot_sb = Rotation.from_euler("ZYX", RPY[::-1]).as_matrix().T
    x, y, z = rot_sb @ rot_eb.T @ point_velocity(time)
    scale, a_y, a_z = OWN[:3]
    reads = ((1 + scale) * x + a_y * z - a_z * y, (1 + scale) * y + a_z * x, (1 + scale) * z - a_y * x)
    measurement = of(a_log(mounting_rpy=RPY), *reads)(solution, OWN[:3])
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)

    distance = float(np.linalg.norm(point(time) - earth.geodetic_to_ecef(*BEACON)))
    measurement = of(a_range(), 1.02 * distance - 3.0)(solution, np.array([0.02, -3.0]))
    assert measurement is not None
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=1e-6)

    measurement = of(Depth(DepthParameters(lever_arm=ARM, surface_height=12.0)), 12.0 - fix.height[i])(
        solution, OWN[:0]
    )
    np.testing.assert_allclose(measurement.innovation, 0.0, atol=2e-6)


def test_standing() -> None:
    """Zero velocity is no innovation."""
    q = tuple(Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_quat())
    state = nav_state.initial_state(LAT, LON, 30.0, ZERO, q)
    solution = Solution(state, nav_state.earth_rate_body(state), ZERO, False, 0.0)
    np.testing.assert_allclose(ZeroVelocity().measure(solution, 0.01).innovation, 0.0)


@pytest.mark.parametrize("vertical", [False, True])
def test_rest_rate(vertical: bool) -> None:
    """What the equations of ZUPT make of a drift, a bias since corrected and a wrong heading is ``h x``."""
    rot_sb = Rotation.from_euler("ZYX", [0.8, 0.3, -0.2]).as_matrix()
    k, gamma = earth.RATE * math.cos(LAT), 1e-3
    drift, then, now = np.array([[1.0, -2.0, 3.0], [0.5, 0.0, 1.0], [0.8, -1.0, 2.0]]) * 1e-6
    # `ins_nav.zupt.zupt_equations`: the solution's heading is less than the true one by its azimuth error, its yaw more
    rate = rot_sb @ (drift - then) + k * np.array([-math.sin(gamma), math.cos(gamma) - 1.0, 0.0])
    stop = StopMeasurement(rot_sb, rate, COVARIANCE, k, np.zeros(3))
    solution = Solution(state_at(), ZERO, tuple(now.tolist()), False, 0.0)
    measurement = ResidualRate(vertical).measure(solution, stop, tuple(then.tolist()))
    x = np.zeros(SIZE)
    x[GYRO_BIAS], x[HEADING] = now - drift, gamma
    # the square of the heading's error: k * gamma² / 2 of some 1e-6
    np.testing.assert_allclose(measurement.innovation, measurement.h @ x, atol=k * gamma**2)
    np.testing.assert_array_equal(measurement.r, COVARIANCE[2:, 2:] if vertical else COVARIANCE)


def test_covariance_is_turned_to_n() -> None:
    """East is uncertain by 1 m, north by 2 m; n is 0.4 rad off."""
    measurement = seen(measuring()["gnss position"][0], state_at(), ZERO, OWN[:0])
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()  # n to east-north-up
    np.testing.assert_allclose(turn @ measurement.r @ turn.T, COVARIANCE, atol=1e-12)
    assert measurement.direct == POSITION


def test_velocity_that_is_no_travel_says_nothing_of_heading() -> None:
    solution = Solution(state_at(), ZERO, ZERO, False, 0.5)
    measurement = of(GnssVelocity(GnssVelocityParameters()), 4.0, 7.0, 0.3)(solution, OWN[:0])
    assert (measurement.h[:2, [HEADING, COSINE]] == 0.0).all()
    # what it may have said is noise: half of the velocity squared
    grown = np.trace(measurement.r[:2, :2]) - 5.0
    assert grown == pytest.approx(2.0 * 0.5 * (6.0**2 + 5.0**2))


def test_nothing_to_say() -> None:
    solution = Solution(state_at(), ZERO, ZERO, True, 0.0)
    assert of(a_log(ZERO), *(math.nan,) * 3)(solution, np.zeros(3)) is None
    where = nav_state.geodetic(solution.state)
    at_the_beacon = a_range((where.lat, where.lon, where.height), ZERO)
    measurement = of(at_the_beacon, 1.0)(solution, np.zeros(2))
    assert measurement is None or np.isfinite(measurement.h).all()


def test_rows() -> None:
    """Horizontal position alone, and the log's axes that are there with their own covariance."""
    solution = Solution(state_at(), ZERO, ZERO, True, 0.0)
    flat = of(measuring_fix(ZERO), LAT, LON, math.nan)(solution, OWN[:0])
    assert flat.innovation.shape == (2,) and flat.h.shape == (2, SIZE) and flat.r.shape == (2, 2)
    assert np.isfinite(flat.innovation).all()
    log = of(a_log(ZERO), 1.0, math.nan, 2.0, covariance=np.arange(9.0).reshape(3, 3))(solution, np.zeros(3))
    assert log is not None and log.own is not None
    assert log.innovation.shape == (2,) and log.own.shape == (2, 3)
    np.testing.assert_array_equal(log.r, [[0.0, 2.0], [6.0, 8.0]])


@pytest.mark.parametrize("lat_deg", [90.0, -90.0, 89.99999])
def test_pole(lat_deg: float) -> None:
    """A fix some metres away, over the pole: the innovation is those metres."""
    state = nav_state.initial_state(math.radians(lat_deg), 0.3, 5.0, ZERO, (0.0, 0.0, 0.0, 1.0))
    moved = nav_state.corrected(state, (30.0, -40.0, 7.0))
    where = nav_state.geodetic(moved)
    solution = Solution(state, ZERO, ZERO, True, 0.0)
    measurement = of(measuring_fix(ZERO), where.lat, where.lon, where.height)(solution, OWN[:0])
    np.testing.assert_allclose(measurement.innovation, [-30.0, 40.0, -7.0], atol=1e-3)
