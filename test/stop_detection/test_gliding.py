"""A carrier that glides without shaking is not stationary."""

import math

import pytest
from stop_harness import driven, run, samples

from ins_nav.simulation.motion import Route
from ins_nav.simulation.scenarios import simulate


@pytest.mark.parametrize(("preset", "rate", "duration"), [("navigation", 100.0, 60.0), ("mems", 50.0, 20.0)])
@pytest.mark.parametrize("start", [1.0, 4.0])
def test_creep_is_not_a_stop(preset: str, rate: float, duration: float, start: float) -> None:
    """0.3 m/s, perfectly even; while the sensors observe it: velocity of mems drifts by 0.1 m/s in half a minute."""

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


@pytest.mark.parametrize("preset", ["perfect", "navigation", "tactical", "mems"])
@pytest.mark.parametrize(
    ("speed", "change", "glide", "turn"),
    # a short drive, a robot's, a tram's; then glides that are no stops, before and after a turn
    [(3.0, 5.0, 0.0, 120.0), (0.3, 4.0, 10.0, 90.0), (5.0, 10.0, 20.0, 90.0), (2.0, 6.0, 150.0, 0.0)]
    + [(12.0, 15.0, 100.0, -60.0)],
)
def test_smooth_drive(speed: float, change: float, glide: float, turn: float, preset: str) -> None:
    """No shaking: velocity alone distinguishes gliding from standing, also after a turn has mixed tilt and biases."""

    def drive(route: Route) -> None:
        route.hold(60.0)
        route.reach(speed, change)
        route.hold(glide)
        if turn:
            route.turn(math.radians(turn), 10.0)
            route.hold(glide)
        route.reach(0.0, change)
        ends.append(route.time)
        route.hold(20.0)

    ends: list[float] = []
    first, second = run(samples(driven(drive, preset, 50.0)))
    assert first.ended == pytest.approx(60.0, abs=0.4 * change)
    assert second.began > ends[0] - 0.4 * change  # below 0.1 of the speed
    assert second.declared < ends[0] + 5.0
    assert second.ended > ends[0] + 19.0


@pytest.mark.parametrize("preset", ["perfect", "navigation", "tactical", "mems"])
def test_smooth_drive_right_after_a_turn(preset: str) -> None:
    """The stop after the turn is so short that a part of the start is in it; the next is found all the same."""
    drive = {"first_stop": 60.0, "turn_deg": 90.0, "drive_time": 30.0, "second_stop": 30.0}
    found = run(
        samples(simulate("zupt1_two_positions", 1, duration=140.0, rate=50.0, **drive, **{"imu.preset": preset}))
    )
    last = found[-1]
    assert all(stop.revoked < 83.0 for stop in found[:-1])  # drives off at 80 s, 0.64 m/s at 83 s
    assert 107.0 < last.began and last.declared < 115.0  # stands from 110 s on
    assert last.ended > 138.0
