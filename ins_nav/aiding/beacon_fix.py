"""Fixes of acoustic beacons that float, and the beacons of a simulation.

A fix measures the place of a beacon at its stamp: place and velocity of the beacon are states of the filter
(`ins_nav.aiding.beacon`), which the ranges to it share (`ins_nav.aiding.acoustic_range`).
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from ins_nav.aiding.base import (
    Aid,
    AidParameters,
    Observation,
    OwnStates,
    Reading,
    Unusable,
    declare_default_stddev,
    declare_min_stddev,
)
from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.depth import simulated_depth
from ins_nav.aiding.fields import no_measurement, read_fix
from ins_nav.aiding.simulated import Fixes, Index, Readings, Truth, World, moved
from ins_nav.config.declaration import Section, parameter
from ins_nav.config.parameters import Parameter, Value
from ins_nav.errors import InsNavError
from ins_nav.estimation.error_model import Array
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.event_log import INFO, WARN

BEACON_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names that can be part of a topic."""
_LATE = 30.0
"""s by which a beacon's fix may be late without a fault."""
_USELESS = 300.0
"""m, one sigma of a beacon's way since its fix: a later fix is of no use."""


def fix_topic(beacon_name: str) -> str:
    """Topic of the fixes of a beacon that floats; name of that aid, too."""
    return f"beacon/{beacon_name}/fix"


@dataclass(frozen=True)
class BeaconFixParameters(AidParameters):
    """Of the fixes of beacons; none can be set."""

    default_stddev: float = declare_default_stddev(3.0, "m")
    min_stddev: float = declare_min_stddev(0.05, "m")


@dataclass(frozen=True)
class SimulatedBeacons(Section):
    """Parameters ``beacon.*`` of a simulation."""

    names: str = parameter("", "names of the acoustic beacons, e.g. vessel, north")
    positions: tuple[float, ...] = parameter(
        [], "east, north of the origin, up from the water's surface: three a beacon", unit="m"
    )
    radii: tuple[float, ...] = parameter(
        [0.0], "radius of its circle about that place, one a beacon, or one for all; 0: it stands", unit="m", low=0.0
    )
    speed: float = parameter(1.0, "speed on that circle", unit="m/s", low=0.0)
    fix_rates: tuple[float, ...] = parameter(
        [0.0], "rate of its fixes, one a beacon, or one for all", unit="Hz", low=0.0, high=100.0
    )
    fix_stddev: float = parameter(0.5, "noise of its fixes, each axis", unit="m", low=0.0)


class SimulatedBeacon(NamedTuple):
    """One beacon of a simulation."""

    name: str
    states: Callable[[Array], Truth]
    """At times, s."""
    fix_rate: float
    """Hz."""
    fix_stddev: float
    """Each axis, m."""

    def exact(self, world: World, index: Index) -> Fixes:
        """Its true places at instants."""
        there = self.states(world.truth.time[index])
        nothing = (0.0, 0.0, 0.0)
        return Fixes(world.stamps_ns[index], there.lat, there.lon, there.height, nothing, self.name)

    def fixes(self, world: World) -> Fixes:
        """The fixes that it transmits."""
        index = world.instants(self.fix_rate, "beacon.fix_rates")
        there = self.states(world.truth.time[index])
        noise = self.fix_stddev * world.stream(f"beacon.{self.name}.fix").standard_normal((len(index), 3))
        place = moved(there.lat, there.lon, there.height, noise)
        return Fixes(world.stamps_ns[index], *place, (self.fix_stddev,) * 3, self.name)


def simulated_beacons(world: World) -> list[SimulatedBeacon]:
    """The beacons of a simulation.

    Raises
    ------
    InsNavError
        Their parameters do not fit together.
    """
    p = world.section(SimulatedBeacons, "beacon")
    names = [name for name in p.names.split(", ") if name]
    for name in names:
        if not BEACON_NAME.fullmatch(name):
            raise InsNavError(f"beacon.names: {name!r} cannot be part of a topic; use letters, digits and _")
    if len(set(names)) < len(names):
        raise InsNavError(f"beacon.names: {p.names} has a name twice; name each once")
    if len(p.positions) != 3 * len(names):
        raise InsNavError(f"beacon.positions: {len(p.positions)} numbers for {len(names)} beacons; give three a beacon")
    # up is from the surface, wherever the trajectory's origin is
    surface = simulated_depth(world).surface_height - world.origin[2]
    beacons = []
    for k, name in enumerate(names):
        east, north, up = p.positions[3 * k : 3 * k + 3]
        radius = _each("beacon.radii", p.radii, names, k)
        period = 2.0 * math.pi * radius / p.speed if radius and p.speed else math.inf
        centre = (east, north, surface + up)
        states = partial(world.circle, centre, 0.0 if math.isinf(period) else radius, period)
        beacons.append(SimulatedBeacon(name, states, _each("beacon.fix_rates", p.fix_rates, names, k), p.fix_stddev))
    return beacons


def _each(name: str, numbers: tuple[float, ...], beacons: list[str], k: int) -> float:
    """Of beacon k, from one number for each or one for all."""
    if len(numbers) not in (1, len(beacons)):
        raise InsNavError(f"{name}: {len(numbers)} numbers for {len(beacons)} beacons; give one a beacon, or one")
    return numbers[k if len(numbers) > 1 else 0]


class BeaconFix(Aid[BeaconFixParameters]):
    """Fix of a beacon that floats: a measurement of its place, which may be late.

    Parameters
    ----------
    beacon : Beacon
        Its states are the aid's own.
    beacon_name : str
    enabled : bool
    """

    NAME = "beacon"
    TOPIC = "beacon/<beacon>/fix"
    MESSAGE_TYPES = ("sensor_msgs/msg/NavSatFix",)
    TEXT = "place of a beacon of `range.beacons` that floats"
    PARAMETERS = BeaconFixParameters
    SIMULATED = ("beacon", SimulatedBeacons)
    MAY_BE_SILENT = True
    KEEPS_LATEST = True

    def __init__(self, beacon: Beacon, beacon_name: str, enabled: bool) -> None:
        name = fix_topic(beacon_name)
        super().__init__(BeaconFixParameters(enabled=enabled), name, name)
        self.states = beacon.states
        self._beacon = beacon
        self._last: tuple[float, ...] | None = None
        self._moves = False

    @classmethod
    def rows(cls, overrides: Mapping[str, object]) -> list[Parameter]:
        """None: its parameters are those of the ranges."""
        return []

    @classmethod
    def create(cls, values: Mapping[str, Value]) -> list[Aid[Any]]:
        """None: they are created with the ranges to the same beacons (`AcousticRange.create`)."""
        return []

    def read(self, message: Any) -> Reading:
        """The content of a message; a repeated place of a moving beacon under a new stamp is rejected."""
        reading = read_fix(message)
        if math.isnan(reading.value[2]):
            raise no_measurement(reading.value)
        repeated = reading.value == self._last
        self._moves = self._moves or not (self._last is None or repeated)
        self._last = reading.value
        if self._moves and repeated:
            raise Unusable("place repeated under a new stamp: rejected", "repeated")
        return reading

    def late(self, seconds: float) -> tuple[bool, str, str]:
        used = self._beacon.reference is None or self._beacon.way_stddev(seconds) < _USELESS
        text = "used for the beacon's place at that time" if used else "rejected: check its clock"
        return used, INFO if used and seconds < _LATE else WARN, text

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement:
        lat, lon, height = observation.value
        ago = (solution.stamp_ns - observation.stamp_ns) * 1e-9
        return self._beacon.measure(own.values, observation.stamp_ns, (lat, lon, height), observation.covariance, ago)

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        """Fixes of the beacons that transmit any."""
        return {fix_topic(beacon.name): beacon.fixes(world) for beacon in simulated_beacons(world) if beacon.fix_rate}

    def restart(self) -> None:
        self._beacon.restart()

    def status(self, own: Sequence[tuple[float, float]]) -> dict[str, str]:
        return {"place sigma": f"{math.hypot(*(s for _, s in own[:3])):.2f} m"} if own else {}
