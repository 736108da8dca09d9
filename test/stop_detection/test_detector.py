"""The stop detector's core, on simulated carriers whose stops are known."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stop_harness import run, samples

from ins_nav.config.configuration import Configuration
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.scenarios import simulate
from ins_nav.stamps import stamp_of
from ins_nav.stop_detection.detector import StopDetector
from ins_nav.stop_detection.stop_limits import StopLimits


@cache
def city_stops() -> tuple[tuple[float, float], ...]:
    """Times at which the car of scenario vehicle, which stands for 30 s first, is slower than 0.05 m/s."""
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

    The car of the simulation does not shake when it drives: velocity alone distinguishes even driving from rest.
    """
    car = {"duration": 280.0, "stand_time": 30.0, "engine_amplitude": engine, "people_amplitude_deg": 0.2}
    found = run(samples(simulate("vehicle", 1, rate=rate, **car, **{"imu.preset": preset})))
    assert len(found) == len(city_stops()) == 3
    for stop, (began, ended) in zip(found, city_stops(), strict=True):
        # mems: tilt drifts by mm/s² in the seconds over which begin and end are sought
        assert stop.began == pytest.approx(began, abs=0.5)
        assert stop.ended == pytest.approx(ended, abs=2.5)
        assert stop.revoked <= ended + 1.0  # the profile takes 0.7 s from 0.05 m/s to the 0.2 that end a stop
    # sway from the first sample on: detected after 10 s; the others after the 2 s of stop.min_duration
    assert found[0].declared < 10.5
    assert all(stop.declared - stop.began < 2.5 for stop in found[1:])


def test_swell() -> None:
    """Rocking is no motion, surge beyond max_speed is: documented in the module."""
    rocking = {"rocking_time": 60.0, "duration": 90.0, "rate": 50.0, "imu.preset": "navigation"}
    rocks, surges = (run(samples(simulate("rocking", 1, surge_amplitude=a, **rocking))) for a in (0.0, 0.3))
    assert [stop.declared < 11.0 and stop.ended > 89.0 for stop in rocks] == [True]
    assert [stop.began > 60.0 and stop.ended > 89.0 for stop in surges] == [True]  # amplitude 0.24 m/s until 60 s


@pytest.mark.parametrize("preset", ["navigation", "mems"])
@pytest.mark.parametrize(
    ("amplitude", "period", "phase"),
    [(0.2, 4.0, 0.0), (0.5, 5.0, 0.0), (0.75, 8.0, 90.0), (1.0, 11.0, 90.0), (2.0, 15.0, 45.0), (5.0, 20.0, 90.0)]
    + [(10.0, 5.0, 90.0)],
)
def test_rocking_from_the_first_sample_on(amplitude: float, period: float, phase: float, preset: str) -> None:
    """The first seconds of a slow rocking look like rest with a gyro bias, which must not become an estimate."""
    rocking = {"roll_amplitude_deg": amplitude, "pitch_amplitude_deg": amplitude, "pitch_phase_deg": phase}
    rocks = simulate(
        "rocking", 1, duration=60.0, rocking_time=70.0, rate=25.0, period=period, **rocking, **{"imu.preset": preset}
    )
    assert [(stop.declared < 15.0, stop.ended > 59.0) for stop in run(samples(rocks))] == [(True, True)]


def test_gaps() -> None:
    """A long gap ends a stop at its last sample, a short one does not; a jump of the stamps restarts the detector."""
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


def _vertical(seconds: float, shakes: bool, begin: float, turn: float = 0.0) -> list[tuple[int, Any]]:
    """Samples at 20 Hz from a time on; vibration of 2 m/s² along the vertical does not change horizontal velocity."""
    times = begin + 0.05 * np.arange(round(20.0 * seconds))
    force = 9.81 + (2.0 * np.sin(2.0 * math.pi * 3.3 * times) if shakes else 0.0 * times)
    return [
        (round(1e9 * t), (0.05, 0.0, 0.0, turn, 0.0, 0.0, f))
        for t, f in zip(times.tolist(), force.tolist(), strict=True)
    ]


def _stillness(*parts: list[tuple[int, Any]]) -> float:
    """That of the only stop that begins."""
    detector = StopDetector()
    changes = [detector.add(stamp, sample) for part in parts for stamp, sample in part]
    (began,) = [change for change in changes if change is not None]
    return began.stillness


def test_stillness_is_evidence_of_rest_after_shaking_only() -> None:
    """Odds of 2 without any knowledge; a window of 4 s in which the carrier shakes in motion adds 2."""
    rest = _vertical(3.0, False, 64.0)
    # the windows at both ends of the vibration are part of it
    assert _stillness(_vertical(64.0, True, 0.0), rest) == pytest.approx(math.log(34.0), abs=0.1)
    # an even turn is no shaking, only its end: in the window of 1 s
    assert _stillness(_vertical(64.0, False, 0.0, turn=0.1), rest) == pytest.approx(math.log(2.0 * 1.25), abs=0.1)
    # after a gap of 2 s nothing is known of the carrier
    gap = [(stamp + 2 * 10**9, (2.0, *sample[1:]) if i == 0 else sample) for i, (stamp, sample) in enumerate(rest)]
    assert _stillness(_vertical(64.0, True, 0.0), gap) == pytest.approx(math.log(2.0))
    # 1.5 s of each 4 are even, of which 0.6 s after the window of 1 s
    often = [
        part for t in np.arange(0.0, 64.0, 4.0) for part in (_vertical(1.5, False, t), _vertical(2.5, True, t + 1.5))
    ]
    assert _stillness(*often, rest) == pytest.approx(math.log(17.0 / 2.9), abs=0.2)


def test_noise_is_estimated_or_given() -> None:
    """0.3 °/√h and 150 µg/√Hz, over 0.1 s; learnt to a third (three axes, the least of some minutes)."""
    standing = samples(simulate("static", 1, duration=120.0, rate=50.0, **{"imu.preset": "mems"}))
    true = np.array([math.radians(0.3) / 60.0, 150e-6 * 9.80665]) / math.sqrt(0.1)
    learner = StopDetector()
    run(standing, learner)
    assert np.array(learner.noise) == pytest.approx(true, rel=0.35)
    configured = Configuration.from_overrides(
        {"imu.gyro_noise_deg_per_sqrt_hour": 0.3, "imu.accel_noise_ug_per_sqrt_hz": 150.0}
    )
    given = StopDetector(StopLimits.of(configured.stop, configured.imu))
    run(standing[:500], given)
    assert np.array(given.noise) == pytest.approx(true)


def test_noisy_imu_needs_its_noise_given() -> None:
    """Ten times stop.vibration over 0.1 s: never still by default, stops found with the noise given."""
    noisy = {"imu.accel_noise_ug_per_sqrt_hz": 6000.0, "imu.gyro_noise_deg_per_sqrt_hour": 10.0}
    standing = samples(simulate("static", 1, duration=20.0, rate=50.0, **noisy))
    assert run(standing) == []
    limits = StopLimits(gyro_noise=math.radians(10.0) / 60.0, accel_noise=6000e-6 * 9.80665, false_alarm=1e-6)
    assert [stop.declared < 6.0 for stop in run(standing, StopDetector(limits))] == [True]


def recording(name: str) -> dict[str, list[tuple[int, list[float]]]]:
    """IMU samples, and horizontal reference velocity where there is one."""
    path = Path(__file__).parents[3] / "shared" / "data" / name
    if not path.is_dir():
        pytest.skip(f"recording {name} is missing")
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
