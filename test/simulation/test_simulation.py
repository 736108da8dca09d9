"""The simulator: its truth against differences of itself, pyins and statistics; scenarios, recordings, command."""

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from ins_nav.cli.simulate import main
from ins_nav.errors import InsNavError
from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation import trajectory as trajectory_module
from ins_nav.simulation.motion import Motion, Route, Signal, constant, sinusoid, smooth_profile
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import SCENARIOS, START_NS, simulate
from ins_nav.simulation.sensors import PRESETS, GnssReceiver, ImuErrors
from ins_nav.simulation.trajectory import EarthMotion, Origin, States

DURATION = 60.0
_close = functools.partial(np.testing.assert_allclose, rtol=0)


def _boat() -> EarthMotion:
    motion = Motion(
        DURATION,
        yaw=constant(0.7) + sinusoid(0.1, 17.0),
        pitch=sinusoid(math.radians(5.0), 11.0),
        roll=sinusoid(math.radians(5.0), 11.0, math.pi / 2),
        x=sinusoid(2.0, 7.0),
        y=sinusoid(1.0, 9.0),
        z=sinusoid(3.0, 8.0),
    )
    return EarthMotion(motion, Origin(math.radians(55.7), math.radians(37.6), 150.0))


def _car(height: float = 50.0) -> EarthMotion:
    route = Route(0.3)
    route.hold(5.0)
    route.reach(15.0, 10.0)
    route.turn(1.5, 8.0)
    route.turn(-2.0, 10.0)
    route.reach(0.0, 8.0)
    speed, yaw = route.speed, route.yaw
    motion = Motion(
        DURATION,
        speed=speed,
        yaw=yaw,
        pitch=-0.01 * speed.derivative(),
        roll=0.01 * speed * yaw.derivative(),
    )
    return EarthMotion(motion, Origin(math.radians(-33.0), math.radians(179.9), height))


def _aircraft_over_the_pole() -> EarthMotion:
    half = 0.5 * DURATION * 250.0
    motion = Motion(
        DURATION,
        speed=constant(250.0),
        yaw=constant(1.2),
        x=constant(-half * math.cos(1.2) + 20.0),  # passes the pole at some 19 m
        y=constant(-half * math.sin(1.2)),
        z=sinusoid(30.0, 20.0),
        roll=sinusoid(0.3, 9.0),
    )
    return EarthMotion(motion, Origin(math.pi / 2, math.radians(30.0), 5000.0))


MOTIONS = {"boat": _boat, "car": _car, "aircraft over the pole": _aircraft_over_the_pole}


@pytest.fixture(params=list(MOTIONS))
def on_earth(request: pytest.FixtureRequest) -> EarthMotion:
    return MOTIONS[request.param]()


_GRID = np.linspace(1.0, DURATION - 1.0, 150) + 0.00123
_KINKS = np.array([5.0, 15.0, 23.0, 33.0, 41.0])  # of the car, in high derivatives: no stencil across them
TIMES = _GRID[np.abs(_GRID[:, None] - _KINKS).min(axis=1) > 0.21]
STEP = 0.05
STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}  # central difference of 8th order


def _difference(on_earth: EarthMotion, name: str) -> np.ndarray:
    shifted = {j: getattr(on_earth.states(TIMES + j * STEP), name) for k in STENCIL for j in (k, -k)}
    return sum(c * (shifted[j] - shifted[-j]) for j, c in STENCIL.items()) / STEP


def _gravity_e(s: States) -> np.ndarray:
    axes = np.stack([earth.enu_axes(lat, lon) for lat, lon in zip(s.lat, s.lon, strict=True)])
    north = earth.NORTH_GRAVITY_PER_METRE * s.height * np.sin(2.0 * s.lat)
    return north[:, None] * axes[:, :, 1] - earth.normal_gravity(np.sin(s.lat), s.height)[:, None] * axes[:, :, 2]


@pytest.mark.parametrize(
    "signal",
    [
        sinusoid(2.0, 7.0, 0.3),
        smooth_profile(1.0, [(2.0, 10.0, 5.0), (15.0, 10.0, -3.0)]),
        smooth_profile(1.0, [(0.0, 30.0, 0.0)]) * sinusoid(1.0, 9.0) + 2.0,
    ],
)
def test_derivatives_of_signals(signal: Signal) -> None:
    t = np.array([0.7, 3.3, 8.1, 17.0, 23.9])
    h = 1e-4
    for order in (0, 1, 2):
        slope = (signal(t + h, order) - signal(t - h, order)) / (2.0 * h)
        # rounding 1e-16 * 5 / h = 5e-12, truncation h²/6 * f''' < 1e-8
        _close(signal(t, order + 1), slope, atol=2e-8)


def test_profile_keeps_its_values_exactly() -> None:
    profile = smooth_profile(12.1, [(1.0, 2.0, 0.3), (3.0, 1.0, 0.0)])
    np.testing.assert_array_equal(profile(np.array([0.0, 0.99, 4.0, 1e4])), [12.1, 12.1, 0.0, 0.0])
    np.testing.assert_array_equal(profile(np.array([0.5, 4.0, 1e4]), 1), 0.0)
    with pytest.raises(ValueError, match="start after 3"):
        smooth_profile(0.0, [(1.0, 2.0, 1.0), (2.9, 1.0, 2.0)])


def test_path_is_the_integral_of_speed_and_direction() -> None:
    car = _car().motion
    route_speed, yaw = car._speed, car._angles[0]
    assert route_speed is not None
    for t in (12.3, 33.333, 59.9):
        x, y = car.sample(np.array([t])).position[:2, 0]
        for value, part in ((x, np.cos), (y, np.sin)):
            true, _ = quad(lambda s: route_speed(s) * part(yaw(s)), 0.0, t, points=[5, 15, 23, 33, 41], epsabs=1e-11)  # noqa: B023
            assert value == pytest.approx(true, abs=1e-9)


def test_positions_agree(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    # a double resolves an Earth radius to 1e-9 m
    _close(earth.geodetic_to_ecef(s.lat, s.lon, s.height), s.position_e, atol=5e-9)


def test_velocity_is_the_change_of_position(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    # rounding of positions: 1e-9 m / 0.05 s, a few times
    _close(_difference(on_earth, "position_e"), s.velocity_e, atol=2e-7)
    for k, velocity in enumerate(s.velocity_n):
        _close(earth.enu_axes(s.lat[k], s.lon[k]) @ velocity, s.velocity_e[k], atol=1e-10)


def test_specific_force_is_acceleration_less_gravity(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    coriolis = 2.0 * np.cross([0.0, 0.0, earth.RATE], s.velocity_e)
    force_e = _difference(on_earth, "velocity_e") + coriolis - _gravity_e(s)
    # the stencil's truncation at the shortest period here, 7 s: (2 pi 0.05 / 7)^8 / 630 * 1.6 m/s² = 5e-14;
    # rounding 250 m/s * 1e-16 / 0.05 s = 1e-12, a few times
    _close(Rotation.from_quat(s.q_eb).inv().apply(force_e), s.specific_force, atol=1e-10)


def test_rate_is_the_change_of_attitude(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    here = Rotation.from_quat(s.q_eb).inv()
    rate = np.zeros((len(TIMES), 3))
    for j, c in STENCIL.items():
        ahead, back = (Rotation.from_quat(on_earth.states(TIMES + k * STEP).q_eb) for k in (j, -j))
        rate += c * ((here * ahead).as_rotvec() - (here * back).as_rotvec()) / STEP
    # rounding 1e-16 / 0.05 s, truncation as above
    _close(rate + here.apply([0.0, 0.0, earth.RATE]), s.rate, atol=1e-12)


def test_attitudes_agree(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    local = Rotation.from_matrix(np.stack([earth.enu_axes(a, b) for a, b in zip(s.lat, s.lon, strict=True)]))
    error = (local * Rotation.from_quat(s.q_nb)).inv() * Rotation.from_quat(s.q_eb)
    # directions near the pole: 1e-16 of an Earth radius over 19 m
    assert error.magnitude().max() < 1e-9


def test_increments_are_integrals(on_earth: EarthMotion) -> None:
    rate = 50.0
    t = on_earth.trajectory(rate)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    for k in (0, 313, len(t.delta_theta) - 1):
        w, f = on_earth.readings((k + 0.5 + 0.5 * nodes) / rate)
        # 4 points at 50 Hz: (2 pi 0.02 / 7)^8 / 1e8 of the amplitude, next to rounding
        _close(t.delta_theta[k], weights @ w / (2.0 * rate), atol=1e-15)
        _close(t.delta_velocity[k], weights @ f / (2.0 * rate), atol=1e-14)


def test_increments_compose_to_the_attitude(on_earth: EarthMotion) -> None:
    t = on_earth.trajectory(200.0)
    theta = t.delta_theta
    turns = theta.copy()
    turns[1:] += np.cross(theta[:-1], theta[1:]) / 12.0  # two-sample coning
    steps = Rotation.from_rotvec(turns)
    attitude = Rotation.identity()
    for step in steps:
        attitude = attitude * step
    earth_turn = Rotation.from_rotvec([0.0, 0.0, earth.RATE * DURATION])
    start, end = Rotation.from_quat(t.q_eb[0]), Rotation.from_quat(t.q_eb[-1])
    error = ((start * attitude).inv() * earth_turn * end).magnitude()
    # measured 2e-11: the first interval, which has no compensation, and what two-sample coning leaves; both fall
    # with the rate (1e-13 at 1000 Hz)
    assert error < 1e-10


def test_chunks_join(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = _car().trajectory(10.0)
    for chunk in (7, 300, 600, 601):  # 600 intervals, 601 instants
        monkeypatch.setattr(trajectory_module, "_CHUNK", chunk)
        parts = _car().trajectory(10.0)
        assert len(parts.time) == 601
        # rounding may depend on the length of arrays
        _close(parts.position_e, whole.position_e, atol=5e-9)
        _close(parts.delta_velocity, whole.delta_velocity, atol=1e-14)


@pytest.mark.parametrize("lat_deg", [-90.0, -20.0, 0.0, 55.7, 90.0])
def test_at_rest_only_gravity_and_earths_rate_remain(lat_deg: float) -> None:
    height = 2000.0
    s = simulate("static", lat_deg=lat_deg, height=height, duration=1.0, roll_deg=20.0, pitch_deg=-30.0)
    t, sin_lat = s.trajectory, math.sin(math.radians(lat_deg))
    north = earth.NORTH_GRAVITY_PER_METRE * height * math.sin(2.0 * math.radians(lat_deg))
    body = Rotation.from_quat(t.q_nb)
    # rounding of sums of a few terms of 10 m/s² and 7e-5 rad/s
    expected = [0.0, -north, earth.normal_gravity(sin_lat, height)]
    _close(body.apply(t.specific_force), np.tile(expected, (201, 1)), atol=2e-14)
    expected = [0.0, earth.RATE * math.cos(math.radians(lat_deg)), earth.RATE * sin_lat]
    _close(body.apply(t.rate), np.tile(expected, (201, 1)), atol=1e-19)
    np.testing.assert_array_equal(t.velocity_n, 0.0)


def test_heading_and_tilt_have_the_signs_of_rep_103() -> None:
    t = simulate("static", duration=0.1, heading_deg=90.0, pitch_deg=10.0, roll_deg=0.0).trajectory
    x, y, _ = Rotation.from_quat(t.q_nb[0]).as_matrix().T
    _close(y, [0.0, 1.0, 0.0], atol=1e-15)  # heads east, left is north
    assert x[2] < 0.0 < x[0]  # bow down
    t = simulate("static", duration=0.1, heading_deg=0.0, roll_deg=10.0).trajectory
    assert Rotation.from_quat(t.q_nb[0]).as_matrix()[2, 1] > 0.0  # left side up


def test_pyins_navigates_to_the_same_place() -> None:
    """An integrator that is not ours, over our increments.

    At ellipsoidal height 0, where its gravity (linear in height, without north component) is ours.
    """
    pd = pytest.importorskip("pandas")
    strapdown = pytest.importorskip("pyins.strapdown")
    t = _car(height=0.0).trajectory(200.0)
    to_frd = np.array([1.0, -1.0, -1.0])
    readings = np.hstack([t.delta_theta * to_frd, t.delta_velocity * to_frd])
    imu = pd.DataFrame(
        np.vstack([readings[:1], readings]),
        index=t.time,
        columns=["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"],
    )
    yaw, pitch, roll = Rotation.from_quat(t.q_nb[0]).as_euler("ZYX", degrees=True)
    start = {
        "lat": math.degrees(t.lat[0]),
        "lon": math.degrees(t.lon[0]),
        "alt": t.height[0],
        "VN": t.velocity_n[0, 1],
        "VE": t.velocity_n[0, 0],
        "VD": -t.velocity_n[0, 2],
        "roll": roll,
        "pitch": -pitch,
        "heading": 90.0 - yaw,
    }
    result = strapdown.Integrator(pd.Series(start)).integrate(strapdown.compute_increments_from_imu(imu, "increment"))
    last = result.iloc[-1]
    place = earth.geodetic_to_ecef(math.radians(last.lat), math.radians(last.lon), last.alt)
    # what is left is pyins' own: trapezoid rule for the position at 200 Hz, its constants to 1e-12
    assert np.linalg.norm(place - t.position_e[-1]) < 1e-3
    _close([last.VE, last.VN, -last.VD], t.velocity_n[-1], atol=1e-4)
    yaw = Rotation.from_quat(t.q_nb[-1]).as_euler("ZYX", degrees=True)[0]
    assert abs((90.0 - last.heading - yaw + 180.0) % 360.0 - 180.0) < 1e-6


def _still(errors: ImuErrors, seed: int = 1, n: int = 100_000, rate: float = 100.0) -> np.ndarray:
    measured, _ = errors.gyro.measure(np.zeros((n, 3)), 1.0 / rate, seed, "gyro")
    return measured


def test_noise_averages_as_white_noise() -> None:
    density = math.radians(0.3) / 60.0
    noise = _still(ImuErrors(gyro_noise_deg_per_sqrt_hour=0.3))
    for size in (1, 10, 100):
        means = noise.reshape(-1, size, 3).mean(axis=1)
        expected = density / math.sqrt(size / 100.0)
        # 3000 independent values at least: their standard deviation is known to 1.3 %, four times that
        assert means.std() == pytest.approx(expected, rel=0.053)


def test_random_walk_grows_with_the_root_of_time() -> None:
    errors = ImuErrors(gyro_bias_random_walk_deg_per_hour_per_sqrt_hour=3.0)
    ends = np.concatenate([_still(errors, seed, n=400, rate=1.0)[[99, 399]] for seed in range(200)], axis=1)
    unit = math.radians(3.0) / 3600.0 / 60.0
    # 600 values: 3 %, four times that
    assert ends[0].std() == pytest.approx(unit * 10.0, rel=0.12)
    assert ends[1].std() == pytest.approx(unit * 20.0, rel=0.12)


def test_scale_misalignment_and_bias() -> None:
    errors = ImuErrors(
        accel_bias_ug=(100.0, 0.0, -50.0),
        accel_scale_ppm=(10.0, 20.0, 30.0),
        accel_misalignment_arcsec=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    )
    measured, bias = errors.accel.measure(np.array([[1.0, 2.0, 3.0]]), 0.01, 0, "accel")
    arcsec, micro_g = math.radians(1 / 3600), 9.80665e-6
    expected = [
        1.0 * 1.00001 + arcsec * (1 * 2.0 + 2 * 3.0) + 100 * micro_g,
        2.0 * 1.00002 + arcsec * (3 * 1.0 + 4 * 3.0),
        3.0 * 1.00003 + arcsec * (5 * 1.0 + 6 * 2.0) - 50 * micro_g,
    ]
    np.testing.assert_allclose(measured[0], expected, rtol=1e-14)
    np.testing.assert_allclose(bias, [100 * micro_g, 0.0, -50 * micro_g])


def test_quantization_loses_nothing() -> None:
    dt, step = 0.005, math.radians(1 / 3600)
    true = np.random.default_rng(0).normal(1e-5, 1e-4, (20_000, 3))  # increments well below the step
    measured, _ = ImuErrors(gyro_quantization_arcsec=1.0).gyro.measure(true, dt, 0, "gyro")
    counts = measured * dt / step
    _close(counts, np.rint(counts), atol=1e-9)
    error = np.cumsum(measured - true, axis=0) * dt
    assert np.abs(error).max() <= 0.5 * step * (1 + 1e-9)


def test_streams_are_apart() -> None:
    everything = PRESETS["tactical"]
    less = ImuErrors(gyro_noise_deg_per_sqrt_hour=0.1)
    only_noise = _still(less, n=1000)
    bias_and_noise = _still(ImuErrors(gyro_noise_deg_per_sqrt_hour=0.1, gyro_bias_stddev_deg_per_hour=1.0), n=1000)
    _close(np.diff(bias_and_noise, axis=0), np.diff(only_noise, axis=0), atol=1e-17)
    np.testing.assert_array_equal(_still(everything), _still(everything))
    assert not np.array_equal(_still(everything, seed=1), _still(everything, seed=2))
    gyro, accel = (e.measure(np.zeros((9, 3)), 1.0, 0, n)[0] for e, n in ((less.gyro, "gyro"), (less.gyro, "accel")))
    assert not np.array_equal(gyro, accel)


def test_paper_figures_of_fog_auv() -> None:
    errors = PRESETS["fog_auv"]
    assert math.degrees(errors.gyro.noise_stddev(1 / 400)) == pytest.approx(0.003)
    assert errors.accel.noise_stddev(1 / 400) == pytest.approx(0.02)
    assert math.degrees(errors.gyro.bias_stddev) * 3600 == pytest.approx(0.2)
    assert errors.accel.bias_stddev == pytest.approx(0.005)


@pytest.mark.parametrize("lat_deg", [-90.0, 0.0, 55.7, 89.99999])
def test_fixes_scatter_about_the_antenna(lat_deg: float) -> None:
    motion = Motion(2000.0, yaw=constant(0.4), roll=constant(0.3), pitch=constant(-0.2))
    t = EarthMotion(motion, Origin(math.radians(lat_deg), -2.0, 300.0)).trajectory(1.0)
    arm = (1.0, -2.0, 3.0)
    fixes = GnssReceiver(1.0, 2.0, 3.0, arm).fixes(t, START_NS + np.arange(2001) * 10**9, seed=3)
    place = earth.geodetic_to_ecef(fixes.lat, fixes.lon, fixes.height)
    error_e = place - t.position_e - Rotation.from_quat(t.q_eb).apply(arm)
    error = error_e @ earth.enu_axes(math.radians(lat_deg), -2.0)
    # 2001 fixes: mean to 0.045 m and 0.067 m, standard deviation to 1.6 %, four times that
    _close(error.mean(axis=0), 0.0, atol=0.27)
    np.testing.assert_allclose(error.std(axis=0), [2.0, 2.0, 3.0], rtol=0.064)
    assert len(fixes.stamps_ns) == 2001
    quiet = GnssReceiver(0.5, 0.0, 0.0, arm).fixes(t, START_NS + np.arange(2001) * 10**9, seed=3)
    place = earth.geodetic_to_ecef(quiet.lat, quiet.lon, quiet.height)
    expected = (t.position_e + Rotation.from_quat(t.q_eb).apply(arm))[::2]
    # offset laid on the ellipsoid to d²/2R, 14 m² / 1.3e7 m
    _close(place, expected, atol=3e-6)
    np.testing.assert_array_equal(np.diff(quiet.stamps_ns), 2 * 10**9)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_a_scenario_repeats_from_its_seed(name: str) -> None:
    noisy: dict[str, Any] = {"duration": 20.0, "imu.preset": "tactical"}
    first, second, other = (simulate(name, seed, **noisy) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.angular_velocity, second.angular_velocity)
    np.testing.assert_array_equal(first.linear_acceleration, second.linear_acceleration)
    np.testing.assert_array_equal(first.fixes.lat, second.fixes.lat)
    assert first.gyro_bias == second.gyro_bias != other.gyro_bias
    assert not np.array_equal(first.angular_velocity, other.angular_velocity)
    rate = first.parameters["rate"]
    assert first.stamps_ns[0] == START_NS + round(1e9 / rate)
    assert first.stamps_ns[-1] == START_NS + 20 * 10**9
    assert len(first.stamps_ns) == 20 * rate == len(first.angular_velocity)


def test_samplings() -> None:
    perfect: dict[str, Any] = {"imu.preset": "perfect", "duration": 5.0, "heave_amplitude": 0.3}
    averaged = simulate("rocking", **perfect)
    perfect["imu.sampling"] = "instantaneous"
    instantaneous = simulate("rocking", **perfect)
    t = averaged.trajectory
    np.testing.assert_allclose(averaged.linear_acceleration / 400.0, t.delta_velocity, rtol=1e-12)
    np.testing.assert_array_equal(instantaneous.angular_velocity, t.rate[1:])
    np.testing.assert_array_equal(instantaneous.linear_acceleration, t.specific_force[1:])


def test_rocking_rocks_and_then_stands() -> None:
    s = simulate("rocking", duration=60.0, rate=50.0, rocking_time=40.0, sway_amplitude=0.2)
    t = s.trajectory
    yaw, pitch, roll = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True).T
    # sampled every 0.02 s of 11 s: cos(pi * 0.02 / 11) of the peak; the truth turns with the carrier's place: 1e-7
    assert roll[:2000].max() == pytest.approx(5.0, rel=1e-4)
    assert pitch[:2000].min() == pytest.approx(-5.0, rel=1e-4)
    _close(yaw, 60.0, atol=1e-5)
    assert np.abs(t.velocity_n[:2000]).max() > 0.1
    np.testing.assert_array_equal(t.velocity_n[45 * 50 + 1 :], 0.0)
    _close(roll[45 * 50 + 1 :], 0.0, atol=1e-12)


def test_vehicle_drives_along_its_nose_and_stops() -> None:
    t = simulate("vehicle", rate=20.0, stand_time=30.0, duration=400.0).trajectory
    speed = np.linalg.norm(t.velocity_n, axis=1)
    assert 14.9 < speed.max() < 15.1
    standing = speed == 0.0
    assert standing[: 30 * 20].all()
    starts = np.flatnonzero(np.diff(standing.astype(int)) == 1)
    assert len(starts) == 3  # to traffic lights
    np.testing.assert_array_equal(t.velocity_n[standing], 0.0)
    np.testing.assert_allclose(np.linalg.norm(t.rate[standing], axis=1), earth.RATE, rtol=1e-12)
    body = Rotation.from_quat(t.q_nb)
    yaw, pitch, roll = body.as_euler("ZYX").T
    driving = speed > 1.0
    course = np.arctan2(t.velocity_n[driving, 1], t.velocity_n[driving, 0])
    slip = (course - yaw[driving] + math.pi) % (2.0 * math.pi) - math.pi
    assert np.abs(slip).max() < 1e-5  # the plane's scale, 1e-5 at 10 km
    assert math.radians(0.5) < np.abs(pitch).max() < math.radians(3.0)
    assert math.radians(0.5) < np.abs(roll).max() < math.radians(3.0)


def test_vehicle_shakes_when_asked_to() -> None:
    shaking: dict[str, Any] = {"engine_amplitude": 1e-4, "people_amplitude_deg": 0.05, "imu.preset": "perfect"}
    s = simulate("vehicle", duration=130.0, **shaking)
    # 1e-4 m at 25 Hz: 2.5 m/s² peak, 1.75 rms, less what averaging over 5 ms at 25 Hz takes (2.5 %)
    assert s.linear_acceleration[: 100 * 200, 2].std() == pytest.approx(1.745 * 0.975, rel=0.01)
    roll = Rotation.from_quat(s.trajectory.q_nb).as_euler("ZYX", degrees=True)[:, 2]
    assert np.abs(roll[: 100 * 200]).max() == pytest.approx(0.05, rel=1e-3)
    assert np.abs(roll[119 * 200 + 1 : 120 * 200]).max() < 1e-12


PAPER_DRIFT = [-1e-7, -1e-7, 1e-7]  # 1e-7 right, -1e-7 forward, 1e-7 up, taken to forward, left, up


@pytest.mark.parametrize(("name", "duration"), [("zupt2_stop", 600.0), ("zupt1_two_positions", 720.0)])
def test_zupt_scenarios_start_as_the_paper_does(name: str, duration: float) -> None:
    assert SCENARIOS[name].parameters["duration"].default == duration
    s = simulate(name, duration=30.0)
    assert (s.parameters["rate"], s.parameters["imu.preset"]) == (200.0, "perfect")
    t = s.trajectory
    np.testing.assert_array_equal(t.velocity_n, 0.0)
    _close([t.lat[0], t.lat[-1]], math.radians(60.0), atol=1e-15)
    # heading 45°: forward north-east, left north-west
    horizontal = earth.RATE * 0.5 * math.sqrt(0.5)
    rate = [horizontal, horizontal, earth.RATE * math.sqrt(0.75)]
    _close(t.rate, np.tile(rate, (6001, 1)), atol=1e-18)
    # averages over 5 ms of numbers of 1e-4: rounding of 1e-20 over 5e-3
    _close(s.angular_velocity, np.tile(np.add(rate, PAPER_DRIFT), (6000, 1)), atol=1e-17)
    _close(s.linear_acceleration[:, :2], 0.0, atol=1e-6)  # normal gravity leans by 1.2e-7 rad at 150 m
    np.testing.assert_allclose(s.gyro_bias, PAPER_DRIFT, rtol=1e-14)


def test_a_preset_adds_to_a_scenarios_own_errors() -> None:
    preset: dict[str, Any] = {"imu.preset": "navigation", "duration": 1.0}
    drawn = simulate("static", 3, **preset).gyro_bias
    np.testing.assert_allclose(simulate("zupt2_stop", 3, **preset).gyro_bias, np.add(drawn, PAPER_DRIFT), rtol=1e-12)
    given = simulate("zupt2_stop", duration=1.0, **{"imu.gyro_bias_deg_per_hour": (0.0, 0.0, 3.0)}).gyro_bias
    np.testing.assert_allclose(given, [0.0, 0.0, math.radians(1.0 / 1200.0)])


def test_zupt2_stop_rocks_to_its_end() -> None:
    t = simulate("zupt2_stop", duration=50.0, rate=20.0, rocking_amplitude_deg=3.0, period=5.0).trajectory
    yaw, pitch, roll = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True).T
    phase = 2.0 * math.pi * t.time / 5.0
    _close(roll, 3.0 * np.sin(phase), atol=1e-12)
    _close(pitch, 3.0 * np.cos(phase), atol=1e-12)
    _close(yaw, 45.0, atol=1e-12)
    np.testing.assert_array_equal(t.velocity_n, 0.0)


SHORT: dict[str, Any] = {"rate": 20.0, "first_stop": 30.0, "second_stop": 40.0, "duration": 190.0}
ENDS = {"first": 30 * 20, "turn": 50 * 20, "second": 90 * 20}  # samples


@pytest.mark.parametrize(("turn_deg", "radius"), [(180.0, 5.0), (-90.0, 8.0), (120.0, 0.0)])
def test_two_positions(turn_deg: float, radius: float) -> None:
    t = simulate("zupt1_two_positions", turn_deg=turn_deg, turn_radius=radius, **SHORT).trajectory
    yaw = np.unwrap(Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True)[:, 0], period=360.0)
    stops = slice(0, ENDS["first"] + 1), slice(ENDS["turn"], ENDS["second"] + 1)
    for stop in stops:
        np.testing.assert_array_equal(t.velocity_n[stop], 0.0)
        # Earth's rate alone, 7.3e-5: double precision, and rounding in where a profile ends
        np.testing.assert_allclose(np.linalg.norm(t.rate[stop], axis=1), earth.RATE, rtol=1e-12)
        # a double resolves an Earth radius to 1e-9 m
        _close(t.position_e[stop] - t.position_e[stop.start], 0.0, atol=5e-9)
    first, second = ENDS["first"], ENDS["turn"]
    assert yaw[0] == pytest.approx(45.0, abs=1e-12)
    # meridians converge: 11 m east at latitude 60° make 1.8e-4°
    assert yaw[second] - yaw[first] == pytest.approx(turn_deg, abs=3e-4)
    chord = 2.0 * radius * abs(math.sin(0.5 * math.radians(turn_deg)))
    assert np.linalg.norm(t.position_e[second] - t.position_e[first]) == pytest.approx(chord, abs=1e-4)
    assert np.linalg.norm(t.velocity_n[ENDS["second"] :], axis=1).max() > 14.0  # the city


def test_two_positions_with_a_drive_between_and_a_tilt() -> None:
    s = simulate("zupt1_two_positions", turn_radius=0.0, drive_time=15.0, tilt_deg=-40.0, **SHORT)
    t = s.trajectory
    arrives, leaves = ENDS["turn"] + 15 * 20, ENDS["second"] + 15 * 20
    np.testing.assert_array_equal(t.velocity_n[arrives : leaves + 1], 0.0)
    # 5 s up to 5 m/s, 5 s there, 5 s down; straight, south-west
    place = earth.enu_axes(t.lat[0], t.lon[0]).T @ (t.position_e[arrives] - t.position_e[0])
    _close(place[:2], [-50.0 * math.sqrt(0.5)] * 2, atol=1e-4)  # 50 m off the origin the plane bends by d²/R
    pitch = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True)[:, 1]
    _close(pitch[: ENDS["first"] + 1], 0.0, atol=1e-12)
    _close(pitch[arrives : leaves + 1], -40.0, atol=1e-12)
    assert np.abs(pitch[leaves + 10 * 20 :]).max() < 3.0  # the springs


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("rockng", {}, "did you mean rocking"),
        ("static", {"imu.gyro_bias_deg_per_our": 1}, "did you mean imu.gyro_bias_deg_per_hour"),
        ("static", {"imu.gyro_bias_deg_per_hour": 1}, "3 numbers"),
        ("static", {"imu.gyro_bias_deg_per_hour": "[1, 2]"}, "3 numbers"),
        ("static", {"imu.preset": "good"}, "one of perfect"),
        ("static", {"duration": "long"}, "'long' is not a number"),
        ("static", {"seed": 1}, "no parameter 'seed'"),
        ("static", {"duration": True}, "True is not a number"),
        ("static", {"lat_deg": 91.0}, "-90 to 90"),
        ("static", {"rate": math.nan}, "not a number"),
        ("static", {"gnss.rate": 50.0, "rate": 10.0}, "lower it"),
        ("static", {"duration": 0.1, "rate": 1.0}, "no sample"),
    ],
)
def test_wrong_parameters_are_explained(name: str, parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        simulate(name, **parameters)


def test_negative_seed_is_refused() -> None:
    with pytest.raises(InsNavError, match="seed -1"):
        simulate("static", -1, duration=1.0)


def test_a_parameter_overrides_the_preset() -> None:
    given: dict[str, Any] = {"imu.preset": "perfect", "imu.gyro_bias_deg_per_hour": "[1, 2e0, -3]", "duration": "1"}
    s = simulate("static", **given)
    np.testing.assert_allclose(np.degrees(s.gyro_bias) * 3600.0, [1.0, 2.0, -3.0])
    assert simulate("rocking", duration=1.0).errors == PRESETS["fog_auv"]
    _close(s.angular_velocity - s.trajectory.rate[1:], np.tile(s.gyro_bias, (200, 1)), atol=1e-18)


def test_recording(tmp_path: Path) -> None:
    s = simulate("rocking", 4, duration=4.0, heave_amplitude=0.5, **{"truth.rate": 100.0})
    assert write_bag(s, tmp_path / "bag") == 1600 + 5 + 3 * 400
    messages: dict[str, list[Any]] = {}
    with BagReader(tmp_path / "bag") as reader:
        counts = {name: info.count for name, info in reader.topics.items()}
        stamps = []
        for raw in reader.messages():
            stamps.append(raw.stamp_ns)
            msg = reader.deserialize(raw)
            assert msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec == raw.stamp_ns
            messages.setdefault(raw.topic, []).append(msg)
    assert counts == {
        "/imu/data_raw": 1600,
        "/gnss/fix": 5,
        "/truth/odometry": 400,
        "/truth/imu": 400,
        "/truth/fix": 400,
    }
    assert stamps == sorted(stamps)
    t = s.trajectory

    imu = messages["/imu/data_raw"]
    assert imu[0].header.frame_id == "imu_link"
    assert imu[0].orientation_covariance[0] == -1.0
    assert imu[0].angular_velocity_covariance[0] == pytest.approx(math.radians(0.003) ** 2)
    assert [imu[7].linear_acceleration.z, imu[7].angular_velocity.x] == [
        s.linear_acceleration[7, 2],
        s.angular_velocity[7, 0],
    ]
    fix = messages["/gnss/fix"][2]
    assert (fix.latitude, fix.altitude) == (math.degrees(s.fixes.lat[2]), s.fixes.height[2])
    assert fix.position_covariance_type == 2
    np.testing.assert_array_equal(fix.position_covariance, [1, 0, 0, 0, 1, 0, 0, 0, 2.25])

    k = 400 * 2  # the truth at 2 s
    true_imu, true_fix, odometry = (messages[f"/truth/{name}"][199] for name in ("imu", "fix", "odometry"))
    assert true_imu.header.stamp.sec == 1_700_000_002
    q = true_imu.orientation
    np.testing.assert_array_equal([q.x, q.y, q.z, q.w], t.q_nb[k])
    assert true_imu.linear_acceleration.z == t.specific_force[k, 2]
    assert true_fix.altitude == t.height[k]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    p, v = odometry.pose.pose.position, odometry.twist.twist.linear
    assert p.z == pytest.approx(t.height[k] - 150.0, abs=1e-8)
    q = odometry.pose.pose.orientation
    speed = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([v.x, v.y, v.z])
    _close(speed, t.velocity_n[k], atol=1e-12)
    w = odometry.twist.twist.angular
    earth_rate = Rotation.from_quat(t.q_eb[k]).inv().apply([0.0, 0.0, earth.RATE])
    _close([w.x, w.y, w.z], t.rate[k] - earth_rate, atol=1e-18)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    command = ["static", "-o", str(bag), "--seed", "3", "--param", "duration:=2", "--param", "rate:=100"]
    assert main(command) == 0
    assert "static, seed 3, 2 s, 200 IMU samples at 100 Hz" in capsys.readouterr().out
    assert main(command) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--param", "imu.gyro_bias_deg_per_hour:=[1, 2, 3e-1]"]) == 0
    with BagReader(bag) as reader:
        assert reader.topics["/imu/data_raw"].count == 200

    assert main(["--list"]) == 0
    listing = capsys.readouterr().out
    for name, scenario in SCENARIOS.items():
        assert f"{name}: {scenario.text}" in listing
        assert all(parameter in listing for parameter in scenario.parameters)

    for wrong, expected in (
        (["-o", str(bag)], "--list"),
        (["static"], "add -o BAG"),
        (["static", "-o", str(tmp_path / "new"), "--param", "duration=2"], "name:=value"),
        (["static", "-o", str(tmp_path / "new"), "--param", "durtion:=2"], "did you mean duration"),
    ):
        assert main(wrong) == 1
        assert expected in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
