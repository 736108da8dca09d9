"""Fine alignment on a rocking base: heading against its sigma and the Cramer-Rao bound, then free inertial.

Every run is the whole of `delayed.FilterSystem`, coarse stage included, with config/paper_alignment.yaml. A
motion is simulated once, without errors; each seed adds noise, biases and fixes. The noise densities are those of the
paper's unit, so the heading does not depend on the rate of the samples, which is lower here to save time.
"""

import functools
import math
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, qmc

from bench.markdown import table
from ins_nav.aiding.gnss import GnssReceiver
from ins_nav.aiding.simulated import fix_message
from ins_nav.config.parameters import read_file
from ins_nav.estimation.error_model import azimuth
from ins_nav.mechanization import earth, nav_state
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.navigator.system import FilterSystem
from ins_nav.recordings.bags import message
from ins_nav.simulation.scenarios import Simulation, simulate

Array = NDArray[np.float64]
SEEDS, MOST_SEEDS = 100, 1024
_CONFIG = Path(__file__).resolve().parents[1] / "config" / "paper_alignment.yaml"
GYRO_NOISE, ACCEL_NOISE = math.radians(0.003) / 20.0, 0.02 / 20.0
"""Densities, rad/√s and m/s/√s: of one sample at 400 Hz, 0.003 °/s and 0.02 m/s²."""
GYRO_BIAS, ACCEL_BIAS = math.radians(0.2) / 3600.0, 0.005
"""Standard deviations of what is drawn for a seed where there are biases, rad/s and m/s²."""
_LEVEL = 5.0
"""s: first stage where the heading is given."""
_DRIFT = 0.01
"""m/s: to which alignment knows the mean velocity of a base that stands or rocks."""
_STEP = 0.1
"""s, of the bound."""
_CHUNK = 5
"""Seeds a task."""


@dataclass(frozen=True)
class Case:
    """A case.

    Attributes
    ----------
    times : floats
        Times of the errors, s.
    latitude_deg, amplitude_deg, period
        Of the place; of rocking, deg and s.
    waves : float
        Amplitude of surge and heave, with that period too, m.
    turn_deg : float
        Turn at 150 s.
    rocking_time : float
        s; it stands then.
    rate : float
        Of the IMU, Hz.
    fix_rate, fix_stddev : float
        Hz, m.
    biased : bool
        The unit has biases, which the filter estimates; otherwise neither.
    heading_error_deg : float or None
        Error of a given heading with a sigma of 100 deg, without the coarse stage; None: not given.
    coarse, fine_duration : float
        s.
    """

    times: tuple[float, ...] = (100.0, 200.0, 300.0)
    latitude_deg: float = 55.7
    amplitude_deg: float = 5.0
    period: float = 11.0
    waves: float = 0.0
    turn_deg: float = 0.0
    rocking_time: float = 1e4
    rate: float = 50.0
    fix_rate: float = 1.0
    fix_stddev: float = 1.0
    biased: bool = False
    heading_error_deg: float | None = None
    coarse: float = 60.0
    fine_duration: float = 300.0

    @property
    def first_stage(self) -> float:
        """Time for which the base is known not to travel, s."""
        return self.coarse if self.heading_error_deg is None else _LEVEL

    def simulation(self) -> Simulation:
        """The motion, with perfect sensors."""
        return simulate(
            "swell_alignment_turn",
            0,
            **{
                "imu.preset": "perfect",
                "gnss.rate": 0.0,
                "rate": self.rate,
                "duration": max(self.times) + 3.0,
                "lat_deg": self.latitude_deg,
                "rocking_time": self.rocking_time,
                "period": self.period,
                "roll_amplitude_deg": self.amplitude_deg,
                "pitch_amplitude_deg": self.amplitude_deg,
                "linear_period": self.period if self.waves else 8.0,
                "surge_amplitude": self.waves,
                "heave_amplitude": self.waves,
                "turn_deg": self.turn_deg,
            },
        )

    def system(self) -> FilterSystem:
        """It, for this."""
        parameters = read_file(_CONFIG, "ins_node")
        parameters["alignment.duration"] = self.coarse
        parameters["alignment.fine_duration"] = self.fine_duration
        if not self.biased:
            parameters["imu.gyro_bias_stddev_deg_per_hour"] = parameters["imu.accel_bias_stddev_mg"] = 0.0
        if self.heading_error_deg is not None:
            true = float(_noiseless(self).parameters["heading_deg"])
            parameters["initial.heading_deg"] = math.remainder(true + self.heading_error_deg, 360.0)
            parameters["initial.heading_stddev_deg"] = 100.0
            parameters["alignment.level_duration"] = _LEVEL
        return FilterSystem(parameters)


@functools.lru_cache(1)
def _noiseless(case: Case) -> Simulation:
    return case.simulation()


@functools.lru_cache(1)
def _drawn() -> Array:
    """Normal biases of every seed, spread evenly: heading errors are mostly theirs, and few seeds must do."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a first part of the sequence will do
        return np.asarray(qmc.MultivariateNormalQMC(np.zeros(6), seed=1).random(MOST_SEEDS))


def run(case: Case, seeds: Sequence[int]) -> Array:
    """Errors and sigmas, shape (n, times, 5), rad and m.

    Heading error, its sigma, NEES of position, velocity and attitude (7), horizontal distance, its sigma.
    """
    return np.array([_run(case, seed) for seed in seeds])


def _run(case: Case, seed: int) -> Array:
    simulation = _noiseless(case)
    path = simulation.trajectory
    rng = np.random.default_rng(seed)
    count, root = len(simulation.stamps_ns), math.sqrt(case.rate)
    rates = simulation.angular_velocity + GYRO_NOISE * root * rng.normal(size=(count, 3))
    forces = simulation.linear_acceleration + ACCEL_NOISE * root * rng.normal(size=(count, 3))
    if case.biased:
        drawn = _drawn()[seed]
        rates += GYRO_BIAS * drawn[:3]
        forces += ACCEL_BIAS * drawn[3:]
    stamps = np.concatenate([[simulation.start_ns], simulation.stamps_ns])
    fixes = GnssReceiver(case.fix_rate, case.fix_stddev, 1.5 * case.fix_stddev).fixes(path, stamps, seed)
    covariance = tuple(np.diag(np.square(fixes.stddev)).ravel().tolist())
    degrees = np.column_stack([np.degrees(fixes.lat), np.degrees(fixes.lon), fixes.height]).tolist()
    pending = iter([*zip(fixes.stamps_ns.tolist(), degrees, strict=True), (2**63, [])])
    fix_ns, place = next(pending)
    system = case.system()
    navigator = system.delayed
    rows: list[list[float]] = []
    due_ns = [simulation.start_ns + round(time * 1e9) for time in case.times]
    samples = np.column_stack([rates, forces]).tolist()
    for stamp_ns, sample in zip(simulation.stamps_ns.tolist(), samples, strict=True):
        while fix_ns <= stamp_ns:
            system.add("gnss/fix", fix_message(message, fix_ns, 0, place[0], place[1], place[2], covariance))
            fix_ns, place = next(pending)
        system.add_imu(stamp_ns, *sample)
        navigator.drain()
        if navigator.settled_ns >= due_ns[len(rows)]:
            rows.append(_errors(simulation, navigator))
            if len(rows) == len(due_ns):
                break
    return np.array(rows)


def _errors(simulation: Simulation, navigator: DelayedNavigator) -> list[float]:
    """Results of `run` for one time."""
    assert navigator.state is not None and navigator.filter is not None
    path, found = simulation.trajectory, navigator.filter
    i = int(np.searchsorted(simulation.stamps_ns, navigator.settled_ns)) + 1
    solution = nav_state.geodetic(navigator.state)
    turn = Rotation.from_quat(solution.q_gb) * Rotation.from_quat(path.q_nb[i]).inv()
    matrix = turn.as_matrix()
    heading = math.atan2(matrix[1, 0], matrix[0, 0])
    tilt = (turn * Rotation.from_rotvec([0.0, 0.0, -heading])).as_rotvec()[:2]
    meridian, prime_vertical = earth.principal_radii(math.sin(path.lat[i]))
    radii = (prime_vertical + path.height[i]) * math.cos(path.lat[i]), meridian + path.height[i]
    position = np.multiply(radii, (solution.lon - path.lon[i], solution.lat - path.lat[i]))
    velocity = solution.velocity_g - turn.apply(path.velocity_n[i])
    c, s = azimuth(navigator.state)
    to_n = np.array([[c, s], [-s, c]])
    states = [0, 1, 3, 4, 6, 7, 8]
    error = np.concatenate([to_n @ position, to_n @ velocity[:2], to_n @ tilt, [math.sin(heading)]])
    error -= found.x[states]
    p = found.p[np.ix_(states, states)]
    nees = float(error @ np.linalg.solve(p, error))
    return [heading, found.heading_stddev, nees, float(np.hypot(*position)), math.sqrt(p[0, 0] + p[1, 1])]


def bound(case: Case, first_stage: float | None = None) -> Array:
    """Least possible standard deviation of the heading at the case's times, rad.

    Covariance of a Kalman filter for the true errors of an inertial solution along the true motion: position,
    velocity and the misalignment psi of the computed inertial axes, on east and north, or east, north and up, and the
    constant biases on body axes::

        dp' = dv
        dv' = -(g / R) dp - 2 u x dv + f x psi + C accel_bias + noise
        psi' = -u x psi + C gyro_bias + noise

    For a linear model with Gaussian noise that is the Cramer-Rao bound. The only prior is that of the biases. Every fix
    is a measurement of position. Until the end of the first stage, true velocity is a constant, zero but for `_DRIFT`:
    the assumption of alignment, two states more.
    """
    simulation = _noiseless(case)
    path = simulation.trajectory
    every = round(_STEP * case.rate)
    lat = math.radians(case.latitude_deg)
    gravity = float(earth.normal_gravity(math.sin(lat), simulation.parameters["height"]))
    u = earth.RATE * np.array([0.0, math.cos(lat), math.sin(lat)])
    rot = Rotation.from_quat(path.q_nb[every // 2 :: every]).as_matrix()
    force = np.diff(path.velocity_n[::every], axis=0) / _STEP + [0.0, 0.0, gravity]
    p = np.square(
        np.diag([1e3] * 2 + [10.0] * 2 + [1.0, 1.0, 100.0] + [GYRO_BIAS] * 3 + [ACCEL_BIAS] * 3 + [_DRIFT] * 2)
    )
    if not case.biased:
        p[7:13, 7:13] = 0.0
    q = np.diag([0.0] * 2 + [ACCEL_NOISE] * 2 + [GYRO_NOISE] * 3 + [0.0] * 8) ** 2 * _STEP
    a = np.zeros((15, 15))
    a[0:2, 2:4] = np.eye(2)
    a[2:4, 0:2] = -gravity / earth.SEMI_MAJOR_AXIS * np.eye(2)
    a[2:4, 2:4] = -2.0 * _cross(u)[:2, :2]
    a[4:7, 4:7] = -_cross(u)
    stage = case.first_stage if first_stage is None else first_stage
    per_fix = round(1.0 / (case.fix_rate * _STEP))
    position, velocity = np.eye(2, 15), np.eye(2, 15, 2) - np.eye(2, 15, 13)
    p = _measured(p, position, case.fix_stddev)
    found = {}
    for k, (c, f) in enumerate(zip(rot, force, strict=False), 1):
        a[2:4, 4:7], a[2:4, 10:13], a[4:7, 7:10] = _cross(f)[:2], c[:2], c
        phi = np.eye(15) + _STEP * a + 0.5 * _STEP**2 * a @ a
        p = phi @ p @ phi.T + q
        if k * _STEP <= stage:
            p = _measured(p, velocity, 1e-5)
        if k % per_fix == 0:
            p = _measured(p, position, case.fix_stddev)
        found[k] = math.sqrt(p[6, 6])
    return np.array([found[round(time / _STEP)] for time in case.times])


def _measured(p: Array, h: Array, stddev: float) -> Array:
    """Covariance after a measurement, Joseph's form."""
    gain = np.linalg.solve(h @ p @ h.T + stddev**2 * np.eye(len(h)), h @ p).T
    left = np.eye(len(p)) - gain @ h
    p = left @ p @ left.T + stddev**2 * gain @ gain.T
    return 0.5 * (p + p.T)


def _cross(x: Array) -> Array:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


_FREE = Case(times=(300.0, 900.0), rocking_time=300.0)
_TURN = Case(times=(100.0, 200.0, 300.0, 600.0), biased=True, turn_deg=180.0, fine_duration=600.0)
_GIVEN = {error: Case(heading_error_deg=error) for error in (0.0, 90.0, 180.0)}
CASES = {
    "no biases": (Case(), 1.0),
    "the same, position to 5 cm at 10 Hz": (Case(fix_rate=10.0, fix_stddev=0.05), 0.5),
    "biases, heading kept": (Case(biased=True), 1.0),
    "biases, turn by 180° at 150 s": (_TURN, 1.0),
    **{f"no coarse stage, heading wrong by {error:g}°": (case, 0.5) for error, case in _GIVEN.items()},
}
"""Cases compared with the bound, and the share of the seeds of each."""
_ROCKING = (
    *((2.0, 4.0, 0.0), (2.0, 20.0, 30.0), (2.0, 8.0, 55.7), (2.0, 11.0, 75.0)),
    *((5.0, 8.0, 0.0), (5.0, 4.0, 30.0), (5.0, 11.0, 55.7), (5.0, 20.0, 75.0)),
    *((10.0, 11.0, 0.0), (10.0, 8.0, 30.0), (10.0, 4.0, 55.7), (10.0, 20.0, 55.7), (10.0, 11.0, 75.0)),
)
"""Amplitude, deg, period, s, latitude, deg."""
_WAVES = 0.5
"""m."""
_COARSE = (60.0, 120.0)
"""s."""


def results(_data: Path, seeds: int = SEEDS) -> Iterator[str]:
    """The section's tables."""
    with ProcessPoolExecutor() as pool:

        def runs(case: Case, share: float) -> Array:
            count = max(2, round(share * seeds))
            chunks = [range(first, min(first + _CHUNK, count)) for first in range(0, count, _CHUNK)]
            return np.concatenate(list(pool.map(functools.partial(run, case), chunks)))

        yield _against_bound({name: (case, runs(case, share)) for name, (case, share) in CASES.items()}, seeds)
        free = {name: runs(case, 0.2) for name, case in (("no biases", _FREE), ("biases", replace(_FREE, biased=True)))}
        yield _free_inertial(free)
        rocking = []
        for amplitude, period, latitude in _ROCKING:
            case = Case((300.0,), latitude, amplitude, period, _WAVES, biased=True)
            rocking.append((case, [runs(replace(case, coarse=coarse), 0.1) for coarse in _COARSE]))
    yield _rocking(rocking)


def _against_bound(found: dict[str, tuple[Case, Array]], seeds: int) -> str:
    rows: list[Sequence[object]] = []
    for name, (case, values) in found.items():
        least, blind = bound(case), bound(case, 0.0)
        for i, time in enumerate(case.times):
            error, sigma, nees = values[:, i, :3].T
            degrees = (f"{math.degrees(x):.3f}" for x in (_rms(error), sigma.mean(), least[i], blind[i]))
            low, high = chi2.ppf((0.025, 0.975), 7 * len(error)) / len(error)
            ratios = f"{_rms(error) / least[i]:.2f}", f"{_rms(error / sigma):.2f}"
            of_nees = f"{nees.mean():.2f} ({low:.1f} to {high:.1f})"
            rows.append([name, f"{time:g}", *degrees, *ratios, of_nees, f"{np.abs(error / sigma).max():.1f}"])
    head = ["fine alignment", "s", "RMS, °", "sigma, °", "bound, °", "no coarse stage, °", "RMS / bound"]
    text = "Heading on a base that rocks by 5° with 11 s, latitude 55.7°, fixes of 1 m at 1 Hz;"
    more = f"{seeds} seeds, half that for 10 Hz and without coarse stage: one sigma of a ratio is 7 % with 100."
    more += " NEES: 7 states, 95 % band."
    return f"{text}\n{more}\n\n{table([*head, 'RMS of error / sigma', 'NEES', 'greatest'], rows)}"


def _free_inertial(found: dict[str, Array]) -> str:
    rows: list[Sequence[object]] = []
    for name, values in found.items():
        heading, distance, sigma = values[:, :, 0], values[:, 1, 3], values[:, 1, 4]
        degrees = (_rms(heading[:, 0]), _rms(heading[:, 1]), _rms(heading[:, 1] - heading[:, 0]))
        ratios = _rms(heading[:, 1] / values[:, 1, 1]), _rms(distance / sigma), (distance / sigma).max()
        metres = _rms(distance), _rms(sigma)
        rows.append([f"{name}, {len(values)} seeds", *(f"{math.degrees(x):.3f}" for x in degrees)])
        rows[-1] = [*rows[-1], f"{ratios[0]:.2f}", *(f"{x:.1f}" for x in metres), *(f"{x:.2f}" for x in ratios[1:])]
    head = ["free inertial, 300 s to 900 s", "heading at 300 s, RMS, °", "at 900 s, °", "change, °", "error / sigma"]
    return table([*head, "distance, RMS, m", "sigma, m", "RMS of distance / sigma", "greatest"], rows)


def _rocking(found: list[tuple[Case, list[Array]]]) -> str:
    rows: list[Sequence[object]] = []
    for case, both in found:
        name = f"{case.amplitude_deg:g}°, {case.period:g} s, latitude {case.latitude_deg:g}°"
        rows.append([name, *(cell for values in both for cell in _honesty(values))])
    every = [np.concatenate([both[i] for _, both in found]) for i in range(len(_COARSE))]
    rows.append(["all", *(cell for values in every for cell in _honesty(values))])
    head = [f"surge and heave {_WAVES:g} m too, biases, {len(found[0][1][0])} seeds, at 300 s"]
    for coarse in _COARSE:
        head += [f"coarse {coarse:g} s: RMS, °", "sigma, °", "RMS of error / sigma", "greatest"]
    return table(head, rows)


def _honesty(values: Array) -> list[str]:
    error, sigma = values[:, 0, :2].T
    ratio = error / sigma
    degrees = (f"{math.degrees(x):.2f}" for x in (_rms(error), sigma.mean()))
    return [*degrees, f"{_rms(ratio):.2f}", f"{np.abs(ratio).max():.1f}"]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
