"""Every fault of `bench.fault_table` on every carrier: errors, sigmas, protection levels, reports, recovery.

The engine of `ins_process` runs over messages in memory (`bench.fault_run`), two processes side by side.
"""

import fnmatch
import functools
import math
import re
import signal
import statistics
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from bench.fault_run import COMPONENTS, EVERY, PROTECTED, Line, Run, Track, recording_of
from bench.fault_table import CARRIERS, ROWS, Row, simulated
from ins_nav.errors import ENDING_SIGNALS, InsNavError

Array = NDArray[np.float64]
_PROCESSES = 2
_HANGS = 900
"""s after which a run counts as hanging."""
_RIGHT = 3.0
"""Right again: within so many sigmas, and so many times the error of the clean run about then."""
_ABOUT = 60.0
"""s about an instant, of which the clean run's greatest error counts."""
_LEVEL_TIME, _SIGMAS, _SIGMA_TIME = 10.0, 5.0, 5.0
"""s to report an error over its protection level; sigmas that an unreported error exceeds for at most so long, s."""
_TEXT = 70
_HEAD = "row                                                        error m  height m  /sigma     worst/sigma   "
_HEAD += "/level    >5s s  none s  reported s  right s  report"


@dataclass(frozen=True)
class Result:
    """A row of the table.

    Attributes
    ----------
    name : str
    error : ndarray, shape (4,)
        Greatest of `bench.fault_run.COMPONENTS`, from the begin of the fault on.
    ratio : ndarray, shape (4,)
        Greatest over sigma.
    level : float
        Greatest over its protection level, NaN where there is none.
    over_time, none_time : float
        s beyond 5 sigma, and without a solution.
    reported, right : float
        s from the begin of the fault to the report; s from its end, or from its begin where it has none, to the last
        error that is not right; infinite: never.
    report : str
    fails : list of str
        Limits that the row exceeds.
    """

    name: str
    error: Array
    ratio: Array
    level: float
    over_time: float
    none_time: float
    reported: float
    right: float
    report: str
    fails: list[str]

    def text(self) -> str:
        """One line of the table."""
        worst = int(np.nanargmax(self.ratio)) if np.isfinite(self.ratio).any() else 0
        cells = [
            self.name[:57].ljust(57),
            f"{_number(self.error[0]):>9}",
            f"{_number(self.error[1]):>9}",
            f"{_number(self.ratio[0]):>7}",
            f"{_number(self.ratio[worst]):>7} {COMPONENTS[worst]:<8}",
            f"{_number(self.level):>6}",
            f"{self.over_time:>8.0f}",
            f"{self.none_time:>7.0f}",
            f"{_seconds(self.reported):>11}",
            f"{_seconds(self.right):>8}",
            f" {self.report[:_TEXT]}",
        ]
        return " ".join(cells)


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}" if value < 1e4 else f"{value:.1e}"


def _seconds(value: float) -> str:
    return "never" if math.isinf(value) else f"{value:.1f}"


def evaluate(row: Row, track: Track, clean: Track, name: str = "") -> Result:
    """Figures of a run with a fault, beside the run without.

    Parameters
    ----------
    row : Row
    track, clean : Track
    name : str, optional
        Other than the row's.
    """
    begin = max(row.span.begin, CARRIERS[row.carrier].aligned)
    time, after = track.time, track.time >= begin
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios, levels = track.error / track.sigma, track.error[:, :PROTECTED] / track.level
    level = _greatest(levels.T)
    line = _first_report(row, track, clean)
    told = line.time if line is not None else math.inf
    fails = []
    beyond = time[after & (level > 1.0)]
    if len(beyond) and told > beyond[0] + _LEVEL_TIME:
        fails.append("over its protection level, unreported")
    is_clean = not (row.faults or row.simulated)
    limits = np.zeros_like(ratios) if is_clean else _usual(clean, time)[1]
    over = after & (ratios > np.maximum(_SIGMAS, limits)).any(axis=1)
    if EVERY * float((over & (time < told)).sum()) > _SIGMA_TIME:
        fails.append("over 5 sigma, unreported")
    elif EVERY * float(over.sum()) > _SIGMA_TIME:
        fails.append("over 5 sigma, reported")
    none = after & np.isnan(track.error[:, 0])
    if EVERY * float(none.sum()) > _SIGMA_TIME:
        fails.append("no solution")
    if track.raised:
        fails.append("raised")
    right = 0.0 if is_clean else _right_again(row, track, clean)
    report = track.raised or (line.text if line is not None else "")
    times = EVERY * float(over.sum()), EVERY * float(none.sum())
    error, ratio = (_greatest(x[after].T, axis=1) for x in (track.error, ratios))
    reported = max(0.0, told - row.span.begin)
    return Result(
        name or row.name, error, ratio, float(_greatest(level[after])), *times, reported, right, report, fails
    )


def _greatest(values: Array, axis: int = 0) -> Array:
    """Greatest that is a number, along an axis; NaN where there is none."""
    filled = np.where(np.isnan(values), -np.inf, values)
    greatest = filled.max(axis=axis, initial=-np.inf)
    return np.where(np.isneginf(greatest), np.nan, greatest)


def _first_report(row: Row, track: Track, clean: Track) -> Line | None:
    """The first warning or error since the begin of the fault; of diagnostics one that names the source."""
    usual = {_kind(line) for line in clean.lines} if row.faults or row.simulated else set()
    for line in track.lines:
        if line.time >= row.span.begin and _kind(line) not in usual and (not line.diagnostic or row.topic in line.text):
            return line
    return None


def _kind(line: Line) -> str:
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", line.text)


def _usual(clean: Track, time: Array) -> tuple[Array, Array]:
    """Greatest errors, and errors over sigma, of the clean run about each time, shape (n, 4) each."""
    width = round(_ABOUT / EVERY) | 1
    about = [
        [maximum_filter1d(np.nan_to_num(column), width) for column in values.T]
        for values in (clean.error, clean.error / clean.sigma)
    ]
    error, ratio = (np.array([np.interp(time, clean.time, column) for column in columns]).T for columns in about)
    return error, ratio


def _right_again(row: Row, track: Track, clean: Track) -> float:
    end = row.span.end if math.isfinite(row.span.end) else row.span.begin
    after = track.time >= max(end, CARRIERS[row.carrier].aligned)
    error, ratio = _usual(clean, track.time)
    limit = np.minimum(_RIGHT * error, np.maximum(_RIGHT, ratio) * track.sigma)
    wrong = track.time[after & ~(track.error <= limit).all(axis=1)]  # NaN is wrong
    if track.raised:
        return math.inf
    if not len(wrong):
        return 0.0
    return math.inf if wrong[-1] > track.time[-1] - _SIGMA_TIME else float(wrong[-1] - end)


def _by_default() -> None:
    """A process ends at a signal: it does not inherit the handlers of the command."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def run_row(name: str, seed: int) -> Track:
    """The run of one row, in a process of its own."""

    def hangs(*_: object) -> None:
        raise TimeoutError(f"no end after {_HANGS} s")

    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(_HANGS)
    try:
        return track_of(ROWS[name], seed)
    finally:
        signal.alarm(0)


def track_of(row: Row, seed: int) -> Track:
    """The run of a row; where the fault begins under way, the way to it is computed once for all rows."""
    simulation, recording = row.recording(seed)
    if row.simulated or row.span.begin <= CARRIERS[row.carrier].aligned or not row.faults:
        return Run(simulation, recording, CARRIERS[row.carrier].parameters).until().track
    return _way(row.carrier, seed, row.span.begin).fork(recording).until().track


@functools.lru_cache(12)
def _way(carrier: str, seed: int, end: float) -> Run:
    """The run without a fault to the begin of one."""
    simulation = simulated(carrier, seed)
    return Run(simulation, recording_of(simulation), CARRIERS[carrier].parameters).until(end)


def chosen(pattern: str) -> list[Row]:
    """Rows whose names match.

    Raises
    ------
    InsNavError
        None does.
    """
    found = [row for row in ROWS.values() if fnmatch.fnmatch(row.name.lower(), f"*{pattern.lower()}*")]
    if not found:
        raise InsNavError(f"no row matches {pattern!r}; a row is for instance {next(iter(ROWS))!r}")
    return found


def results(data: Path, seeds: int = 1, rows: str = "*") -> Iterator[str]:
    """Rows as they are ready, then the summary.

    Parameters
    ----------
    data : Path
        Not used.
    seeds : int
        Of the simulation, from 1 on.
    rows : str
        Pattern of names, ``*`` and ``?`` as in file names.
    """
    wanted, found = chosen(rows), []
    yield _HEAD
    with ProcessPoolExecutor(_PROCESSES, initializer=_by_default) as pool:
        clean: dict[tuple[str, int], Future[Track]] = {}
        runs: dict[Future[Track], tuple[Row, int]] = {}
        for seed in range(1, seeds + 1):
            for carrier in dict.fromkeys(row.carrier for row in wanted):
                clean[carrier, seed] = pool.submit(run_row, f"{carrier}: none", seed)
        for seed in range(1, seeds + 1):
            for row in wanted:
                usual = clean[row.carrier, seed]
                runs[usual if row.name == f"{row.carrier}: none" else pool.submit(run_row, row.name, seed)] = row, seed
        try:
            for future in as_completed(runs):
                row, seed = runs[future]
                name = row.name if seeds == 1 else f"{row.name} #{seed}"
                result = evaluate(row, future.result(), clean[row.carrier, seed].result(), name)
                found.append(result)
                print(result.text(), flush=True)
        finally:
            pool.shutdown(cancel_futures=True)
    yield summary(found)


def summary(found: list[Result]) -> str:
    """Numbers of rows that exceed limits, and their names."""
    lines = [f"{len(found)} rows"]
    for limit in dict.fromkeys(fail for result in found for fail in sorted(result.fails)):
        rows = sorted((x for x in found if limit in x.fails), key=lambda x: -_worst(x))
        lines.append(f"\n{limit}: {len(rows)} rows")
        lines += [f"- {x.name}: {_number(_worst(x))} sigma, {_number(x.error[0])} m" for x in rows]
    finite = [x.reported for x in found if math.isfinite(x.reported)]
    if finite:
        lines.append(f"\nreported in {len(finite)} rows, after {statistics.median(finite):.1f} s at the median")
    return "\n".join(lines)


def _worst(result: Result) -> float:
    return float(_greatest(result.ratio)) if np.isfinite(result.ratio).any() else math.inf
