"""Runs for the tests of calibration at stops: a navigator fed with a simulation, the paper's run, routes of a car."""

import copy
import functools
import math
import pickle
from collections.abc import Callable
from typing import Any, Self

import numpy as np
from navigators import Ins
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import earth, nav_state
from ins_nav.simulation import scenarios
from ins_nav.simulation.motion import Motion, Route, sinusoid
from ins_nav.simulation.scenarios import Simulation, simulate

Array = np.ndarray


DEG_PER_HOUR = math.radians(1.0) / 3600.0
ARC_SECOND = math.radians(1.0 / 3600.0)
DRIFT = np.array([-1e-7, -1e-7, 1e-7])
"""rad/s: as in the paper."""
BIASED = {"imu.gyro_bias_deg_per_hour": tuple((DRIFT / DEG_PER_HOUR).tolist())}
PERFECT = {"imu.preset": "perfect"}
ON_CALL = {"zupt.zero_velocity": False}
WIDE = {"imu.accel_bias_stddev_mg": 0.0, "imu.gyro_bias_stddev_deg_per_hour": 0.05}
"""Drifts of 0.02 °/h are there; at sigmas of that size the prior would hold them back by some tenths of a percent."""
NO_WALK = {"imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 0.0}
ONE_METRE = np.eye(3).ravel()
KNOWN = WIDE | {
    "initial.heading_deg": 45.0,
    "initial.heading_stddev_deg": 0.0,
    "alignment.level_duration": 40.0,
}
SETTLED = 5.0
"""s after a call: delay 2.2 s, whole seconds of data, corrections half a second apart, applied 1 s later."""
HZ = 25.0
"""Enough for standing, and for perfect sensors on a road; whoever rocks or drives with zero velocity has 50."""


class Fed:
    """A navigator, fed with a simulation up to the time asked for."""

    def __init__(self, s: Simulation, parameters: dict[str, Any]) -> None:
        p = s.parameters
        place = {"latitude_deg": p["lat_deg"], "longitude_deg": p["lon_deg"], "height": p["height"]}
        self.navigator = Ins({f"initial.{name}": x for name, x in place.items()} | parameters)
        self.s = s
        self._rows = np.c_[s.angular_velocity, s.linear_acceleration].tolist()
        self._next = 0

    def to(self, time: float, skip: bool = False) -> Self:
        """Feed what comes until then, s from the start of the simulation; or leave it out."""
        until = round(time * self.s.parameters["rate"])
        if not skip:
            stamps = self.s.stamps_ns[self._next : until].tolist()
            for stamp, row in zip(stamps, self._rows[self._next : until], strict=True):
                self.navigator.add_imu(stamp, *row)
        self._next = until
        return self

    def fork(self) -> Self:
        """Another in the same state."""
        other = copy.copy(self)
        other.navigator = pickle.loads(pickle.dumps(self.navigator))  # ten times faster than deepcopy
        return other

    def settle(self) -> Self:
        """Feed what comes until the call before is in the solution: the filter's delay and aiding.feedback_time."""
        return self.to(self._next / self.s.parameters["rate"] + SETTLED)

    def call(self, service: str) -> str:
        """Call a service that does it."""
        done, text = getattr(self.navigator, service)()
        assert done, text
        return str(text)

    def refused(self, service: str) -> str:
        """Call a service that refuses; half a second on the solution is bit for bit that without the call."""
        without = self.fork()
        done, text = getattr(self.navigator, service)()
        assert not done
        assert self.navigator.events.counts[f"{service} refused"] == 1
        time = self._next / self.s.parameters["rate"] + 0.5
        for fed in (self, without):
            fed.to(time)
        assert self.navigator.state == without.navigator.state
        assert self.navigator.gyro_bias == without.navigator.gyro_bias
        assert self.navigator.changes == without.navigator.changes
        return str(text)

    @property
    def bias(self) -> Array:
        return np.array(self.navigator.gyro_bias)

    def within_sigmas(self, most: float = 3.0) -> None:
        """The drifts are within so many of their sigmas."""
        sigma = np.sqrt(np.diag(self.navigator.gyro_bias_covariance))
        np.testing.assert_array_less(np.abs(self.bias - DRIFT), most * sigma)

    @property
    def solution(self) -> nav_state.Geodetic:
        assert self.navigator.state is not None
        return nav_state.geodetic(self.navigator.state)

    def rotation(self) -> Array:
        """Attitude found less true on east, north, up, arc seconds."""
        found = Rotation.from_quat(self.solution.q_gb) * Rotation.from_quat(self.s.trajectory.q_nb[self._next]).inv()
        return np.asarray(found.as_rotvec() / ARC_SECOND, float)

    def position(self) -> float:
        """Distance from the truth, horizontally, m."""
        t, here = self.s.trajectory, self.solution
        true = earth.geodetic_to_ecef(t.lat[self._next], t.lon[self._next], here.height)
        return float(np.linalg.norm(earth.geodetic_to_ecef(here.lat, here.lon, here.height) - true))

    def velocity(self) -> float:
        """Horizontal error, m/s."""
        return math.dist(self.solution.velocity_g[:2], self.s.trajectory.velocity_n[self._next, :2])


@functools.cache
def paper(name: str = "zupt2_stop", **parameters: float) -> Simulation:
    return simulate(name, 0, **{"duration": 260.0, "rate": HZ, **parameters})


def driven(make: Callable[[Route], None], road: float = 5e-4, **parameters: Any) -> Simulation:
    """A car on the route given, starting at 60° north with heading 45°; the road shakes it, s of its speed at 3 Hz."""
    route = Route(math.radians(45.0))
    make(route)

    def motion(_p: object) -> Motion:
        return Motion(route.time, speed=route.speed, yaw=route.yaw, z=route.speed * sinusoid(road, 1.0 / 3.0))

    scenarios.scenario("Test.", {})(motion)
    given = {"imu.preset": "perfect", "rate": HZ, "lat_deg": 60.0, **parameters}
    try:
        return simulate("motion", 0, duration=route.time, **given)
    finally:
        del scenarios.SCENARIOS["motion"]


@functools.cache
def two_positions() -> Simulation:
    """Position 1 from 60 s on, position 2 from 215 s on, after a turn by -120°; neither is that of the alignment."""

    def route(r: Route) -> None:
        r.hold(30.0)
        r.reach(5.0, 10.0)
        r.hold(10.0)
        r.reach(0.0, 10.0)
        r.hold(120.0)
        r.reach(3.0, 10.0)
        r.turn(math.radians(-120.0), 15.0)
        r.reach(0.0, 10.0)
        r.hold(130.0)

    return driven(route, **BIASED, rate=50.0)


TWO = WIDE | {
    "initial.heading_deg": 45.2,
    "initial.heading_stddev_deg": 0.5,
    "alignment.level_duration": 10.0,
}
"""A heading that is off by 0.2°."""
