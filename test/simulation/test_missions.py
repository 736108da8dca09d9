"""The mission `auv_dive`: path, phases, and the aids of each phase."""

import functools
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import close, seconds_of

from ins_nav.errors import InsNavError
from ins_nav.mechanization import earth
from ins_nav.simulation.scenarios import Simulation, simulate

DIVE: dict[str, Any] = {"rate": 10.0, "imu.preset": "perfect"}


@functools.cache
def _dive(**changes: Any) -> Simulation:
    return simulate("auv_dive", 1, **DIVE, **changes)


def test_dive_goes_down_and_comes_back() -> None:
    s = _dive()
    t = s.trajectory
    assert t.time[-1] == 300.0 + 120.0 + 3600.0 + 120.0
    below = (t.time > 420.0 + 200.0) & (t.time < 4020.0 - 200.0)
    close(t.height[below], -50.0, atol=1e-9)
    # as long as it goes on, aside from the slopes
    close(np.linalg.norm(t.velocity_n[below], axis=1), 1.5, atol=2e-4)  # the plane's scale, 1e-4 at 600 m
    swell = 0.5 * 0.3 + 1e-9
    surface = ((t.time > 310.0) & (t.time < 420.0)) | (t.time > 4020.0)
    assert np.abs(t.height[surface]).max() <= swell
    assert 0.4 < np.abs(t.height[t.time < 300.0]).max() <= 0.5 + 1e-9
    body = Rotation.from_quat(t.q_nb)
    pitch = body.as_euler("ZYX", degrees=True)[:, 1]
    close(pitch[below], 0.0, atol=1e-9)
    diving = (t.time > 505.0) & (t.time < 560.0)  # the swell is gone
    close(pitch[diving], 12.0, atol=1e-6)  # bow down
    # it moves along its bow; the plane bends by 1e-4 rad
    v = body[np.flatnonzero(diving)].inv().apply(t.velocity_n[diving])
    close(v[:, 1:], 0.0, atol=1e-3)


def test_dive_runs_parallel_legs() -> None:
    t = _dive().trajectory
    place = (t.position_e - t.position_e[0]) @ earth.enu_axes(t.origin.lat, t.origin.lon)
    yaw = np.unwrap(Rotation.from_quat(t.q_nb).as_euler("ZYX")[:, 0])
    rate = np.gradient(yaw, t.time)  # meridians converge: 4e-7 rad/s
    on_leg = (np.abs(rate) < 1e-6) & (t.time > 430.0) & (t.time < 4000.0)
    starts = np.flatnonzero(np.diff(on_leg.astype(int)) == 1) + 1
    legs = [k for k in starts if on_leg[k : k + 1500].all()]
    assert len(legs) >= 13
    legs = legs[1:]  # the first begins in the swell
    along = np.array([math.cos(yaw[legs[0]]), math.sin(yaw[legs[0]])])
    across = np.array([-along[1], along[0]])
    offsets = place[legs, :2] @ across
    close(np.abs(np.diff(offsets)), 30.0, atol=0.03)  # yaw off by the meridians' convergence, 7e-5 rad of 300 m
    assert np.abs(offsets[-1] - offsets[0]) == pytest.approx(30.0 * (len(legs) - 1), abs=0.1)  # always on
    assert np.ptp(place[legs, :2] @ along) == pytest.approx(300.0, abs=1.0)  # 0.3 s of the turns' smooth ends


def test_dive_has_no_gnss_under_water_but_the_other_aids() -> None:
    s = _dive()
    seconds = seconds_of(s.fixes.stamps_ns)
    gap = np.argmax(np.diff(seconds))
    np.testing.assert_array_equal(np.diff(seconds)[[gap - 1, gap + 1]], 1.0)
    assert 420.0 < seconds[gap] < 435.0
    assert 4005.0 < seconds[gap + 1] < 4020.0
    assert (np.diff(np.delete(seconds, range(gap + 1))) == 1.0).all()  # none is missing before and after
    assert (np.diff(seconds[: gap + 1]) == 1.0).all()
    assert len(s.aids["log"].velocity) == len(s.aids["depth"].value) == 5 * 4140 + 1
    assert len(s.aids["range/vessel"].distance) == 4140 // 5 + 1
    assert 40.0 < s.aids["range/vessel"].distance.min() < s.aids["range/vessel"].distance.max() < 700.0
    assert s.aids["depth"].value.max() == pytest.approx(50.0, abs=0.4)  # noise, the lever arm in the swell


def test_dive_aligns_in_swell_with_a_turn() -> None:
    short: dict[str, Any] = {"duration": 310.0}
    yaw = {
        deg: np.unwrap(Rotation.from_quat(_dive(**short, turn_deg=deg).trajectory.q_nb).as_euler("ZYX")[:, 0])
        for deg in (0.0, 180.0, -90.0)
    }
    for deg, angle in yaw.items():
        # meridians converge by 1e-7 rad within the swell
        assert math.degrees(angle[2900] - angle[0]) == pytest.approx(deg, abs=1e-4)
        close(np.degrees(angle[:1501]), 60.0, atol=1e-4)
    roll = Rotation.from_quat(_dive(**short, turn_deg=0.0).trajectory.q_nb).as_euler("ZYX", degrees=True)[:, 2]
    # sampled every 0.1 s of 11 s
    assert np.abs(roll[:3000]).max() == pytest.approx(5.0, rel=2e-3)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"depth": 500.0, "dive_time": 600.0}, "dive_time 600 s is too short for 500 m: give 3157 s or more"),
        ({"height": 120.0}, "height 120 m differs from the height of the water, depth.surface_height 0 m; give both"),
        ({"turn_start": 290.0}, "goes beyond alignment_time 300 s"),
    ],
)
def test_an_impossible_dive_is_explained(parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        simulate("auv_dive", **DIVE, **parameters)


def test_a_short_shallow_dive() -> None:
    lake: dict[str, Any] = {"height": 120.0, "depth.surface_height": 120.0}
    s = simulate("auv_dive", **DIVE, **lake, depth=2.0, dive_time=60.0, alignment_time=30.0, turn_deg=0.0)
    assert s.trajectory.height.min() == pytest.approx(118.0, abs=1e-9)
    assert np.abs(s.trajectory.height[-100:] - 120.0).max() < 0.16
    assert s.aids["depth"].value.max() == pytest.approx(2.0, abs=0.4)  # noise, and the gauge 0.1 m up
    assert 150 < len(s.fixes.lat) < 330 - 30
