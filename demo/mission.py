"""The mission of the demo: how it is simulated, its phases, and what is measured of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization import earth
from ins_nav.recordings.bags import BagReader
from ins_nav.report.comparison import Comparison, Errors, compare, horizontal_offset
from ins_nav.report.series import Array, Positions, Stamps, Track
from ins_nav.report.table import table
from ins_nav.simulation.scenarios import Simulation, simulate

NAMES = ("alignment in swell", "at the surface", "dive", "surfaced")
_SAME_POSITION, _SAME_ANGLE = 1e-3, 1e-4
"""m and deg: live and ins_process are to agree within."""

_FULL: dict[str, Any] = {
    "alignment_time": 180.0,
    "turn_start": 90.0,
    "surface_leg": 120.0,
    "depth": 40.0,
    "dive_time": 420.0,
    "leg_length": 105.0,
    "leg_spacing": 25.0,
    "surface_time": 45.0,
    "log.lost_start": 450.0,
    "log.lost_duration": 60.0,
}
_QUICK: dict[str, Any] = {
    "alignment_time": 90.0,
    "turn_start": 65.0,
    "surface_leg": 20.0,
    "depth": 8.0,
    "dive_time": 80.0,
    "surface_time": 10.0,
    "log.lost_start": 145.0,
    "log.lost_duration": 10.0,
}
_ALWAYS: dict[str, Any] = {
    "range.outlier_share": 0.1,
    "beacon.positions": (65.0, 45.0, -2.0),
    "beacon.radii": (20.0,),
}


class Span(NamedTuple):
    """From and to, s since the start of the recording."""

    start: float
    end: float


@dataclass(frozen=True)
class Mission:
    """A mission with its phases, each of `NAMES`; the dive is while there are no fixes."""

    simulation: Simulation
    phases: tuple[Span, Span, Span, Span]
    log_lost: Span

    def time(self, stamps_ns: Stamps) -> Array:
        """Time of stamps, s since the start of the recording."""
        return (stamps_ns - self.simulation.start_ns).astype(np.float64) * 1e-9


def make(quick: bool, seed: int) -> Mission:
    """Simulate it.

    Parameters
    ----------
    quick : bool
        200 s instead of 765 s.
    seed : int
    """
    simulation = simulate("auv_dive", seed, **_ALWAYS, **(_QUICK if quick else _FULL))
    p, fixes = simulation.parameters, (simulation.fixes.stamps_ns - simulation.start_ns) * 1e-9
    lost = int(np.argmax(np.diff(fixes)))
    down, up = fixes[lost : lost + 2].tolist()
    aligned, end = p["alignment_time"], float(simulation.trajectory.time[-1])
    phases = Span(0.0, aligned), Span(aligned, down), Span(down, up), Span(up, end)
    return Mission(simulation, phases, Span(p["log.lost_start"], p["log.lost_start"] + p["log.lost_duration"]))


def described(mission: Mission) -> str:
    """The mission in some lines."""
    p, minutes = mission.simulation.parameters, mission.phases[-1].end / 60.0
    return "\n".join(
        [
            f"an underwater vehicle's mission of {minutes:.1f} min",
            f"  {p['alignment_time']:.0f} s in the swell with a half turn, {p['surface_leg']:.0f} s under way at the "
            f"surface, {p['dive_time']:.0f} s under water down to {p['depth']:.0f} m, surfacing",
            "  fibre-optic gyros; GNSS at the surface, depth gauge, log, ranges to a vessel",
            f"  the log loses the bottom for {p['log.lost_duration']:.0f} s; {100.0 * p['range.outlier_share']:.0f} % "
            f"of the ranges are wrong by {' to '.join(f'{x:.0f}' for x in p['range.outlier_span'])} m",
        ]
    )


def local(position: Positions, mission: Mission) -> Array:
    """East and north of the origin of the mission, (n, 2), m."""
    origin = mission.simulation.trajectory.origin
    start = earth.geodetic_to_ecef(origin.lat, origin.lon, origin.height)
    return horizontal_offset(position.ecef, start, origin.lat, origin.lon)


def accuracy(mission: Mission, reference: Track, comparison: Comparison) -> str:
    """Table of errors and their sigmas at the ends of the phases."""
    position, attitude = comparison.position, comparison.attitude
    assert attitude is not None
    aligned, surface, dive, end = mission.phases
    heading = np.degrees([np.abs(attitude.values[:, 2]), attitude.stddev[:, 2]])
    horizontal = np.array([np.hypot(*position.values[:, :2].T), np.hypot(*position.stddev[:, :2].T)])
    under = np.flatnonzero(_within(mission, position, dive))
    down, last, up = under[0], under[-1], -1
    worst = under[np.argmax(horizontal[0, under])]
    distance = _distance(reference.position, mission, dive)
    rows = {f"heading after {aligned.end:.0f} s in the swell, deg": (heading[:, _last(mission, attitude, aligned)], 3)}
    rows["  when it dives"] = heading[:, _last(mission, attitude, surface)], 3
    rows["  at the end of the dive"] = heading[:, _last(mission, attitude, dive)], 3
    rows["horizontal position when it dives, m"] = horizontal[:, down], 2
    rows["  at its worst under water"] = horizontal[:, worst], 2
    rows["  at the end of the dive, before GNSS returns"] = horizontal[:, last], 2
    rows[f"  the same in % of the {distance:.0f} m run under water"] = 100.0 / distance * horizontal[:, last], 3
    rows[f"  {end.end - end.start:.0f} s after surfacing"] = horizontal[:, up], 2
    rows["depth at the end of the dive, m"] = np.array([abs(position.values[last, 2]), position.stddev[last, 2]]), 2
    return table(
        {
            column: {row: f"{pair[i]:.{digits}f}" for row, (pair, digits) in rows.items()}
            for i, column in enumerate(("error", "its sigma"))
        }
    )


def aids(filter_says: dict[str, str]) -> str:
    """Table of what was done with the aids' messages, from the diagnostics of alignment_node."""
    ending = ": accepted, rejected"
    columns: dict[str, dict[str, str]] = {"accepted": {}, "rejected by the gate": {}, "without a value": {}}
    for key, value in filter_says.items():
        if key.endswith(ending):
            name = key.removesuffix(ending)
            counts = (*value.split(", "), filter_says.get(f"{name} unusable", "0"))
            for column, count in zip(columns.values(), counts, strict=True):
                column[name] = count
    return table(columns)


def last_status(bag: Path, subject: str) -> dict[str, str]:
    """Values of the last status on /diagnostics whose name ends so."""
    last: dict[str, str] = {}
    with BagReader(bag) as reader:
        for raw in reader.messages(["/diagnostics"]):
            for status in reader.deserialize(raw).status:
                if status.name.endswith(f": {subject}"):
                    last = {item.key: item.value for item in status.values}
    return last


def agreement(live: Track, batch: Track) -> str:
    """How far two results are the same, in words."""
    difference = compare(live, batch)
    assert difference.attitude is not None
    distance = np.linalg.norm(difference.position.values, axis=1)
    turn = np.degrees(np.abs(difference.attitude.values).max(axis=1))
    same = np.count_nonzero((distance <= _SAME_POSITION) & (turn <= _SAME_ANGLE))
    counts = f"{len(live.position.stamps_ns)} and {len(batch.position.stamps_ns)}"
    text = (
        f"live and ins_process: {counts} solutions, {same} the same within {1e3 * _SAME_POSITION:g} mm and "
        f"{_SAME_ANGLE:g} deg\n  greatest difference: {1e3 * distance.max():.3g} mm, {turn.max():.2g} deg"
    )
    late = live.diagnostics.get("correction late")
    return f"{text} (corrections that came late, as the machine was busy: {late})" if late else text


def _distance(position: Positions, mission: Mission, span: Span) -> float:
    """Run over ground in the time, m."""
    steps = np.diff(local(position, mission)[_within(mission, position, span)], axis=0)
    return float(np.hypot(*steps.T).sum())


def _within(mission: Mission, series: Errors | Positions, span: Span) -> NDArray[np.bool_]:
    time = mission.time(series.stamps_ns)
    return (time >= span.start) & (time < span.end)


def _last(mission: Mission, series: Errors, span: Span) -> int:
    return int(np.flatnonzero(_within(mission, series, span))[-1])
