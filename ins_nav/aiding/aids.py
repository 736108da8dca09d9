"""The aids of the system: what each parameter set makes of a message, checked, as a `Measurement` for the filter.

Every aid goes through the same steps: message -> `Observation` (values checked, covariance found) -> queue by stamp ->
`Aid.measure` -> gate and update (`ins_nav.estimation.error_filter`) -> `Record`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.measurements import BeaconRange, Depth, GnssPosition, GnssVelocity, Log
from ins_nav.aiding.parameters import beacon_names
from ins_nav.config.parameters import Value
from ins_nav.estimation.error_model import Array, SlowState, Vector, rotation_matrix
from ins_nav.estimation.innovation_gate import GATE, PATIENCE
from ins_nav.estimation.observation import Measurement, Solution, Update
from ins_nav.estimation.state_layout import POSITION
from ins_nav.mechanization import nav_state
from ins_nav.mechanization.attitude import rotate
from ins_nav.mechanization.earth import normal_gravity

GNSS, GNSS_VELOCITY, LOG, DEPTH, PRESSURE = "gnss", "gnss_velocity", "log", "depth", "pressure"
RANGE, BEACON = "range", "beacon"
_TOPICS = {GNSS: "gnss/fix", GNSS_VELOCITY: "gnss/velocity"}
_ANYWHERE = 1e3
"""m: uncertainty of a surface's height that is not given."""
_BEACON_STDDEV, _BEACON_LEAST = 3.0, 0.05
"""m: of a beacon's fix without covariance, and the least that is believed."""
_HUGE = 1e30
"""Square of a sigma that nobody means."""


class Observation(NamedTuple):
    """A message of an aid, checked.

    Attributes
    ----------
    stamp_ns : int
        When it was measured: the delay is taken off.
    aid : str
    value : tuple of floats
    serial : int
        Tells apart those that are alike.
    covariance : ndarray
    """

    stamp_ns: int
    aid: str  # before the serial: the order of arrival must not matter
    value: tuple[float, ...]
    serial: int
    covariance: Array


def topic(name: str) -> str:
    """Of an aid (or where it is none, its name), for people; that of a beacon's ranges is range/<beacon>."""
    return _TOPICS.get(name, name)


def range_name(beacon: str) -> str:
    """Name of the aid that is the ranges to a beacon."""
    return f"{RANGE}/{beacon}"


def fix_name(beacon: str) -> str:
    """Name of the fixes of a beacon that floats."""
    return f"{BEACON}/{beacon}/fix"


@dataclass
class Record:
    """What became of an aid's messages, for diagnostics."""

    accepted: int = 0
    rejected: int = 0
    last: Update | None = None
    first_ns: int = 0
    """Stamp of the first."""
    accepted_ns: int = 0
    """Stamp of the last accepted."""

    @property
    def interval(self) -> float:
        """Mean from one to the next, s; 0 before there are two."""
        if self.last is None:
            return 0.0
        return (self.last.stamp_ns - self.first_ns) * 1e-9 / max(1, self.accepted + self.rejected - 1)

    def take(self, update: Update) -> None:
        """One more."""
        self.last = update
        self.first_ns = self.first_ns or update.stamp_ns
        if update.accepted:
            self.accepted += 1
            self.accepted_ns = update.stamp_ns
        else:
            self.rejected += 1


@dataclass(frozen=True)
class Settings:
    """Parameters that every aid has; see the table."""

    enabled: bool
    default_stddev: float
    min_stddev: float
    lever_arm: Vector
    delay_ns: int
    gate: float
    patience: float

    @classmethod
    def of(cls, name: str, values: Mapping[str, Value]) -> "Settings":
        """From the values of the parameters ``<name>.*``."""

        def number(key: str) -> float:
            return float(values[f"{name}.{key}"])  # type: ignore[arg-type]

        return cls(
            bool(values[f"{name}.enabled"]),
            number("default_stddev"),
            number("min_stddev"),
            _vector(values[f"{name}.lever_arm"]),
            round(number("delay") * 1e9),
            number("gate"),
            number("patience"),
        )

    def covariance(self, given: Sequence[float], size: int, missing: Sequence[int] = ()) -> Array:
        """Covariance to use, shape (size, size): the one given, but no less than the least; the default for none.

        Parameters
        ----------
        given : sequence of float
            Empty, or size² numbers; one that is not positive, or not a number, is none.
        size : int
        missing : sequence of int
            Axes not measured: whatever is given for them is not looked at.
        """
        least = self.min_stddev**2
        if len(given) == size * size:
            matrix = np.array(given, float).reshape(size, size)
            for i in missing:
                matrix[i, :] = matrix[:, i] = 0.0
                matrix[i, i] = self.default_stddev**2
            if (np.abs(matrix) < _HUGE).all() and (matrix.diagonal() > 0.0).all():
                matrix = 0.5 * (matrix + matrix.T)
                if np.linalg.eigvalsh(matrix)[0] <= 0.0:
                    matrix = np.diag(matrix.diagonal())
                return np.asarray(matrix + np.diag(np.maximum(0.0, least - matrix.diagonal())), float)
        return np.eye(size) * max(least, self.default_stddev**2)


@dataclass(frozen=True)
class Aid:
    """An aid as parameters describe it.

    Attributes
    ----------
    settings : Settings
    states : tuple of SlowState
        Its own in the filter.
    shares : str
        Another aid whose states it sees, too; ``own`` has those after its own.
    """

    settings: Settings
    states: tuple[SlowState, ...] = field(default=())
    shares: str = ""

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        """What the filter is to make of an observation; None where it says nothing."""
        raise NotImplementedError

    def patience(self, seen: Observation) -> float:
        """As `ins_nav.estimation.error_filter.ErrorFilter.update` takes it, s."""
        return self.settings.patience


class _Gnss(Aid):
    """Position; its error may be slow (own states) besides white: reflections, the atmosphere."""

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        lat, lon, height = seen.value
        aid = GnssPosition(self.settings.lever_arm, horizontal=math.isnan(height))
        plain = aid.measure(solution, lat, lon, height, seen.covariance)
        if not self.states:
            return plain
        rows = len(plain.innovation)
        return plain._replace(innovation=plain.innovation + own[:rows], own=np.eye(3)[:rows])


class _GnssVelocity(Aid):
    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        east, north, up = seen.value
        aid = GnssVelocity(self.settings.lever_arm, horizontal=math.isnan(up))
        return aid.measure(solution, (east, north, 0.0 if math.isnan(up) else up), seen.covariance)


@dataclass(frozen=True)
class _Log(Aid):
    log: Log = field(default_factory=Log)

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        x, y, z = seen.value
        return self.log.measure(solution, own, (x, y, z), seen.covariance)

    def patience(self, seen: Observation) -> float:
        """Nothing but zeros are what some logs say that have lost the bottom: no reason to doubt the filter."""
        return self.settings.patience if any(x for x in seen.value if math.isfinite(x)) else 0.0


class _Surface:
    """Ellipsoidal height of the water's surface, m; NaN until the first depth finds it."""

    def __init__(self, height: float) -> None:
        self.height = height


@dataclass(frozen=True)
class _Depth(Aid):
    """Depth; the height of the surface is a state of its own where it is not known exactly."""

    surface: _Surface = field(default_factory=lambda: _Surface(0.0))

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        depth, variance = self._depth(solution, seen)
        aid = Depth(self.settings.lever_arm)
        if math.isnan(self.surface.height):
            self.surface.height = aid.height(solution) + depth
        surface = self.surface.height + float(own.sum())
        plain = aid.measure(solution, depth, variance, surface)
        # a gauge that says otherwise for long: the surface is not where it was thought to be
        return plain._replace(direct=None) if self.states else plain._replace(own=None)

    def _depth(self, solution: Solution, seen: Observation) -> tuple[float, float]:
        """m, and its variance, m²."""
        return seen.value[0], float(seen.covariance[0, 0])


@dataclass(frozen=True)
class _Pressure(_Depth):
    """Absolute pressure, Pa: depth by the weight of a column of water of the same density and gravity throughout."""

    air: float = 0.0
    density: float = 1.0

    def _depth(self, solution: Solution, seen: Observation) -> tuple[float, float]:
        where = nav_state.geodetic(solution.state)
        weight = self.density * normal_gravity(math.sin(where.lat), where.height)
        return (seen.value[0] - self.air) / weight, float(seen.covariance[0, 0]) / weight**2


@dataclass(frozen=True)
class Range(Aid):
    """Slant range to a beacon, which was where it was when sound left it."""

    beacon: Beacon = field(default_factory=lambda: Beacon(None, 0.0))
    sound_speed: float = 1500.0
    two_way: bool = False
    meter: BeaconRange = field(default_factory=BeaconRange)

    def travel_time(self, distance: float) -> float:
        """Time that sound takes, s."""
        return distance / self.sound_speed

    def place(self, own: Array, seen: Observation) -> Array | None:
        """Of the beacon when sound left it, Earth-fixed, m; None: nobody knows."""
        return self.beacon.at(own[len(self.states) :], self._ago(seen))

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        place = self.place(own, seen)
        if place is None:
            return None  # nobody knows where it is
        mine = own[: len(self.states)]
        plain = self.meter.measure(solution, mine, place, seen.value[0], float(seen.covariance[0, 0]))
        if plain is None or not self.shares:
            return plain
        assert plain.own is not None
        from_beacon: Array = np.array(rotate(solution.state[7:11], *plain.h[0, POSITION].tolist()))
        columns = self.beacon.columns(-from_beacon, self._ago(seen))
        return plain._replace(own=np.hstack([plain.own, columns[None]]), shares=self.shares)

    def place_columns(self, solution: Solution, seen: Observation) -> Array | None:
        """Of the states, on the beacon's place on n when sound left it, shape (3, k); None where it is moored."""
        if not self.shares:
            return None
        rot_en = rotation_matrix(solution.state[7:11])
        columns = [self.beacon.columns(axis, self._ago(seen)) for axis in rot_en.T]
        return np.hstack([np.zeros((3, len(self.states))), columns])

    def spread(self, solution: Solution, covariance: Array) -> Array:
        """Covariance of the beacon's place on n, shape (3, 3), m², from that of its states."""
        if not self.shares:
            return np.zeros((3, 3))
        rot_en = rotation_matrix(solution.state[7:11])
        spread: Array = rot_en.T @ covariance[:3, :3] @ rot_en
        return spread

    def _ago(self, seen: Observation) -> float:
        """s from when sound left to the stamp; that of two ways is of the middle already."""
        return 0.0 if self.two_way else self.travel_time(seen.value[0])


@dataclass(frozen=True)
class BeaconFix(Aid):
    """Fix of a beacon that floats: it says nothing but where the beacon is, or was."""

    beacon: Beacon = field(default_factory=lambda: Beacon(None, 0.0))

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        lat, lon, height = seen.value
        ago = (solution.stamp_ns - seen.stamp_ns) * 1e-9
        return self.beacon.measure(own, seen.stamp_ns, (lat, lon, height), seen.covariance, ago)


def make(values: Mapping[str, Value]) -> dict[str, Aid]:
    """The aids that are enabled, by name, from the values of the parameters; some of them remember things."""

    def number(name: str) -> float:
        return float(values[name])  # type: ignore[arg-type]

    settings = {name: Settings.of(name, values) for name in (GNSS, GNSS_VELOCITY, LOG, DEPTH, PRESSURE, RANGE)}
    misalignment = math.radians(number("log.misalignment_stddev_deg"))
    log = Log(
        tuple(math.radians(x) for x in _vector(values["log.mounting_rpy_deg"])),  # type: ignore[arg-type]
        settings[LOG].lever_arm,
        SlowState(number("log.scale_stddev"), value=number("log.scale")),
        SlowState(misalignment, value=math.radians(number("log.pitch_deg"))),
        SlowState(misalignment, value=math.radians(number("log.yaw_deg"))),
        _wandering(number, "log.current") if values["log.water_track"] else None,
        _wandering(number, "log.slow") if values["log.slow_stddev"] else None,
    )
    height = number("depth.surface_height")
    unsure = _ANYWHERE if math.isnan(height) else number("depth.surface_stddev")
    surface = (SlowState(unsure),) if unsure > 0.0 else ()
    aids: dict[str, Aid] = {
        GNSS: _Gnss(settings[GNSS], (_wandering(number, "gnss.slow"),) * 3 if values["gnss.slow_stddev"] else ()),
        GNSS_VELOCITY: _GnssVelocity(settings[GNSS_VELOCITY]),
        LOG: _Log(settings[LOG], log.states, "", log),
        DEPTH: _Depth(settings[DEPTH], surface, "", _Surface(height)),
        PRESSURE: _Pressure(
            settings[PRESSURE],
            surface,
            "",
            _Surface(height),
            number("pressure.surface_pressure"),
            number("pressure.density"),
        ),
    }
    return {name: aid for name, aid in (aids | _ranges(values, settings[RANGE])).items() if aid.settings.enabled}


def _wandering(number: Callable[[str], float], name: str) -> SlowState:
    """By the parameters ``<name>_stddev``, of the process at any time, and ``<name>_time``, its correlation time."""
    stddev, time = number(f"{name}_stddev"), number(f"{name}_time")
    return SlowState(stddev, stddev * math.sqrt(2.0 / time), time)


def _ranges(values: Mapping[str, Value], settings: Settings) -> dict[str, Aid]:
    """Ranges to every beacon, and fixes of those that float."""

    def number(name: str) -> float:
        return float(values[name])  # type: ignore[arg-type]

    made: dict[str, Aid] = {}
    fixes = replace(
        settings,
        default_stddev=_BEACON_STDDEV,
        min_stddev=_BEACON_LEAST,
        delay_ns=0,
        gate=GATE,
        patience=PATIENCE,
    )
    meter = BeaconRange(
        settings.lever_arm, SlowState(number("range.scale_stddev")), SlowState(number("range.bias_stddev"))
    )
    for name in beacon_names(values["range.beacons"]):
        lat, lon = (math.radians(number(f"range.{name}.{axis}_deg")) for axis in ("latitude", "longitude"))
        place = None if math.isnan(lat) else (lat, lon, number(f"range.{name}.height"))
        beacon = Beacon(place, number("range.beacon_speed"))
        fix, two_way = "" if beacon.moored else fix_name(name), bool(values["range.two_way"])
        made[range_name(name)] = Range(settings, meter.states, fix, beacon, number("range.sound_speed"), two_way, meter)
        if fix:
            made[fix] = BeaconFix(fixes, beacon.states, "", beacon)
    return made


def _vector(value: Value) -> Vector:
    x, y, z = (float(item) for item in value)  # type: ignore[union-attr]
    return x, y, z
