"""ZUPT: the paper's run, two positions, noise against the theoretical bound, real stops.

References
----------
.. [1] E. S. Lobusov, A. V. Fomichev, "ZUPT mode for a strapdown INS of a ground vehicle", Vestnik MGTU, 2014, no. 6.
"""

import functools
import itertools
import math
import multiprocessing
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.markdown import table
from bench.zupt_bound import Span, bound
from bench.zupt_recordings import recordings
from ins_nav.aiding.simulated import fix_message
from ins_nav.config.parameters import read_file
from ins_nav.errors import InsNavError
from ins_nav.estimation.state_layout import GYRO_BIAS, HEADING, SIZE
from ins_nav.mechanization import earth, nav_state
from ins_nav.navigator.system import NavigationSystem
from ins_nav.recordings.bags import message
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.zupt.calibration import SETTLE_NS
from ins_nav.zupt.stationary_rates import StationaryRates, StationaryRatesResult
from ins_nav.zupt.zupt_equations import StopMeasurement, zupt1_nonlinear

Array = NDArray[np.float64]
PAPER = Path(__file__).resolve().parents[1] / "config" / "paper_zupt.yaml"
PAPER_CALL = 200.0
"""s: the call of ZUPT-2."""
GYRO_NOISE, ACCEL_NOISE = math.radians(0.001) / 60.0, 10e-6 * 9.80665
"""0.001 °/√h in rad/√s, 10 µg/√Hz in m/s²/√Hz."""
_RATE, _NOISY_RATE = 100.0, 20.0
"""Hz, of the runs with two positions, without noise and with it: white noise of a density is the same at any rate."""
_FIRST, _TURN, _SECOND = 200.0, 20.0, 200.0
"""s: stops of ZUPT-1 and the turn between them."""
_LATE = 2.0
"""s before the end of a stop, of the call there."""
_SETTLED = 6.0
"""s after a call, when its correction is in the solution."""
_SEEDS = 100
_ARC_SECOND = math.radians(1.0 / 3600.0)
_TILT_DEG = 40.0
_WRONG_DEG = 0.5
_KNOWN: Mapping[str, object] = {
    "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 0.0,
    "imu.accel_bias_stddev_mg": 0.0,
}
"""Of the simulated IMU."""


class Found(NamedTuple):
    """After the last call."""

    drift: Array
    """Estimated less true, rad/s; shape (3,)."""
    heading: float
    """Estimated less true, rad."""
    sigma: Array
    """Of drifts and heading, shape (4,)."""
    true: Array
    """Drifts, rad/s."""


def navigate(
    simulation: Simulation,
    overrides: Mapping[str, object],
    calls: Sequence[tuple[float, str]],
    noise: np.random.Generator | None = None,
) -> Found:
    """Navigate through a simulation that ends `_SETTLED` after the last call of a service.

    Raises
    ------
    InsNavError
        A call was refused.
    """
    p, rates, forces = simulation.parameters, simulation.angular_velocity, simulation.linear_acceleration
    if noise is not None:
        root = math.sqrt(p["rate"])
        rates = rates + GYRO_NOISE * root * noise.standard_normal(rates.shape)
        forces = forces + ACCEL_NOISE * root * noise.standard_normal(forces.shape)
    navigator = NavigationSystem(overrides, aided=False)
    navigator.add("gnss/fix", fix_message(message, simulation.start_ns, 0, p["lat_deg"], p["lon_deg"], p["height"]))
    stamps, samples = simulation.stamps_ns.tolist(), np.column_stack([rates, forces]).tolist()
    done = 0
    for time, service in calls:
        due = round(time * p["rate"])
        for stamp, sample in zip(stamps[done:due], samples[done:due], strict=True):
            navigator.add_imu(stamp, *sample)
        done = due
        success, text = navigator.zupt1() if service == "zupt1" else navigator.zupt2()
        if not success:
            raise InsNavError(f"{simulation.scenario}, {time:g} s: {text}")
    for stamp, sample in zip(stamps[done:], samples[done:], strict=True):
        navigator.add_imu(stamp, *sample)
    realtime = navigator.realtime
    assert realtime.state is not None
    done = len(stamps)
    error = Rotation.from_quat(nav_state.geodetic(realtime.state).q_gb) * _truth(simulation, done).inv()
    return Found(
        np.array(realtime.gyro_bias) - simulation.gyro_bias,
        -float(error.as_rotvec()[2]),
        np.sqrt(realtime.accuracy.covariance.diagonal()[[*range(*GYRO_BIAS.indices(SIZE)), HEADING]]),
        np.array(simulation.gyro_bias),
    )


def _tried(*run: Any) -> Found | str:
    """As `navigate`; a refusal's text."""
    try:
        return navigate(*run)
    except InsNavError as error:
        return str(error)


def _truth(simulation: Simulation, i: int) -> Rotation:
    return Rotation.from_quat(simulation.trajectory.q_nb[i])


def results(data: Path) -> Iterator[str]:
    """The section's tables."""
    # Small matrices: threads of the processes would get in each other's way
    os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        yield _table_of_stops(list(pool.map(_one_stop, *zip(*_ROCKING, strict=True))))
        yield _table_of_positions(list(pool.map(_two_positions, _POSITIONS)))
        chunks = [range(first, first + 5) for first in range(0, _SEEDS, 5)]
        for case in _NOISY:
            found = itertools.chain.from_iterable(pool.map(functools.partial(_noisy, case), chunks))
            yield _table_of_noise(case, list(found))
        yield from recordings(data, pool)


# --- the paper's run


_ROCKING = [(0.0, 11.0), *itertools.product((1.0, 3.0, 5.0), (5.0, 11.0))]
"""Amplitude, deg, and period, s."""


def paper_overrides() -> dict[str, object]:
    """Parameters of the paper's run."""
    return read_file(PAPER, "ins_node", "stop_detector_node")


def _one_stop(amplitude: float, period: float) -> Found | str:
    """The result, or the reason of a refusal."""
    motion = {"rocking_amplitude_deg": amplitude, "period": period, "duration": PAPER_CALL + _SETTLED, "gnss.rate": 0.0}
    return _tried(simulate("zupt2_stop", 0, **motion), paper_overrides(), [(PAPER_CALL, "zupt2")])


def _table_of_stops(found: Sequence[Found | str]) -> str:
    rows: list[Sequence[object]] = []
    for (amplitude, period), one in zip(_ROCKING, found, strict=True):
        name = f"rocking {amplitude:g}°, {period:g} s" if amplitude else "level"
        rows.append([name, *(["refused"] * 4 if isinstance(one, str) else _percents(one))])
    rows.append(["the paper, rocking", "6.5", "1.4", "0.5", "6.5"])
    text = table(["ZUPT-2 over 40 to 200 s: error of the drifts, %", "x", "y", "z", "greatest"], rows)
    return _with_refusals(text, found)


def _with_refusals(text: str, found: Sequence[Found | str]) -> str:
    return "\n\n".join([text, *(f"Refused: {one}" for one in found if isinstance(one, str))])


def _percents(found: Found) -> list[str]:
    percent = 100.0 * np.abs(found.drift / found.true)
    return [f"{x:.4f}" for x in (*percent, percent.max())]


# --- two positions, without noise


class _Positions(NamedTuple):
    name: str
    motion: Mapping[str, float]
    overrides: Mapping[str, object]
    calls: Sequence[tuple[float, str]]


_WIDE: Mapping[str, object] = {**_KNOWN, "imu.gyro_bias_stddev_deg_per_hour": 0.1}
_END_OF_FIRST, _END = _FIRST - _LATE, _FIRST + _TURN + _SECOND - _LATE
_BOTH = ((_END_OF_FIRST, "zupt1"), (_END, "zupt1"))
_DRIVEN = {"turn_deg": 90.0, "first_stop": 90.0, "second_stop": 100.0}
_CITY_STOP = 90.0 + _TURN + 100.0 + 90.0, 20.0
"""Beginning and length of the first stop in the city, s; it has turned by 90° clockwise till there."""
_IN_NAVIGATION = ((90.0 + _TURN + 100.0 - _LATE, "zupt1"), (sum(_CITY_STOP) - _LATE, "zupt1"))
_POSITIONS = [
    *(_Positions(f"self-alignment, turn {turn:g}°", {"turn_deg": turn}, _WIDE, _BOTH) for turn in (90.0, 180.0)),
    _Positions("self-alignment, two stops of the drive, turn 90°", _DRIVEN, _WIDE, _IN_NAVIGATION),
    _Positions(
        f"heading given {_WRONG_DEG:g}° wrong, two stops of the drive",
        _DRIVEN,
        {**_WIDE, "initial.heading_deg": 45.0 + _WRONG_DEG, "initial.heading_stddev_deg": 1.0},
        _IN_NAVIGATION,
    ),
]


def _two_stops(duration: float, rate: float, **motion: float) -> Simulation:
    shared = {"duration": duration, "rate": rate, "gnss.rate": 0.0, "first_stop": _FIRST, "turn_time": _TURN}
    return simulate("zupt1_two_positions", 0, **{**shared, "second_stop": _SECOND, **motion})


def _two_positions(case: _Positions) -> Found:
    return navigate(_two_stops(case.calls[-1][0] + _SETTLED, _RATE, **case.motion), case.overrides, case.calls)


def _table_of_positions(found: Sequence[Found]) -> str:
    rows: list[Sequence[object]] = [
        [case.name, *_percents(one), f"{abs(one.heading) / _ARC_SECOND:.3f}"]
        for case, one in zip(_POSITIONS, found, strict=True)
    ]
    percent, azimuth = _without_vertical()
    text = f"without the vertical equation, second position tilted by {_TILT_DEG:g}°"
    rows.append([text, *(f"{x:.4f}" for x in (*percent, percent.max())), f"{azimuth / _ARC_SECOND:.3f}"])
    head = ["ZUPT-1, no noise: error of the drifts, %", "x", "y", "z", "greatest", "of the azimuth, arc seconds"]
    return table(head, rows)


def _without_vertical() -> tuple[Array, float]:
    """Error of drifts, %, and azimuth, rad, of the equations (9), from the measurements of two stops."""
    s = _two_stops(_FIRST + _TURN + _SECOND, _RATE, tilt_deg=_TILT_DEG)
    drift = np.array(s.gyro_bias)
    rows = Rotation.from_quat(s.trajectory.q_nb).as_matrix()
    turned = np.cumsum(rows[:, 2, :], axis=0) / _RATE  # of S, clockwise, per unit of drift
    azimuth = 1e-3  # at the start of the first stop
    one, starts, _ = _stop(s, 0.0, _FIRST, azimuth)
    second = _FIRST + _TURN
    start = round(second * _RATE)
    two, _, last = _stop(s, second, second + _SECOND, azimuth + float((turned[start] - turned[starts]) @ drift))
    m = one.measurement
    first = StopMeasurement(m.rot_sb, m.rate, m.covariance, m.horizontal_rate, turned[last] - turned[starts])
    found = zupt1_nonlinear(first, two.measurement)
    true = azimuth + float((turned[last] - turned[starts]) @ drift)
    return 100.0 * np.abs(found.drift / drift - 1.0), abs(found.azimuth - true)


def _stop(s: Simulation, start: float, end: float, azimuth: float) -> tuple[StationaryRatesResult, int, int]:
    """A stop measured on axes turned clockwise by an azimuth at its start; the instants of start and end."""
    first, last = round(start * _RATE), round(end * _RATE)
    q = (Rotation.from_euler("z", azimuth) * _truth(s, first)).as_quat()
    lat, height = float(s.trajectory.lat[first]), float(s.trajectory.height[first])
    rest = StationaryRates(nav_state.initial_state(lat, 0.0, height, (0.0, 0.0, 0.0), tuple(q.tolist())))  # type: ignore[arg-type]
    values = np.column_stack([np.full(last - first, 1.0 / _RATE), s.angular_velocity[first:last]])
    samples: list[Any] = np.column_stack([values, s.linear_acceleration[first:last]]).tolist()
    for previous, sample in zip([samples[0], *samples], samples, strict=False):
        rest.add(previous, sample, False)
    return rest.result(), first, last


# --- noise


class _Noisy(NamedTuple):
    name: str
    duration: float
    turn_deg: float
    """0: one stop."""
    overrides: Mapping[str, object]
    calls: Sequence[tuple[float, str]]


_UNKNOWN: Mapping[str, object] = {**_KNOWN, "imu.gyro_bias_stddev_deg_per_hour": 0.5}
"""Uninformative: the bound has no prior either."""
_HEADING: Mapping[str, object] = {
    "initial.heading_deg": 45.0,
    "initial.heading_stddev_deg": 0.0,
    "alignment.level_duration": 40.0,
}
_NOISY = [
    _Noisy("ZUPT-2, one stop of 200 s", _FIRST, 0.0, {**_UNKNOWN, **_HEADING}, [(_FIRST, "zupt2")]),
    _Noisy("ZUPT-1, two stops of 200 s, turn 180°", _END, 180.0, _UNKNOWN, [(125.0, "zupt1"), _BOTH[1]]),
]


@functools.lru_cache(1)
def _noiseless(duration: float, turn_deg: float) -> Simulation:
    return _two_stops(duration + _SETTLED, _NOISY_RATE, turn_deg=turn_deg)


def _noisy(case: _Noisy, seeds: Sequence[int]) -> list[Found | str]:
    simulation = _noiseless(case.duration, case.turn_deg)
    return [_tried(simulation, case.overrides, case.calls, np.random.default_rng(seed)) for seed in seeds]


def least(case: _Noisy, unused: float) -> Array:
    """Least standard deviations of drifts and azimuth, shape (4,); the last seconds before a call are unused."""
    p = _noiseless(case.duration, case.turn_deg).parameters
    lat, yaw = math.radians(p["lat_deg"]), math.radians(90.0 - p["heading_deg"])
    start, end = (Rotation.from_euler("z", yaw + math.radians(turn)).as_matrix() for turn in (0.0, case.turn_deg))
    spans = [Span(_FIRST - unused, True, start)]
    if case.turn_deg:
        between = Rotation.from_euler("z", yaw + math.radians(0.5 * case.turn_deg)).as_matrix()
        second = case.calls[-1][0] - _FIRST - _TURN
        spans = [
            Span(_FIRST, True, start),
            Span(_TURN, False, between),
            Span(second - unused, True, end),
        ]
    gravity = float(earth.normal_gravity(math.sin(lat), p["height"]))
    covariance = bound(spans, lat, GYRO_NOISE, ACCEL_NOISE / gravity, not case.turn_deg)
    return np.asarray(np.sqrt(np.diag(covariance)), float)


def _table_of_noise(case: _Noisy, tried: Sequence[Found | str]) -> str:
    found = [one for one in tried if not isinstance(one, str)]
    error = np.array([[*one.drift, one.heading] for one in found])
    sigma = np.array([one.sigma for one in found])
    rms = np.sqrt((error**2).mean(axis=0))
    bounds = least(case, round(SETTLE_NS * 1e-9)), least(case, 0.0)
    unit = [math.radians(1.0) / 3600.0] * 3 + [_ARC_SECOND]
    names = ["drift x, °/h", "drift y, °/h", "drift z, °/h", "azimuth, arc seconds"][: 4 if case.turn_deg else 3]
    rows: list[Sequence[object]] = []
    for i, name in enumerate(names):
        z = np.abs(error[:, i] / sigma[:, i])
        values = [f"{x / unit[i]:.5g}" for x in (bounds[0][i], rms[i], sigma[:, i].mean())]
        ratios = [f"{rms[i] / b[i]:.2f}" for b in bounds]
        within = [f"{100.0 * np.mean(z < n):.0f}" for n in (1.0, 2.0, 3.0)]
        rows.append([name, *values, *ratios, " ".join(within), f"{np.sqrt(np.mean(z**2)):.2f}"])
    head = [
        f"{case.name}, {len(found)} seeds",
        "bound",
        "RMS error",
        "mean sigma",
        "RMS over the bound",
        "over that of all data",
        "% within 1, 2, 3 sigmas",
        "RMS of error / sigma",
    ]
    return _with_refusals(table(head, rows), tried)
