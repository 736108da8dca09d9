"""True motion over the ellipsoid, against its differences and an independent integrator."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import DURATION, car, close

from ins_nav.mechanization import earth
from ins_nav.simulation import trajectory as trajectory_module
from ins_nav.simulation.motion import Motion, constant, sinusoid
from ins_nav.simulation.scenarios import simulate
from ins_nav.simulation.trajectory import EarthMotion, Origin, States


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


MOTIONS = {"boat": _boat, "car": car, "aircraft over the pole": _aircraft_over_the_pole}


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


def test_positions_agree(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    # a double resolves an Earth radius to 1e-9 m
    close(earth.geodetic_to_ecef(s.lat, s.lon, s.height), s.position_e, atol=5e-9)


def test_velocity_is_the_change_of_position(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    # rounding of positions: 1e-9 m / 0.05 s, a few times
    close(_difference(on_earth, "position_e"), s.velocity_e, atol=2e-7)
    for k, velocity in enumerate(s.velocity_n):
        close(earth.enu_axes(s.lat[k], s.lon[k]) @ velocity, s.velocity_e[k], atol=1e-10)


def test_specific_force_is_acceleration_less_gravity(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    coriolis = 2.0 * np.cross([0.0, 0.0, earth.RATE], s.velocity_e)
    force_e = _difference(on_earth, "velocity_e") + coriolis - _gravity_e(s)
    # the stencil's truncation at the shortest period here, 7 s: (2 pi 0.05 / 7)^8 / 630 * 1.6 m/s² = 5e-14;
    # rounding 250 m/s * 1e-16 / 0.05 s = 1e-12, a few times
    close(Rotation.from_quat(s.q_eb).inv().apply(force_e), s.specific_force, atol=1e-10)


def test_rate_is_the_change_of_attitude(on_earth: EarthMotion) -> None:
    s = on_earth.states(TIMES)
    here = Rotation.from_quat(s.q_eb).inv()
    rate = np.zeros((len(TIMES), 3))
    for j, c in STENCIL.items():
        ahead, back = (Rotation.from_quat(on_earth.states(TIMES + k * STEP).q_eb) for k in (j, -j))
        rate += c * ((here * ahead).as_rotvec() - (here * back).as_rotvec()) / STEP
    # rounding 1e-16 / 0.05 s, truncation as above
    close(rate + here.apply([0.0, 0.0, earth.RATE]), s.rate, atol=1e-12)


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
        close(t.delta_theta[k], weights @ w / (2.0 * rate), atol=1e-15)
        close(t.delta_velocity[k], weights @ f / (2.0 * rate), atol=1e-14)


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
    # measured 2e-11: the first interval, which has no compensation, and the rest of two-sample coning; both fall
    # with the rate (1e-13 at 1000 Hz)
    assert error < 1e-10


def test_chunks_join(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = car().trajectory(10.0)
    for chunk in (7, 300, 600, 601):  # 600 intervals, 601 instants
        monkeypatch.setattr(trajectory_module, "_CHUNK", chunk)
        parts = car().trajectory(10.0)
        assert len(parts.time) == 601
        # rounding may depend on the length of arrays
        close(parts.position_e, whole.position_e, atol=5e-9)
        close(parts.delta_velocity, whole.delta_velocity, atol=1e-14)


@pytest.mark.parametrize("lat_deg", [-90.0, -20.0, 0.0, 55.7, 90.0])
def test_at_rest_only_gravity_and_earths_rate_remain(lat_deg: float) -> None:
    height = 2000.0
    s = simulate("static", lat_deg=lat_deg, height=height, duration=1.0, roll_deg=20.0, pitch_deg=-30.0)
    t, sin_lat = s.trajectory, math.sin(math.radians(lat_deg))
    north = earth.NORTH_GRAVITY_PER_METRE * height * math.sin(2.0 * math.radians(lat_deg))
    body = Rotation.from_quat(t.q_nb)
    # rounding of sums of a few terms of 10 m/s² and 7e-5 rad/s
    expected = [0.0, -north, earth.normal_gravity(sin_lat, height)]
    close(body.apply(t.specific_force), np.tile(expected, (201, 1)), atol=2e-14)
    expected = [0.0, earth.RATE * math.cos(math.radians(lat_deg)), earth.RATE * sin_lat]
    close(body.apply(t.rate), np.tile(expected, (201, 1)), atol=1e-19)
    np.testing.assert_array_equal(t.velocity_n, 0.0)


def test_heading_and_tilt_have_the_signs_of_rep_103() -> None:
    t = simulate("static", duration=0.1, heading_deg=90.0, pitch_deg=10.0, roll_deg=0.0).trajectory
    x, y, _ = Rotation.from_quat(t.q_nb[0]).as_matrix().T
    close(y, [0.0, 1.0, 0.0], atol=1e-15)  # heads east, left is north
    assert x[2] < 0.0 < x[0]  # bow down
    t = simulate("static", duration=0.1, heading_deg=0.0, roll_deg=10.0).trajectory
    assert Rotation.from_quat(t.q_nb[0]).as_matrix()[2, 1] > 0.0  # left side up


def test_pyins_navigates_to_the_same_place() -> None:
    """An independent integrator over our increments.

    At ellipsoidal height 0, where its gravity (linear in height, without north component) is ours.
    """
    pd = pytest.importorskip("pandas")
    strapdown = pytest.importorskip("pyins.strapdown")
    t = car(height=0.0).trajectory(200.0)
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
    # the rest is by pyins: trapezoid rule for the position at 200 Hz, its constants to 1e-12
    assert np.linalg.norm(place - t.position_e[-1]) < 1e-3
    close([last.VE, last.VN, -last.VD], t.velocity_n[-1], atol=1e-4)
    yaw = Rotation.from_quat(t.q_nb[-1]).as_euler("ZYX", degrees=True)[0]
    assert abs((90.0 - last.heading - yaw + 180.0) % 360.0 - 180.0) < 1e-6
