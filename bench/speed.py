"""Cost of a sample: in the core, in the navigator, in ins_process."""

import itertools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from pyins.strapdown import Integrator, compute_increments_from_imu

from bench.markdown import spread, table
from bench.mechanization import DURATION, from_pyins, pyins_data
from bench.recordings import process
from ins_nav import strapdown
from ins_nav.navigator import Navigator, Phase
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import Simulation, simulate

_RATE, _ALIGNMENT = 400.0, 20.0
_REPEATS, _SLOW_REPEATS = 7, 3
_COUNT = 20_000
"""Samples of the loops in plain Python."""


def seconds(function: Callable[[], object], repeats: int = _REPEATS) -> list[float]:
    """Times of several calls, after one that does not count."""
    function()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return times


def results(_data: Path) -> Iterator[str]:
    """The section's tables."""
    yield _core()
    simulation = simulate("vehicle", 0, rate=_RATE, duration=DURATION, stand_time=30.0)
    yield _whole(simulation)


def _core() -> str:
    trajectory, readings = pyins_data(60.0, _RATE)
    case = from_pyins(trajectory, readings)
    first, count = tuple(case.samples[0].tolist()), len(case.samples) - 1
    samples = [tuple(row) for row in case.samples[: _COUNT + 1].tolist()]

    def plain() -> None:
        state, previous = case.start, samples[0]
        for sample in samples[1:]:
            state = strapdown.step(state, previous, sample, False, True)
            previous = sample

    increments = compute_increments_from_imu(readings, "increment")
    theirs = seconds(lambda: Integrator(trajectory.iloc[0]).integrate(increments))
    whole = seconds(lambda: Integrator(trajectory.iloc[0]).integrate(compute_increments_from_imu(readings, "increment")))
    ours = seconds(lambda: strapdown.integrate(case.start, first, case.samples[1:]))
    times = {
        "strapdown.step, plain Python (live)": [t / _COUNT for t in seconds(plain)],
        "strapdown.step, compiled by numba (batch)": [t / count for t in ours],
        "pyins' integrator (batch), increments given": [t / count for t in theirs],
        "the same, increments with coning and sculling too, as ours": [t / count for t in whole],
    }
    base = statistics.median(ours) / count
    rows = [
        [name, spread([t * 1e6 for t in ts], 3), f"{statistics.median(ts) / base:.1f}"] for name, ts in times.items()
    ]
    return table(["one sample", f"µs, median of {_REPEATS} (range)", "times the compiled step"], rows)


def _whole(simulation: Simulation) -> str:
    add = [_add_imu(simulation) for _ in range(_REPEATS)]
    count = len(simulation.stamps_ns)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bag(simulation, folder / "bag")
        times = []
        for i in range(_SLOW_REPEATS):
            began = time.perf_counter()
            process(folder / "bag", folder / f"out{i}", f"alignment.duration:={_ALIGNMENT}")
            times.append(time.perf_counter() - began)
    rows = [
        ["Navigator.add_imu while navigating, µs a sample", spread([t * 1e6 for t in add], 2)],
        [f"ins_process, {DURATION:g} s at {_RATE:g} Hz, s", spread(times, 1)],
        ["ins_process, samples a second", spread([count / t for t in times], 0)],
        ["ins_process, times real time", spread([DURATION / t for t in times], 0)],
    ]
    return table(["", f"median of {_REPEATS}, of {_SLOW_REPEATS} for ins_process (range)"], rows)


def _add_imu(simulation: Simulation) -> float:
    """Seconds a sample."""
    place = {"latitude_deg": 55.7, "longitude_deg": 37.6, "height": 150.0}
    navigator = Navigator(
        {f"initial.{name}": value for name, value in place.items()} | {"alignment.duration": _ALIGNMENT}
    )
    values = np.column_stack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
    rows = zip(simulation.stamps_ns.tolist(), values, strict=True)
    for stamp, row in rows:
        navigator.add_imu(stamp, *row)
        if navigator.phase is Phase.NAVIGATING:
            break
    rest = list(itertools.islice(rows, _COUNT))
    began = time.perf_counter()
    for stamp, row in rest:
        navigator.add_imu(stamp, *row)
    return (time.perf_counter() - began) / len(rest)
