"""Simulated aids: log, depth and pressure gauges, ranges to acoustic beacons, velocity of the GNSS.

`measure_aids` draws all of them along a trajectory from the parameters of `ins_nav.simulation.parameters`. A sensor
measures at the trajectory's instants nearest to its own, and is where its lever arm puts it. Every error source draws
from a stream of its own, named after it, and draws for every instant, whether there is a reading then or not: what is
switched on or off leaves the other draws as they were.
"""

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ins_nav.errors import InsNavError
from ins_nav.mechanization import earth
from ins_nav.simulation.motion import Array, Motion, constant, sinusoid
from ins_nav.simulation.parameters import Values
from ins_nav.simulation.sensors import Fixes, GnssReceiver, instants, moved, stream
from ins_nav.simulation.trajectory import EarthMotion, Trajectory

Stamps = NDArray[np.int64]
Index = NDArray[np.int64]

_POSITIVE_OUTLIERS = 0.9
"""A reflected ray is longer than the direct one; what is left is noise taken for a reply."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class Velocities(NamedTuple):
    """Velocity of the GNSS antenna, m of them."""

    stamps_ns: Stamps
    velocity: Array
    """(m, 3), east, north, up, m/s."""
    stddev: float
    """Each axis, m/s."""


@dataclass(frozen=True)
class LogReadings:
    """Of a log: ``(1 + scale) v + (0, a_y, a_z) x v`` of the velocity v over ground, or through water, on its axes."""

    stamps_ns: Stamps
    velocity: Array
    """(m, 3), m/s; NaN or 0 while it has lost the bottom, if `lost` says so."""
    stddev: Array
    """(m,), of the noise, each axis, m/s."""
    scale: float
    """Given and drawn."""
    misalignment: tuple[float, float]
    """a_y and a_z, given and drawn, rad."""
    current: tuple[float, float]
    """Of the water it tracks, east, north, given and drawn, m/s."""


@dataclass(frozen=True)
class GaugeReadings:
    """Of a gauge, m of them: depth below the mean surface, m, down positive, or absolute pressure, Pa."""

    stamps_ns: Stamps
    value: Array
    """(m,)."""
    stddev: float
    """Of the noise."""
    bias: float
    """Given and drawn."""


@dataclass(frozen=True)
class RangeReadings:
    """Slant ranges to one beacon, m of them: ``(1 + scale) distance + bias``."""

    stamps_ns: Stamps
    """Of the replies' arrival, where stamps are late; else of the instants they are for."""
    distance: Array
    """(m,), m."""
    stddev: float
    """Of the noise, m."""
    limit: float
    """Largest range, m."""
    scale: float
    """Given and drawn."""
    bias: float
    """Given and drawn, m."""
    outlier: NDArray[np.bool_]
    """(m,)."""
    beacon: Fixes
    """Where the beacon was, exactly, at the instants the ranges are for."""


@dataclass(frozen=True)
class SimulatedAids:
    """Everything that aids measured in a simulation; without readings what is absent."""

    fixes: Fixes
    gnss_velocity: Velocities
    log: LogReadings
    depth: GaugeReadings
    pressure: GaugeReadings
    ranges: dict[str, RangeReadings]
    """By beacon; empty where there is no rate."""
    beacon_fixes: dict[str, Fixes]
    """By beacon; only of those which transmit any."""


def measure_aids(parameters: Values, trajectory: Trajectory, stamps_ns: Stamps, seed: int) -> SimulatedAids:
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

    Raises
    ------
    InsNavError
        If an aid is faster than the trajectory, or the beacons' parameters do not fit together.
    """
    p = parameters
    surface = p["depth.surface_height"]
    receiver = GnssReceiver(
        p["gnss.rate"],
        p["gnss.horizontal_stddev"],
        p["gnss.vertical_stddev"],
        p["gnss.lever_arm"],
        surface - p["gnss.lost_depth"],
    )
    # the weight of the water grows by 2e-7 of itself a metre: constant
    weight = p["pressure.density"] * float(earth.normal_gravity(math.sin(trajectory.origin.lat), surface))
    beacons = _beacons(p, trajectory)
    scale = p["range.scale"] + p["range.scale_stddev"] * float(stream(seed, "range.scale").standard_normal())
    return SimulatedAids(
        fixes=receiver.fixes(trajectory, stamps_ns, seed),
        gnss_velocity=_gnss_velocity(p, trajectory, stamps_ns, seed, receiver.lowest),
        log=_log(p, trajectory, stamps_ns, seed),
        depth=_gauge("depth", p, trajectory, stamps_ns, seed, 1.0, 0.0),
        pressure=_gauge("pressure", p, trajectory, stamps_ns, seed, weight, p["pressure.surface"]),
        ranges={b.name: _ranges(b, p, trajectory, stamps_ns, seed, scale) for b in beacons if p["range.rate"]},
        beacon_fixes={b.name: _beacon_fixes(b, p, trajectory, stamps_ns, seed) for b in beacons if b.fix_rate},
    )


def _gnss_velocity(p: Values, t: Trajectory, stamps_ns: Stamps, seed: int, lowest: float) -> Velocities:
    arm, stddev = p["gnss.lever_arm"], p["gnss.velocity_stddev"]
    index = instants(t, p["gnss.velocity_rate"], "gnss.velocity_rate")
    noise = stddev * stream(seed, "gnss.velocity").standard_normal((len(index), 3))
    velocity = _turned(t.q_nb[index], _velocity_body(t, index, arm)) + noise
    seen = _height(t, index, arm) >= lowest
    return Velocities(stamps_ns[index][seen], velocity[seen], stddev)


def _log(p: Values, t: Trajectory, stamps_ns: Stamps, seed: int) -> LogReadings:
    index = instants(t, p["log.rate"], "log.rate")
    count = len(index)
    scale = p["log.scale"] + p["log.scale_stddev"] * float(stream(seed, "log.scale").standard_normal())
    a = np.radians(p["log.misalignment_deg"])
    a += math.radians(p["log.misalignment_stddev_deg"]) * stream(seed, "log.misalignment").standard_normal(2)
    current = np.array(p["log.current"])
    current += p["log.current_stddev"] * stream(seed, "log.current").standard_normal(2)
    flow = _turned(t.q_nb[index], [*current, 0.0], inverse=True)
    roll, pitch, yaw = np.radians(p["log.mounting_rpy_deg"])
    body_to_sensor = Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv()
    true = body_to_sensor.apply(_velocity_body(t, index, p["log.lever_arm"]) - flow)
    speed = np.linalg.norm(true, axis=1)
    stddev = np.hypot(p["log.noise_stddev"], p["log.noise_per_speed"] * speed)
    velocity = (1.0 + scale) * true + np.cross([0.0, *a], true)
    velocity += stddev[:, None] * stream(seed, "log.noise").standard_normal((count, 3))
    wrong, size = _outliers("log.outlier", p, seed, "log", count)
    direction = stream(seed, "log.outlier_direction").standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    velocity += np.where(wrong, size, 0.0)[:, None] * direction
    lost = _within(t.time[index], p["log.lost_start"], p["log.lost_duration"], p["log.lost_period"])
    if p["log.lost"] != "silent":
        velocity[lost] = math.nan if p["log.lost"] == "nan" else 0.0
        lost[:] = False
    a_y, a_z = a.tolist()
    east, north = current.tolist()
    return LogReadings(stamps_ns[index][~lost], velocity[~lost], stddev[~lost], scale, (a_y, a_z), (east, north))


def _gauge(
    name: str, p: Values, t: Trajectory, stamps_ns: Stamps, seed: int, per_metre: float, at_surface: float
) -> GaugeReadings:
    index = instants(t, p[f"{name}.rate"], f"{name}.rate")
    stddev = p[f"{name}.noise_stddev"]
    bias = p[f"{name}.bias"] + p[f"{name}.bias_stddev"] * float(stream(seed, f"{name}.bias").standard_normal())
    depth = p["depth.surface_height"] - _height(t, index, p[f"{name}.lever_arm"])
    value = at_surface + per_metre * depth + bias + stddev * stream(seed, f"{name}.noise").standard_normal(len(index))
    lies = _within(t.time[index], p[f"{name}.lie_start"], p[f"{name}.lie_duration"])
    value[lies] += p[f"{name}.lie_offset"]
    return GaugeReadings(stamps_ns[index], value, stddev, bias)


@dataclass(frozen=True)
class _Beacon:
    name: str
    motion: EarthMotion
    fix_rate: float


def _beacons(p: Values, t: Trajectory) -> list[_Beacon]:
    names = [name for name in p["beacon.names"].split(", ") if name]
    for name in names:
        if not _NAME.fullmatch(name):
            raise InsNavError(f"beacon.names: {name!r} cannot be part of a topic; use letters, digits and _")
    if len(set(names)) < len(names):
        raise InsNavError(f"beacon.names: {p['beacon.names']} has a name twice; name each once")
    positions = p["beacon.positions"]
    if len(positions) != 3 * len(names):
        raise InsNavError(f"beacon.positions: {len(positions)} numbers for {len(names)} beacons; give three a beacon")
    # up is from the surface, wherever the trajectory's origin is
    up = p["depth.surface_height"] - t.origin.height
    beacons = []
    for k, name in enumerate(names):
        east, north, height = positions[3 * k : 3 * k + 3]
        radius = _each(p, "beacon.radii", names, k)
        period = 2.0 * math.pi * radius / p["beacon.speed"] if radius and p["beacon.speed"] else math.inf
        if math.isinf(period):
            radius = 0.0
        motion = Motion(
            float(t.time[-1]),
            yaw=constant(0.0),
            x=sinusoid(radius, period, 0.5 * math.pi) + east,
            y=sinusoid(radius, period) + north,
            z=constant(up + height),
        )
        beacons.append(_Beacon(name, EarthMotion(motion, t.origin), _each(p, "beacon.fix_rates", names, k)))
    return beacons


def _each(p: Values, name: str, beacons: list[str], k: int) -> float:
    """Of beacon k, from one number for each or one for all."""
    numbers = p[name]
    if len(numbers) not in (1, len(beacons)):
        raise InsNavError(f"{name}: {len(numbers)} numbers for {len(beacons)} beacons; give one a beacon, or one")
    return float(numbers[k if len(numbers) > 1 else 0])


def _ranges(beacon: _Beacon, p: Values, t: Trajectory, stamps_ns: Stamps, seed: int, scale: float) -> RangeReadings:
    source = f"range.{beacon.name}"
    index = instants(t, p["range.rate"], "range.rate")
    count, stddev = len(index), p["range.noise_stddev"]
    bias = p["range.bias"] + p["range.bias_stddev"] * float(stream(seed, f"{source}.bias").standard_normal())
    there = beacon.motion.states(t.time[index])
    here = t.position_e[index] + _turned(t.q_eb[index], p["range.lever_arm"])
    true = np.linalg.norm(here - there.position_e, axis=1)
    distance = (1.0 + scale) * true + bias + stddev * stream(seed, f"{source}.noise").standard_normal(count)
    wrong, size = _outliers("range.outlier", p, seed, source, count)
    sign = np.where(stream(seed, f"{source}.outlier_sign").random(count) < _POSITIVE_OUTLIERS, 1.0, -1.0)
    distance = np.maximum(distance + np.where(wrong, sign * size, 0.0), 0.0)
    late = np.rint(true * (1e9 / p["range.delay_speed"])).astype(np.int64) if p["range.delay_speed"] else 0
    heard = true <= p["range.max"]
    return RangeReadings(
        (stamps_ns[index] + late)[heard],
        distance[heard],
        stddev,
        p["range.max"],
        scale,
        bias,
        wrong[heard],
        Fixes(stamps_ns[index][heard], there.lat[heard], there.lon[heard], there.height[heard], (0.0, 0.0, 0.0)),
    )


def _beacon_fixes(beacon: _Beacon, p: Values, t: Trajectory, stamps_ns: Stamps, seed: int) -> Fixes:
    index = instants(t, beacon.fix_rate, "beacon.fix_rates")
    stddev = p["beacon.fix_stddev"]
    there = beacon.motion.states(t.time[index])
    noise = stddev * stream(seed, f"beacon.{beacon.name}.fix").standard_normal((len(index), 3))
    return Fixes(stamps_ns[index], *moved(there.lat, there.lon, there.height, noise), (stddev, stddev, stddev))


def _outliers(name: str, p: Values, seed: int, source: str, count: int) -> tuple[NDArray[np.bool_], Array]:
    """Which readings are wrong, and by how much they would be."""
    low, high = p[f"{name}_span"]
    if low > high:
        raise InsNavError(f"{name}_span: [{low:g}, {high:g}] goes down; give the smaller number first")
    wrong = stream(seed, f"{source}.outlier").random(count) < p[f"{name}_share"]
    return wrong, stream(seed, f"{source}.outlier_size").uniform(low, high, count)


def _within(time: Array, start: float, duration: float, period: float = 0.0) -> NDArray[np.bool_]:
    """Which times, s, are in a window, or in one of those that come back after each period."""
    since = time - start
    if period:
        since = np.where(since < 0.0, since, since % period)
    inside: NDArray[np.bool_] = (since >= 0.0) & (since < duration)
    return inside


def _velocity_body(t: Trajectory, index: Index, arm: tuple[float, float, float]) -> Array:
    """Velocity over ground of a place on the body, on body axes, m/s, (m, 3)."""
    q = t.q_eb[index]
    rate = t.rate[index] - _turned(q, [0.0, 0.0, earth.RATE], inverse=True)
    return _turned(q, t.velocity_e[index], inverse=True) + np.cross(rate, arm)


def _height(t: Trajectory, index: Index, arm: tuple[float, float, float]) -> Array:
    """Ellipsoidal height of a place on the body, m, to d² / 2R, (m,)."""
    return t.height[index] + _turned(t.q_nb[index], arm)[:, 2]


def _turned(q: Array, vector: ArrayLike, inverse: bool = False) -> Array:
    """One vector, or one each, turned by quaternions; by none too, which older scipy refuses; (m, 3)."""
    if not len(q):
        return np.zeros((0, 3))
    turned: Array = Rotation.from_quat(q).apply(vector, inverse=inverse)
    return turned
