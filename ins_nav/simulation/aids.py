"""Simulated aids along a trajectory: every aid of `ins_nav.aiding.registry` that declares simulated readings."""

import math
from collections.abc import Mapping
from typing import Any

from ins_nav.aiding.registry import aid_classes
from ins_nav.aiding.simulated import Stamps, World
from ins_nav.simulation.motion import Array, Motion, constant, sinusoid
from ins_nav.simulation.parameters import Values
from ins_nav.simulation.trajectory import EarthMotion, States, Trajectory


def measure_aids(parameters: Values, trajectory: Trajectory, stamps_ns: Stamps, seed: int) -> Mapping[str, Any]:
    """Draw what the aids measure along a trajectory.

    Parameters
    ----------
    parameters : mapping
        All of a simulation's, as `Simulation.parameters` has them.
    trajectory : Trajectory
        n + 1 instants.
    stamps_ns : ndarray, shape (n + 1,)
        Their stamps.
    seed : int
        Not negative.

    Returns
    -------
    mapping of topic to readings
        `ins_nav.aiding.simulated.Readings` of a class of each aid's own; without any where the aid's rate is 0.

    Raises
    ------
    InsNavError
        If an aid is faster than the trajectory, or its parameters do not fit together.
    """
    origin = trajectory.origin

    def circle(centre: tuple[float, float, float], radius: float, period: float, time: Array) -> States:
        east, north, up = centre
        motion = Motion(
            float(trajectory.time[-1]),
            yaw=constant(0.0),
            x=sinusoid(radius, period, 0.5 * math.pi) + east,
            y=sinusoid(radius, period) + north,
            z=constant(up),
        )
        return EarthMotion(motion, origin).states(time)

    world = World(parameters, trajectory, stamps_ns, seed, (origin.lat, origin.lon, origin.height), circle)
    return {topic: readings for kind in aid_classes() for topic, readings in kind.simulate(world).items()}
