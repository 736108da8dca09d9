"""Turns of a carrier that stands: detected, and distinguished from swaying."""

import math

import pytest
from stop_harness import driven, run, samples

from ins_nav.simulation import scenarios
from ins_nav.simulation.motion import Motion, Route, Signal, sinusoid
from ins_nav.simulation.scenarios import simulate


@pytest.mark.parametrize("radius", [0.0, 5.0])
@pytest.mark.parametrize(
    ("preset", "rate", "late"),
    # how long a turn hides in the noise of the gyros: by 0.5 s it is at 0.0025°, by 1 s at 0.04°
    [("perfect", 50.0, 0.3), ("navigation", 200.0, 0.4), ("fog_auv", 100.0, 0.5), ("tactical", 50.0, 1.0)]
    + [("mems", rate, 1.3) for rate in (50.0, 200.0)],
)
def test_turn_between_two_positions(preset: str, rate: float, late: float, radius: float) -> None:
    """On the spot, or on a small circle: two stops without any observable part of the turn."""
    stand = {"first_stop": 40.0, "second_stop": 30.0, "duration": 90.0, "turn_radius": radius}
    first, second = run(samples(simulate("zupt1_two_positions", 1, rate=rate, **stand, **{"imu.preset": preset})))
    assert first.began < 0.3
    assert first.ended == pytest.approx(40.0, abs=late)
    assert first.revoked < 46.0  # 6° at 4.3 s
    assert second.began == pytest.approx(60.0, abs=late)
    assert second.declared < 62.5
    assert second.ended > 89.0


@pytest.mark.parametrize(("preset", "late"), [("perfect", 0.5), ("navigation", 1.2), ("mems", 6.0)])
def test_slow_turn(preset: str, late: float) -> None:
    """90° in 60 s: 0.003° by 3.3 s, 0.03° by 6 s."""
    turn = {"turn_radius": 0.0, "turn_deg": -90.0, "turn_time": 60.0, "first_stop": 60.0, "second_stop": 30.0}
    first, second = run(
        samples(simulate("zupt1_two_positions", 1, duration=150.0, rate=50.0, **turn, **{"imu.preset": preset}))
    )
    assert first.ended == pytest.approx(60.0, abs=late)
    assert first.revoked < 78.0  # 8° at 17 s
    assert second.began == pytest.approx(120.0, abs=late)
    assert second.declared < 122.5
    assert second.ended > 149.0


@pytest.mark.parametrize("preset", ["perfect", "tactical", "mems"])
def test_tilt_on_the_spot(preset: str) -> None:
    """Pitch goes to 20° in 20 s: detected when it is still again, from 2 s before the smooth end on."""
    tilt = {"turn_radius": 0.0, "turn_deg": 0.0, "tilt_deg": 20.0, "first_stop": 40.0, "second_stop": 30.0}
    first, second = run(
        samples(simulate("zupt1_two_positions", 1, duration=90.0, rate=50.0, **tilt, **{"imu.preset": preset}))
    )
    assert first.ended == pytest.approx(40.0, abs=2.5)  # 0.17° by then
    assert second.began == pytest.approx(60.0, abs=2.5)
    assert second.declared < 62.5
    assert second.ended > 89.0


@pytest.mark.parametrize("preset", ["navigation", "mems"])
def test_yawing_is_no_turn(preset: str) -> None:
    """4° to both sides, as at anchor, with roll and pitch; the bias of mems is learnt at the same time."""

    def anchored(_p: object) -> Motion:
        def swing(degrees: float, period: float) -> Signal:
            return sinusoid(math.radians(degrees), period)

        return Motion(120.0, yaw=swing(4.0, 17.0), pitch=swing(2.0, 7.0), roll=swing(3.0, 9.0))

    scenarios.scenario("Test.", {})(anchored)
    try:
        swings = simulate("anchored", 1, duration=120.0, rate=25.0, **{"imu.preset": preset})
    finally:
        del scenarios.SCENARIOS["anchored"]
    assert [(stop.declared < 15.0, stop.ended > 119.0) for stop in run(samples(swings))] == [(True, True)]


def test_turning_on_the_spot_is_not_a_stop() -> None:
    def turntable(route: Route) -> None:
        route.hold(20.0)
        route.turn(math.radians(360.0), 60.0)
        route.hold(20.0)

    turns = samples(driven(turntable, "navigation", 50.0))
    first, second = run(turns)
    assert first.revoked < 35.0 and second.declared > 80.0
    # a detector started in the turn finds no stop
    assert run([m for m in turns if 35.0 < (m[0] - scenarios.START_NS) * 1e-9 < 65.0]) == []
