"""Coarse alignment on a rocking base: error of the heading, against its sigma and the theoretical bound.

A motion is simulated once, without errors; every seed starts at another phase of it with other noise, and with
another irregular sea.
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
from ins_nav.alignment.coarse_alignment import AlignmentError, CoarseAlignment
from ins_nav.mechanization import earth
from ins_nav.simulation.motion import Motion, Signal, constant, sinusoid
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.simulation.trajectory import EarthMotion, Origin

Array = NDArray[np.float64]
DURATION, RATE = 120.0, 400.0
GYRO_NOISE, ACCEL_NOISE = math.radians(0.003), 0.02
"""Standard deviations of one sample at that rate, rad/s and m/s²."""
_SEEDS, _SEEDS_SURGING, _PHASES = 100, 10, 10
_LATITUDES, _PERIODS = (0.0, 30.0, 55.7, 75.0), (5.0, 8.0, 12.0)
_AMPLITUDE = 0.5
_SWELL_RATE, _SWELL_LATITUDE, _SWELL_DURATIONS, _SWELL_PERIODS = 50.0, 55.7, (30.0, 60.0, 120.0), (8.0, 20.0)
_LINES = 20
"""Number of sinusoids of an irregular sea."""


class Case(NamedTuple):
    """A rocking base."""

    latitude_deg: float
    amplitude: float = 0.0
    """Of surge, sway and heave, m."""
    period: float = 8.0
    """Of surge, sway and heave, s; of the highest waves, where they are irregular."""
    duration: float = DURATION
    rate: float = RATE
    irregular: bool = False


@functools.lru_cache(1)
def _noiseless(case: Case) -> Simulation:
    axes = dict.fromkeys(("surge_amplitude", "sway_amplitude", "heave_amplitude"), case.amplitude)
    place = {"lat_deg": case.latitude_deg, "linear_period": case.period}
    rest = {"duration": case.duration + case.period, "rate": case.rate, "imu.preset": "perfect", "gnss.rate": 0.0}
    return simulate("rocking", 0, **axes, **place, **rest)


def _sea(amplitude: float, period: float, rng: np.random.Generator) -> Signal:
    """Irregular waves with the spectrum of the North Sea (JONSWAP), as high in the mean square as a sinusoid."""
    borders = np.geomspace(0.55, 2.5, _LINES + 1)
    x = borders[:-1] + rng.uniform(size=_LINES) * np.diff(borders)
    peak = 3.3 ** np.exp(-0.5 * ((x - 1.0) / np.where(x < 1.0, 0.07, 0.09)) ** 2)
    height = np.sqrt(x**-5 * np.exp(-1.25 * x**-4) * peak * np.diff(borders))
    height *= amplitude / np.linalg.norm(height)
    phase = rng.uniform(0.0, 2.0 * math.pi, _LINES)
    return sum((sinusoid(h, period / f, q) for h, f, q in zip(height, x, phase, strict=True)), constant(0.0))


def _irregular(case: Case, seed: int) -> tuple[Array, Array, Array]:
    """Rates and forces without errors, attitude at their end."""
    rng = np.random.default_rng([seed, round(case.period), round(case.duration)])
    x, y, z = (_sea(case.amplitude, case.period, rng) for _ in range(3))
    pitch, roll = (_sea(math.radians(5.0), 11.0, rng) for _ in range(2))
    yaw = constant(rng.uniform(0.0, 2.0 * math.pi))
    motion = Motion(case.duration, yaw=yaw, pitch=pitch, roll=roll, x=x, y=y, z=z)
    path = EarthMotion(motion, Origin(math.radians(case.latitude_deg), 0.0, 150.0)).trajectory(case.rate)
    return path.delta_theta * case.rate, path.delta_velocity * case.rate, path.q_nb[-1]


def _regular(case: Case, seed: int) -> tuple[Array, Array, Array]:
    """The same from the one simulation."""
    simulation = _noiseless(case)
    count = round(case.duration * case.rate)
    start = round(seed % _PHASES / _PHASES * case.period * case.rate)
    taken = slice(start, start + count)
    last = simulation.trajectory.q_nb[start + count]
    return simulation.angular_velocity[taken], simulation.linear_acceleration[taken], last


def run(case: Case, seeds: Sequence[int]) -> Array:
    """Error of the heading and its sigma by the alignment, shape (n, 2), rad; without the runs that are refused."""
    rows = []
    for seed in seeds:
        rates, forces, last = (_irregular if case.irregular else _regular)(case, seed)
        rng = np.random.default_rng(seed)
        size = math.sqrt(case.rate / RATE)
        rates = rates + size * GYRO_NOISE * rng.normal(size=rates.shape)
        forces = forces + size * ACCEL_NOISE * rng.normal(size=forces.shape)
        intervals = np.full(len(rates), 1.0 / case.rate)
        samples = [tuple(row) for row in np.column_stack([intervals, rates, forces]).tolist()]
        alignment = CoarseAlignment(case.duration)
        for previous, sample in zip([samples[0], *samples], samples, strict=False):
            alignment.add(previous, sample, False)
        try:
            found = alignment.solve(math.radians(case.latitude_deg), 150.0)
        except AlignmentError:
            continue
        error = (Rotation.from_quat(last) * Rotation.from_quat(found.q_gb).inv()).as_rotvec()[2]
        rows.append((error, found.heading_stddev))
    return np.array(rows).reshape(-1, 2)


def bound(latitude_deg: float, height: float) -> float:
    """Least possible standard deviation of the heading, rad, for a base that does not travel.

    Covariance of a Kalman filter at the rate of the samples. Its state is the misalignment about east, north and
    up, driven by the gyros' noise and turned by the Earth; it measures the horizontal specific force, which is
    gravity times the level's error and the accelerometers' noise. There is no prior.
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
        swells = [
            Case(_SWELL_LATITUDE, _AMPLITUDE, period, duration, _SWELL_RATE, irregular)
            for duration in _SWELL_DURATIONS
            for irregular in (False, True)
            for period in _SWELL_PERIODS
        ]
        swell = list(pool.map(run, swells, [range(_SEEDS_SURGING)] * len(swells)))
    yield _surging(surging)
    yield _swell(swell)


def _rocking(found: Array, least: float) -> str:
    error, sigma = found.T
    within = int(np.count_nonzero(np.abs(error) < 3.0 * sigma))
    degrees = [f"{math.degrees(x):.4f}" for x in (_rms(error), sigma.mean(), sigma.max(), least)]
    ratios = [f"{x / least:.2f}" for x in (_rms(error), sigma.mean(), sigma.max())]
    rows: list[Sequence[object]] = [
        [f"within 3 sigmas, of {len(error)}", within, "", "99"],
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


def _swell(found: list[Array]) -> str:
    n = len(_SWELL_PERIODS)
    rows = []
    for i, duration in enumerate(_SWELL_DURATIONS):
        for j, sea in enumerate(("sinusoid", "irregular")):
            part = found[(2 * i + j) * n : (2 * i + j + 1) * n]
            rows.append([f"{duration:g} s, {sea}", *map(_swell_cell, part)])
    text = (
        f"The same at latitude {_SWELL_LATITUDE:g}°; in brackets the greatest error / sigma too, and how many of "
        f"{_SEEDS_SURGING} were refused for a sigma over 30°:"
    )
    return f"{text}\n\n{table(['alignment, sea', *(f'period {p:g} s' for p in _SWELL_PERIODS)], rows)}"


def _swell_cell(found: Array) -> str:
    refused = _SEEDS_SURGING - len(found)
    if not len(found):
        return f"{refused} refused"
    ratio = found[:, 0] / found[:, 1]
    tail = f", {refused} refused" if refused else ""
    return f"{math.degrees(_rms(found[:, 0])):.2f} ({_rms(ratio):.2f}, {np.abs(ratio).max():.1f}{tail})"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
