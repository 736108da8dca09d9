"""Ranges to acoustic beacons.

Parameters give the place of a moored beacon. A floating one transmits fixes; its place and velocity are states of the
filter (`ins_nav.aiding.beacon`). A range is the distance to the beacon's place at the emission of the sound. While the
position sigma is large, ranges are gathered until they determine one position (`ins_nav.aiding.range_search`).

A range reads ``(1 + scale) distance + bias``; its own states are scale (error of the sound speed) and bias, m.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.aiding.base import (
    Aid,
    AidParameters,
    Observation,
    OwnStates,
    Reading,
    Unusable,
    declare_default_stddev,
    declare_lever_arm,
    declare_min_stddev,
)
from ins_nav.aiding.beacon import Beacon
from ins_nav.aiding.beacon_fix import BEACON_NAME, BeaconFix, SimulatedBeacon, fix_topic, simulated_beacons
from ins_nav.aiding.fields import no_measurement
from ins_nav.aiding.geometry import from_earth, set_turned
from ins_nav.aiding.range_search import BeaconErrors, RangeSearch, uncertain
from ins_nav.aiding.simulated import (
    Fixes,
    MakeMessage,
    Messages,
    Readings,
    Stamps,
    World,
    header,
    rows,
    turned,
)
from ins_nav.config.declaration import Section, parameter
from ins_nav.config.parameters import NAN, Parameter, ParameterError, Value
from ins_nav.estimation.error_model import Array, Vector, rotation_matrix
from ins_nav.estimation.observation import Measurement, Solution
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import HORIZONTAL_POSITION, POSITION, SIZE
from ins_nav.event_log import WARN
from ins_nav.mechanization.attitude import rotate
from ins_nav.mechanization.nav_state import NavState, position_ecef
from ins_nav.stamps import NS, stamp_of

_POSITIVE_OUTLIERS = 0.9
"""A reflected ray is longer than the direct one; the other outliers are noise detected as a reply."""
_LINEAR = 0.1
"""Error of position, over the distance, up to which a range is linear in it: to half a percent of the distance."""
_PLACE = (
    ("latitude_deg", "latitude of the beacon, deg", 90.0),
    ("longitude_deg", "longitude of the beacon", 360.0),
    ("height", "its ellipsoidal height, m", 12e3),
)


@dataclass(frozen=True)
class RangeParameters(AidParameters):
    """Parameters ``range.*``."""

    default_stddev: float = declare_default_stddev(1.0, "m")
    min_stddev: float = declare_min_stddev(0.01, "m")
    lever_arm: Vector = declare_lever_arm("transducer")
    beacons: str = parameter(
        "",
        "names of acoustic beacons, separated by commas. The place of each is range.<beacon>.latitude_deg, .longitude_"
        "deg and .height; without them, fixes are expected on beacon/<beacon>/fix",
    )
    scale_stddev: float = parameter(0.0, "relative error of the speed of sound; 0: none", low=0.0, high=0.2)
    bias_stddev: float = parameter(0.0, "constant error of a beacon's ranges; 0: none", unit="m", low=0.0, high=1e3)
    sound_speed: float = parameter(1500.0, "for the travel time of the sound", unit="m/s", low=300.0, high=7000.0)
    two_way: bool = parameter(
        False,
        "the vehicle interrogates and the beacon replies: a range is of the middle of that time; false: of its end",
    )
    beacon_speed: float = parameter(
        1.0,
        "standard deviation of each component of the velocity of a beacon that floats",
        unit="m/s",
        low=0.0,
        high=30.0,
    )


@dataclass(frozen=True)
class SimulatedRanges(Section):
    """Parameters ``range.*`` of a simulation."""

    rate: float = parameter(0.0, "ranges a second to each beacon; 0: none", unit="Hz", low=0.0, high=100.0)
    lever_arm: Vector = parameter([0.0, 0.0, 0.0], "transducer from the IMU: forward, left, up", unit="m")
    noise_stddev: float = parameter(0.5, "white noise", unit="m", low=0.0)
    bias: float = parameter(0.0, "constant error of every range", unit="m")
    bias_stddev: float = parameter(0.0, "the same, drawn once a run for each beacon and added", unit="m", low=0.0)
    scale: float = parameter(
        0.0, "error of the sound speed: ranges are 1 + scale times the distance", low=-0.5, high=0.5
    )
    scale_stddev: float = parameter(0.0, "the same, drawn once a run and added", low=0.0, high=0.5)
    outlier_share: float = parameter(0.0, "share of outliers, nine in ten of them too long", low=0.0, high=1.0)
    outlier_span: tuple[float, float] = parameter(
        [10.0, 300.0], "smallest and largest error of an outlier", unit="m", low=0.0
    )
    max: float = parameter(5000.0, "largest distance with a reply", unit="m", low=0.0)
    delay_speed: float = parameter(
        0.0, "speed of the reply's sound: stamps are late by distance over speed; 0: not late", unit="m/s", low=0.0
    )


@dataclass(frozen=True)
class RangeReadings:
    """Slant ranges to one beacon, m of them: ``(1 + scale) distance + bias``."""

    stamps_ns: Stamps
    """Of the replies' arrival, where stamps are late; else of the emissions."""
    distance: Array
    """(m,), m."""
    stddev: float
    """Of the noise, m."""
    limit: float
    """Largest range, m."""
    scale: float
    """Given and drawn."""
    bias: float
    """Given and drawn, m."""
    outlier: NDArray[np.bool_]
    """(m,)."""
    beacon: Fixes
    """Where the beacon was, exactly, at the instants the ranges are for."""
    message_type: str

    def messages(self, make: MakeMessage) -> Messages:
        for stamp, distance in rows(self.stamps_ns, self.distance):
            yield stamp, range_message(make, stamp, distance, self.stddev**2, (0.0, self.limit))


def range_message(
    make: MakeMessage,
    stamp_ns: int,
    distance: float,
    variance: float = 0.0,
    limits: tuple[float, float] = (0.0, math.inf),
) -> Any:
    """sensor_msgs/Range of an acoustic range, m, its variance, m², 0: unknown, and least and greatest range."""
    return make(
        "sensor_msgs/msg/Range",
        header=header(make, stamp_ns, "range_link"),
        radiation_type=0,  # ULTRASOUND
        field_of_view=2.0 * math.pi,
        min_range=limits[0],
        max_range=limits[1],
        range=distance,
        variance=variance,
    )


def beacon_names(value: object) -> list[str]:
    """Names in ``range.beacons``.

    Raises
    ------
    ParameterError
        One cannot be part of a topic, occurs twice, or is that of another parameter.
    """
    names = [name.strip() for name in str(value).split(",") if name.strip()]
    known = {row.name for row in RangeParameters.rows(AcousticRange.NAME)}
    for name in names:
        if not BEACON_NAME.fullmatch(name) or f"{AcousticRange.NAME}.{name}" in known:
            raise ParameterError(f"parameter range.beacons: {name!r} cannot be the name of a beacon")
    if len(set(names)) < len(names):
        raise ParameterError(f"parameter range.beacons: a name occurs twice in {value!r}")
    return names


class AcousticRange(Aid[RangeParameters]):
    """Slant range to one beacon.

    Parameters
    ----------
    parameters : RangeParameters
    beacon : Beacon
    beacon_name : str
    search : RangeSearch, optional
        That of another beacon: ranges to all of them are searched together.
    """

    NAME = "range"
    TOPIC = "range/<beacon>"
    MESSAGE_TYPES = ("sensor_msgs/msg/Range",)
    TEXT = "slant range, m, to each of `range.beacons`; zero or outside `min_range` to `max_range`: rejected"
    PARAMETERS = RangeParameters
    SIMULATED = ("range", SimulatedRanges)
    EXPECTED = True

    def __init__(
        self, parameters: RangeParameters, beacon: Beacon, beacon_name: str, search: RangeSearch | None = None
    ) -> None:
        name = f"range/{beacon_name}"
        super().__init__(parameters, name, name)
        self.states = (SlowState(parameters.scale_stddev), SlowState(parameters.bias_stddev))
        self.shares = "" if beacon.moored else fix_topic(beacon_name)
        self._beacon = beacon
        self.search = RangeSearch() if search is None else search
        self._moves_search = search is None

    @classmethod
    def rows(cls, overrides: Mapping[str, object]) -> list[Parameter]:
        beacons = beacon_names(overrides.get("range.beacons", ""))
        keys = "|".join(key for key, _, _ in _PLACE)
        for name in overrides:
            place = re.fullmatch(rf"range\.({BEACON_NAME.pattern})\.({keys})", name)
            if place and place[1] not in beacons:
                raise ParameterError(f"parameter {name}: {place[1]} is not in range.beacons")
        places = [
            Parameter(f"range.{beacon}.{key}", NAN, f"{text}; not given: from {fix_topic(beacon)}", -limit, limit)
            for beacon in beacons
            for key, text, limit in _PLACE
        ]
        return [*super().rows(overrides), *places]

    @classmethod
    def check(cls, values: Mapping[str, Value]) -> None:
        for beacon in beacon_names(values["range.beacons"]):
            given = [not math.isnan(value) for value in _place(beacon, values)]
            if any(given) and not all(given):
                a, b, c = (f"range.{beacon}.{key}" for key, _, _ in _PLACE)
                raise ParameterError(f"{a}, {b} and {c} go together: give all three or none")

    @classmethod
    def create(cls, values: Mapping[str, Value]) -> list[Aid[Any]]:
        """Ranges to every beacon, and fixes of those that float."""
        parameters = RangeParameters.from_values(cls.NAME, values)
        aids: list[Aid[Any]] = []
        search: RangeSearch | None = None
        for name in beacon_names(parameters.beacons):
            lat, lon, height = _place(name, values)
            place = None if math.isnan(lat) else (math.radians(lat), math.radians(lon), height)
            beacon = Beacon(place, parameters.beacon_speed)
            ranges = cls(parameters, beacon, name, search)
            search = ranges.search
            aids.append(ranges)
            if not beacon.moored:
                aids.append(BeaconFix(beacon, name, parameters.enabled))
        return aids

    def read(self, message: Any) -> Reading:
        distance, stamp_ns = float(message.range), stamp_of(message)
        low, high = float(message.min_range), float(message.max_range)
        if not low < high:  # not filled in
            low, high = 0.0, math.inf
        if not (math.isfinite(distance) and distance > 0.0 and low <= distance <= high):
            raise no_measurement((distance,))
        if self.parameters.two_way:
            stamp_ns -= round(NS * self._travel_time(distance))  # half of the time
        return Reading((distance,), (float(message.variance),), stamp_ns)

    def measure(self, solution: Solution, own: OwnStates, observation: Observation) -> Measurement | None:
        """The range alone; with a large position sigma, the position by all gathered ranges."""
        place = self._place(own, observation)
        if place is None:
            text = "the beacon's place is unknown: publish its fixes, or set its parameters"
            raise Unusable(text, "unusable", WARN)
        away, covariance = self._away(solution.state, place), solution.position_covariance
        spread = self._beacon_covariance(solution, own)
        if uncertain(spread[:2, :2], away):
            raise Unusable(f"sigma of the beacon's place is {math.sqrt(spread.trace()):.0f} m: rejected")
        if not uncertain(covariance[:2, :2], away):
            if self.name in self.search:
                self.search.restart()
            return self._range(solution, own, observation, away, covariance + spread)
        return self._gather(solution, own, observation, away, spread)

    def restart(self) -> None:
        self.search.restart()

    def corrected(self, before: NavState, after: NavState) -> None:
        if self._moves_search:
            x, y, _ = from_earth(after, np.subtract(position_ecef(after), position_ecef(before)))
            self.search.moved(x, y)

    @classmethod
    def simulate(cls, world: World) -> dict[str, Readings]:
        """Ranges to every beacon, and its true places at their instants."""
        p = world.section(SimulatedRanges, cls.NAME)
        scale = p.scale + p.scale_stddev * float(world.stream("range.scale").standard_normal())
        readings: dict[str, Readings] = {}
        for beacon in simulated_beacons(world) if p.rate else ():
            readings[f"range/{beacon.name}"] = ranges = _simulated_ranges(world, p, beacon, scale)
            readings[f"truth/{fix_topic(beacon.name)}"] = ranges.beacon
        return readings

    def _travel_time(self, distance: float) -> float:
        """Of the sound, s."""
        return distance / self.parameters.sound_speed

    def _ago(self, observation: Observation) -> float:
        """Time from the beacon's emission to the stamp, s; 0 for two ways: their stamp is that of the middle."""
        return 0.0 if self.parameters.two_way else self._travel_time(observation.value[0])

    def _place(self, own: OwnStates, observation: Observation) -> Array | None:
        """Of the beacon at the emission, Earth-fixed, m; None: unknown."""
        return self._beacon.at(own.values[len(self.states) :], self._ago(observation))

    def _away(self, state: NavState, place: Array) -> Array:
        """From the beacon to the transducer, on n, shape (3,), m."""
        arm = rotate(state[0:4], *self.parameters.lever_arm)
        return np.add(from_earth(state, np.subtract(position_ecef(state), place)), arm)

    def _range(
        self, solution: Solution, own: OwnStates, observation: Observation, away: Array, covariance: Array
    ) -> Measurement | None:
        """To second order in the error of the place, of that covariance, shape (3, 3), m².

        Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 10.3.2: range grows
        with the square of an error across the direction to the beacon, so that a large sigma of the place increases
        the variance.
        """
        scale, bias = map(float, own.values[: len(self.states)])
        length = float(np.linalg.norm(away))
        if length == 0.0:
            return None  # at the beacon: no direction
        h: Array = np.zeros((3, SIZE))
        h[:, POSITION] = np.eye(3)
        set_turned(h, rotate(solution.state[0:4], *self.parameters.lever_arm))
        across = (np.eye(3) - np.outer(away, away) / length**2) / length @ covariance
        z = np.array([(1.0 + scale) * (length + 0.5 * across.trace()) + bias - observation.value[0]])
        row = ((1.0 + scale) / length) * away @ h
        r = np.array([[float(observation.covariance[0, 0]) + 0.5 * (across @ across).trace()]])
        columns = np.array([[length, 1.0]])
        if self.shares:
            direction: Array = np.array(rotate(solution.state[7:11], *row[POSITION].tolist()))
            columns = np.hstack([columns, self._beacon.columns(-direction, self._ago(observation))[None]])
        shares = (self.shares,) if self.shares else ()
        return Measurement(z, row[None], r, POSITION, columns, shares, _LINEAR * length)

    def _gather(
        self, solution: Solution, own: OwnStates, observation: Observation, away: Array, spread: Array
    ) -> Measurement:
        """Position by the gathered ranges to all beacons; ``spread`` is the beacon's covariance, shape (3, 3), m²."""
        scale, bias = own.values[: len(self.states)].tolist()
        distance = (observation.value[0] - bias) / (1.0 + scale)
        position = solution.position_covariance[:2, :2]
        columns = self._error_columns(solution, observation, distance)
        offset = float(columns[2] @ own.covariance @ columns[2])
        names = (self.name, self.shares) if self.shares else (self.name,)
        errors = BeaconErrors(spread[:2, :2], offset, names, columns)
        self.search.add(self.name, away, distance, float(observation.covariance[0, 0]), position, errors)
        found = self.search.settled(away, position)
        if found is None:
            sigma = math.sqrt(position.trace())
            text = f"position sigma is {sigma:.0f} m at a distance of {distance:.0f} m: ranges are gathered until they "
            raise Unusable(text + "determine one position: change course", "gathered")
        self.search.restart()
        h = np.zeros((len(found.z), SIZE))
        h[:, HORIZONTAL_POSITION] = found.position
        first, *others = sorted(found.beacons, key=lambda beacon: beacon[0].names != names)
        shares = (*names[1:], *(name for errors, _ in others for name in errors.names))
        own_columns = np.hstack([rows @ errors.columns for errors, rows in (first, *others)])
        return Measurement(-found.z, h, np.diag(found.variance), POSITION, own_columns, shares)

    def _error_columns(self, solution: Solution, observation: Observation, distance: float) -> Array:
        """Jacobian by the states of the beacon's place, two axes of n, and of the offset of a range, shape (3, k)."""
        columns = np.zeros((3, len(self.states)))
        columns[2] = distance, 1.0
        if not self.shares:
            return columns
        rot_en = rotation_matrix(solution.state[7:11])
        place = [self._beacon.columns(axis, self._ago(observation)) for axis in rot_en.T[:2]]
        return np.hstack([columns, [*place, np.zeros_like(place[0])]])

    def _beacon_covariance(self, solution: Solution, own: OwnStates) -> Array:
        """Covariance of the beacon's place on n, shape (3, 3), m²."""
        if not self.shares:
            return np.zeros((3, 3))
        rot_en = rotation_matrix(solution.state[7:11])
        begin = len(self.states)
        covariance: Array = rot_en.T @ own.covariance[begin : begin + 3, begin : begin + 3] @ rot_en
        return covariance


def _simulated_ranges(world: World, p: SimulatedRanges, beacon: SimulatedBeacon, scale: float) -> RangeReadings:
    source = f"range.{beacon.name}"
    index = world.instants(p.rate, "range.rate")
    count, t = len(index), world.truth
    bias = p.bias + p.bias_stddev * float(world.stream(f"{source}.bias").standard_normal())
    here = t.position_e[index] + turned(t.q_eb[index], p.lever_arm)
    true = np.linalg.norm(here - beacon.states(t.time[index]).position_e, axis=1)
    noise = p.noise_stddev * world.stream(f"{source}.noise").standard_normal(count)
    distance = (1.0 + scale) * true + bias + noise
    wrong, size = world.outliers("range.outlier", p.outlier_share, p.outlier_span, source, count)
    sign = np.where(world.stream(f"{source}.outlier_sign").random(count) < _POSITIVE_OUTLIERS, 1.0, -1.0)
    distance = np.maximum(distance + np.where(wrong, sign * size, 0.0), 0.0)
    late = np.rint(true * (NS / p.delay_speed)).astype(np.int64) if p.delay_speed else 0
    heard = true <= p.max
    return RangeReadings(
        (world.stamps_ns[index] + late)[heard],
        distance[heard],
        p.noise_stddev,
        p.max,
        scale,
        bias,
        wrong[heard],
        beacon.exact(world, index[heard]),
        AcousticRange.MESSAGE_TYPES[0],
    )


def _place(beacon: str, values: Mapping[str, Value]) -> tuple[float, ...]:
    """Latitude and longitude, deg, and height, m, of a beacon by its parameters; NaN: not given."""
    place = []
    for key, _, _ in _PLACE:
        value = values[f"range.{beacon}.{key}"]
        assert isinstance(value, float)  # as checked values are
        place.append(value)
    return tuple(place)
