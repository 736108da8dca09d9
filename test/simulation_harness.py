"""Motions over the ellipsoid, and simulated aids along one of them, for the tests of `ins_nav.simulation`."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ins_nav.simulation.aids import measure_aids
from ins_nav.simulation.motion import Motion, Route, constant, sinusoid
from ins_nav.simulation.parameters import SHARED, resolved
from ins_nav.simulation.scenarios import START_NS
from ins_nav.simulation.trajectory import EarthMotion, Origin, Trajectory

NS = 10**9


ORIGIN = Origin(math.radians(55.7), math.radians(37.6), -20.0)


EXACT: dict[str, Any] = {
    "gnss.rate": 5.0,
    "gnss.velocity_rate": 5.0,
    "gnss.velocity_stddev": 0.0,
    "log.rate": 5.0,
    "log.noise_stddev": 0.0,
    "depth.rate": 5.0,
    "depth.noise_stddev": 0.0,
    "pressure.rate": 5.0,
    "pressure.noise_stddev": 0.0,
    "beacon.names": "down, vessel",
    "beacon.positions": (0.0, 0.0, -120.0, 300.0, 400.0, -2.0),
    "beacon.radii": (0.0, 50.0),
    "beacon.fix_rates": (0.0, 1.0),
    "beacon.fix_stddev": 0.0,
    "range.rate": 5.0,
    "range.noise_stddev": 0.0,
}


@functools.cache
def swimmer() -> EarthMotion:
    """A body that turns about all axes under way, 20 m below the ellipsoid."""
    motion = Motion(
        60.0,
        speed=constant(1.5) + sinusoid(0.3, 13.0),
        yaw=constant(0.7) + sinusoid(0.5, 17.0),
        pitch=sinusoid(0.2, 11.0),
        roll=sinusoid(0.3, 9.0),
        z=sinusoid(2.0, 19.0),
    )
    return EarthMotion(motion, ORIGIN)


@functools.cache
def path() -> Trajectory:
    return swimmer().trajectory(20.0)


def measure(seed: int = 0, trajectory: Trajectory | None = None, **changes: Any) -> Mapping[str, Any]:
    t = path() if trajectory is None else trajectory
    p = resolved("test", SHARED, {**EXACT, "rate": 1.0 / t.interval, **changes})
    return measure_aids(p, t, stamps_of(t), seed)


def stamps_of(t: Trajectory) -> np.ndarray:
    return np.asarray(START_NS + np.rint(t.time * NS).astype(np.int64))


def of_beacons(aids: Mapping[str, Any], prefix: str) -> set[str]:
    """Names of the beacons with readings on topics of a prefix."""
    return {topic.split("/")[1] for topic in aids if topic.startswith(f"{prefix}/")}


def seconds_of(stamps_ns: np.ndarray) -> np.ndarray:
    return (stamps_ns - START_NS) / NS


DURATION = 60.0


close = functools.partial(np.testing.assert_allclose, rtol=0)


def car(height: float = 50.0) -> EarthMotion:
    route = Route(0.3)
    route.hold(5.0)
    route.reach(15.0, 10.0)
    route.turn(1.5, 8.0)
    route.turn(-2.0, 10.0)
    route.reach(0.0, 8.0)
    speed, yaw = route.speed, route.yaw
    motion = Motion(
        DURATION,
        speed=speed,
        yaw=yaw,
        pitch=-0.01 * speed.derivative(),
        roll=0.01 * speed * yaw.derivative(),
    )
    return EarthMotion(motion, Origin(math.radians(-33.0), math.radians(179.9), height))
