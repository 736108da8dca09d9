"""Named scenarios: repeatable from a seed, with the motion of their text."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import close

from ins_nav.errors import InsNavError
from ins_nav.mechanization import earth
from ins_nav.simulation.scenarios import SCENARIOS, START_NS, simulate
from ins_nav.simulation.sensors import PRESETS


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


def test_vehicle_shakes_by_its_parameters() -> None:
    shaking: dict[str, Any] = {"engine_amplitude": 1e-4, "people_amplitude_deg": 0.05, "imu.preset": "perfect"}
    s = simulate("vehicle", duration=130.0, **shaking)
    # 1e-4 m at 25 Hz: 2.5 m/s² peak, 1.75 rms, less 2.5 % by averaging over 5 ms at 25 Hz
    assert s.linear_acceleration[: 100 * 200, 2].std() == pytest.approx(1.745 * 0.975, rel=0.01)
    roll = Rotation.from_quat(s.trajectory.q_nb).as_euler("ZYX", degrees=True)[:, 2]
    assert np.abs(roll[: 100 * 200]).max() == pytest.approx(0.05, rel=1e-3)
    assert np.abs(roll[119 * 200 + 1 : 120 * 200]).max() < 1e-12


PAPER_DRIFT = [-1e-7, -1e-7, 1e-7]  # 1e-7 right, -1e-7 forward, 1e-7 up, on the axes forward, left, up


@pytest.mark.parametrize(("name", "duration"), [("zupt2_stop", 600.0), ("zupt1_two_positions", 720.0)])
def test_zupt_scenarios_start_as_the_paper_does(name: str, duration: float) -> None:
    assert SCENARIOS[name].parameters["duration"].default == duration
    s = simulate(name, duration=30.0)
    assert (s.parameters["rate"], s.parameters["imu.preset"]) == (200.0, "perfect")
    t = s.trajectory
    np.testing.assert_array_equal(t.velocity_n, 0.0)
    close([t.lat[0], t.lat[-1]], math.radians(60.0), atol=1e-15)
    # heading 45°: forward north-east, left north-west
    horizontal = earth.RATE * 0.5 * math.sqrt(0.5)
    rate = [horizontal, horizontal, earth.RATE * math.sqrt(0.75)]
    close(t.rate, np.tile(rate, (6001, 1)), atol=1e-18)
    # averages over 5 ms of numbers of 1e-4: rounding of 1e-20 over 5e-3
    close(s.angular_velocity, np.tile(np.add(rate, PAPER_DRIFT), (6000, 1)), atol=1e-17)
    close(s.linear_acceleration[:, :2], 0.0, atol=1e-6)  # normal gravity leans by 1.2e-7 rad at 150 m
    np.testing.assert_allclose(s.gyro_bias, PAPER_DRIFT, rtol=1e-14)


def test_a_preset_adds_to_the_errors_of_a_scenario() -> None:
    preset: dict[str, Any] = {"imu.preset": "navigation", "duration": 1.0}
    drawn = simulate("static", 3, **preset).gyro_bias
    np.testing.assert_allclose(simulate("zupt2_stop", 3, **preset).gyro_bias, np.add(drawn, PAPER_DRIFT), rtol=1e-12)
    given = simulate("zupt2_stop", duration=1.0, **{"imu.gyro_bias_deg_per_hour": (0.0, 0.0, 3.0)}).gyro_bias
    np.testing.assert_allclose(given, [0.0, 0.0, math.radians(1.0 / 1200.0)])


def test_zupt2_stop_rocks_to_its_end() -> None:
    t = simulate("zupt2_stop", duration=50.0, rate=20.0, rocking_amplitude_deg=3.0, period=5.0).trajectory
    yaw, pitch, roll = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True).T
    phase = 2.0 * math.pi * t.time / 5.0
    close(roll, 3.0 * np.sin(phase), atol=1e-12)
    close(pitch, 3.0 * np.cos(phase), atol=1e-12)
    close(yaw, 45.0, atol=1e-12)
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
        close(t.position_e[stop] - t.position_e[stop.start], 0.0, atol=5e-9)
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
    close(place[:2], [-50.0 * math.sqrt(0.5)] * 2, atol=1e-4)  # 50 m off the origin the plane bends by d²/R
    pitch = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True)[:, 1]
    close(pitch[: ENDS["first"] + 1], 0.0, atol=1e-12)
    close(pitch[arrives : leaves + 1], -40.0, atol=1e-12)
    assert np.abs(pitch[leaves + 10 * 20 :]).max() < 3.0  # the springs


def test_negative_seed_is_refused() -> None:
    with pytest.raises(InsNavError, match="seed -1"):
        simulate("static", -1, duration=1.0)


def test_a_parameter_overrides_the_preset() -> None:
    given: dict[str, Any] = {"imu.preset": "perfect", "imu.gyro_bias_deg_per_hour": "[1, 2e0, -3]", "duration": "1"}
    s = simulate("static", **given)
    np.testing.assert_allclose(np.degrees(s.gyro_bias) * 3600.0, [1.0, 2.0, -3.0])
    assert simulate("rocking", duration=1.0).errors == PRESETS["fog_auv"]
    close(s.angular_velocity - s.trajectory.rate[1:], np.tile(s.gyro_bias, (200, 1)), atol=1e-18)


def test_redrawn_along_the_same_trajectory() -> None:
    short: dict[str, Any] = {"rate": 10.0, "duration": 60.0}
    first = simulate("auv_dive", 1, **short)
    again, fresh = first.redrawn(2), simulate("auv_dive", 2, **short)
    assert again.trajectory is first.trajectory
    np.testing.assert_array_equal(again.angular_velocity, fresh.angular_velocity)
    np.testing.assert_array_equal(again.linear_acceleration, fresh.linear_acceleration)
    np.testing.assert_array_equal(again.stamps_ns, fresh.stamps_ns)
    np.testing.assert_array_equal(again.aids["log"].velocity, fresh.aids["log"].velocity)
    np.testing.assert_array_equal(again.fixes.lat, fresh.fixes.lat)
    assert (again.seed, again.gyro_bias) == (2, fresh.gyro_bias)
    assert again.parameters == fresh.parameters
    changed = first.redrawn(1, **{"log.scale": 0.01, "imu.gyro_noise_deg_per_sqrt_hour": 0.0})
    assert changed.aids["log"].scale == pytest.approx(first.aids["log"].scale + 0.01, abs=1e-15)
    assert changed.parameters["log.scale"] == 0.01
    np.testing.assert_array_equal(changed.aids["depth"].value, first.aids["depth"].value)
    for name in ("depth", "imu.preset", "rate"):
        with pytest.raises(InsNavError, match=f"{name} cannot change along a trajectory; simulate auv_dive anew"):
            first.redrawn(1, **{name: 3.0})
    with pytest.raises(InsNavError, match=r"did you mean log\.scale"):
        first.redrawn(1, **{"log.scal": 3.0})
