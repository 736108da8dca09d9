"""Least possible covariance of drifts and azimuth from stops: the likelihood of all data, no filter."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization import earth

Array = NDArray[np.float64]
_STEP = 1.0
"""s of a block."""


class Span(NamedTuple):
    """Some time of a run."""

    duration: float
    """s."""
    rest: bool
    rot_sb: Array
    """Body to east, north, up, on the mean; shape (3, 3)."""


def bound(spans: Sequence[Span], lat: float, gyro_noise: float, tilt_noise: float, azimuth_known: bool) -> Array:
    """Covariance of the drifts, rad/s, and of the azimuth at the end, rad; shape (4, 4).

    The tilt and azimuth error of S goes with Earth's rate, the drifts and the gyros' white noise, through the turns
    too. At rest each second shows the tilt, with the accelerometers' white noise, and the run-off of yaw exactly: a
    vehicle may rock at a stop, so its level may change, but it does not turn. Everything is linear, and unknown:
    drifts, azimuth (unless known), and the level of each stop by itself, since the accelerometers' biases turn with
    the vehicle. All observations are stacked, with the covariance that their common noise gives them, and the
    information on the unknowns follows.

    Parameters
    ----------
    spans : sequence of Span
        In order, from the first sample to the last one used.
    lat : float
        rad.
    gyro_noise : float
        White noise of an axis, rad/√s.
    tilt_noise : float
        White noise of the accelerometers over gravity, rad·√s.
    azimuth_known : bool
        At the start, exactly.
    """
    rate: Array = earth.RATE * np.array([0.0, math.cos(lat), math.sin(lat)])
    turn = np.eye(3) - _STEP * np.cross(np.eye(3), rate)  # d psi/dt = - rate x psi
    steps = [(span, i == 0) for span in spans for i in range(round(span.duration / _STEP))]
    unknowns = 6 + 2 * sum(span.rest for span in spans)
    state = np.zeros((3, unknowns + 3 * len(steps)))  # psi, as a function of the unknowns and of each second's noise
    state[:, :3] = np.eye(3)
    rows, variances, level = [], [], 4
    for k, (span, first) in enumerate(steps):
        level += 2 * (first and span.rest)
        after = turn @ state
        after[:, 3:6] += _STEP * span.rot_sb
        after[:, unknowns + 3 * k : unknowns + 3 * k + 3] = np.eye(3)
        if span.rest:
            tilt = 0.5 * (state + after)[:2]
            tilt[:, level : level + 2] += np.eye(2)
            rows += [*tilt, after[2] - state[2]]
            variances += [tilt_noise**2 / _STEP, tilt_noise**2 / _STEP, 0.0]
        state = after
    model = np.array(rows)
    by_unknown, by_noise = model[:, :unknowns], model[:, unknowns:]
    covariance = gyro_noise**2 * _STEP * by_noise @ by_noise.T + np.diag(variances)
    sought: Array = np.zeros((4, unknowns))
    sought[:3, 3:6] = np.eye(3)
    sought[3] = state[2, :unknowns]
    # the level of the first stop is the tilt at the start; units that make the matrices well conditioned
    kept = [i for i in range(unknowns) if i not in ((0, 1, 2) if azimuth_known else (0, 1))]
    unit = np.array([1e-3] * 3 + [1e-7] * 3 + [1e-6] * (unknowns - 6))[kept]
    scaled = by_unknown[:, kept] * unit
    information = scaled.T @ np.linalg.solve(covariance, scaled)
    left = sought[:, kept] * unit
    return np.asarray(left @ np.linalg.solve(information, left.T), float)
