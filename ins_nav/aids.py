"""The aids of the system: what each parameter set makes of a message, checked, as a `Measurement` for the filter.

Every aid goes through the same steps: message -> `Observation` (values checked, covariance found) -> queue by stamp ->
`Aid.measure` -> gate and update (`ins_nav.error_filter`) -> `Record`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ins_nav.error_filter import Measurement, Solution, Update
from ins_nav.error_model import Array, SlowState, Vector
from ins_nav.measurements import Depth, GnssPosition, GnssVelocity, Log
from ins_nav.parameters import Value

GNSS, GNSS_VELOCITY, LOG, DEPTH = "gnss", "gnss_velocity", "log", "depth"
TOPICS = {GNSS: "gnss/fix", GNSS_VELOCITY: "gnss/velocity", LOG: "log", DEPTH: "depth"}
"""Topic of each aid, to be named in messages for people."""
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


@dataclass
class Record:
    """What became of an aid's messages, for diagnostics."""

    accepted: int = 0
    rejected: int = 0
    last: Update | None = None
    accepted_ns: int = 0

    def take(self, update: Update) -> None:
        """One more."""
        self.last = update
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
    """

    settings: Settings
    states: tuple[SlowState, ...] = field(default=())

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        """What the filter is to make of an observation; None where it says nothing."""
        raise NotImplementedError


class _Gnss(Aid):
    """Position; its error may be slow (own states) besides white: reflections, the atmosphere."""

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        lat, lon, height = seen.value
        plain = GnssPosition(self.settings.lever_arm).measure(solution, lat, lon, height, seen.covariance)
        if not self.states:
            return plain
        return plain._replace(innovation=plain.innovation + own, own=np.eye(3))


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


@dataclass(frozen=True)
class _Depth(Aid):
    surface: float = 0.0

    def measure(self, solution: Solution, own: Array, seen: Observation) -> Measurement | None:
        aid = Depth(self.surface, self.settings.lever_arm)
        return aid.measure(solution, seen.value[0], float(seen.covariance[0, 0]))


def make(values: Mapping[str, Value]) -> dict[str, Aid]:
    """The aids that are enabled, by name, from the values of the parameters."""

    def number(name: str) -> float:
        return float(values[name])  # type: ignore[arg-type]

    settings = {name: Settings.of(name, values) for name in TOPICS}
    slow = number("gnss.slow_stddev")
    time = number("gnss.slow_time")
    drift = SlowState(slow, slow * math.sqrt(2.0 / time), time)
    log = Log(
        tuple(math.radians(x) for x in _vector(values["log.mounting_rpy_deg"])),  # type: ignore[arg-type]
        settings[LOG].lever_arm,
        SlowState(number("log.scale_stddev")),
        SlowState(math.radians(number("log.misalignment_stddev_deg"))),
    )
    aids = {
        GNSS: _Gnss(settings[GNSS], (drift,) * 3 if slow > 0.0 else ()),
        GNSS_VELOCITY: _GnssVelocity(settings[GNSS_VELOCITY]),
        LOG: _Log(settings[LOG], log.states, log),
        DEPTH: _Depth(settings[DEPTH], (), number("depth.surface_height")),
    }
    return {name: aid for name, aid in aids.items() if aid.settings.enabled}


def _vector(value: Value) -> Vector:
    x, y, z = (float(item) for item in value)  # type: ignore[union-attr]
    return x, y, z
