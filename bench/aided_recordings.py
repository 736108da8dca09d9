"""Real recordings with aids: accuracy against the reference, honesty of the sigmas, outliers, outages of GNSS."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.markdown import table
from ins_nav.estimation.observation import Measurement
from ins_nav.mechanization import nav_state
from ins_nav.messages import inputs
from ins_nav.navigator.system import FilterSystem, NavigationSystem
from ins_nav.recordings.bags import BagReader
from ins_nav.report.comparison import Errors, compare
from ins_nav.report.series import Attitudes, Positions, Track, read_reference
from ins_nav.stamps import stamp_of

Array = NDArray[np.float64]
_SECOND = 1_000_000_000
_STANDS = 60.0
"""s, of rlg_drive."""
TACTICAL: dict[str, object] = {
    "alignment.duration": 300.0,
    "imu.gyro_bias_stddev_deg_per_hour": 3.0,
    "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 1.0,
    "imu.accel_bias_stddev_mg": 1.0,
}
"""For the unit of kingston_a; the first stop lasts 527 s."""
MEMS: dict[str, object] = {
    "imu.gyro_bias_stddev_deg_per_hour": 200.0,
    "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour": 20.0,
    "imu.accel_bias_stddev_mg": 10.0,
    "imu.accel_bias_walk_mg_per_sqrt_hour": 0.3,
    "imu.gyro_noise_deg_per_sqrt_hour": 0.3,
    "imu.accel_noise_ug_per_sqrt_hz": 150.0,
    "initial.latitude_deg": 42.3,
    "initial.longitude_deg": -83.7,
    "initial.height": 250.0,
    "initial.heading_deg": 0.0,
    "navigation.vertical_channel": True,
    "zupt.zero_velocity": False,
    "stop_detector.start_sequence": "never",
}
"""For the unit of auv_pool; it floats, and is nowhere near still for alignment."""
_POOL: dict[str, dict[str, object]] = {
    "covariances of its messages": {},
    "its log wanders by 4 cm/s within 1 s, it shakes by 1 mg/√Hz": {
        "log.slow_stddev": 0.04,
        "log.slow_time": 1.0,
        "imu.accel_noise_ug_per_sqrt_hz": 1000.0,
    },
}
"""Parameters: the log's covariance is that of white noise, but its differences between readings are correlated."""
_OUTAGE, _OUTAGES = 60.0, 10
_MOVES_OFF = 527.0
"""s, of kingston_a."""
_MOVING = 1.0
"""m/s."""
_OUTLIER = 10.0
"""m: a fix so far off is one."""
_SLOW = ((0.0, 60.0), (1.0, 60.0), (2.0, 30.0), (2.0, 60.0), (2.0, 120.0), (3.0, 60.0))
"""gnss.slow_stddev, m, and gnss.slow_time, s, that are tried."""


class Accepted(NamedTuple):
    """An update of the filter by a fix."""

    stamp_ns: int
    moved: float
    """How far it moved the horizontal position, in sigmas of before."""
    anew: bool
    """Taken after a row of rejected ones that agreed with each other."""


class Outcome(NamedTuple):
    """Of a run."""

    track: Track
    """What the live node would publish."""
    accepted: tuple[Accepted, ...]
    rejected: int


class _Watched(FilterSystem):
    """Notes what updates do."""

    def __init__(self, overrides: Mapping[str, object]) -> None:
        super().__init__(overrides)
        self._update = self.delayed._update
        self.delayed._update = self.update  # type: ignore[method-assign]

    def update(self, name: str, stamp_ns: int, measurement: Measurement, *limits: float) -> bool:
        """In place of the filter's."""
        return self._update(name, stamp_ns, measurement, *limits)


class _Fixes(_Watched):
    """Notes what fixes do."""

    def __init__(self, overrides: Mapping[str, object]) -> None:
        self.accepted: list[Accepted] = []
        super().__init__(overrides)

    def update(self, name: str, stamp_ns: int, measurement: Measurement, *limits: float) -> bool:
        """In place of the filter's."""
        d = self.delayed
        if name != "gnss":
            return super().update(name, stamp_ns, measurement, *limits)
        assert d.filter is not None and d.state is not None
        before, p = nav_state.position_ecef(d.state), d.filter.p[:2, :2].copy()
        rot_en = Rotation.from_quat(d.state[7:11])
        accepted = super().update(name, stamp_ns, measurement, *limits)
        last = d.records[name].last
        if accepted and last is not None:
            moved = rot_en.inv().apply(np.subtract(nav_state.position_ecef(d.state), before))[:2]
            size = math.sqrt(moved @ np.linalg.solve(p, moved))
            self.accepted.append(Accepted(stamp_ns, size, bool(last.reason)))
        return accepted


def follow(bag: Path, parameters: Mapping[str, object], aids: Sequence[str], given: Callable[[int], bool]) -> Outcome:
    """Run the navigator and the filter over a recording as ``ins_process`` does.

    Parameters
    ----------
    bag : Path
    parameters : mapping
    aids : sequence of str
        Topics besides the IMU's. With none the navigator is on its own: fixes give it its first place only.
    given : callable
        Of a stamp: whether a fix of that time is given to the filter.
    """
    system, aided = NavigationSystem(parameters, aided=False), _Fixes(parameters)
    navigator = system.realtime
    rows: list[tuple[float, ...]] = []
    stamps: list[int] = []
    with BagReader(bag) as reader:
        for raw in reader.messages({topic: topic for topic in ("/imu/data_raw", "/gnss/fix", *aids)}):
            message = reader.deserialize(raw)
            if raw.topic != "/imu/data_raw":
                if raw.topic == "/gnss/fix":
                    system.add("gnss/fix", message)
                if raw.topic != "/gnss/fix" or given(stamp_of(message)):
                    aided.add(raw.topic.removeprefix("/"), message)
                continue
            sample = inputs.read_imu(message)
            aided.add_imu(*sample)
            for correction in aided.delayed.drain() if aids else ():
                system.correct(correction)
            if system.add_imu(*sample):
                assert navigator.state is not None
                found, p = nav_state.geodetic(navigator.state), navigator.covariance
                sigma = np.full(6, np.nan) if p is None else np.sqrt(p.diagonal()[[0, 1, 2, 6, 7, 8]])
                stamps.append(navigator.stamp_ns)
                rows.append((found.lat, found.lon, found.height, *found.q_gb, *sigma))
    columns, stamps_ns = np.array(rows), np.array(stamps)
    covariance = np.einsum("ni,ij->nij", columns[:, 10:13] ** 2, np.eye(3))
    track = Track(
        bag.name,
        Positions(stamps_ns, columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 7:10]),
        Attitudes(stamps_ns, Rotation.from_quat(columns[:, 3:7]), covariance),
        None,
    )
    return Outcome(
        track, tuple(aided.accepted), aided.delayed.records["gnss"].rejected if "gnss" in aided.delayed.records else 0
    )


def results(data: Path) -> Iterator[str]:
    """The section's tables."""
    for name, section in (("rlg_drive", _drive), ("kingston_a", _city), ("auv_pool", _pool)):
        if (data / name).exists():
            yield from section(data / name)
        else:
            yield f"{name} skipped: no recordings in {data}"


def _drive(bag: Path) -> Iterator[str]:
    fixes = read_reference(bag, "gnss/fix")
    assert fixes is not None
    start_ns = int(fixes.position.stamps_ns[0])

    def standing(stamp_ns: int) -> bool:
        return stamp_ns - start_ns < _STANDS * _SECOND

    fine = {"alignment.fine_duration": _STANDS, "aiding.until_aligned": True}
    ways: dict[str, tuple[dict[str, object], list[str]]] = {
        f"ins_node alone, coarse alignment for {_STANDS:g} s": ({"alignment.duration": _STANDS}, []),
        "coarse for 30 s, fine with GNSS and the stop": ({"alignment.duration": 30.0, **fine}, ["/gnss/fix"]),
        "coarse for 30 s, fine with GNSS only": (
            {"alignment.duration": 30.0, "zupt.zero_velocity": False, **fine},
            ["/gnss/fix"],
        ),
    }
    rows = []
    for name, (parameters, aids) in ways.items():
        track = follow(bag, parameters, aids, standing).track
        distance = np.hypot(*compare(track, fixes).position.values[:, :2].T)
        assert track.attitude is not None
        at = min(int(np.searchsorted(track.attitude.stamps_ns, start_ns + (_STANDS + 5.0) * _SECOND)), len(distance))
        heading = math.degrees(track.attitude.euler[at, 2])
        rows.append([name, f"{heading:.2f}", f"{distance.max():.2f}", f"{_rms(distance):.2f}"])
    head = [
        f"{bag.name}, free inertial from {_STANDS:g} s on",
        "heading, °",
        "greatest distance from GNSS, m",
        "RMS, m",
    ]
    yield table(head, rows)


def _city(bag: Path) -> Iterator[str]:
    every: Callable[[int], bool] = _always
    ways: dict[str, tuple[Path, dict[str, object], list[str], Callable[[int], bool]]] = {
        "gnss/fix": (bag, TACTICAL, ["/gnss/fix"], every),
        "gnss/fix, log": (bag, TACTICAL, ["/gnss/fix", "/log"], every),
        "gnss/fix, gyros 1 °/h": (bag, TACTICAL | {"imu.gyro_bias_stddev_deg_per_hour": 1.0}, ["/gnss/fix"], every),
        "gnss/fix, 10 outages": (bag, TACTICAL, ["/gnss/fix"], _no_outage),
        "gnss/fix, log, 10 outages": (bag, TACTICAL, ["/gnss/fix", "/log"], _no_outage),
    }
    tried = {
        slow: (bag, TACTICAL | {"gnss.slow_stddev": slow[0], "gnss.slow_time": slow[1]}, ["/gnss/fix", "/log"], every)
        for slow in _SLOW
    }
    with ProcessPoolExecutor() as pool:
        runs = {name: pool.submit(follow, *arguments) for name, arguments in ways.items()}
        trials = {slow: pool.submit(follow, *arguments) for slow, arguments in tried.items()}
        truth = _Truth(bag)
        full = [name for name in ways if "outages" not in name]
        yield table([bag.name, *full], truth.accuracy([runs[name].result() for name in full]))
        yield truth.outages({name: runs[name].result() for name in ways if "outages" in name})
        yield truth.slow({slow: trial.result() for slow, trial in trials.items()})


def _pool(bag: Path) -> Iterator[str]:
    """Without a reference: stability of the run, its innovations, and the distance from dead reckoning by the log."""
    rows = [row for name, parameters in _POOL.items() for row in _pool_rows(bag, name, parameters)]
    head = ["accepted", "innovation / sigma, RMS", "correlation with the one before", "farthest from the start, m"]
    head += ["at the end, from dead reckoning by log and vertical gyro, m", "sigma, m"]
    yield table([f"{bag.name}, heading given", *head], rows)


def _pool_rows(bag: Path, name_of_case: str, parameters: Mapping[str, object]) -> list[list[str]]:
    innovations: dict[str, list[tuple[bool, Array]]] = {"depth": [], "log": []}

    class Innovations(_Watched):
        def update(self, name: str, stamp_ns: int, measurement: Measurement, *limits: float) -> bool:
            accepted = super().update(name, stamp_ns, measurement, *limits)
            last = self.delayed.records[name].last
            assert last is not None
            innovations[name].append((last.accepted, np.array(last.innovation) / last.sigma))
            return accepted

    system = Innovations(MEMS | parameters)
    navigator, front_end = system.delayed, system.front_end
    yaw, stamp_ns, log_ns, alone, farthest = 0.0, 0, 0, np.zeros(2), 0.0
    with BagReader(bag) as reader:
        for raw in reader.messages({topic: topic for topic in ("/imu/data_raw", "/log", "/depth")}):
            message = reader.deserialize(raw)
            now = stamp_of(message)
            if raw.topic == "/imu/data_raw":
                system.add_imu(*inputs.read_imu(message))
                if navigator.filter is not None and stamp_ns:
                    yaw += message.angular_velocity.z * (now - stamp_ns) * 1e-9
                stamp_ns = now
                if navigator.state is not None and front_end.map is not None:
                    farthest = max(farthest, math.hypot(*front_end.map.position(navigator.state)[:2]))
            elif raw.topic == "/log":
                system.add("log", message)
                linear = message.twist.twist.linear
                if navigator.filter is not None and log_ns:
                    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
                    alone += turn @ (linear.x, linear.y) * (now - log_ns) * 1e-9
                log_ns = now
            else:
                system.add("depth", message)
            navigator.drain()
    assert navigator.filter is not None and navigator.state is not None and front_end.map is not None
    east, north, _ = front_end.map.position(navigator.state)
    # yaw 0 was given as heading 0, which is north
    off = math.hypot(east + alone[1], north - alone[0])
    sigma = math.sqrt(navigator.filter.p[0, 0] + navigator.filter.p[1, 1])
    rows = []
    for name, every in innovations.items():
        taken = np.array([size for accepted, size in every if accepted])
        alike = [np.corrcoef(taken[1:, i], taken[:-1, i])[0, 1] for i in range(taken.shape[1])]
        cells = [f"{len(taken)} of {len(every)}", f"{_rms(taken):.2f}", ", ".join(f"{x:.2f}" for x in alike)]
        rows.append([f"{name}, {name_of_case}", *cells, f"{farthest:.2f}", f"{off:.2f}", f"{sigma:.2f}"])
    return rows


def _always(_stamp_ns: int) -> bool:
    return True


def _no_outage(stamp_ns: int) -> bool:
    time = stamp_ns * 1e-9 - 1.7e9
    return not any(begin <= time < begin + _OUTAGE for begin in _outages())


def _outages() -> Array:
    """When they begin, s."""
    return np.linspace(_MOVES_OFF + 40.0, 1857.0 - _OUTAGE - 10.0, _OUTAGES).round()


class _Truth:
    """Of kingston_a."""

    def __init__(self, bag: Path) -> None:
        track = read_reference(bag)
        fixes = read_reference(bag, "gnss/fix")
        assert track is not None and track.velocity is not None and track.attitude is not None and fixes is not None
        self._track, self._velocity = track, track.velocity
        self._off = compare(fixes, track).position
        self._first_ns = int(track.position.stamps_ns[0])

    def _moving(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        speed = np.hypot(*self._velocity.enu[:, :2].T)
        now = np.interp(stamps_ns.astype(float), self._velocity.stamps_ns.astype(float), speed)
        return np.asarray(now > _MOVING)

    def accuracy(self, outcomes: Sequence[Outcome]) -> list[list[str]]:
        """Rows of the table, a column for each outcome."""
        columns = [self._figures(outcome) for outcome in outcomes]
        return [[name, *(column[name] for column in columns)] for name in columns[0]]

    def _figures(self, outcome: Outcome) -> dict[str, str]:
        found = compare(outcome.track, self._track)
        assert found.attitude is not None
        position, heading = found.position, np.degrees(found.attitude.values[:, 2])
        distance = np.hypot(*position.values[:, :2].T)
        ratio = found.attitude.values[:, 2] / found.attitude.stddev[:, 2]
        moving = self._moving(found.attitude.stamps_ns)
        off = np.hypot(*self._off.values[:, :2].T)
        taken = np.isin(self._off.stamps_ns, [update.stamp_ns for update in outcome.accepted])
        judged = self._off.stamps_ns > outcome.track.position.stamps_ns[0]
        outliers = judged & (off > _OUTLIER)
        moved = [update.moved for update in outcome.accepted if not update.anew]
        return {
            "horizontal error, RMS, m": f"{_rms(distance):.2f}",
            "greatest, m": f"{distance.max():.2f}",
            "of the fixes themselves, RMS, m": f"{_rms(off[judged]):.2f}",
            "horizontal error / sigma, RMS": f"{_honesty(position):.2f}",
            "heading error, RMS, °": f"{_rms(heading):.2f}",
            "error / sigma, RMS": f"{_rms(ratio[np.isfinite(ratio)]):.2f}",
            "heading error while moving, RMS, °": f"{_rms(heading[moving]):.2f}",
            "moving, error / sigma, RMS": f"{_rms(ratio[moving & np.isfinite(ratio)]):.2f}",
            "fixes accepted": str(len(outcome.accepted)),
            "rejected": str(outcome.rejected),
            f"fixes off by more than {_OUTLIER:g} m": str(np.count_nonzero(outliers)),
            "of those accepted": str(np.count_nonzero(outliers & taken)),
            "worst fix accepted, m": f"{off[taken].max():.1f}",
            "accepted that moved position by more than 3 sigma": str(np.count_nonzero(np.array(moved) > 3.0)),
            "greatest move, sigmas": f"{max(moved):.1f}",
            "accepted after rejected ones that agree": str(len(outcome.accepted) - len(moved)),
        }

    def outages(self, outcomes: Mapping[str, Outcome]) -> str:
        """Table of the greatest errors within the outages."""
        rows = []
        for name, outcome in outcomes.items():
            errors = compare(outcome.track, self._track).position
            time = (errors.stamps_ns - self._first_ns) / _SECOND
            distance = np.hypot(*errors.values[:, :2].T)
            ratio = distance / np.hypot(*errors.stddev[:, :2].T)
            within = [(begin <= time) & (time <= begin + _OUTAGE) for begin in _outages()]
            worst = np.array([distance[w].max() for w in within])
            at_end = np.array([ratio[w][-1] for w in within])
            each = " ".join(f"{x:.1f}" for x in worst)
            rows.append([name, each, f"{_rms(worst):.2f}", f"{worst.max():.2f}", f"{_rms(at_end):.2f}"])
        head = [f"GNSS off for {_OUTAGE:g} s", "greatest errors, m", "RMS of them, m", "greatest, m"]
        return table([*head, "RMS of error / sigma at the end"], rows)

    def slow(self, outcomes: Mapping[tuple[float, float], Outcome]) -> str:
        """Table of what a slow error of GNSS in the filter does."""
        rows = []
        for (stddev, time), outcome in outcomes.items():
            found = compare(outcome.track, self._track)
            assert found.attitude is not None
            heading, sigma = found.attitude.values[:, 2], found.attitude.stddev[:, 2]
            moving = self._moving(found.attitude.stamps_ns)
            distance = np.hypot(*found.position.values[:, :2].T)
            on = moving & np.isfinite(sigma)
            honest = _honesty(found.position), _rms(heading[on] / sigma[on])
            name = f"{stddev:g} m, {time:g} s" if stddev else "none"
            rows.append([name, *(f"{x:.2f}" for x in (_rms(distance), honest[0], distance.max()))])
            rows[-1] += [f"{math.degrees(_rms(heading[moving])):.3f}", f"{honest[1]:.2f}", str(outcome.rejected)]
        head = ["slow error of gnss/fix (with log)", "horizontal RMS, m", "error / sigma", "greatest, m"]
        return table([*head, "heading moving, RMS, °", "error / sigma", "fixes rejected"], rows)


def _honesty(position: Errors) -> float:
    """RMS over time and both axes of horizontal error over sigma."""
    ratio = position.values[:, :2] / position.stddev[:, :2]
    return _rms(ratio[np.isfinite(ratio).all(axis=1)])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
