"""Coarse alignment on a rocking base: error of the heading, against its own sigma and against theory.

A motion is simulated once, without errors; every seed begins at another phase of it and adds noise of its own.
"""

import functools
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.markdown import table
from ins_nav import earth
from ins_nav.coarse_alignment import CoarseAlignment
from ins_nav.simulation.scenarios import Simulation, simulate

Array = NDArray[np.float64]
DURATION, RATE = 120.0, 400.0
GYRO_NOISE, ACCEL_NOISE = math.radians(0.003), 0.02
"""Standard deviations of one sample, rad/s and m/s²."""
_SEEDS, _SEEDS_SURGING, _PHASES = 100, 10, 10
_LATITUDES, _PERIODS = (0.0, 30.0, 55.7, 75.0), (5.0, 8.0, 12.0)
_AMPLITUDE = 0.5


class Case(NamedTuple):
    """A rocking base."""

    latitude_deg: float
    amplitude: float = 0.0
    """Of surge, sway and heave, m."""
    period: float = 8.0
    """Of surge, sway and heave, s."""


@functools.lru_cache(1)
def _noiseless(case: Case) -> Simulation:
    axes = dict.fromkeys(("surge_amplitude", "sway_amplitude", "heave_amplitude"), case.amplitude)
    place = {"lat_deg": case.latitude_deg, "linear_period": case.period}
    rest = {"duration": DURATION + case.period, "rate": RATE, "imu.preset": "perfect", "gnss.rate": 0.0}
    return simulate("rocking", 0, **axes, **place, **rest)


def run(case: Case, seeds: Sequence[int]) -> Array:
    """Error of the heading and its sigma by the alignment, shape (n, 2), rad."""
    simulation = _noiseless(case)
    count = round(DURATION * RATE)
    rows = []
    for seed in seeds:
        start = round(seed % _PHASES / _PHASES * case.period * RATE)
        taken = slice(start, start + count)
        truth = Rotation.from_quat(simulation.trajectory.q_nb[start + count])
        rng = np.random.default_rng(seed)
        rates = simulation.angular_velocity[taken] + GYRO_NOISE * rng.normal(size=(count, 3))
        forces = simulation.linear_acceleration[taken] + ACCEL_NOISE * rng.normal(size=(count, 3))
        samples = [tuple(row) for row in np.column_stack([np.full(count, 1.0 / RATE), rates, forces]).tolist()]
        alignment = CoarseAlignment(DURATION)
        for previous, sample in zip([samples[0], *samples], samples, strict=False):
            alignment.add(previous, sample, False)
        found = alignment.solve(math.radians(case.latitude_deg), simulation.parameters["height"])
        error = (truth * Rotation.from_quat(found.q_gb).inv()).as_rotvec()[2]
        rows.append((error, found.heading_stddev))
    return np.array(rows)


def bound(latitude_deg: float, height: float) -> float:
    """Least possible standard deviation of the heading, rad, for a base that does not travel.

    Covariance of a Kalman filter at the rate of the samples. Its state is the misalignment about east, north and
    up, driven by the gyros' noise and turned by the Earth; it measures the horizontal specific force, which is
    gravity times the level's error and the accelerometers' noise. Nothing is known before.
    """
    lat, dt = math.radians(latitude_deg), 1.0 / RATE
    gravity = float(earth.normal_gravity(math.sin(lat), height))
    turn = Rotation.from_rotvec([0.0, -earth.RATE * dt * math.cos(lat), -earth.RATE * dt * math.sin(lat)]).as_matrix()
    growth = np.eye(3) * (GYRO_NOISE * dt) ** 2
    p = np.eye(3) * 10.0**2
    for _ in range(round(DURATION * RATE)):
        p = turn @ p @ turn.T + growth
        for axis in range(2):
            p = p - np.outer(p[axis], p[axis]) / (p[axis, axis] + (ACCEL_NOISE / gravity) ** 2)
    return math.sqrt(p[2, 2])


def results(_data: Path) -> Iterator[str]:
    """The section's tables."""
    latitude = 55.7
    with ProcessPoolExecutor() as pool:
        chunks = [range(first, first + 10) for first in range(0, _SEEDS, 10)]
        rocking = pool.map(functools.partial(run, Case(latitude)), chunks)
        least = bound(latitude, _noiseless(Case(latitude)).parameters["height"])
        yield _rocking(np.concatenate(list(rocking)), least)
        cases = [Case(lat, _AMPLITUDE, period) for lat in _LATITUDES for period in _PERIODS]
        surging = list(pool.map(run, cases, [range(_SEEDS_SURGING)] * len(cases)))
    yield _surging(surging)


def _rocking(found: Array, least: float) -> str:
    error, sigma = found.T
    within = int(np.count_nonzero(np.abs(error) < 3.0 * sigma))
    degrees = [f"{math.degrees(x):.4f}" for x in (_rms(error), sigma.mean(), sigma.max(), least)]
    ratios = [f"{x / least:.2f}" for x in (_rms(error), sigma.mean(), sigma.max())]
    rows: list[Sequence[object]] = [
        [f"within 3 of its own sigmas, of {len(error)}", within, "", "99"],
        ["RMS error", degrees[0], ratios[0], "2"],
        ["mean sigma", degrees[1], ratios[1], "2"],
        ["greatest sigma", degrees[2], ratios[2], "2"],
        ["theoretical bound", degrees[3], "1", ""],
        ["RMS of error / sigma", f"{_rms(error / sigma):.2f}", "", ""],
    ]
    return table([f"heading after {DURATION:g} s, rocking 5°, 11 s", "deg", "over the bound", "limit"], rows)


def _surging(found: list[Array]) -> str:
    cells = [f"{math.degrees(_rms(x[:, 0])):.3f} ({_rms(x[:, 0] / x[:, 1]):.2f})" for x in found]
    n = len(_PERIODS)
    rows = [[f"latitude {lat:g}°", *cells[i * n : (i + 1) * n]] for i, lat in enumerate(_LATITUDES)]
    head = f"surge, sway, heave {_AMPLITUDE:g} m too"
    text = f"RMS heading error in degrees, in brackets RMS of error / sigma, of {_SEEDS_SURGING} phases and seeds:"
    return f"{text}\n\n{table([head, *(f'period {period:g} s' for period in _PERIODS)], rows)}"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
