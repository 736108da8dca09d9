"""Cost of a sample: in the core, in the navigator, in ins_process.

Processor time, which other processes disturb less than the clock's; all of it is one thread's.
"""

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
from ins_nav.mechanization import strapdown
from ins_nav.navigator.front_end import Phase
from ins_nav.navigator.system import NavigationSystem
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import Simulation, simulate

_RATE, _ALIGNMENT = 400.0, 20.0
_REPEATS, _SLOW_REPEATS = 7, 3
_COUNT = 20_000
"""Samples of the loops in plain Python."""


def results(_data: Path) -> Iterator[str]:
    """The section's tables."""
    yield _core()
    simulation = simulate("vehicle", 0, rate=_RATE, duration=DURATION, stand_time=30.0)
    yield _navigator(simulation)
    yield _process(simulation)


def _core() -> str:
    trajectory, readings = pyins_data(60.0, _RATE)
    case = from_pyins(trajectory, readings)
    first, count = tuple(case.samples[0].tolist()), len(case.samples) - 1
    samples = [tuple(row) for row in case.samples[: _COUNT + 1].tolist()]
    increments = compute_increments_from_imu(readings, "increment")

    def plain() -> None:
        state = case.start
        for previous, sample in itertools.pairwise(samples):
            state = strapdown.step(state, previous, sample, False, True)

    def pyins_integrates() -> None:
        Integrator(trajectory.iloc[0]).integrate(increments)

    def pyins_does_all() -> None:
        Integrator(trajectory.iloc[0]).integrate(compute_increments_from_imu(readings, "increment"))

    times = {
        "strapdown.step, plain Python (live)": _times(plain, _COUNT),
        "strapdown.step, compiled by numba (batch)": _times(
            lambda: strapdown.integrate(case.start, first, case.samples[1:]), count
        ),
        "pyins' integrator (batch), its increments given": _times(pyins_integrates, count),
        "pyins, coning and sculling included as in ours": _times(pyins_does_all, count),
    }
    base = statistics.median(times["strapdown.step, compiled by numba (batch)"])
    rows = [
        [name, spread([t * 1e6 for t in ts], 3), f"{statistics.median(ts) / base:.1f}"] for name, ts in times.items()
    ]
    return table(["one sample", f"µs, median of {_REPEATS} (range)", "times the compiled step"], rows)


def _times(function: Callable[[], object], samples: int) -> list[float]:
    """Seconds a sample of several calls, after one that does not count."""
    function()
    times = []
    for _ in range(_REPEATS):
        began = time.process_time()
        function()
        times.append((time.process_time() - began) / samples)
    return times


def _navigator(simulation: Simulation) -> str:
    place = {"latitude_deg": 55.7, "longitude_deg": 37.6, "height": 150.0}
    settings = {f"initial.{name}": value for name, value in place.items()} | {"alignment.duration": _ALIGNMENT}
    navigator = NavigationSystem(settings, aided=False)
    values = np.column_stack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
    samples = zip(simulation.stamps_ns.tolist(), values, strict=True)
    phases: dict[Phase, list[float]] = {Phase.COARSE: [], Phase.NAVIGATING: []}
    size = 1_000
    while len(phases[Phase.NAVIGATING]) < _COUNT // size:
        chunk, phase = list(itertools.islice(samples, size)), navigator.phase
        began = time.process_time()
        for stamp, row in chunk:
            navigator.add_imu(stamp, *row)
        if navigator.phase is phase:  # not where the alignment is solved
            phases[phase].append((time.process_time() - began) / size)
    rows = [[f"Navigator.add_imu, {phase.value}", spread([t * 1e6 for t in ts], 2)] for phase, ts in phases.items()]
    return table([f"one sample, in plain Python, {_RATE:g} Hz", "µs, median (range)"], rows)


def _process(simulation: Simulation) -> str:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bag(simulation, folder / "bag")
        clock, processor = [], []
        for i in range(_SLOW_REPEATS):
            began, busy = time.perf_counter(), time.process_time()
            process(folder / "bag", folder / str(i), f"alignment.duration:={_ALIGNMENT}")
            processor.append(time.process_time() - busy)
            clock.append(time.perf_counter() - began)
    rows = [
        [
            label,
            f"{len(simulation.stamps_ns) / statistics.median(times):.0f}",
            f"{DURATION / statistics.median(times):.0f}",
            spread(times, 1),
        ]
        for label, times in (("processor time", processor), ("by the clock", clock))
    ]
    head = f"ins_process, {DURATION:g} s at {_RATE:g} Hz, bag to bag"
    return table([head, "samples a second", "times real time", f"s, median of {_SLOW_REPEATS} (range)"], rows)
