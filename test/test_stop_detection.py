"""The stop detector's core, on simulated carriers whose stops are known."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from ins_nav.bags import BagReader
from ins_nav.health import Health
from ins_nav.imu_stream import ImuStream
from ins_nav.messages import stamp_of
from ins_nav.parameters import default_values
from ins_nav.simulation import scenarios
from ins_nav.simulation.motion import Motion, Route
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.stop_detection import StopDetector, StopLimits


class Stop(NamedTuple):
    """Times from the start of the recording, s."""

    began: float
    ended: float
    declared: float
    revoked: float


def samples(simulation: Simulation) -> list[tuple[int, list[float]]]:
    rows = np.hstack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
    return list(zip(simulation.stamps_ns.tolist(), rows, strict=True))


def run(messages: list[tuple[int, list[float]]], detector: StopDetector | None = None) -> list[Stop]:
    """Stops found in a stream of stamps and values; one that lasts to the end ends there."""
    detector = detector or StopDetector()
    stream = ImuStream(Health(), 35.0, 400.0, 10.0)
    start, open_stop, found = messages[0][0], None, []
    for stamp, row in messages:
        for taken, sample in stream.accept(stamp, *row):
            if isinstance(sample, float):
                detector.restart()
                continue
            change = detector.add(taken, sample)
            if change is None:
                continue
            seconds = (change.stamp_ns - start) * 1e-9, (change.decided_ns - start) * 1e-9
            if change.stopped:
                assert open_stop is None
                open_stop = seconds
            else:
                assert open_stop is not None
                found.append(Stop(open_stop[0], seconds[0], open_stop[1], seconds[1]))
                open_stop = None
    if open_stop is not None:
        end = (messages[-1][0] - start) * 1e-9
        found.append(Stop(open_stop[0], end, open_stop[1], end))
    return found


def driven(make: Callable[[Route], None], preset: str, rate: float, seed: int = 0) -> Simulation:
    """A car without any vibration on the route given."""
    route = Route(0.5)
    make(route)
    speed = route.speed

    def motion(_p: object) -> Motion:
        return Motion(route.time, speed=speed, yaw=route.yaw, pitch=-0.01 * speed.derivative())

    scenarios.scenario("Test.", {})(motion)
    try:
        return simulate("motion", seed, duration=route.time, rate=rate, **{"imu.preset": preset})
    finally:
        del scenarios.SCENARIOS["motion"]


@cache
def city_stops() -> tuple[tuple[float, float], ...]:
    """When the car of scenario vehicle, which stands for 30 s first, is slower than 0.05 m/s."""
    true = simulate("vehicle", duration=280.0, stand_time=30.0, rate=20.0, **{"imu.preset": "perfect"}).trajectory
    still = np.linalg.norm(true.velocity_e, axis=1) < 0.05
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return tuple((float(true.time[a]), float(true.time[b - 1])) for a, b in edges.reshape(-1, 2))


@pytest.mark.parametrize(
    ("preset", "rate", "engine"),
    [("navigation", 400.0, 1e-4), ("fog_auv", 200.0, 1e-4), ("tactical", 100.0, 1e-4), ("mems", 100.0, 5e-5)],
)
def test_city_drive(preset: str, rate: float, engine: float) -> None:
    """Engine running, people swaying the car at the start; no stop but the true ones, none missed.

    The car of the simulation does not shake when it drives: velocity alone tells even driving from rest.
    """
    car = {"duration": 280.0, "stand_time": 30.0, "engine_amplitude": engine, "people_amplitude_deg": 0.2}
    found = run(samples(simulate("vehicle", 1, rate=rate, **car, **{"imu.preset": preset})))
    assert len(found) == len(city_stops()) == 3
    for stop, (began, ended) in zip(found, city_stops(), strict=True):
        # mems: tilt drifts by mm/s² in the seconds over which begin and end are sought
        assert stop.began == pytest.approx(began, abs=0.5)
        assert stop.ended == pytest.approx(ended, abs=2.5)
        assert stop.revoked <= ended + 1.0  # the profile takes 0.7 s from 0.05 m/s to the 0.2 that end a stop
    # swayed from the first sample on: told after 10 s; the others after the 2 s of stop.min_duration
    assert found[0].declared < 10.5
    assert all(stop.declared - stop.began < 2.5 for stop in found[1:])


@pytest.mark.parametrize(("preset", "rate", "duration"), [("navigation", 100.0, 60.0), ("mems", 50.0, 20.0)])
@pytest.mark.parametrize("start", [1.0, 4.0])
def test_creep_is_not_a_stop(preset: str, rate: float, duration: float, start: float) -> None:
    """0.3 m/s, perfectly even; as long as the sensors can tell: velocity of mems drifts by 0.1 m/s in half a minute."""

    def creep(route: Route) -> None:
        route.hold(40.0)
        route.reach(0.3, start)
        route.hold(duration)
        route.reach(0.0, start)
        route.hold(20.0)

    first, second = run(samples(driven(creep, preset, rate)))
    assert first.revoked < 40.0 + 0.8 * start  # the step of degree 7 is at 0.28 m/s then
    stands = 40.0 + 2.0 * start + duration
    assert second.declared > stands  # not before it stands
    assert second.began > stands - 0.5 * start  # 0.15 m/s and falling


def test_swell() -> None:
    """Rocking is no motion, surge beyond max_speed is: documented in the module."""
    rocking = {"rocking_time": 60.0, "duration": 90.0, "rate": 50.0, "imu.preset": "navigation"}
    rocks, surges = (run(samples(simulate("rocking", 1, surge_amplitude=a, **rocking))) for a in (0.0, 0.3))
    assert [stop.declared < 11.0 and stop.ended > 89.0 for stop in rocks] == [True]
    assert [stop.began > 60.0 and stop.ended > 89.0 for stop in surges] == [True]  # amplitude 0.24 m/s until 60 s


def test_turning_on_the_spot_is_not_a_stop() -> None:
    def turntable(route: Route) -> None:
        route.hold(20.0)
        route.turn(math.radians(360.0), 60.0)
        route.hold(20.0)

    found = run(samples(driven(turntable, "navigation", 50.0)))
    # a stop that is under way goes on: nothing travels. A detector that wakes up in the turn finds none
    assert [(stop.began < 0.5, stop.ended > 99.0) for stop in found] == [(True, True)]
    turning = [
        m for m in samples(driven(turntable, "navigation", 50.0)) if 35.0 < (m[0] - scenarios.START_NS) * 1e-9 < 65.0
    ]
    assert run(turning) == []


def test_start_in_motion() -> None:
    """The first level is that of braking: rest is found all the same, and not before."""

    def brakes(route: Route) -> None:
        route.reach(12.0, 6.0)
        route.turn(1.0, 6.0)
        route.reach(0.0, 8.0)
        route.hold(30.0)

    moving = samples(driven(brakes, "mems", 50.0))[int(4.0 * 50) :]
    (stop,) = run(moving)
    assert stop.began == pytest.approx(16.0, abs=1.0)
    assert stop.ended > 45.0


def test_large_gyro_bias() -> None:
    standing = {
        "duration": 20.0,
        "rate": 50.0,
        "imu.preset": "mems",
        "imu.gyro_bias_deg_per_hour": (800.0, -800.0, 800.0),
    }
    (stop,) = run(samples(simulate("static", 1, roll_deg=170.0, **standing)))
    assert stop.declared < 2.5


def test_gaps() -> None:
    """A long gap ends a stop at its last sample, a short one does not; a jump of the stamps begins again."""
    standing = samples(simulate("static", 1, duration=30.0, rate=50.0))
    short = [m for i, m in enumerate(standing) if not 500 < i <= 530]
    assert [stop.ended > 29.0 for stop in run(short)] == [True]
    before, after = run([m for i, m in enumerate(standing) if not 500 < i < 600])
    assert before.ended == pytest.approx(10.0, abs=0.05)
    assert after.began == pytest.approx(12.0, abs=0.2)
    looped = standing + standing[:500]
    detector = StopDetector()
    run(standing, detector)
    detector.restart()
    assert not detector.stopped and detector.rest_ns == 0
    assert detector.noise[1] < 1e-3  # the IMU is the same
    run(looped[len(standing) :], detector)
    assert detector.stopped and detector.rest_ns == pytest.approx(9.98e9, abs=0.2e9)


def test_noise_is_learnt_or_given() -> None:
    """0.3 °/√h and 150 µg/√Hz, over 0.1 s; learnt to a third (three axes, the least of some minutes)."""
    standing = samples(simulate("static", 1, duration=120.0, rate=50.0, **{"imu.preset": "mems"}))
    true = np.array([math.radians(0.3) / 60.0, 150e-6 * 9.80665]) / math.sqrt(0.1)
    learner = StopDetector()
    run(standing, learner)
    assert np.array(learner.noise) == pytest.approx(true, rel=0.35)
    values = default_values() | {
        "imu.gyro_noise_deg_per_sqrt_hour": 0.3,
        "imu.accel_noise_ug_per_sqrt_hz": 150.0,
        "stop.sway_deg_per_s": 0.06,
    }
    limits = StopLimits.from_parameters(values)
    assert limits.sway == pytest.approx(StopLimits().sway, rel=0.05)
    given = StopDetector(limits)
    run(standing[:500], given)
    assert np.array(given.noise) == pytest.approx(true)


def test_noisy_imu_needs_its_noise_given() -> None:
    """Ten times stop.vibration over 0.1 s: never still by default, found when it is told."""
    noisy = {"imu.accel_noise_ug_per_sqrt_hz": 6000.0, "imu.gyro_noise_deg_per_sqrt_hour": 10.0}
    standing = samples(simulate("static", 1, duration=20.0, rate=50.0, **noisy))
    assert run(standing) == []
    told = StopLimits(gyro_noise=math.radians(10.0) / 60.0, accel_noise=6000e-6 * 9.80665, false_alarm=1e-6)
    assert [stop.declared < 6.0 for stop in run(standing, StopDetector(told))] == [True]


def recording(name: str) -> dict[str, list[tuple[int, list[float]]]]:
    """IMU samples, and horizontal reference velocity where there is one."""
    path = Path(__file__).parents[2] / "shared" / "data" / name
    if not path.is_dir():
        pytest.skip(f"recording {name} is not there")
    found: dict[str, list[tuple[int, list[float]]]] = {}
    with BagReader(path) as bag:
        topics = [topic for topic in ("/imu/data_raw", "/reference/velocity") if topic in bag.topics]
        for raw in bag.messages(topics):
            message: Any = bag.deserialize(raw)
            if raw.topic == "/imu/data_raw":
                w, f = message.angular_velocity, message.linear_acceleration
                row = [w.x, w.y, w.z, f.x, f.y, f.z]
            else:
                row = [message.twist.twist.linear.x, message.twist.twist.linear.y]
            found.setdefault(raw.topic, []).append((stamp_of(message), row))
    return found


def test_kingston() -> None:
    """Every stop of 10 s or more by the reference; none while it moves faster than 0.5 m/s, published or dated."""
    data = recording("kingston_a")
    imu, reference = data["/imu/data_raw"], data["/reference/velocity"]
    time = np.array([(stamp - imu[0][0]) * 1e-9 for stamp, _ in reference])
    speed = np.hypot(*np.array([row for _, row in reference]).T)
    still = np.concatenate([[0], (speed < 0.05).astype(int), [0]])
    true = [(time[a], time[b - 1]) for a, b in np.flatnonzero(np.diff(still)).reshape(-1, 2) if b - 1 - a >= 10]
    found = run(imu)
    assert len(true) == 9
    for began, ended in true:
        # At rest the reference keeps up to 0.13 m/s until its own zero-velocity update, some 3 s later: it says when a
        # stop must have begun, not that it had not. That it began too early shows below, where it still moves.
        (stop,) = [stop for stop in found if stop.began < ended and stop.ended > began]
        assert stop.began < began + 1.0 and stop.declared < began + 3.0
        assert ended - 0.5 < stop.ended < ended + 1.5
    fine = np.arange(0.0, time[-1], 0.1)
    fast = np.interp(fine, time, speed) > 0.5
    for stop in found:
        assert not fast[(fine > stop.began) & (fine < stop.revoked)].any()


def test_rlg_drive() -> None:
    """66 s and more with people moving in the car are one stop; the drive has none, nor has any part of it."""
    imu = recording("rlg_drive")["/imu/data_raw"]
    (stop,) = run(imu)
    assert stop.began < 0.2 and stop.declared < 2.5
    assert 69.0 < stop.ended < 70.5 and stop.revoked < 71.0  # specific force begins to rise at 69.4 s
    for start in (72.0, 100.0):
        assert run([m for m in imu if (m[0] - imu[0][0]) * 1e-9 > start]) == []
