"""Zero velocity at stops: what it corrects, and what it must not erase."""

import functools
from typing import Any

import pytest
from zupt_harness import PERFECT, Fed, driven

from ins_nav.simulation.motion import Route
from ins_nav.simulation.scenarios import Simulation, simulate


@functools.cache
def _drive(**errors: Any) -> Simulation:
    """Stands for 30 s, stops from 120 to 140 s and from 232 to 262 s."""
    return simulate("vehicle", 0, duration=300.0, stand_time=30.0, rate=50.0, **PERFECT, **errors)


VEHICLE = {"initial.heading_deg": 30.0, "initial.heading_stddev_deg": 0.0, "alignment.level_duration": 10.0}


@pytest.mark.parametrize(
    ("errors", "sigmas"),
    [
        ({"imu.accel_bias_ug": (1000.0, 1000.0, 0.0)}, {"imu.accel_bias_stddev_mg": 1.0}),
        ({"imu.gyro_bias_deg_per_hour": (1.0, 1.0, 1.0)}, {"imu.gyro_bias_stddev_deg_per_hour": 1.0}),
    ],
    ids=["accelerometers", "gyros"],
)
def test_zero_velocity(errors: dict[str, Any], sigmas: dict[str, Any]) -> None:
    free = Fed(_drive(**errors), VEHICLE | sigmas | {"zupt.zero_velocity": False})
    held = Fed(_drive(**errors), VEHICLE | sigmas)
    for time, gain in ((130.0, 1.4), (260.0, 20.0)):
        free.to(time)
        held.to(time)
        # a correction a second, 2 to 3 s late: the acceleration left, 0.02 m/s² after a turn, for that time
        assert held.velocity() < 0.1 < 0.3 < free.velocity()
        # what is left after the first stop is the shape of the error's growth, unknown; measured 1.5 and 6.5, 75 and 14
        assert held.position() * (gain if time < 200.0 else 10.0) < free.position()
    assert not free.navigator.delayed.records
    held.call("zupt2")
    assert held.to(262.0).velocity() < 0.1


def test_zero_velocity_leaves_a_perfect_imu_as_it_is() -> None:
    fed = Fed(_drive(), VEHICLE)
    errors = [fed.to(time).position() for time in (60.0, 110.0, 130.0, 200.0, 250.0, 300.0)]
    assert max(errors) < 0.01  # wanted; 6 cm without zero velocity at the end


@pytest.mark.parametrize("preset", ["perfect", "navigation"])
@pytest.mark.parametrize(("speed", "allowed"), [(0.15, 0.3), (0.3, 0.1)])
def test_a_slow_smooth_start_is_not_erased(speed: float, allowed: float, preset: str) -> None:
    """A creep of 44 s without any shaking: 7 m and 13 m."""
    fed = Fed(_creep(speed, preset), VEHICLE | {"initial.heading_deg": 45.0})
    # it is noticed when stop.max_speed, 0.1 m/s, is passed; before that some mm/s are taken for error
    assert max(fed.to(time).position() for time in (70.0, 90.0, 104.0, 120.0, 138.0)) < allowed


def test_a_creep_slower_than_what_counts_as_travelling_is_a_rest() -> None:
    """`stop.max_speed` says so; a base that may drift unfelt goes without zero velocity."""
    parameters = VEHICLE | {"initial.heading_deg": 45.0}
    erased = Fed(_creep(0.05, "perfect"), parameters).to(138.0)
    assert erased.position() == pytest.approx(0.05 * 44.0, abs=0.05)
    free = Fed(_creep(0.05, "perfect"), parameters | {"zupt.zero_velocity": False}).to(138.0)
    assert free.position() < 0.02  # 1e-7 rad of the plumb line: g t²/2 = 9 mm


@functools.cache
def _creep(speed: float, preset: str) -> Simulation:
    def route(r: Route) -> None:
        r.hold(60.0)
        r.reach(speed, 4.0)
        r.hold(40.0)
        r.reach(0.0, 4.0)
        r.hold(30.0)

    return driven(route, road=0.0, **{"imu.preset": preset})
