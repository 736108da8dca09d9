"""What the monitors report of a fault, when, and what it may hide; nothing on good data."""

import math
from pathlib import Path

import numpy as np
import pytest
from monitored_imu import ACCEL_NOISE, GYRO_NOISE, START, Monitored, drive

from ins_nav.event_log import ERROR, WARN, EventLog
from ins_nav.mechanization.imu_monitor import ImuMonitor
from ins_nav.messages.inputs import read_imu
from ins_nav.recordings.bags import BagReader
from ins_nav.stop_detection.detector import StopDetector

DATA = Path(__file__).parents[3] / "shared" / "data"


@pytest.mark.parametrize("rate", [10.0, 100.0, 400.0])
@pytest.mark.parametrize("resolution", [0.0, 1.0, 8.0, 30.0])
def test_good_data(resolution: float, rate: float) -> None:
    monitored = Monitored(drive(3, rate, resolution), rate)
    assert monitored.events.counts == {} and monitored.hidden == []


@pytest.mark.parametrize("name", ["rlg_drive", "kingston_a", "auv_pool", "mems_car"])
def test_recordings(name: str) -> None:
    """Real IMUs from 5 dollars to ring-laser gyros, driving, standing and diving: no alarm."""
    if not (DATA / name).is_dir():
        pytest.skip(f"recording {name} is not there")
    events, detector = EventLog(), StopDetector()
    monitor, last_ns = ImuMonitor(events), 0
    with BagReader(DATA / name) as bag:
        for raw in bag.messages(["/imu/data_raw"]):
            stamp_ns, *values = read_imu(bag.deserialize(raw))
            interval = (stamp_ns - last_ns) * 1e-9 if last_ns else 0.0
            sample = (interval, *values)
            if interval:
                detector.add(stamp_ns, sample)  # type: ignore[arg-type]
            monitor.add(stamp_ns, sample, detector.stopped)  # type: ignore[arg-type]
            assert monitor.hidden == []
            last_ns = stamp_ns
    assert events.counts == {}
    assert all(math.isfinite(limit) for limit in monitor.noise_limits)


def test_a_frozen_axis_hides_what_the_others_do() -> None:
    """Yaw of up to 0.3 rad/s in turns of 16 s."""
    values = drive(1)
    true = values[9000:11000, 2].copy()
    values[9000:11000, 2] = values[8999, 2]
    monitored = Monitored(values)
    assert (monitored.reports[0].level, monitored.first) == (ERROR, {"frozen axes": pytest.approx(91.0, abs=0.02)})
    assert f"angular_velocity.z at {values[8999, 2]:.6g} frozen for 1.0 s" in monitored.text
    turns = [monitored.hidden_at(t)[0] for t in np.arange(90.1, 110.0, 0.2)]
    assert all(turn[0] == turn[1] == 0.0 < turn[2] for turn in turns)
    lost = 0.01 * np.cumsum(true - values[8999, 2])
    sigma = np.sqrt(np.cumsum(np.repeat([0.2 * turn[2] for turn in turns], 20)))
    assert np.abs(lost / sigma)[10:].max() < 2.0
    assert not np.any(monitored.hidden_at(89.9)) and not np.any(monitored.hidden_at(110.1))


def test_samples_that_repeat() -> None:
    values = drive(1)
    values[9050:9200] = values[9049]
    monitored = Monitored(values)
    assert monitored.reports[0].level == ERROR and "every value frozen" in monitored.text
    assert set(monitored.events.counts) == {"frozen samples"}
    rate, force = monitored.hidden_at(91.5)
    assert (rate > 0.0).all() and (force > 0.0).all()


def test_held_values() -> None:
    """The speed that each hold misses walks with the sigma that is stated."""
    values = drive(1)
    true = values.copy()
    for offset in (1, 2, 3):
        values[offset::4, 3:] = values[::4, 3:][: len(values[offset::4])]
    monitored = Monitored(values)
    assert set(monitored.events.counts) == {"repeated values"}
    assert "linear_acceleration has each value in 4 samples" in monitored.text
    lost = 0.01 * (true - values)[7000:14000, 3:].cumsum(axis=0)
    sigma = math.sqrt(sum(monitored.hidden_at(t)[1].mean() for t in range(70, 140)))
    walk = np.square(lost[400::400] - lost[:-400:400]).mean() * 700 / 40  # over 4 s, as a walk over 70 s
    assert 0.3 < math.sqrt(walk) / sigma < 2.0


@pytest.mark.parametrize(("axis", "limit"), [(2, 0.25), (4, 1.5), (3, 1.0)])
def test_saturation(axis: int, limit: float) -> None:
    """What was cut off is within the sigma, whose turn or speed walks by what the axis showed before."""
    values = drive(1, resolution=1.0)
    cut = values[7000:14000, axis] - np.clip(values[7000:14000, axis], -limit, limit)
    values[7000:14000, axis] = np.clip(values[7000:14000, axis], -limit, limit)
    monitored = Monitored(values)
    assert monitored.events.counts["saturated"] > 5
    sensor = "angular_velocity" if axis < 3 else "linear_acceleration"
    assert f"{sensor}.{'xyz'[axis % 3]} is saturated at" in monitored.text
    variances = [monitored.hidden_at(t)[axis // 3][axis % 3] for t in np.arange(70.5, 140.0)]
    lost = np.abs(0.01 * np.cumsum(cut)[499::500])
    assert (lost[2:] < 3.0 * np.sqrt(np.cumsum(variances)[4::5][2:])).all()


@pytest.mark.parametrize("times", [10.0, 57.3])
@pytest.mark.parametrize("sensor", ["angular_velocity", "linear_acceleration"])
def test_noise_that_grows_at_rest(sensor: str, times: float) -> None:
    values = drive(1)
    axes, size = (slice(0, 3), GYRO_NOISE) if sensor == "angular_velocity" else (slice(3, 6), ACCEL_NOISE)
    values[3000:5000, axes] += times * size * np.random.default_rng(2).standard_normal((2000, 3))
    monitored = Monitored(values)
    assert (monitored.reports[0].level, set(monitored.events.counts)) == (WARN, {"noise grown"})
    assert f"noise of {sensor} is" in monitored.text
    found = monitored.hidden_at(45.0)[0 if sensor == "angular_velocity" else 1]
    white = times * size * 0.1  # a sample is 0.01 s
    if times < 15.0:
        assert np.sqrt(found) == pytest.approx(white, rel=0.3)
    else:  # perhaps another unit: nothing is known of the motion
        assert (np.sqrt(found) > 10.0 * white).all()


def test_a_unit_and_a_sign_that_change_under_way() -> None:
    values = drive(1)
    values[11000:, 3:] /= 9.80665
    assert "it is in g: publish m/s²" in Monitored(values).text
    values = drive(1)
    values[11000:13000, 3:] *= -1.0
    monitored = Monitored(values)
    assert set(monitored.events.counts) == {"force turned"}
    assert monitored.events.counts["force turned"] == 20


def test_an_axis_that_is_not_measured() -> None:
    values = drive(1)
    values[:, 0] = 0.0
    monitored = Monitored(values)
    assert monitored.monitor.constant == ["angular_velocity.x"]
    assert monitored.hidden == [] and "angular_velocity.x is 0 in every sample since the start" in monitored.text


def test_a_restart_forgets() -> None:
    monitored = Monitored(drive(1)[:3000])
    assert all(math.isfinite(limit) for limit in monitored.monitor.noise_limits)
    monitored.monitor.restart()
    assert monitored.monitor.noise_limits == (math.inf, math.inf)
    assert monitored.monitor.add(START + 10**12, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8), True) is False
