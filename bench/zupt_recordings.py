"""Effect of stops in real drives: free inertial after them, with and without corrections."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.markdown import table
from ins_nav.cli.process import input_topics, input_types
from ins_nav.config.declaration import DEG_PER_HOUR
from ins_nav.estimation import covariance_propagation
from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.state_layout import HORIZONTAL_POSITION, POSITION
from ins_nav.mechanization import nav_state, strapdown
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.strapdown import Sample
from ins_nav.messages.inputs import read_imu
from ins_nav.navigator.system import NavigationSystem, ScheduledCalls
from ins_nav.recordings.bags import BagReader
from ins_nav.report.comparison import horizontal_offset
from ins_nav.report.series import Positions, interpolated, read_reference

Array = NDArray[np.float64]
_FREE = 60.0
"""s of free inertial."""
_LEAST = 10.0
"""s: shorter stops are not counted."""
_NS = 1e-9
_TACTICAL: Mapping[str, object] = {
    "imu.gyro_bias_stddev_deg_per_hour": 3.0,
    "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 1.0,
    "imu.accel_bias_stddev_mg": 1.0,
}
_HEADING: Mapping[str, object] = {"initial.heading_deg": 199.8, "initial.heading_stddev_deg": 1.0}
_SOUGHT: Mapping[str, object] = {"alignment.duration": 300.0}
_VERTICAL_DRIFT = -2.0
"""deg/h, of kingston_a's up gyro."""


class Way(NamedTuple):
    """How to go through a recording."""

    name: str
    overrides: Mapping[str, object]
    calls: bool


class Departure(NamedTuple):
    """The end of a stop."""

    began: float
    """s from the recording's start."""
    length: float
    """s."""
    error: float
    """How far the position's error has moved after `_FREE` of free inertial, m; NaN when the recording ends before."""
    stddev: float
    """Of that, by the covariance at the end of the stop, m."""
    gyro_bias: Array
    """In use, rad/s."""


class Journey(NamedTuple):
    """A recording gone through."""

    departures: list[Departure]
    end: float
    """Horizontal distance from the last reference position, m."""
    done: int
    """Calibrations."""


def go(bag: Path, way: Way) -> Journey:
    """Through a recording; from each longer stop on, besides, free inertial as it would go on without stops."""
    system = NavigationSystem(way.overrides, aided=False)
    navigator = system.realtime
    calls = ScheduledCalls(system, lambda _stopped: None) if way.calls else None
    reference = read_reference(bag)
    assert reference is not None
    samples: list[tuple[int, Array]] = []
    departures: list[tuple[int, int, int, NavState, Array, ErrorFilter]] = []
    states: list[tuple[int, NavState]] = []
    stopped, since = False, 0
    with BagReader(bag) as reader:
        names = input_topics(reader, {}, input_types(system.configuration.values))
        for raw in reader.messages(names):
            topic, message = names[raw.topic], reader.deserialize(raw)
            if topic != "/imu/data_raw":
                system.add(topic.removeprefix("/"), message)
                continue
            new = system.add_imu(*read_imu(message))
            if calls is not None:
                calls.after_sample()
            if not new or navigator.state is None:
                continue
            # biases out of these samples are put back: later ones may differ
            sample = np.array([*navigator.angular_velocity, *navigator.specific_force])
            sample += [*navigator.gyro_bias, *navigator.accel_bias]
            samples.append((navigator.stamp_ns, sample))
            states.append((navigator.stamp_ns, navigator.state))
            detector = system.front_end.detector
            if stopped and not detector.stopped:
                bias = np.array([*navigator.gyro_bias, *navigator.accel_bias])
                span, i = (since, detector.since_ns), len(samples) - 1
                departures.append((*span, i, navigator.state, bias, _filter(system)))
            stopped, since = detector.stopped, detector.since_ns
        first_ns = reader.start_ns
    stamps = np.array([stamp for stamp, _ in samples])
    values = np.array([sample for _, sample in samples])
    positions = reference.position
    found = []
    for began, ended, i, state, bias, errors in departures:
        if (ended - began) * _NS < _LEAST:
            continue
        last = int(np.searchsorted(stamps, stamps[i] + _FREE / _NS))
        moved = stddev = math.nan
        if last < len(stamps) and stamps[last] <= positions.stamps_ns[-1]:
            after = _free(state, errors, stamps[i - 1 : last + 1], values[i - 1 : last + 1] - bias)
            change = _error(after, int(stamps[last]), positions) - _error(state, int(stamps[i]), positions)
            moved = float(np.hypot(*change))
            stddev = math.sqrt(float(errors.p.diagonal()[HORIZONTAL_POSITION].sum()))
        found.append(Departure((began - first_ns) * _NS, (ended - began) * _NS, moved, stddev, bias[:3]))
    last_ns = int(positions.stamps_ns[positions.stamps_ns <= stamps[-1]][-1])
    nearest = states[int(np.argmin(np.abs(stamps - last_ns)))]
    return Journey(found, float(np.hypot(*_error(nearest[1], nearest[0], positions))), system.services.solved)


def _filter(system: NavigationSystem) -> ErrorFilter:
    """A filter with the errors of the present solution, position exact."""
    navigator = system.realtime
    assert navigator.covariance is not None
    covariance = navigator.covariance
    covariance[POSITION, :] = covariance[:, POSITION] = 0.0
    model = covariance_propagation.error_model(system.configuration, navigator.accuracy.white_noise)
    return covariance_propagation.filter_of(model, covariance)


def _free(state: NavState, errors: ErrorFilter, stamps: NDArray[np.int64], values: Array) -> NavState:
    """Free inertial from the second of the stamps, where state and errors are, to the last."""
    intervals = np.diff(stamps) * _NS
    rows: list[Sample] = np.column_stack([intervals, values[1:]]).tolist()
    for previous, sample in itertools.pairwise(rows):
        before = state
        state = strapdown.step(state, previous, sample, False, False)
        errors.propagate(before, state, sample[0])
    return state


def _error(state: NavState, stamp_ns: int, reference: Positions) -> Array:
    """Position less the reference's, east and north, m."""
    ecef = interpolated(reference.stamps_ns, reference.ecef, np.array([stamp_ns]))
    where = nav_state.geodetic(state)
    offset = horizontal_offset(np.array([nav_state.position_ecef(state)]), ecef, where.lat, where.lon)
    return np.asarray(offset[0], float)


def recordings(data: Path, pool: Executor) -> Iterator[str]:
    """Tables of the recordings that are there."""
    for name, ways, section in (("kingston_a", _KINGSTON, _kingston), ("rlg_drive", _DRIVE, _drive)):
        if (data / name).exists():
            journeys = list(pool.map(go, [data / name] * len(ways), ways))
            yield section(ways, journeys)
        else:
            yield f"{name} skipped: no recordings in {data}"


_KINGSTON = [
    Way("nothing", {**_TACTICAL, **_HEADING, "zupt.zero_velocity": False}, False),
    Way("zero velocity", {**_TACTICAL, **_HEADING}, False),
    Way("and ZUPT", {**_TACTICAL, **_HEADING}, True),
    Way("self-aligned: zero velocity", {**_TACTICAL, **_SOUGHT}, False),
    Way("self-aligned: and ZUPT", {**_TACTICAL, **_SOUGHT}, True),
]


def _kingston(ways: Sequence[Way], journeys: Sequence[Journey]) -> str:
    whole = journeys[2].departures
    rows: list[Sequence[object]] = []
    for i, one in enumerate(whole):
        if not math.isnan(one.error):
            same = [journey.departures[i] for journey in journeys]
            cells = [_moved(each.error, each.error / each.stddev) for each in same]
            vertical = one.gyro_bias[2] / DEG_PER_HOUR
            rows.append([f"{one.began:.0f} s, {one.length:.0f} s long", *cells, f"{vertical:+.2f}"])
    rms = []
    for journey in journeys:
        both = np.array([(one.error, one.error / one.stddev) for one in journey.departures])
        rms.append(_moved(*np.sqrt(np.nanmean(both**2, axis=0)).tolist()))
    worst = max(abs(one.gyro_bias[2] / DEG_PER_HOUR - _VERTICAL_DRIFT) for one in whole)
    rows.append(["RMS", *rms, f"off by {worst:.2f} (limit 2)"])
    head = [
        f"kingston_a, from the stop at: error after {_FREE:g} s, m (over its sigma)",
        *(way.name for way in ways),
        f"vertical drift, °/h (known {_VERTICAL_DRIFT:g})",
    ]
    return table(head, rows)


_DRIVE = [
    Way("nothing", {"zupt.zero_velocity": False}, False),
    Way("zero velocity", {}, False),
    Way("and ZUPT-1, ZUPT-2", {}, True),
    Way("30 s of alignment, nothing", {"zupt.zero_velocity": False, "alignment.duration": 30.0}, False),
    Way(
        "30 s of alignment, zero velocity and ZUPT-2",
        {"alignment.duration": 30.0, "stop_detector.start_sequence": "zupt2"},
        True,
    ),
]


def _drive(ways: Sequence[Way], journeys: Sequence[Journey]) -> str:
    rows = [[way.name, _metres(one.end), one.done] for way, one in zip(ways, journeys, strict=True)]
    return table(["rlg_drive, one stop of 66 s, then 70 s", "from the last fix, m", "calibrations"], rows)


def _metres(value: float) -> str:
    return f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"


def _moved(error: float, ratio: float) -> str:
    return f"{_metres(error)} ({ratio:.2f})"
