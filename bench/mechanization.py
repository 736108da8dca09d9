"""Errors of the mechanization itself: a perfect IMU in known motion, and coning.

The motion and its increments come from pyins, which is independent of this package, except across the pole, where
pyins is singular.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyins import sim, transform
from scipy.spatial.transform import Rotation

from bench.markdown import table
from ins_nav.mechanization import attitude, nav_state, strapdown
from ins_nav.simulation.motion import Motion, sinusoid, smooth_profile
from ins_nav.simulation.trajectory import EarthMotion, Origin

Array = NDArray[np.float64]
DURATION = 600.0
_FLU = np.array([1.0, -1.0, -1.0])
"""Body axes of pyins (forward, right, down) to ours."""
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_HALF_CONE, _CONE_RATE, _CONE_SAMPLING, _CONE_TIME = math.radians(1.0), 10.0, 400.0, 60.0


class Case(NamedTuple):
    """A motion: samples (n + 1, 7), the first one before the start, and the true state at start and end."""

    samples: Array
    start: nav_state.NavState
    end: nav_state.NavState


def pyins_data(latitude_deg: float, rate: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Trajectory and increments by pyins: a car that turns, accelerates and rocks, at height 0."""
    t = np.arange(round(DURATION * rate) + 1) / rate
    heading = np.radians(30.0) + 0.4 * np.sin(2 * np.pi * t / 40) + 2 * np.pi * t / 200
    speed = 10.0 + 6.0 * np.sin(2 * np.pi * t / 60)
    velocity = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), np.zeros_like(t)])
    angles = np.column_stack(
        [3.0 * np.sin(2 * np.pi * t / 17), 4.0 * np.sin(2 * np.pi * t / 13 + 1), np.degrees(heading)]
    )
    return sim.generate_imu(t, [latitude_deg, 30.0, 0.0], angles, velocity, "increment")


def from_pyins(trajectory: pd.DataFrame, increments: pd.DataFrame) -> Case:
    """The motion on axes forward, left, up."""
    dt = float(trajectory.index[1])
    values = increments.to_numpy() / dt * np.tile(_FLU, 2)

    def state(i: int) -> nav_state.NavState:
        row = trajectory.iloc[i]
        rot = _ENU_NED @ transform.mat_from_rph(row[["roll", "pitch", "heading"]]) @ np.diag(_FLU)
        velocity = _ENU_NED @ row[["VN", "VE", "VD"]].to_numpy()
        q = Rotation.from_matrix(rot).as_quat()
        return nav_state.initial_state(math.radians(row.lat), math.radians(row.lon), row.alt, tuple(velocity), tuple(q))

    return Case(np.column_stack([np.full(len(values), dt), values]), state(0), state(-1))


def across_the_pole(rate: float) -> Case:
    """6 km exactly over the north pole, weaving and turning, by `ins_nav.simulation`."""
    motion = Motion(
        DURATION,
        x=sinusoid(200.0, 60.0),
        y=smooth_profile(-3000.0, [(0.0, DURATION, 3000.0)]),
        yaw=smooth_profile(0.3, [(0.0, DURATION, 20.0)]) + sinusoid(0.4, 40.0),
        pitch=sinusoid(math.radians(4.0), 13.0, 1.0),
        roll=sinusoid(math.radians(3.0), 17.0),
    )
    t = EarthMotion(motion, Origin(0.5 * math.pi, 0.0, 0.0)).trajectory(rate)
    values = np.column_stack([t.delta_theta, t.delta_velocity]) * rate
    samples = np.column_stack([np.full(len(values), 1.0 / rate), values])

    def state(i: int) -> nav_state.NavState:
        q, velocity = t.q_nb[i], t.velocity_n[i]
        return nav_state.initial_state(t.lat[i], t.lon[i], t.height[i], tuple(velocity), tuple(q))

    return Case(np.concatenate([samples[:1], samples]), state(0), state(-1))


def errors(case: Case) -> tuple[float, float, float]:
    """Of position, m, attitude, rad, and velocity, m/s, at the end, all on Earth-fixed axes."""
    states = strapdown.integrate(case.start, tuple(case.samples[0].tolist()), case.samples[1:])
    found, true = (_earth_fixed(state) for state in (tuple(states[-1].tolist()), case.end))
    turn = (found[1] * true[1].inv()).magnitude()
    return float(np.linalg.norm(found[0] - true[0])), turn, float(np.linalg.norm(found[2] - true[2]))


def _earth_fixed(state: nav_state.NavState) -> tuple[Array, Rotation, Array]:
    rot_en = Rotation.from_quat(state[7:11])
    return np.array(nav_state.position_ecef(state)), rot_en * Rotation.from_quat(state[:4]), rot_en.apply(state[4:7])


def coning_drift(compensated: bool) -> float:
    """Drift about the axis of a coning motion, rad/s, from the exact integrals of its rate."""
    omega, dt = 2.0 * math.pi * _CONE_RATE, 1.0 / _CONE_SAMPLING
    t = np.arange(-1, round(_CONE_TIME * _CONE_SAMPLING) + 1) * dt
    amplitude = math.sin(_HALF_CONE)
    # the rotation vector of constant length turns about z: these are the components of its body rate, integrated
    integral = np.column_stack(
        [
            amplitude * np.cos(omega * t),
            amplitude * np.sin(omega * t),
            -2.0 * omega * math.sin(0.5 * _HALF_CONE) ** 2 * t,
        ]
    )
    rates = np.diff(integral, axis=0) / dt
    none = [0.0] * 3
    s, c = math.sin(0.5 * _HALF_CONE), math.cos(0.5 * _HALF_CONE)
    q = (s, 0.0, 0.0, c)
    for before, now in zip(rates[:-1].tolist(), rates[1:].tolist(), strict=True):
        change = [b - a for a, b in zip(before, now, strict=True)] if compensated else none
        increments = strapdown.compensated_increments(dt, *now, *none, *change, *none)
        q = attitude.multiply(q, attitude.from_rotation_vector(*increments[:3]))
    # a whole number of turns: back where it began
    return float((Rotation.from_quat(q) * Rotation.from_quat([s, 0.0, 0.0, c]).inv()).magnitude()) / _CONE_TIME


def results(_data: Path) -> Iterator[str]:
    """The section's tables."""
    rows = []
    for place in (0.0, 60.0, 89.9, None):
        for rate in (200.0, 400.0):
            case = across_the_pole(rate) if place is None else from_pyins(*pyins_data(place, rate))
            position, angle, velocity = errors(case)
            name = "across the pole" if place is None else f"latitude {place:g}°"
            rows.append([name, f"{rate:g}", f"{position * 1e3:.4f}", f"{angle:.1e}", f"{velocity:.1e}"])
    rows.append(["limit", "", "1", "1e-08", "1e-05"])
    head = [f"error after {DURATION:g} s, perfect IMU", "Hz", "position, mm", "attitude, rad", "velocity, m/s"]
    yield table(head, rows)
    drift = [math.degrees(coning_drift(compensated)) * 3600.0 for compensated in (True, False)]
    name = f"coning, {math.degrees(_HALF_CONE):g}° half cone at {_CONE_RATE:g} Hz, sampled at {_CONE_SAMPLING:g} Hz"
    yield table(
        [name, "drift, °/h", "limit"],
        [["compensated", f"{drift[0]:.4f}", "0.04"], ["not compensated", f"{drift[1]:.2f}", ""]],
    )
