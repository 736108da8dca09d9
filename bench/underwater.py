"""A vehicle under water: log, depth gauge and ranges to a beacon, the whole dive; then faults.

Every run is the whole of `delayed.FilterSystem` with config/auv.yaml along scenario auv_dive, coarse alignment
included (`bench.underwater_run`). The noises of the IMU are densities: a low rate of its samples saves time.
"""

import functools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.stats import chi2

from bench.markdown import table
from bench.underwater_bound import bound
from bench.underwater_run import (
    EAST,
    LAG,
    LOG_ANGLE,
    LOG_SCALE,
    NEES,
    NORTH,
    RATE,
    SIGMA,
    SIGMA_UP,
    TIME,
    UP,
    Array,
    Given,
    Run,
    errors_of,
    filter_parameters,
    noiseless,
    prior,
)
from ins_nav.mechanization import earth
from ins_nav.simulation.scenarios import Simulation

SEEDS = 50
_CHUNK = 5
"""Seeds a task."""

_NO_RANGES = ("range", "beacon")
_JUMP = 50.0
"""m: error to the east of fixes after the dive."""
_BEFORE = 3.0
"""s before the first fix when the errors at the end are taken: fixes are not on their way yet."""
_NEAR = 3.0
"""m from where the fixes are, on the mean."""


@dataclass(frozen=True)
class Dive:
    """A case of the whole mission: with the log's constants zero or drawn, with ranges or without."""

    log: bool = True
    ranges: bool = True

    @property
    def skip(self) -> Sequence[str]:
        """Aids left out."""
        return () if self.ranges else _NO_RANGES

    @property
    def log_prior(self) -> tuple[float, float]:
        """Sigma of scale, and of the angles, deg."""
        return (LOG_SCALE, LOG_ANGLE) if self.log else (0.0, 0.0)


def _surfaced(simulation: Simulation) -> float:
    """Time of the first fix after the dive, s."""
    stamps = simulation.aids["gnss/fix"].stamps_ns
    return float(stamps[int(np.argmax(np.diff(stamps))) + 1] - simulation.start_ns) * 1e-9


def run_dive(dive: Dive, seeds: Sequence[int]) -> list[tuple[Array, Array]]:
    """Errors until the fixes return, and the results of `_surfacing` for right fixes and for fixes with a jump."""
    found = []
    for seed in seeds:
        simulation = noiseless(()).redrawn(seed, **errors_of(seed, dive.log))
        run = Run(simulation, filter_parameters(*dive.log_prior), dive.skip).until(_surfaced(simulation) - _BEFORE)
        run.rows.append(run.errors())
        returns = [] if dive.ranges else [_surfacing(run.fork(), jump) for jump in (0.0, _JUMP)]
        found.append((np.array(run.rows), np.array(returns)))
    return found


def _surfacing(run: Run, jump: float) -> list[float]:
    """Distance from the mean of the fixes to come before them, epochs until it is near, greatest distance then."""
    simulation, before = run.simulation, len(run.rows)
    _, prime_vertical = earth.principal_radii(math.sin(simulation.trajectory.origin.lat))
    degrees = math.degrees(jump / (prime_vertical * math.cos(simulation.trajectory.origin.lat)))
    run.change("fix", lambda fix: (*fix[:2], fix[2] + degrees, *fix[3:]))
    last = run.rows[-1]
    run.until(float(simulation.trajectory.time[-1]) - LAG, 0.5)
    rows = np.array(run.rows[before:])
    away = np.hypot(rows[:, EAST] - jump, rows[:, NORTH])
    fixes = (simulation.aids["gnss/fix"].stamps_ns - simulation.start_ns) * 1e-9
    epochs = np.searchsorted(fixes, rows[:, TIME], side="right") - np.searchsorted(fixes, last[TIME], side="right")
    near = int(np.argmax(away < _NEAR)) if (away < _NEAR).any() else len(away) - 1
    return [math.hypot(last[EAST] - jump, last[NORTH]), float(epochs[near]), float(away[near:].max())]


def _dives(found: dict[str, tuple[Dive, list[tuple[Array, Array]]]]) -> str:
    rows = []
    simulation = noiseless(())
    begins = float(simulation.parameters["alignment_time"] + simulation.parameters["surface_leg"])
    for name, (dive, results_) in found.items():
        values = np.array([errors for errors, _ in results_])
        times = np.rint(2.0 * values[0, :, TIME]) / 2.0
        under = times > begins + 60.0
        least = np.array([x.horizontal for x in bound(simulation, prior(*dive.log_prior), times.tolist(), dive.ranges)])
        distance = np.hypot(values[..., EAST], values[..., NORTH])
        ratio = distance / values[..., SIGMA]
        gone = _distance(simulation, begins, times[-1])
        end, nees = distance[:, -1], values[:, -1, NEES]
        low, high = np.sqrt(chi2.ppf((0.025, 0.975), 2 * len(nees)) / (2 * len(nees)))
        all_along = np.sqrt(np.mean(distance[:, under] ** 2, axis=0)) / least[under]
        rows.append(
            [
                f"{name}, {len(values)} seeds",
                *(f"{_rms(end):.2f}", f"{100.0 * _rms(end) / gone:.3f}", "5 m" if dive.ranges else "0.3 %"),
                *(f"{values[:, -1, SIGMA].mean():.2f}", f"{least[-1]:.2f}", f"{_rms(end) / least[-1]:.2f}"),
                f"{_rms(all_along):.2f}",
                f"{math.sqrt(nees.mean() / 2.0):.2f} ({low:.2f} to {high:.2f})",
                f"{ratio[:, under].max():.1f}",
            ]
        )
    head = [
        "before GNSS returns",
        "distance off at the end, RMS, m",
        "% of the distance run",
        "limit",
        "sigma, m",
        "bound, m",
    ]
    head += [
        "RMS / bound (limit 1.15)",
        "the same, all along the dive",
        "error / sigma, horizontal",
        "greatest, all along",
    ]
    text = f"""auv_dive: aligned in swell for 300 s with a turn, then {gone / 1e3:.1f} km in an hour under water.
Log and depth gauge at 1 Hz, ranges of 0.5 m at 0.2 Hz to a vessel with fixes of 0.5 m at 1 Hz, IMU at {RATE:g} Hz."""
    return f"{text}\n\n{table(head, rows)}"


def _surfacings(found: dict[str, tuple[Dive, list[tuple[Array, Array]]]]) -> str:
    rows = []
    for name, (_, results_) in found.items():
        for jump, (away, epochs, after) in zip(
            (0.0, _JUMP), np.array([x for _, x in results_]).transpose(1, 2, 0), strict=True
        ):
            what = f"{name}, {len(results_)} seeds, fixes {f'off by {jump:g} m' if jump else 'right'}"
            rows.append(
                [what, f"{_rms(away):.1f}", f"{np.median(epochs):g}", f"{epochs.max():g}", "10", f"{after.max():.1f}"]
            )
    head = ["GNSS returns after the dive", "away before, RMS, m"]
    head += [f"fixes until within {_NEAR:g} m, median", "greatest", "limit", "greatest distance afterwards, m"]
    return table(head, rows)


def _distance(simulation: Simulation, begin: float, end: float) -> float:
    """Horizontal way between two times, m."""
    path = simulation.trajectory
    span = (path.time >= begin) & (path.time <= end)
    return float(np.hypot(*path.velocity_n[span, :2].T).mean() * (end - begin))


# --- calibration

_CALIBRATED = (0.01, 1.0)
"""Scale and angles, deg, of the log, and their sigmas in the filter."""
_LEGS = ((120.0, 1.0), (1800.0, 1.0), (600.0, 0.1))
"""Time at the surface, s, and noise of fixes, m."""


def _surface(leg: float, stddev: float) -> Given:
    gnss = {"gnss.horizontal_stddev": stddev, "gnss.vertical_stddev": 1.5 * stddev}
    return tuple({"surface_leg": leg, "duration": 300.0 + leg, **gnss}.items())


def run_calibration(motion: Given, seeds: Sequence[int]) -> list[Array]:
    """Errors of scale and angles, and their sigmas, shape (3, 2)."""
    found = []
    scale, angle = _CALIBRATED
    for seed in seeds:
        constants = errors_of(seed, False) | {"log.scale": scale, "log.misalignment_deg": (angle, -angle)}
        simulation = noiseless(motion).redrawn(seed, **constants)
        run = Run(simulation, filter_parameters(scale, angle), _NO_RANGES).until(
            float(simulation.trajectory.time[-1]) - LAG
        )
        own = np.array(run.navigator.own_states("log"))
        own[:, 0] -= [simulation.aids["log"].scale, *simulation.aids["log"].misalignment]
        found.append(own)
    return found


def _calibrations(found: dict[tuple[float, float], list[Array]]) -> str:
    rows = []
    unit = np.array([100.0, *[math.degrees(1.0)] * 2])
    for (leg, stddev), values in found.items():
        simulation = noiseless(_surface(leg, stddev))
        (least,) = bound(simulation, prior(*_CALIBRATED), [float(simulation.trajectory.time[-1]) - LAG], False)
        error = unit * np.sqrt(np.mean(np.square([x[:, 0] for x in values]), axis=0))
        theory = unit * np.sqrt(least.log.diagonal())
        ratio = np.array([x[:, 0] / x[:, 1] for x in values])
        pairs = [f"{a:.3f} ({b:.3f})" for a, b in zip(error, theory, strict=True)]
        rows.append([f"{leg:g} s, fixes of {stddev:g} m", *pairs, f"{_rms(ratio):.2f}", f"{np.abs(ratio).max():.1f}"])
    rows.append(["limit", "0.050", "0.050", "0.050", "", "3"])
    head = [f"log wrong by {_CALIBRATED[0]:.0%} and {_CALIBRATED[1]:g}°, {len(values)} seeds: at the surface for"]
    head += ["scale, RMS (bound), %", "pitch, RMS (bound), °", "yaw, RMS (bound), °", "error / sigma", "greatest"]
    return table(head, rows)


# --- faults

_BEGIN = 420.0
"""s, when the dive begins."""
_SHORT: Given = (("dive_time", 1200.0),)
_OUTLIERS = {"range.outlier_share": 0.2}
_BIAS = {"range.bias": 3.0}
_FAULT_START, _FAULT_TIME = _BEGIN + 800.0, 60.0


def _lost(how: str) -> dict[str, Any]:
    return {"log.lost_start": _BEGIN + 300.0, "log.lost_duration": 300.0, "log.lost": how}


def _lie(offset: float) -> dict[str, Any]:
    return {"depth.fault_start": _FAULT_START, "depth.fault_duration": _FAULT_TIME, "depth.fault_offset": offset}


FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "20 % of the ranges off by 10 to 300 m": _OUTLIERS,
    "ranges too long by 3 m": _BIAS,
    "log lost for 5 min: NaN": _lost("nan"),
    "log lost for 5 min: zeros": _lost("zeros"),
    "depth gauge wrong by 5 m for 1 min": _lie(5.0),
    "depth gauge wrong by 0.5 m for 1 min": _lie(0.5),
    "all at once, zeros and 5 m, whole dive": _OUTLIERS | _BIAS | _lost("zeros") | _lie(5.0),
}
_WHOLE = "whole dive"
_KINDS = ("range/vessel rejected", "log unusable", "depth rejected")


def run_fault(name: str, seeds: Sequence[int]) -> list[tuple[Array, list[float]]]:
    """Errors all along, and what diagnostics count of `_KINDS`; last the ranges' bias found, m."""
    found = []
    for seed in seeds:
        simulation = noiseless(() if _WHOLE in name else _SHORT).redrawn(seed, **errors_of(seed) | FAULTS[name])
        run = Run(simulation, filter_parameters()).until(float(simulation.trajectory.time[-1]) - LAG)
        ((_, _), (bias, _)) = run.navigator.own_states("range/vessel")
        counts = [float(run.navigator.events.counts.get(kind, 0)) for kind in _KINDS]
        found.append((np.array(run.rows), [*counts, bias]))
    return found


def _faults(found: dict[str, list[tuple[Array, list[float]]]]) -> str:
    rows = []
    for name, results_ in found.items():
        values = np.array([x for x, _ in results_])
        values = values[:, values[0, :, TIME] > _BEGIN - 60.0]
        distance = np.hypot(values[..., EAST], values[..., NORTH])
        across, up = distance / values[..., SIGMA], np.abs(values[..., UP]) / values[..., SIGMA_UP]
        counts = np.mean([x for _, x in results_], axis=0)
        ratios = [f(x) for x in (across, up) for f in (_greatest, lambda x: f"{_rms(x):.2f}")]
        rows.append([name, f"{_rms(distance):.2f}", *ratios, *(f"{x:.0f}" for x in counts[:3]), f"{counts[3]:.1f}"])
    head = [
        f"faults, {len(results_)} seeds, all along",
        "distance off, RMS, m",
        "greatest, over sigma (seeds beyond 3)",
        "RMS",
    ]
    head += ["height, greatest over sigma (seeds beyond 3)", "RMS", *_KINDS, "bias of ranges found, m"]
    return table(head, rows)


# --- a wrong start, a wrong beacon

_AWAY = (200.0, 400.0)
"""m, of the beacon from the start."""
_START_STDDEV, _START_OFF = 200.0, (150.0, 200.0)
"""m: sigma of the initial position in the filter, each axis, and its errors."""
_LOOKS = (100.0, 300.0, 600.0, 900.0, 1200.0, 1600.0)
"""s."""


def run_wrong_start(away: float, seeds: Sequence[int]) -> list[Array]:
    """Errors all along, without GNSS."""
    found = []
    for seed in seeds:
        absent = {"gnss.rate": 0.0, "beacon.positions": (0.0, -away, -2.0)}
        simulation = noiseless(_SHORT).redrawn(seed, **errors_of(seed) | absent)
        rng = np.random.default_rng(seed)
        length, direction = rng.uniform(*_START_OFF), rng.uniform(0.0, 2.0 * math.pi)
        origin = simulation.trajectory.origin
        meridian, prime_vertical = earth.principal_radii(math.sin(origin.lat))
        lat = origin.lat + length * math.cos(direction) / meridian
        lon = origin.lon + length * math.sin(direction) / (prime_vertical * math.cos(origin.lat))
        start = {"initial.latitude_deg": math.degrees(lat), "initial.longitude_deg": math.degrees(lon)}
        start |= {"initial.height": 0.0, "initial.position_stddev": _START_STDDEV, "depth.surface_height": 0.0}
        found.append(np.array(Run(simulation, filter_parameters() | start).until(_LOOKS[-1], 20.0).rows))
    return found


def _wrong_starts(found: dict[float, list[Array]]) -> str:
    rows = []
    for away, values in found.items():
        for time in _LOOKS:
            at = np.array([x[int(np.argmax(x[:, TIME] >= time - 20.0))] for x in values])
            distance = np.hypot(at[:, EAST], at[:, NORTH])
            ratios = f"{math.sqrt(at[:, NEES].mean() / 2.0):.2f}", f"{(distance / at[:, SIGMA]).max():.1f}"
            metres = f"{_rms(distance):.1f}", f"{distance.max():.1f}", f"{_rms(at[:, SIGMA]):.1f}"
            rows.append([f"{away:g} m, {time:g} s", *metres, *ratios])
    text = f"no GNSS, start wrong by {_START_OFF[0]:g} to {_START_OFF[1]:g} m, sigma {_START_STDDEV:g} m an axis, "
    head = [f"{text}{len(values)} seeds: beacon at", "distance off, RMS, m", "greatest, m", "sigma, RMS, m"]
    return table([*head, "error / sigma", "greatest (limit 3)"], rows)


_WRONG = 100.0
"""m, by which the beacon's fixes are wrong, to the east."""


def run_wrong_beacon(_: None, seeds: Sequence[int]) -> list[tuple[Array, list[float], list[float]]]:
    """Errors all along, numbers of ranges accepted and rejected, and the result of `_surfacing`."""
    found = []
    for seed in seeds:
        simulation = noiseless(_SHORT).redrawn(seed, **errors_of(seed))
        run = Run(simulation, filter_parameters())
        origin = simulation.trajectory.origin
        _, prime_vertical = earth.principal_radii(math.sin(origin.lat))
        degrees = math.degrees(_WRONG / (prime_vertical * math.cos(origin.lat)))
        run.change("beacon", lambda fix, off=degrees: (*fix[:3], fix[3] + off, *fix[4:]))  # type: ignore[misc]
        run.until(_surfaced(simulation) - _BEFORE)
        run.rows.append(run.errors())
        record = run.navigator.records["range/vessel"]
        found.append((np.array(run.rows), [float(record.accepted), float(record.rejected)], _surfacing(run, 0.0)))
    return found


def _wrong_beacons(found: list[tuple[Array, list[float], list[float]]]) -> str:
    values = np.array([x for x, _, _ in found])
    distance = np.hypot(values[..., EAST], values[..., NORTH])
    ratio = (distance / values[..., SIGMA])[:, values[0, :, TIME] > _BEGIN]
    accepted, rejected = np.mean([x for _, x, _ in found], axis=0)
    epochs = np.array([x[1] for _, _, x in found])
    row = [f"{len(found)} seeds", f"{accepted:.0f}", f"{rejected:.0f}", f"{_rms(distance[:, -1]):.1f}"]
    row += [f"{_rms(values[:, -1, SIGMA]):.1f}", f"{ratio.max():.1f}", f"{np.median(epochs):g}", f"{epochs.max():g}"]
    head = [f"beacon's fixes wrong by {_WRONG:g} m from the start, dive of 20 min"]
    head += ["ranges accepted", "rejected", "distance off at the end, RMS, m", "sigma, m", "greatest error / sigma"]
    return table([*head, f"fixes until within {_NEAR:g} m, median", "greatest"], [row])


DIVES = {
    "log perfect but for noise, no ranges": (Dive(log=False, ranges=False), 0.2),
    "log 0.2 % and 0.1°, no ranges": (Dive(ranges=False), 1.0),
    "the same with ranges": (Dive(), 1.0),
}
"""Cases compared with the bound, and the share of the seeds of each."""
_Result = TypeVar("_Result")
_Key = TypeVar("_Key")


def results(_data: Path, seeds: int = SEEDS) -> Iterator[str]:
    """The section's tables."""
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1)) as pool:

        def runs(what: Callable[[_Key, Sequence[int]], list[_Result]], of: _Key, share: float) -> list[_Result]:
            count = max(2, round(share * seeds))
            chunks = [range(first, min(first + _CHUNK, count)) for first in range(0, count, _CHUNK)]
            return [x for part in pool.map(functools.partial(what, of), chunks) for x in part]

        dives = {name: (dive, runs(run_dive, dive, share)) for name, (dive, share) in DIVES.items()}
        yield _dives(dives)
        yield _surfacings({name: dives[name] for name in dives if not dives[name][0].ranges})
        yield _calibrations({leg: runs(run_calibration, _surface(*leg), 0.4) for leg in _LEGS})
        yield _faults({name: runs(run_fault, name, 0.4) for name in FAULTS})
        yield _wrong_starts({away: runs(run_wrong_start, away, 0.2) for away in _AWAY})
        yield _wrong_beacons(runs(run_wrong_beacon, None, 0.2))


def _greatest(ratios: Array) -> str:
    """Over all, and how many seeds are ever beyond 3."""
    return f"{ratios.max():.1f} ({np.count_nonzero(ratios.max(axis=1) > 3.0)})"


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
