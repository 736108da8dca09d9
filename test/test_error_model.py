"""Error model: every column against the mechanization, corrections of any size, lumping."""

import functools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav import strapdown
from ins_nav.error_model import COSINE, HEADING, SIZE, Array, ErrorModel
from ins_nav.simulation.motion import Motion, constant, sinusoid
from ins_nav.simulation.trajectory import EarthMotion, Origin

RATE = 100.0
ZERO = (0.0, 0.0, 0.0)
NAMES = ("x", "y", "z", "vx", "vy", "vz", "tilt x", "tilt y", "heading") + tuple(
    f"{sensor} bias {axis}" for sensor in ("gyro", "accel") for axis in "xyz"
)
INJECTED = (10.0,) * 3 + (0.1,) * 3 + (1e-4, 1e-4, 1e-3) + (1e-6,) * 3 + (1e-3,) * 3
"""m, m/s, rad, rad/s, m/s²: each is a thousand times what rounding makes, and second order is small."""


@dataclass(frozen=True)
class Drive:
    samples: Array
    start: strapdown.State


@functools.cache
def drive(kind: str) -> Drive:
    """300 s; rocking by 5° with 5 s."""
    rocking = {"roll": sinusoid(math.radians(5.0), 5.0), "pitch": sinusoid(math.radians(4.0), 6.0, 1.0)}
    if kind == "car":  # turns, brakes, surges
        motion = Motion(
            300.0,
            speed=constant(12.0) + sinusoid(5.0, 40.0),
            yaw=constant(0.4) + sinusoid(2.0, 90.0),
            **rocking,
        )
        origin = Origin(math.radians(56.0), 0.6, 150.0)
    elif kind == "aircraft":
        motion = Motion(300.0, speed=constant(300.0), yaw=sinusoid(1.5, 200.0), z=sinusoid(100.0, 60.0), **rocking)
        origin = Origin(math.radians(-35.0), 2.0, 9000.0)
    else:  # over the pole
        motion = Motion(300.0, speed=constant(100.0), yaw=constant(1.2), x=constant(-5e3), y=constant(-13e3), **rocking)
        origin = Origin(math.pi / 2.0, 0.0, 50.0)
    path = EarthMotion(motion, origin).trajectory(RATE)
    samples = np.c_[np.full(len(path.delta_theta), 1.0 / RATE), RATE * path.delta_theta, RATE * path.delta_velocity]
    velocity, q_gb = tuple(path.velocity_n[0]), tuple(path.q_nb[0])
    return Drive(samples, strapdown.initial_state(path.lat[0], path.lon[0], path.height[0], velocity, q_gb))


@functools.cache
def undisturbed(kind: str, vertical: bool) -> Array:
    d = drive(kind)
    return run(d, level(d.start, vertical), ZERO, ZERO, vertical)


def level(state: strapdown.State, vertical: bool) -> strapdown.State:
    return state if vertical else (*state[:6], 0.0, *state[7:])


def run(d: Drive, state: strapdown.State, gyro_bias: tuple, accel_bias: tuple, vertical: bool) -> Array:
    """States from the start on, with these biases removed from the samples."""
    samples = d.samples - [0.0, *gyro_bias, *accel_bias]
    states = strapdown.integrate(state, tuple(samples[0]), samples, vertical=vertical)
    return np.vstack([state, states])


def difference(computed: strapdown.State, true: strapdown.State) -> Array:
    """The error state between two solutions, by rotations alone: nothing of the model or of `apply` is used."""
    q = [(Rotation.from_quat(s[0:4]), Rotation.from_quat(s[7:11])) for s in (computed, true)]
    x = np.zeros(SIZE)
    turn = (q[1][1].inv() * q[0][1]).as_rotvec()  # computed n from the true one; its vertical part is azimuth alone
    azimuth = Rotation.from_rotvec([0.0, 0.0, turn[2]])
    away = np.subtract(strapdown.position_ecef(computed), strapdown.position_ecef(true))
    x[0:3] = q[0][1].inv().apply(away)
    x[2] = computed[11] - true[11]
    rot = q[0][0] * (azimuth.inv() * q[1][0]).inv()
    heading = math.atan2(*(rot.as_matrix()[1::-1, 0]))
    x[6:8] = (rot * Rotation.from_rotvec([0.0, 0.0, -heading])).as_rotvec()[:2]
    x[HEADING], x[COSINE] = math.sin(heading), 1.0 - math.cos(heading)
    x[3:6] = np.subtract(computed[4:7], (rot * azimuth.inv()).apply(true[4:7]))
    return x


def model(vertical: bool) -> ErrorModel:
    return ErrorModel(vertical=vertical, gyro_noise=0.0, accel_noise=0.0)


def propagated(states: Array, x: Array, every: int, vertical: bool) -> Array:
    """The injected error by the model, along a solution."""
    for i in range(0, len(states) - 1, every):
        before, after = (tuple(map(float, states[k])) for k in (i, i + every))
        x = model(vertical).transition(before, after, every / RATE) @ x
    return x


def grown(kind: str, vertical: bool, x: Array) -> tuple[Array, Array]:
    """Solution started with the errors x, and its difference from the undisturbed one at the end."""
    d = drive(kind)
    start, gyro_bias, accel_bias = model(vertical).apply(-x, level(d.start, vertical), ZERO, ZERO)
    disturbed = run(d, start, gyro_bias, accel_bias, vertical)
    end = difference(tuple(disturbed[-1]), tuple(undisturbed(kind, vertical)[-1]))
    end[9:15] = x[9:15]
    return disturbed, end


SCALE = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01, 1e-5, 1e-5, 1e-5, 1, 1, 1, 1, 1, 1, 1])
"""Compared in m, cm/s and 1e-5 rad: in these units the errors of five minutes are of one size."""


def disagreement(found: Array, true: Array, vertical: bool) -> float:
    """Largest deviation over the size of the error."""
    counts = np.ones(SIZE, bool)
    counts[9:15] = False
    counts[[2, 5]] = vertical
    away, size = (np.linalg.norm((x / SCALE)[counts]) for x in (found - true, true))
    return float(away / size)


@pytest.mark.parametrize(
    ("kind", "vertical"), [("car", True), ("car", False), ("aircraft", True), ("pole", True), ("pole", False)]
)
@pytest.mark.parametrize("column", range(15), ids=NAMES)
def test_every_column(kind: str, vertical: bool, column: int) -> None:
    """The signs' judge: an error alone, five minutes of rocking and driving, model against mechanization."""
    if not vertical and column in (2, 5):
        return  # these are no states of the mechanization then
    x = np.zeros(SIZE)
    x[column] = INJECTED[column]
    _, end = grown(kind, vertical, x)
    found = propagated(undisturbed(kind, vertical), x, 10, vertical)
    print("REL", kind, vertical, NAMES[column], disagreement(found, end, vertical))
    assert disagreement(found, end, vertical) < 1e-3
