"""Figures 1 to 4 of the ZUPT paper in one: drifts as they are found, attitude, yaw and velocity before and after."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.zupt import ACCEL_NOISE, GYRO_NOISE, PAPER_CALL, paper_overrides
from ins_nav.aiding.simulated import fix_message
from ins_nav.mechanization import nav_state
from ins_nav.navigator.system import NavigationSystem
from ins_nav.recordings.bags import message
from ins_nav.report.figures import save
from ins_nav.simulation.scenarios import Simulation, simulate
from ins_nav.zupt.stationary_rates import MIN_DURATION, StationaryRates
from ins_nav.zupt.zupt_equations import zupt2

Array = NDArray[np.float64]
_DURATION = 600.0
_RATE = 50.0
_START, _EVERY = 40.0, 4.0
"""s: the drifts are sought from, and shown every."""
_UNIT = 1e-7
"""rad/s."""
_ARC_SECONDS = math.degrees(1.0) * 3600.0
_EAST, _NORTH, _UP = "#0072B2", "#D55E00", "#009E73"
"""Okabe and Ito's colours."""


def draw(path: Path) -> None:
    """Simulate the paper's run and draw it.

    Raises
    ------
    InsNavError
        The file cannot be written.
    """
    s = simulate("zupt2_stop", 0, **{"duration": _DURATION, "rate": _RATE, "gnss.rate": 0.0})
    fig = Figure(figsize=(11.5, 7.0), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08))
    panels = fig.subplots(2, 2)
    _drifts(panels[0, 0], s)
    time, left = _errors(s, False)
    _, corrected = _errors(s, True)
    _curves(panels[0, 1], time, left, corrected, {0: ("east", _EAST), 1: ("north", _NORTH)})
    panels[0, 1].set_title("tilt error about east and north, arc seconds", loc="left", fontsize="medium")
    _curves(panels[1, 0], time, left, corrected, {2: ("yaw", _UP)})
    panels[1, 0].set_title("yaw error, arc seconds", loc="left", fontsize="medium")
    _curves(panels[1, 1], time, left, corrected, {3: ("east", _EAST), 4: ("north", _NORTH)})
    panels[1, 1].set_title("velocity error (Schuler oscillation), mm/s", loc="left", fontsize="medium")
    for axes in panels.flat:
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlabel("time, s")
    save(fig, path)


def _curves(axes: Axes, time: Array, left: Array, corrected: Array, columns: dict[int, tuple[str, str]]) -> None:
    """Errors with the ZUPT and without."""
    after = time >= PAPER_CALL
    for column, (name, colour) in columns.items():
        axes.plot(time[after], left[after, column], color=colour, linewidth=1.4, linestyle=(0, (4, 2)), alpha=0.55)
        axes.plot(time, corrected[:, column], color=colour, linewidth=2.0, label=name)
    axes.plot([], [], color="0.3", linestyle=(0, (4, 2)), alpha=0.6, label="without ZUPT-2")
    axes.axvline(PAPER_CALL, color="0.3", linewidth=1.0)
    label = {"rotation": 90.0, "va": "center", "color": "0.3"}
    axes.annotate("ZUPT-2", (PAPER_CALL, 0.48), (4, 0), ("data", "axes fraction"), "offset points", **label)
    axes.set_xlim(0.0, time[-1])
    axes.legend(frameon=False)


def _errors(s: Simulation, call: bool) -> tuple[Array, Array]:
    """Times, and rows of attitude error about east, north, up, arc seconds, and velocity east, north, mm/s."""
    navigator = NavigationSystem(paper_overrides())
    p = s.parameters
    navigator.add("gnss/fix", fix_message(message, s.start_ns, 0, p["lat_deg"], p["lon_deg"], p["height"]))
    samples = np.column_stack([s.angular_velocity, s.linear_acceleration]).tolist()
    times, rows = [], []
    for i, (stamp, sample) in enumerate(zip(s.stamps_ns.tolist(), samples, strict=True), 1):
        navigator.add_imu(stamp, *sample)
        if call and i == round(PAPER_CALL * _RATE):
            navigator.zupt2()
        state = navigator.realtime.state
        if state is not None and i % round(_RATE) == 0:
            where = nav_state.geodetic(state)
            error = Rotation.from_quat(where.q_gb) * Rotation.from_quat(s.trajectory.q_nb[i]).inv()
            times.append(i / _RATE)
            east, north, _ = where.velocity_g
            rows.append([*(error.as_rotvec() * _ARC_SECONDS), 1e3 * east, 1e3 * north])
    return np.array(times), np.array(rows)


def _drifts(axes: Axes, s: Simulation) -> None:
    """Results of ZUPT-2, call after call, without noise and with it."""
    ideal, noisy = _found(s, 0.0), _found(s, 1.0)
    for axis, (name, colour) in enumerate((("x", _EAST), ("y", _NORTH), ("z", _UP))):
        value, sigma = noisy[:, 1 + axis], noisy[:, 4 + axis]
        axes.fill_between(noisy[:, 0], value - sigma, value + sigma, color=colour, alpha=0.13, linewidth=0.0)
        axes.plot(noisy[:, 0], value, color=colour, linewidth=1.0, alpha=0.8)
        dashes = (4, 4) if name == "y" else (None, None)  # x and y are equal
        axes.plot(ideal[:, 0], ideal[:, 1 + axis], color=colour, linewidth=2.4, dashes=dashes, label=name)
    axes.plot([], [], color="0.3", linewidth=1.0, label="with noise, ±1 sigma")
    axes.set_xlim(_START, PAPER_CALL)
    axes.set_ylim(-3.0, 3.0)
    axes.set_title("gyro drifts found from 40 s on, 1e-7 rad/s", loc="left", fontsize="medium")
    axes.legend(frameon=False, loc="upper right", ncols=4)


def _found(s: Simulation, noise: float) -> Array:
    """Rows of time, drifts and sigmas, 1e-7 rad/s."""
    rng = np.random.default_rng(0)
    first, last = round(_START * _RATE), round(PAPER_CALL * _RATE)
    gyro, accel = noise * math.sqrt(_RATE) * np.array([GYRO_NOISE, ACCEL_NOISE])
    rates = s.angular_velocity[first:last] + gyro * rng.standard_normal((last - first, 3))
    forces = s.linear_acceleration[first:last] + accel * rng.standard_normal((last - first, 3))
    values: list[Any] = np.column_stack([np.full(last - first, 1.0 / _RATE), rates, forces]).tolist()
    q, lat = s.trajectory.q_nb[first], float(s.trajectory.lat[first])
    rest = StationaryRates(
        nav_state.initial_state(lat, 0.0, s.parameters["height"], (0.0, 0.0, 0.0), tuple(q.tolist()))
    )
    rows = []
    for i, (previous, sample) in enumerate(itertools.pairwise(values), 2):
        rest.add(previous, sample, False)
        if i % round(_EVERY * _RATE) == 0 and i / _RATE > MIN_DURATION:
            found = zupt2(rest.result().measurement)
            rows.append([_START + i / _RATE, *(found.drift / _UNIT), *(np.sqrt(np.diag(found.covariance)[:3]) / _UNIT)])
    return np.array(rows)
