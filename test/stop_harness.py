"""Streams of simulated and recorded IMUs through the stop detector."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ins_nav.config.sections import ImuSection
from ins_nav.event_log import EventLog
from ins_nav.mechanization.imu_stream import ImuStream
from ins_nav.simulation import scenarios
from ins_nav.simulation.motion import Motion, Route
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.stop_detection.detector import StopDetector


class Stop(NamedTuple):
    """Times from the start of the recording, s."""

    began: float
    ended: float
    declared: float
    revoked: float


def samples(simulation: Simulation) -> list[tuple[int, list[float]]]:
    rows = np.hstack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
    return list(zip(simulation.stamps_ns.tolist(), rows, strict=True))


def run(messages: list[tuple[int, list[float]]], detector: StopDetector | None = None) -> list[Stop]:
    """Stops found in a stream of stamps and values; one that lasts to the end ends there."""
    detector = detector or StopDetector()
    stream = ImuStream(EventLog(), ImuSection())
    start, open_stop, found = messages[0][0], None, []
    for stamp, row in messages:
        for taken, sample in stream.accept(stamp, *row):
            if isinstance(sample, float):
                detector.restart()
                continue
            change = detector.add(taken, sample)
            if change is None:
                continue
            seconds = (change.stamp_ns - start) * 1e-9, (change.decided_ns - start) * 1e-9
            if change.stopped:
                assert open_stop is None
                open_stop = seconds
            else:
                assert open_stop is not None
                found.append(Stop(open_stop[0], seconds[0], open_stop[1], seconds[1]))
                open_stop = None
    if open_stop is not None:
        end = (messages[-1][0] - start) * 1e-9
        found.append(Stop(open_stop[0], end, open_stop[1], end))
    return found


def driven(make: Callable[[Route], None], preset: str, rate: float, seed: int = 0) -> Simulation:
    """A car without any vibration on the route given."""
    route = Route(0.5)
    make(route)
    speed = route.speed

    def motion(_p: object) -> Motion:
        return Motion(route.time, speed=speed, yaw=route.yaw, pitch=-0.01 * speed.derivative())

    scenarios.scenario("Test.", {})(motion)
    try:
        return simulate("motion", seed, duration=route.time, rate=rate, **{"imu.preset": preset})
    finally:
        del scenarios.SCENARIOS["motion"]
