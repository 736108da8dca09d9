"""Velocity since the last rest: reset where it diverges, rest found from any start."""

import pytest
from stop_harness import driven, run, samples

from ins_nav.simulation.motion import Route
from ins_nav.simulation.scenarios import simulate


def test_a_wrong_gyro_bias_is_reset() -> None:
    """A gyro that jumps by 0.57°/s at a stop: velocity runs away, by g w t²/2 to 150 m/s within 55 s."""
    standing = samples(simulate("static", 1, duration=180.0, rate=25.0))
    jumps = [(stamp, [row[0] + (0.01 if i > 1500 else 0.0), *row[1:]]) for i, (stamp, row) in enumerate(standing)]
    before, after = run(jumps)
    assert before.ended == pytest.approx(60.0, abs=1.5)
    assert after.declared < 60.0 + 55.0 + 5.0
    assert after.ended > 179.0


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
