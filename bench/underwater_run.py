"""A navigator fed with a simulated mission under water, message by message, and its errors."""

import copy
import functools
import heapq
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from bench.underwater_bound import Prior
from ins_nav.aiding.acoustic_range import range_message
from ins_nav.aiding.depth import depth_message
from ins_nav.aiding.simulated import fix_message, velocity_message
from ins_nav.config.parameters import read_file
from ins_nav.estimation.error_model import azimuth
from ins_nav.mechanization import earth, nav_state
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.system import FilterSystem
from ins_nav.recordings.bags import message
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.simulation.sensors import PRESETS

Array = NDArray[np.float64]
Given = tuple[tuple[str, Any], ...]
"""Parameters, hashable."""
Message = tuple[int, str, tuple[Any, ...]]
"""Stamp, aid, content."""
MOST_SEEDS = 1024
RATE = 20.0
"""Hz, of the IMU: the densities of its noises stay."""
LAG = 2.5
"""s by which the last solution is older than the last sample."""
TIME, EAST, NORTH, UP, SIGMA, SIGMA_UP, NEES = range(7)
"""Columns of `Run.errors`: errors and sigmas, m; SIGMA is that of the horizontal distance, NEES of two components."""
_CONFIG = Path(__file__).resolve().parents[1] / "config" / "auv.yaml"
_MOTION: dict[str, Any] = {"rate": RATE, "log.rate": 1.0, "depth.rate": 1.0}
_EVERY = 10.0
"""s between two rows of errors."""


_UNIT = PRESETS["fog_auv"]
LOG_SCALE, LOG_ANGLE = 0.002, 0.1
"""One sigma of what is drawn: scale, and deg."""
_RANGE_SCALE, _RANGE_BIAS = 0.002, 1.0
"""The same of the ranges; m."""
_DRAWS = 11


@functools.lru_cache(2)
def noiseless(motion: Given) -> Simulation:
    """The mission, to be redrawn."""
    return simulate("auv_dive", 0, **_MOTION, **dict(motion))


class Run:
    """A navigator fed with a simulation."""

    def __init__(self, simulation: Simulation, parameters: Mapping[str, Any], skip: Sequence[str] = ()) -> None:
        self.simulation = simulation
        self.system = FilterSystem(read_file(_CONFIG, "ins_node") | dict(parameters))
        self.rows: list[list[float]] = []
        self._samples = np.column_stack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
        self._stamps = simulation.stamps_ns.tolist()
        self._aids = messages(simulation, skip)
        self._sample = self._aid = 0

    @property
    def navigator(self) -> DelayedNavigator:
        """The filter."""
        return self.system.delayed

    def fork(self) -> "Run":
        """Another that goes on from here."""
        other = copy.copy(self)
        other.system = copy.deepcopy(self.system)
        other.rows = list(self.rows)
        return other

    def change(self, name: str, function: Callable[[tuple[Any, ...]], tuple[Any, ...]]) -> None:
        """Another content for the messages still to come of an aid."""
        left = [
            (stamp, of, function(values) if of == name else values) for stamp, of, values in self._aids[self._aid :]
        ]
        self._aids, self._aid = left, 0

    def until(self, time: float, every: float = _EVERY) -> "Run":
        """Go on to a time of the solution, s, and look at the errors now and then."""
        system, navigator, start_ns = self.system, self.navigator, self.simulation.start_ns
        end_ns, every_ns = start_ns + round(time * 1e9), round(every * 1e9)
        due_ns = start_ns if not self.rows else start_ns + round((self.rows[-1][0] + every) * 1e9)
        aids = self._aids
        for k in range(self._sample, len(self._stamps)):
            stamp_ns = self._stamps[k]
            system.add_imu(stamp_ns, *self._samples[k])
            navigator.drain()
            while self._aid < len(aids) and aids[self._aid][0] <= stamp_ns:
                aid_ns, name, values = aids[self._aid]
                system.add(*_message(aid_ns, name, values))
                self._aid += 1
            self._sample = k + 1
            if navigator.filter is None:
                continue
            if navigator.settled_ns >= due_ns:
                due_ns += every_ns * (1 + (navigator.settled_ns - due_ns) // every_ns)
                self.rows.append(self.errors())
            if navigator.settled_ns >= end_ns:
                break
        return self

    def errors(self) -> list[float]:
        """Of the solution at present; columns above."""
        navigator, path, found = self.navigator, self.simulation.trajectory, self.navigator.filter
        assert navigator.state is not None and found is not None
        i = int(np.searchsorted(self.simulation.stamps_ns, navigator.settled_ns)) + 1
        solution = nav_state.geodetic(navigator.state)
        meridian, prime_vertical = earth.principal_radii(math.sin(path.lat[i]))
        east = (solution.lon - path.lon[i]) * (prime_vertical + path.height[i]) * math.cos(path.lat[i])
        north = (solution.lat - path.lat[i]) * (meridian + path.height[i])
        c, s = azimuth(navigator.state)
        error, p = np.array([c * east + s * north, c * north - s * east]), found.p[:2, :2]
        return [
            (navigator.settled_ns - self.simulation.start_ns) * 1e-9,
            *(east, north, solution.height - path.height[i]),
            *(math.sqrt(p[0, 0] + p[1, 1]), math.sqrt(found.p[2, 2]), float(error @ np.linalg.solve(p, error))),
        ]


def messages(simulation: Simulation, skip: Sequence[str] = ()) -> list[Message]:
    """Stamp, aid and content of all, in order, but of the aids to skip."""
    aids = simulation.aids
    streams: list[list[Message]] = []

    def add(name: str, stamps: NDArray[np.int64], values: Sequence[tuple[Any, ...]]) -> None:
        if name not in skip:
            streams.append([(stamp, name, value) for stamp, value in zip(stamps.tolist(), values, strict=True)])

    def diagonal(stddev: Sequence[float]) -> tuple[float, ...]:
        return tuple(np.diag(np.square(stddev)).ravel().tolist())

    floating = {topic.split("/")[1]: fixes for topic, fixes in aids.items() if topic.startswith("beacon/")}
    fixes = [aids["gnss/fix"], *floating.values()]
    names: list[tuple[Any, ...]] = [(), *((name,) for name in floating)]
    for fix, name in zip(fixes, names, strict=True):
        places = np.column_stack([np.degrees(fix.lat), np.degrees(fix.lon), fix.height]).tolist()
        covariance = diagonal(fix.stddev)
        add("beacon" if name else "fix", fix.stamps_ns, [(*name, 0, *place, covariance) for place in places])
    log = aids["log"]
    velocities = zip(log.velocity.tolist(), log.stddev.tolist(), strict=True)
    add("log", log.stamps_ns, [(tuple(velocity), diagonal([stddev] * 3)) for velocity, stddev in velocities])
    add(
        "depth", aids["depth"].stamps_ns, [(depth, aids["depth"].stddev ** 2) for depth in aids["depth"].value.tolist()]
    )
    for topic, ranges in aids.items():
        prefix, _, beacon = topic.partition("/")
        if prefix == "range":
            add("range", ranges.stamps_ns, [(beacon, x, ranges.stddev**2) for x in ranges.distance.tolist()])
    return list(heapq.merge(*streams, key=lambda item: item[0]))


def _message(stamp_ns: int, name: str, values: tuple[Any, ...]) -> tuple[str, Any]:
    """Topic and message."""
    if name == "fix":
        return "gnss/fix", fix_message(message, stamp_ns, *values)
    if name == "beacon":
        return f"beacon/{values[0]}/fix", fix_message(message, stamp_ns, *values[1:])
    if name == "range":
        return f"range/{values[0]}", range_message(message, stamp_ns, *values[1:])
    make = velocity_message if name == "log" else depth_message
    return name, make(message, stamp_ns, *values)


@functools.lru_cache(1)
def _drawn() -> Array:
    """Normal constants of every seed, spread evenly: few seeds must do."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a first part of the sequence will do
        return np.asarray(qmc.MultivariateNormalQMC(np.zeros(_DRAWS), seed=1).random(MOST_SEEDS))


def errors_of(seed: int, log: bool = True) -> dict[str, Any]:
    """Constant errors of all sensors, for `Simulation.redrawn`; with a perfect log, but for its noise."""
    drawn = _drawn()[seed]
    unit = 1.0 if log else 0.0
    return {
        "imu.gyro_bias_deg_per_hour": tuple(_UNIT.gyro_bias_stddev_deg_per_hour * drawn[0:3]),
        "imu.gyro_bias_stddev_deg_per_hour": 0.0,
        "imu.accel_bias_ug": tuple(_UNIT.accel_bias_stddev_ug * drawn[3:6]),
        "imu.accel_bias_stddev_ug": 0.0,
        "log.scale": unit * LOG_SCALE * drawn[6],
        "log.scale_stddev": 0.0,
        "log.misalignment_deg": tuple(unit * LOG_ANGLE * drawn[7:9]),
        "log.misalignment_stddev_deg": 0.0,
        "range.scale": _RANGE_SCALE * drawn[9],
        "range.bias": _RANGE_BIAS * drawn[10],
    }


def prior(log_scale: float, log_angle_deg: float) -> Prior:
    """Priors of the filter."""
    angle = math.radians(log_angle_deg)
    return Prior(_UNIT.gyro.bias_stddev, _UNIT.accel.bias_stddev, log_scale, angle, _RANGE_SCALE, _RANGE_BIAS)


def filter_parameters(log_scale: float = LOG_SCALE, log_angle_deg: float = LOG_ANGLE) -> dict[str, Any]:
    """Parameters of the navigator for what is drawn."""
    return {"log.scale_stddev": log_scale, "log.misalignment_stddev_deg": log_angle_deg}
