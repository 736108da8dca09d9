"""Real recordings, where they are at hand: alignment against known headings, free inertial against satellite fixes."""

import functools
import math
from pathlib import Path
from typing import Any

import pytest
from navigators import Ins

from ins_nav.mechanization import attitude, nav_state
from ins_nav.messages.inputs import read_imu
from ins_nav.navigator.front_end import Phase
from ins_nav.recordings.bags import BagReader

DATA = Path(__file__).parents[2] / "shared" / "data"


def _recording(name: str) -> Path:
    path = DATA / name
    if not path.is_dir():
        pytest.skip(f"recording {name} is missing")
    return path


@functools.cache
def _messages(name: str, seconds: float = math.inf) -> list[tuple[str, Any]]:
    """Topic and message, by stamp, of the first seconds."""
    messages = []
    with BagReader(_recording(name)) as bag:
        topics = [topic for topic in ("/imu/data_raw", "/gnss/fix") if topic in bag.topics]
        for raw in bag.messages(topics):
            if raw.stamp_ns > bag.start_ns + seconds * 1e9:
                break
            messages.append((raw.topic, bag.deserialize(raw)))
    return messages


class Run:
    """A navigator fed with a recording: its reports, and its distance from each fix once it navigates."""

    def __init__(self, name: str, seconds: float = math.inf, **parameters: Any) -> None:
        self.navigator = Ins({key.replace("__", "."): value for key, value in parameters.items()})
        self.reports: list[str] = []
        self.aligned_heading = math.nan
        self.distances: list[float] = []
        n = self.navigator
        for topic, message in _messages(name, seconds):
            if topic == "/gnss/fix":
                n.add("gnss/fix", message)
                self._compare(message)
            elif n.add_imu(*read_imu(message)) and math.isnan(self.aligned_heading):
                assert n.state is not None
                yaw = attitude.to_euler(nav_state.geodetic(n.state).q_gb)[2]
                self.aligned_heading = math.degrees(attitude.heading_from_yaw(yaw))
        self.reports += [report.text for report in n.events.drain()]

    def _compare(self, fix: Any) -> None:
        state = self.navigator.state
        if state is None or fix.status.status < 0:
            return
        frame = nav_state.MapFrame(math.radians(fix.latitude), math.radians(fix.longitude), state[11])
        east, north, _ = frame.position(state)
        self.distances.append(math.hypot(east, north))

    @property
    def heading_stddev(self) -> float:
        """deg."""
        return math.degrees(math.sqrt(self.navigator.attitude_covariance[2, 2]))


def test_vehicle_with_ring_laser_gyros() -> None:
    """No initial angle, people moving in the car; then 70 s and 250 m of drive on inertial sensors alone."""
    run = Run("rlg_drive")
    assert run.navigator.phase is Phase.NAVIGATING
    # known: 2.4° to 2.5°; 2.60° (sigma 0.23°) measured from these 60 s
    assert run.aligned_heading == pytest.approx(2.45, abs=0.3)
    assert abs(run.aligned_heading - 2.45) < 3.0 * run.heading_stddev < 1.5
    assert len(run.distances) > 60
    # required: 10 m; 4.0 m measured, with fixes of 2 m
    assert max(run.distances) < 10.0
    assert run.navigator.events.counts.get("restarts", 0) == 0


def test_car_with_tactical_gyros_at_10_hz() -> None:
    """The first stop; gyro biases of 0.5 deg/h are real: sigma covers them."""
    run = Run("kingston_a", 510.0, alignment__duration=480.0, imu__gyro_bias_stddev_deg_per_hour=1.0)
    assert run.navigator.phase is Phase.NAVIGATING, run.reports
    assert abs(math.remainder(run.aligned_heading - 199.8, 360.0)) < 3.0 * run.heading_stddev
    # 1 deg/h of 10.8 deg/h at this latitude is 5.3°; 202.1° (sigma 5.2°) measured
    assert run.heading_stddev < 7.0


def test_car_with_known_gyro_biases() -> None:
    """The same stop with the biases known from the recording's description: on right, forward, up there."""
    biases = [-0.3, -0.5, -2.2]
    run = Run("kingston_a", 510.0, alignment__duration=480.0, imu__gyro_bias_deg_per_hour=biases)
    # 199.97° (sigma 0.69°) measured from 500 s; the biases are known to 0.1 deg/h, which is 0.5°
    assert math.remainder(run.aligned_heading - 199.8, 360.0) == pytest.approx(0.0, abs=1.5)
    assert run.heading_stddev < 1.0


def test_underwater_vehicle_with_mems_gyros() -> None:
    """Stamps that jitter and gyros that cannot find north: with a given heading it navigates to the end."""
    run = Run(
        "auv_pool",
        initial__heading_deg=0.0,
        initial__latitude_deg=42.3,
        initial__longitude_deg=-83.7,
        initial__height=250.0,
    )
    n = run.navigator
    assert n.phase is Phase.NAVIGATING, run.reports
    assert n.state is not None and all(math.isfinite(x) for x in n.state)
    assert math.hypot(*n.state[0:4]) == pytest.approx(1.0, abs=1e-12)
    assert n.stream.received - n.stream.accepted <= 5
    # 67 s of MEMS: a tilt of 2° is 0.4 m/s² and 900 m; 880 m measured
    assert n.map is not None
    assert math.hypot(*n.map.position(n.state)) < 2000.0


def test_mems_gyros_that_cannot_find_north_are_reported() -> None:
    run = Run("auv_pool", initial__latitude_deg=42.3, initial__longitude_deg=-83.7, initial__height=250.0)
    assert run.navigator.state is None
    assert any("give initial.heading_deg" in line or "moved off" in line for line in run.reports), run.reports
