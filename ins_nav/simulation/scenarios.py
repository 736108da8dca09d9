"""Named scenarios, each a motion with sensors; simulated by name, repeatable from a seed.

A scenario is a function from its parameters' values to a motion, decorated with the declarations of parameters::

    @scenario("Stands still.", {"roll_deg": Parameter(0.0, "deg", "roll"), "duration": 60.0})
    def static(p: Values) -> Motion: ...

A `Parameter` is one of this scenario only; a bare value is another default of a shared parameter, and of a sensor's
error it has priority over the preset.

References
----------
.. [1] E. S. Lobusov, A. V. Fomichev, "ZUPT mode for a strapdown INS of a ground vehicle", Vestnik MGTU, 2014, no. 6.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ins_nav.aiding.registry import aid_classes
from ins_nav.aiding.simulated import Fixes
from ins_nav.errors import InsNavError
from ins_nav.mechanization import attitude
from ins_nav.mechanization.earth import NO_WATER
from ins_nav.recordings.bags import suggestion
from ins_nav.simulation.aids import measure_aids
from ins_nav.simulation.missions import AUV_DIVE, auv_dive
from ins_nav.simulation.motion import Array, Motion, Route, Signal, constant, sinusoid, smooth_profile
from ins_nav.simulation.parameters import SHARED, Parameter, Values, resolved
from ins_nav.simulation.sensors import ImuErrors, Triple, measure_imu
from ins_nav.simulation.trajectory import EarthMotion, Origin, Trajectory
from ins_nav.simulation.waves import ROCKING, SWELL, rocking_signals

START_NS = 1_700_000_000 * 10**9
"""Stamp of a simulation's time 0."""

_SENSORS = ("imu.", *(f"{kind.SIMULATED[0]}." for kind in aid_classes() if kind.SIMULATED is not None))
MotionMaker = Callable[[Values], Motion]


@dataclass(frozen=True)
class Scenario:
    """A kind of motion and its parameters."""

    text: str
    parameters: dict[str, Parameter]
    motion: MotionMaker
    errors: Values
    """Sensor errors of the scenario, to which those of the preset are added."""
    under_water: bool = False
    """Below ``depth.surface_height`` is water."""


SCENARIOS: dict[str, Scenario] = {}


@dataclass(frozen=True)
class Simulation:
    """Trajectory and readings. Sample k of n covers the interval that ends at its stamp."""

    scenario: str
    seed: int
    parameters: dict[str, Any]
    trajectory: Trajectory
    """Truth at n + 1 instants: sample k belongs to instant k + 1."""
    start_ns: int
    """Stamp of instant 0."""
    stamps_ns: NDArray[np.int64]
    """(n,)."""
    angular_velocity: Array
    """(n, 3), measured, rad/s."""
    linear_acceleration: Array
    """(n, 3), measured specific force, m/s²."""
    errors: ImuErrors
    gyro_bias: Triple
    """Constant part of the gyros' bias, the random part included, rad/s."""
    accel_bias: Triple
    """The same of the accelerometers, m/s²."""
    aids: Mapping[str, Any]
    """Readings of aids by topic (`ins_nav.aiding.simulated.Readings`)."""

    @property
    def fixes(self) -> Fixes:
        """GNSS."""
        fixes: Fixes = self.aids["gnss/fix"]
        return fixes

    def redrawn(self, seed: int, **parameters: Any) -> "Simulation":
        """Draw all sensors' errors anew along the same trajectory: one run of a Monte Carlo study.

        Parameters
        ----------
        seed : int
            Not negative.
        **parameters
            Of the sensors, by name, to change besides; not ``imu.preset``.

        Raises
        ------
        InsNavError
            If a parameter is unknown, does not fit, or is not one of the sensors.
        """
        for name in parameters:
            if name == "imu.preset" or not name.startswith(_SENSORS):
                raise InsNavError(f"parameter {name} cannot change along a trajectory; simulate {self.scenario} anew")
        table = SCENARIOS[self.scenario].parameters
        return _measured(
            self.scenario, resolved(self.scenario, table, {**self.parameters, **parameters}), self.trajectory, seed
        )


def scenario(
    text: str, parameters: Mapping[str, Any], under_water: bool = False
) -> Callable[[MotionMaker], MotionMaker]:
    """Register the decorated function under its name."""

    def register(motion: MotionMaker) -> MotionMaker:
        own = {n: p if isinstance(p, Parameter) else replace(SHARED[n], default=p) for n, p in parameters.items()}
        every = own | {n: p for n, p in SHARED.items() if n not in own}
        errors = {n: own[n].default for n in (f"imu.{f.name}" for f in fields(ImuErrors)) if n in own}
        SCENARIOS[motion.__name__] = Scenario(text, every, motion, errors, under_water)
        return motion

    return register


def simulate(name: str, seed: int = 0, /, **parameters: Any) -> Simulation:
    """Simulate a scenario.

    Parameters
    ----------
    name : str
        Of the scenario.
    seed : int
        Of everything drawn, not negative. Both by position: the names are the scenario's.
    **parameters
        By name, in their own types or as text; names with a dot as ``**{"imu.preset": "mems"}``.

    Raises
    ------
    InsNavError
        If the scenario or a parameter is unknown, or a value does not fit.
    """
    if name not in SCENARIOS:
        raise InsNavError(f"no scenario {name!r}{suggestion(name, SCENARIOS)}")
    chosen = SCENARIOS[name]
    p = resolved(name, chosen.parameters, {**chosen.errors, **parameters})
    origin = Origin(math.radians(p["lat_deg"]), math.radians(p["lon_deg"]), p["height"])
    motion = chosen.motion(p)
    if round(motion.duration * p["rate"]) < 1:
        raise InsNavError(f"duration {motion.duration:g} s at rate {p['rate']:g} Hz has no sample; make it longer")
    surface = p["depth.surface_height"] if chosen.under_water else NO_WATER
    return _measured(name, p, EarthMotion(motion, origin, surface).trajectory(p["rate"]), seed)


def _measured(name: str, p: dict[str, Any], trajectory: Trajectory, seed: int) -> Simulation:
    stamps_ns = START_NS + np.rint(np.arange(len(trajectory.time)) * (1e9 / p["rate"])).astype(np.int64)
    imu = measure_imu(p, trajectory, seed)
    return Simulation(
        scenario=name,
        seed=seed,
        parameters=p,
        trajectory=trajectory,
        start_ns=START_NS,
        stamps_ns=stamps_ns[1:],
        angular_velocity=imu.angular_velocity,
        linear_acceleration=imu.linear_acceleration,
        errors=ImuErrors.of(p),
        gyro_bias=imu.gyro_bias,
        accel_bias=imu.accel_bias,
        aids=measure_aids(p, trajectory, stamps_ns, seed),
    )


def _yaw(p: Values) -> float:
    return attitude.heading_from_yaw(math.radians(p["heading_deg"]))


@scenario(
    "Stands still, at any attitude.",
    {
        "roll_deg": Parameter(0.0, "deg", "roll, right side down positive", -180.0, 180.0),
        "pitch_deg": Parameter(0.0, "deg", "pitch about the left axis, bow down positive", -90.0, 90.0),
    },
)
def static(p: Values) -> Motion:
    return Motion(
        p["duration"],
        yaw=constant(_yaw(p)),
        pitch=constant(math.radians(p["pitch_deg"])),
        roll=constant(math.radians(p["roll_deg"])),
    )


_ROCKING = ROCKING | {
    "duration": 900.0,
    "rate": 400.0,
    "imu.preset": "fog_auv",
    "rocking_time": Parameter(300.0, "s", "time of rocking; it settles within 5 s after that", 0.0),
}
_SWELL = (
    _ROCKING
    | SWELL
    | {
        "lat_deg": 55.7,
        "rocking_time": Parameter(900.0, "s", "time of rocking; it settles within 5 s after that", 0.0),
    }
)


@scenario("Rocks about a constant heading as on a bench, then stands still.", _ROCKING)
def rocking(p: Values) -> Motion:
    return _rocking(p, constant(_yaw(p)))


@scenario("Rocks in swell at the surface, heading kept: fine alignment with satellite position.", _SWELL)
def swell_alignment(p: Values) -> Motion:
    return _rocking(p, constant(_yaw(p)))


@scenario(
    "The same with a turn: two positions make gyro biases and heading observable together.",
    _SWELL
    | {
        "turn_start": Parameter(150.0, "s", "when the turn begins", 0.0),
        "turn_deg": Parameter(180.0, "deg", "angle of the turn, to the left"),
        "turn_time": Parameter(20.0, "s", "duration of the turn", 0.1),
    },
)
def swell_alignment_turn(p: Values) -> Motion:
    yaw = _yaw(p)
    turned = yaw + math.radians(p["turn_deg"])
    return _rocking(p, smooth_profile(yaw, [(p["turn_start"], p["turn_time"], turned)]))


def _rocking(p: Values, yaw: Signal) -> Motion:
    """Roll and pitch about the heading; surge and sway along the first heading."""
    waves = rocking_signals(p, smooth_profile(1.0, [(p["rocking_time"], 5.0, 0.0)]), _yaw(p))
    return Motion(p["duration"], yaw=yaw, roll=waves.roll, pitch=waves.pitch, x=waves.x, y=waves.y, z=waves.z)


_CITY: tuple[tuple[str, float, float], ...] = (
    ("reach", 12.0, 10.0),
    ("hold", 0.0, 25.0),
    ("reach", 6.0, 6.0),
    ("turn", 90.0, 8.0),
    ("reach", 15.0, 10.0),
    ("hold", 0.0, 20.0),
    ("reach", 0.0, 11.0),
    ("hold", 0.0, 20.0),
    ("reach", 10.0, 8.0),
    ("turn", -40.0, 7.0),
    ("hold", 0.0, 12.0),
    ("turn", 40.0, 7.0),
    ("reach", 6.0, 5.0),
    ("turn", -90.0, 8.0),
    ("reach", 14.0, 10.0),
    ("hold", 0.0, 25.0),
    ("reach", 0.0, 10.0),
    ("hold", 0.0, 30.0),
    ("reach", 5.0, 6.0),
    ("turn", 180.0, 14.0),
    ("reach", 13.0, 9.0),
    ("hold", 0.0, 18.0),
    ("reach", 6.0, 6.0),
    ("turn", 90.0, 8.0),
    ("reach", 0.0, 6.0),
    ("hold", 0.0, 15.0),
)
"""Action, new speed in m/s or angle in degrees, duration in s: some five minutes, three stops."""

_PITCH_PER_ACCELERATION = -0.01
_ROLL_PER_LATERAL_ACCELERATION = 0.01
"""How a car's body leans on its springs, rad per m/s²."""


@scenario(
    "A car stands, then drives through a city with turns and stops.",
    {
        "duration": 720.0,
        "stand_time": Parameter(120.0, "s", "time of standing at first", 0.0),
        "engine_amplitude": Parameter(0.0, "m", "amplitude of vibration up and down, all the time", 0.0),
        "engine_frequency": Parameter(25.0, "Hz", "frequency of that vibration", 0.1),
        "people_amplitude_deg": Parameter(
            0.0, "deg", "sway in roll and pitch by people, while it stands at first", 0.0
        ),
        "people_period": Parameter(2.3, "s", "period of that sway in roll; in pitch it is 0.7 of it", 0.1),
    },
)
def vehicle(p: Values) -> Motion:
    route = Route(_yaw(p))
    route.hold(p["stand_time"])
    _drive_through_city(route, p["duration"])
    speed, yaw = route.speed, route.yaw
    pitch, roll = _lean(speed, yaw)
    people = smooth_profile(math.radians(p["people_amplitude_deg"]), [(max(p["stand_time"] - 5.0, 0.0), 4.0, 0.0)])
    return Motion(
        p["duration"],
        speed=speed,
        yaw=yaw,
        pitch=pitch + people * sinusoid(1.0, 0.7 * p["people_period"]),
        roll=roll + people * sinusoid(1.0, p["people_period"]),
        z=sinusoid(p["engine_amplitude"], 1.0 / p["engine_frequency"]),
    )


def _drive_through_city(route: Route, until: float) -> None:
    while route.time < until:
        for action, value, duration in _CITY:
            if action == "reach":
                route.reach(value, duration)
            elif action == "turn":
                route.turn(math.radians(value), duration)
            else:
                route.hold(duration)


def _lean(speed: Signal, yaw: Signal) -> tuple[Signal, Signal]:
    """Pitch and roll of the body on its springs."""
    return (
        _PITCH_PER_ACCELERATION * speed.derivative(),
        _ROLL_PER_LATERAL_ACCELERATION * speed * yaw.derivative(),
    )


_DRIFT = math.degrees(1e-7) * 3600.0
_PAPER: dict[str, Any] = {
    "rate": 200.0,
    "lat_deg": 60.0,
    "heading_deg": 45.0,
    "imu.preset": "perfect",
    # on the paper's axes right, forward, up: 1e-7, -1e-7, 1e-7 rad/s
    "imu.gyro_bias_deg_per_hour": replace(
        SHARED["imu.gyro_bias_deg_per_hour"],
        default=(-_DRIFT, -_DRIFT, _DRIFT),
        text="drifts, 1e-7 rad/s; drifts by a preset are added",
    ),
}
"""Of the numerical example of [1]_."""


@scenario(
    "The ZUPT-2 run of Lobusov and Fomichev (2014): one stop, level or rocking, ideal sensors but for gyro drifts.",
    _PAPER
    | {
        "rocking_amplitude_deg": Parameter(
            0.0, "deg", "amplitude of roll and pitch, all the time; pitch a quarter of a period ahead", 0.0, 60.0
        ),
        "period": Parameter(11.0, "s", "period of roll and pitch", 0.1),
    },
)
def zupt2_stop(p: Values) -> Motion:
    amplitude = math.radians(p["rocking_amplitude_deg"])
    return Motion(
        p["duration"],
        yaw=constant(_yaw(p)),
        roll=sinusoid(amplitude, p["period"]),
        pitch=sinusoid(amplitude, p["period"], 0.5 * math.pi),
    )


_SHORT_DRIVE_SPEED = 5.0
_UNTILT_TIME = 10.0


@scenario(
    "ZUPT-1: a vehicle stands, turns, stands in a second position, then drives through a city.",
    _PAPER
    | {
        "duration": 720.0,
        "first_stop": Parameter(200.0, "s", "time of standing at first, self-alignment included", 0.0),
        "turn_deg": Parameter(180.0, "deg", "turn to the second position, counter-clockwise"),
        "turn_time": Parameter(20.0, "s", "duration of the turn", 0.1),
        "turn_radius": Parameter(5.0, "m", "radius of the turn, 0 for on the spot", 0.0),
        "drive_time": Parameter(
            0.0, "s", f"time of driving straight on after that, up to {_SHORT_DRIVE_SPEED:g} m/s", 0.0
        ),
        "second_stop": Parameter(200.0, "s", "time of standing in the second position", 0.0),
        "tilt_deg": Parameter(0.0, "deg", "pitch in the second position, bow down positive", -85.0, 85.0),
    },
)
def zupt1_two_positions(p: Values) -> Motion:
    turn = math.radians(p["turn_deg"])
    turning = (p["first_stop"], p["turn_time"])
    route = Route(_yaw(p))
    route.hold(p["first_stop"])
    route.turn(turn, p["turn_time"])
    if p["drive_time"]:
        third = p["drive_time"] / 3.0
        route.reach(_SHORT_DRIVE_SPEED, third)
        route.hold(third)
        route.reach(0.0, third)
    route.hold(p["second_stop"])
    leaves = route.time
    _drive_through_city(route, p["duration"])
    arc = smooth_profile(0.0, [(*turning, p["turn_radius"] * abs(turn))])
    speed, yaw = route.speed + arc.derivative(), route.yaw
    pitch, roll = _lean(speed, yaw)
    tilt = smooth_profile(0.0, [(*turning, math.radians(p["tilt_deg"])), (leaves, _UNTILT_TIME, 0.0)])
    return Motion(p["duration"], speed=speed, yaw=yaw, pitch=pitch + tilt, roll=roll)


scenario(
    "An underwater vehicle's mission: alignment in swell, surface leg, dive in parallel legs, surfacing.",
    AUV_DIVE,
    under_water=True,
)(auv_dive)
