"""Least possible covariance of an aided solution along a simulated dive: a Kalman filter for its true errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ins_nav.mechanization import earth
from ins_nav.simulation.scenarios import Simulation

Array = NDArray[np.float64]
_STEP = 0.5
"""s; divides the times of all readings."""
_POSITION, _VELOCITY, _PSI, _GYRO, _ACCEL, _LOG, _RANGE = (slice(i, i + 3) for i in (0, 3, 6, 9, 12, 15, 18))
_SURFACE, _BEACON, _DRIFT = 20, slice(21, 24), slice(24, 27)
_SIZE = 27
_MANOEUVRE = 30.0
"""s: correlation time of the velocity of the beacon's vessel."""


@dataclass(frozen=True)
class Prior:
    """Priors, one sigma.

    Attributes
    ----------
    gyro_bias, accel_bias : float
        Each axis, rad/s and m/s².
    log_scale, log_angle : float
        Of the log, rad for the angles.
    range_scale, range_bias : float
        m for the bias.
    beacon_speed : float
        Each component, m/s; 0: its place is known exactly.
    """

    gyro_bias: float
    accel_bias: float
    log_scale: float = 0.0
    log_angle: float = 0.0
    range_scale: float = 0.0
    range_bias: float = 0.0
    beacon_speed: float = 1.0


@dataclass(frozen=True)
class Least:
    """Least covariances.

    Attributes
    ----------
    position : ndarray, shape (3, 3)
        East, north, up, m².
    heading : float
        Variance, rad².
    log : ndarray, shape (3, 3)
        Scale, angles about the left and up axes, rad.
    """

    position: Array
    heading: float
    log: Array

    @property
    def horizontal(self) -> float:
        """Sigma of the horizontal distance, m."""
        return math.sqrt(self.position[0, 0] + self.position[1, 1])


def bound(simulation: Simulation, prior: Prior, times: Sequence[float], ranges: bool = True) -> list[Least]:
    """Least possible covariances of a solution's errors at times, s, from all readings up to each.

    Covariance of a Kalman filter along the true motion. Its states are position, velocity and the misalignment psi of
    the computed inertial axes, on east, north, up; constant biases on body axes; scale and angles of the log; scale
    and bias of the ranges; height of the surface; place and velocity of the beacon's vessel, which change as those of
    a first-order Gauss-Markov process::

        dp' = dv
        dv' = (-g / R, -g / R, 2 g / R) dp - 2 u x dv + f x psi + C accel_bias + noise
        psi' = -u x psi - C gyro_bias + noise

    For a linear model with Gaussian noise that is the Cramer-Rao bound. The assumption of coarse
    alignment, that the base does not travel, is not used.

    Parameters
    ----------
    simulation : Simulation
        Its readings count by their stamps and noise, not their values.
    prior : Prior
    times : floats
        In order.
    ranges : bool
        Those to the first beacon are there.
    """
    path, p = simulation.trajectory, simulation.parameters
    every = round(_STEP * p["rate"])
    steps = (len(path.time) - 1) // every
    rot = Rotation.from_quat(path.q_nb).as_matrix()
    gravity = float(earth.normal_gravity(math.sin(path.origin.lat), path.origin.height))
    u = earth.RATE * np.array([0.0, math.cos(path.origin.lat), math.sin(path.origin.lat)])
    noise = simulation.errors.gyro.noise, simulation.errors.accel.noise
    a = np.zeros((_SIZE, _SIZE))
    a[_POSITION, _VELOCITY] = a[_BEACON, _DRIFT] = np.eye(3)
    a[_VELOCITY, _POSITION] = gravity / earth.SEMI_MAJOR_AXIS * np.diag([-1.0, -1.0, 2.0])
    a[_VELOCITY, _VELOCITY], a[_PSI, _PSI] = -2.0 * _cross(u), -_cross(u)
    a[_DRIFT, _DRIFT] = -np.eye(3) / _MANOEUVRE
    q = np.zeros(_SIZE)
    q[_VELOCITY], q[_PSI] = noise[1] ** 2, noise[0] ** 2
    q[_DRIFT] = 2.0 * prior.beacon_speed**2 / _MANOEUVRE
    known = np.diag(np.square(_start(prior)))
    readings = _readings(simulation, ranges)
    due = [round(time / _STEP) for time in times]
    found: list[Least] = []
    for k in range(steps + 1):
        if k:
            first = (k - 1) * every
            c = rot[first : first + every + 1].mean(axis=0)
            force = (path.velocity_n[first + every] - path.velocity_n[first]) / _STEP + [0.0, 0.0, gravity]
            a[_VELOCITY, _PSI], a[_VELOCITY, _ACCEL], a[_PSI, _GYRO] = _cross(force), c, -c
            phi = np.eye(_SIZE) + _STEP * a + 0.5 * _STEP**2 * a @ a
            half = np.diag(0.5 * _STEP * q)
            known = phi @ (known + half) @ phi.T + half
        i = k * every
        for name, index in readings.get(i, ()):
            known = _measured(known, *_MODELS[name](simulation, i, index, rot[i]))
        while len(found) < len(due) and due[len(found)] == k:
            found.append(Least(known[:3, :3].copy(), float(known[8, 8]), known[_LOG, _LOG].copy()))
    return found


def _start(prior: Prior) -> Array:
    """Sigmas of the states."""
    first = [100.0] * 3 + [1.0] * 5 + [10.0] + [prior.gyro_bias] * 3 + [prior.accel_bias] * 3
    own = [prior.log_scale, prior.log_angle, prior.log_angle, prior.range_scale, prior.range_bias, 100.0]
    speed = prior.beacon_speed
    return np.array([*first, *own, *[100.0 if speed else 0.0] * 3, *[speed] * 3])


def _readings(simulation: Simulation, ranges: bool) -> dict[int, list[tuple[str, int]]]:
    """Name and number of the readings at each instant of the trajectory."""
    aids, rate = simulation.aids, simulation.parameters["rate"]
    stamps = {"fix": aids["gnss/fix"].stamps_ns, "depth": aids["depth"].stamps_ns}
    stamps["log"] = aids["log"].stamps_ns[np.isfinite(aids["log"].velocity).all(axis=1)]
    ranged = [topic for topic in aids if topic.startswith("range/")]
    if ranges and ranged:
        fixes = f"beacon/{ranged[0].partition('/')[2]}/fix"
        stamps["range"] = aids[ranged[0]].beacon.stamps_ns  # of the instants they are for
        if fixes in aids:
            stamps["beacon"] = aids[fixes].stamps_ns
    found: dict[int, list[tuple[str, int]]] = {}
    for kind, values in stamps.items():
        for number, instant in enumerate(np.rint((values - simulation.start_ns) * 1e-9 * rate).astype(int).tolist()):
            if instant % round(_STEP * rate):
                raise ValueError(f"a reading of {kind} between two steps of {_STEP} s")
            found.setdefault(instant, []).append((kind, number))
    return found


def _fix(simulation: Simulation, _i: int, _index: int, rot: Array) -> tuple[Array, Array]:
    return _place(rot, simulation.parameters["gnss.lever_arm"]), np.square(simulation.aids["gnss/fix"].stddev)


def _depth(simulation: Simulation, _i: int, _index: int, rot: Array) -> tuple[Array, Array]:
    h = _place(rot, simulation.parameters["depth.lever_arm"])[2:]
    h[0, _SURFACE] = -1.0
    return h, np.array([simulation.aids["depth"].stddev ** 2])


def _log(simulation: Simulation, i: int, index: int, rot: Array) -> tuple[Array, Array]:
    path, arm = simulation.trajectory, np.array(simulation.parameters["log.lever_arm"])
    h = np.zeros((3, _SIZE))
    spin = rot.T @ (earth.RATE * np.array([0.0, math.cos(path.lat[i]), math.sin(path.lat[i])]))
    body = rot.T @ path.velocity_n[i] + np.cross(path.rate[i] - spin, arm)
    h[:, _VELOCITY], h[:, _PSI], h[:, _GYRO] = rot.T, -rot.T @ _cross(path.velocity_n[i]), -_cross(arm)
    h[:, _LOG] = np.column_stack([body, np.cross([0.0, 1.0, 0.0], body), np.cross([0.0, 0.0, 1.0], body)])
    return h, np.full(3, simulation.aids["log"].stddev[index] ** 2)


def _range(simulation: Simulation, i: int, index: int, rot: Array) -> tuple[Array, Array]:
    path, readings = simulation.trajectory, _first(simulation, "range/")
    arm = simulation.parameters["range.lever_arm"]
    there = readings.beacon
    place = earth.geodetic_to_ecef(there.lat[index], there.lon[index], there.height[index])
    away = earth.enu_axes(path.lat[i], path.lon[i]).T @ (path.position_e[i] - place) + rot @ arm
    length = float(np.linalg.norm(away))
    h = (away / length) @ _place(rot, arm)
    h[_BEACON] = -away / length
    h[18:20] = length, 1.0
    return h[None], np.array([readings.stddev**2])


def _beacon(simulation: Simulation, _i: int, _index: int, _rot: Array) -> tuple[Array, Array]:
    return np.eye(3, _SIZE, _BEACON.start), np.square(_first(simulation, "beacon/").stddev)


def _first(simulation: Simulation, prefix: str) -> Any:
    """Readings of the first aid of that prefix."""
    return next(readings for topic, readings in simulation.aids.items() if topic.startswith(prefix))


_MODELS = {"fix": _fix, "depth": _depth, "log": _log, "range": _range, "beacon": _beacon}


def _place(rot: Array, arm: Sequence[float]) -> Array:
    """Of the errors on the place of what has a lever arm."""
    h = np.eye(3, _SIZE)
    h[:, _PSI] = _cross(rot @ arm)
    return h


def _measured(p: Array, h: Array, variances: Array) -> Array:
    """Covariance after a measurement, Joseph's form."""
    r = np.diag(variances)
    gain = np.linalg.solve(h @ p @ h.T + r, h @ p).T
    left = np.eye(len(p)) - gain @ h
    p = left @ p @ left.T + gain @ r @ gain.T
    return 0.5 * (p + p.T)


def _cross(x: Array) -> Array:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])
