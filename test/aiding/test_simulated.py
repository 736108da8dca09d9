"""Common parts of simulated readings: instants, windows, outliers, turned vectors, random numbers by name."""

import math

import numpy as np
import pytest
from simulation_harness import path, stamps_of

from ins_nav.aiding import simulated
from ins_nav.aiding.depth import SimulatedDepth
from ins_nav.aiding.simulated import World
from ins_nav.errors import InsNavError
from ins_nav.simulation.parameters import SHARED, resolved


def _world(seed: int = 0, **parameters: object) -> World:
    t = path()
    values = resolved("test", SHARED, {"rate": 20.0, **parameters})
    origin = (t.origin.lat, t.origin.lon, t.origin.height)
    return World(values, t, stamps_of(t), seed, origin, lambda *_: t)


def test_instants_are_the_nearest() -> None:
    time = np.linspace(0.0, 10.0, 201)
    np.testing.assert_array_equal(simulated.instants(time, 5.0, "x"), np.arange(0, 201, 4))
    np.testing.assert_array_equal(simulated.instants(time, 0.3, "x"), [0, 67, 133, 200])
    assert len(simulated.instants(time, 0.0, "x")) == 0
    with pytest.raises(InsNavError, match="x 21 Hz is above the IMU's rate"):
        simulated.instants(time, 21.0, "x")


def test_random_numbers_are_those_of_name_and_seed() -> None:
    draw = _world().stream("a").standard_normal()
    assert draw == _world().stream("a").standard_normal()
    assert len({draw, _world().stream("b").standard_normal(), _world(1).stream("a").standard_normal()}) == 3
    with pytest.raises(InsNavError, match="negative"):
        simulated.stream(-1, "a")


def test_windows() -> None:
    time = np.arange(10.0)
    assert np.flatnonzero(simulated.within(time, 2.0, 3.0)).tolist() == [2, 3, 4]
    assert np.flatnonzero(simulated.within(time, 1.0, 1.0, 4.0)).tolist() == [1, 5, 9]
    assert not simulated.within(time, 2.0, 0.0).any()


def test_outliers() -> None:
    wrong, size = _world().outliers("x", 0.2, (1.0, 2.0), "x", 5000)
    assert wrong.mean() == pytest.approx(0.2, abs=0.03)  # five sigma
    assert 1.0 <= size.min() < size.max() <= 2.0
    with pytest.raises(InsNavError, match=r"x_span: \[2, 1\] goes down"):
        _world().outliers("x", 0.2, (2.0, 1.0), "x", 5)


def test_sections_are_in_si_units() -> None:
    section = _world(**{"depth.lever_arm": (1.0, 2.0, 3.0), "depth.surface_height": 7.0}).section(
        SimulatedDepth, "depth"
    )
    assert (section.lever_arm, section.surface_height) == ((1.0, 2.0, 3.0), 7.0)


def test_a_place_on_the_body() -> None:
    """Its velocity is the derivative of its height and place."""
    world, index, arm = _world(), np.array([200, 201, 202]), (1.0, -2.0, 3.0)
    up = simulated.turned(path().q_nb[index], world.velocity_body(index, arm))[:, 2]
    height = world.height(index, arm)
    # central difference over 0.1 s: h² / 6 of the third derivative, 3 m * (2 pi / 9 s)^3 * 0.3
    assert (height[2] - height[0]) / 0.1 == pytest.approx(up[1], abs=3e-3)
    assert simulated.turned(np.zeros((0, 4)), arm).shape == (0, 3)


def test_moved_by_metres() -> None:
    lat, lon, height = simulated.moved(
        np.array([0.0, 0.5 * math.pi]), np.zeros(2), np.zeros(2), np.array([[6.378137, 0.0, 1.0], [0.0, 10.0, 0.0]])
    )
    assert lon[0] == pytest.approx(1e-6) and height[0] == 1.0
    assert lat[1] == pytest.approx(0.5 * math.pi - 10.0 / 6.4e6, abs=1e-8)
