"""What every aid shares: its declaration, the check of its messages, its measurement for the filter.

An aid is a subclass of `Aid` in a module of its own, and that module is all that knows it: parameters with unit, range
and text; topic and message types; the check of a message (`Aid.read`); the measurement with its Jacobian
(`Aid.measure`); the report of its states. `ins_nav.aiding.registry` finds the modules. Each message passes the same
stages: `Aid.observe` -> `Observation` -> queue by stamp (`ins_nav.aiding.aid_queue`) -> `Aid.measure` -> gate and
update (`ins_nav.estimation.error_filter`) -> `Record`.

Messages are read by the names of their fields, so that those of rclpy, of rosbags and of tests are alike.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from ins_nav.aiding.simulated import Readings, World
from ins_nav.alignment.initial_position import Place
from ins_nav.config.declaration import Section, parameter
from ins_nav.config.parameters import Parameter, Value
from ins_nav.estimation.error_model import Array, Vector
from ins_nav.estimation.observation import Measurement, Solution, Update
from ins_nav.estimation.slow_state import SlowState
from ins_nav.event_log import INFO, WARN
from ins_nav.mechanization.nav_state import NavState
from ins_nav.stamps import NS

_LARGEST = 1e30
"""Greatest variance that a message may have."""


class Unusable(Exception):
    """A message or an observation gives no measurement.

    Attributes
    ----------
    kind : str
        Under which it is counted, after the aid's name.
    level : str
        Of the report.
    """

    def __init__(self, text: str, kind: str = "unusable", level: str = INFO) -> None:
        super().__init__(text)
        self.kind = kind
        self.level = level


class Reading(NamedTuple):
    """The content of a message, checked by the aid.

    Attributes
    ----------
    value : tuple of floats
        NaN: not measured.
    covariance : sequence of floats
        Row by row; empty where the message has none.
    stamp_ns : int
        Of the measurement, before `AidParameters.delay` is subtracted.
    """

    value: tuple[float, ...]
    covariance: Sequence[float]
    stamp_ns: int


class Observation(NamedTuple):
    """A reading with the covariance to use, of the instant at which it was measured.

    Attributes
    ----------
    stamp_ns : int
    aid : str
    value : tuple of floats
    covariance : ndarray, shape (m, m)
    """

    stamp_ns: int
    aid: str
    value: tuple[float, ...]
    covariance: Array


class OwnStates(NamedTuple):
    """States of the filter that belong to an aid, followed by those that it shares.

    Attributes
    ----------
    values : ndarray, shape (k,)
        In use.
    covariance : ndarray, shape (k, k)
    """

    values: Array
    covariance: Array


NO_STATES = OwnStates(np.zeros(0), np.zeros((0, 0)))

_MISSED = 30.0
"""s without an accepted measurement of an aid after which a warning is due."""


@dataclass
class Record:
    """Counts of an aid's measurements, for diagnostics."""

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

    def count(self, update: Update) -> None:
        """Count one more."""
        self.last = update
        self.first_ns = self.first_ns or update.stamp_ns
        if update.accepted:
            self.accepted += 1
            self.accepted_ns = update.stamp_ns
        else:
            self.rejected += 1

    def fault(self, aid: "Aid[Any]", heard: bool, now_ns: int, began_ns: int) -> str:
        """Reason for a warning that no measurement of an aid has been accepted for long; empty without one.

        Parameters
        ----------
        aid : Aid
        heard : bool
            A message has arrived.
        now_ns, began_ns : int
            Stamps of the filter: at present, and at its start.
        """
        last_ns = self.last.stamp_ns if self.last is not None else 0
        silent, out = ((now_ns - max(ns, began_ns)) * 1e-9 for ns in (last_ns, self.accepted_ns))
        usual = max(_MISSED, 5.0 * self.interval)
        if silent > usual and heard and not aid.MAY_BE_SILENT:
            return f"nothing usable for {silent:.0f} s"
        if silent > usual and not heard and aid.EXPECTED:
            return "never heard"
        if self.last is not None and silent <= usual < out:
            return f"{self.last.reason} for {out:.0f} s: check its sigma, lever arm and clock"
        return ""


def declare_default_stddev(default: float, unit: str) -> float:
    """Declare `AidParameters.default_stddev`."""
    declared: float = parameter(default, "of a message without covariance, each axis", unit=unit, low=1e-6)
    return declared


def declare_min_stddev(default: float, unit: str) -> float:
    """Declare `AidParameters.min_stddev`."""
    declared: float = parameter(default, "smaller sigmas of messages are raised to this", unit=unit, low=1e-6)
    return declared


def declare_lever_arm(what: str) -> Vector:
    """Declare `AidParameters.lever_arm` of a sensor of that name."""
    declared: Vector = parameter([0.0] * 3, f"{what} from the IMU, base_link's axes", unit="m", low=-1e3, high=1e3)
    return declared


@dataclass(frozen=True)
class AidParameters(Section):
    """Parameters that every aid has."""

    enabled: bool = parameter(True, "use its messages")
    default_stddev: float = declare_default_stddev(1.0, "")
    min_stddev: float = declare_min_stddev(0.01, "")
    lever_arm: Vector = declare_lever_arm("sensor")
    delay: float = parameter(0.0, "from the measurement to its stamp", unit="s", low=-1.0, high=10.0)
    gate: float = parameter(1e-4, "probability with which a good measurement is rejected", low=1e-12, high=0.5)

    def covariance(self, given: Sequence[float], size: int, missing: Sequence[int] = ()) -> Array:
        """Covariance to use, shape (size, size): the one given, no less than ``min_stddev``; else the default.

        Parameters
        ----------
        given : sequence of float
            size² numbers row by row; anything else, or a variance that is not positive and finite, counts as not given.
        size : int
        missing : sequence of int
            Axes not measured: what is given for them is ignored.
        """
        least = self.min_stddev**2
        if len(given) == size * size:
            matrix = np.array(given, float).reshape(size, size)
            for i in missing:
                matrix[i, :] = matrix[:, i] = 0.0
                matrix[i, i] = self.default_stddev**2
            if (np.abs(matrix) < _LARGEST).all() and (matrix.diagonal() > 0.0).all():
                matrix = 0.5 * (matrix + matrix.T)
                if np.linalg.eigvalsh(matrix)[0] <= 0.0:
                    matrix = np.diag(matrix.diagonal())
                return np.asarray(matrix + np.diag(np.maximum(0.0, least - matrix.diagonal())), float)
        return np.eye(size) * max(least, self.default_stddev**2)


P = TypeVar("P", bound=AidParameters)


class Aid(ABC, Generic[P]):
    """A source of measurements.

    Parameters
    ----------
    parameters : AidParameters
    name : str
        Where there are several of a class: in the filter and in diagnostics.
    topic : str
        Likewise.

    Attributes
    ----------
    name, topic, parameters
    states : tuple of SlowState
        The aid's own states in the filter.
    shares : str
        Name of another aid whose states it depends on, too.
    """

    NAME: ClassVar[str]
    """Prefix of its parameters; its name in the filter and in diagnostics, unless there are several."""
    TOPIC: ClassVar[str]
    """With ``<...>`` for what differs where there are several."""
    MESSAGE_TYPES: ClassVar[tuple[str, ...]]
    TEXT: ClassVar[str]
    """Of a message's content, for the table of topics."""
    PARAMETERS: ClassVar[type[AidParameters]]
    SIMULATED: ClassVar[tuple[str, type[Section]] | None] = None
    """Prefix and section of the parameters of its simulated readings."""

    GIVES_POSITION: ClassVar[bool] = False
    """Its first message is a place to align at; once it is accepted, position is known without other aids."""
    MAY_BE_SILENT: ClassVar[bool] = False
    """Silence is no fault."""
    EXPECTED: ClassVar[bool] = False
    """Silence since the start is reported too."""
    KEEPS_LATEST: ClassVar[bool] = False
    """Its latest message is a measurement for a filter that starts later."""
    CALIBRATED: ClassVar[int] = 0
    """Number of its first states that describe unit and mounting: they are kept when alignment restarts."""
    CALIBRATION: ClassVar[tuple[str, ...]] = ()
    """Names of the parameters that `calibration` gives."""

    def __init__(self, parameters: P, name: str = "", topic: str = "") -> None:
        self.parameters = parameters
        self.name = name or self.NAME
        self.topic = topic or self.TOPIC
        self.states: tuple[SlowState, ...] = ()
        self.shares = ""

    # --- declaration

    @classmethod
    def rows(cls, overrides: Mapping[str, object]) -> list[Parameter]:
        """Rows of the parameter table; where there are several of a class, those that the overrides name.

        Raises
        ------
        ParameterError
        """
        return cls.PARAMETERS.rows(cls.NAME)

    @classmethod
    def check(cls, values: Mapping[str, Value]) -> None:
        """Check what ranges of single parameters cannot.

        Raises
        ------
        ParameterError
        """

    @classmethod
    def create(cls, values: Mapping[str, Value]) -> "list[Aid[Any]]":
        """The aids of this class, from checked values of the parameters."""
        parameters: Any = cls.PARAMETERS.from_values(cls.NAME, values)  # the class of the aid's generic parameter
        return [cls(parameters)]

    # --- messages

    @abstractmethod
    def read(self, message: Any) -> Reading:
        """The content of a message.

        Raises
        ------
        Unusable
        """

    def observe(self, message: Any) -> Observation:
        """A message as an observation.

        Raises
        ------
        Unusable
        """
        reading = self.read(message)
        missing = [i for i, x in enumerate(reading.value) if not math.isfinite(x)]
        covariance = self.parameters.covariance(reading.covariance, len(reading.value), missing)
        stamp_ns = reading.stamp_ns - round(self.parameters.delay * NS)
        return Observation(stamp_ns, self.name, reading.value, covariance)

    def place(self, observation: Observation) -> Place:
        """The place to align at, of an aid that gives position; a height that is NaN is not known."""
        raise NotImplementedError

    def late(self, seconds: float) -> tuple[bool, str, str]:
        """Of a message older than the filter's state: whether it is used, level and end of the report."""
        return False, WARN, "rejected: raise aiding.max_delay, or check its clock"

    # --- measurement

    @abstractmethod
    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement | None:
        """An observation as a measurement for the filter; None where nothing can be computed of it.

        Raises
        ------
        Unusable
            With a reason that is worth a report.
        """

    def restart(self) -> None:
        """Reset what the aid keeps, together with its states in the filter."""

    def corrected(self, before: NavState, after: NavState) -> None:
        """The solution was corrected."""

    # --- simulation

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        """Simulated readings by topic; those below truth/ are exact.

        Raises
        ------
        InsNavError
            The parameters do not fit together.
        """
        return {}

    # --- reports

    def calibration(self, own: Sequence[tuple[float, float]]) -> dict[str, Value]:
        """Values of the parameters `CALIBRATION` from value and sigma of each own state."""
        return {}

    def status(self, own: Sequence[tuple[float, float]]) -> dict[str, str]:
        """Own states, value and sigma each, for diagnostics."""
        return {"own states": ", ".join(f"{x:.4f} ± {s:.4f}" for x, s in own)} if own else {}


def slow_error(stddev: float, time: float) -> SlowState:
    """A first-order Gauss-Markov process of that stationary sigma and correlation time, s."""
    return SlowState(stddev, stddev * math.sqrt(2.0 / time), time)
