"""Parameters: one table for nodes and `ins_process`; names, defaults, ranges, meaning.

Files are ROS 2 parameter YAML (``/**: ros__parameters:``). Values are checked once, when read; a name that is not
in the table is an error with the nearest one suggested. A NaN default means "not given".
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ins_nav.errors import InsNavError

NAN = math.nan
Value = bool | int | float | str | list[float]


class ParameterError(InsNavError):
    """A parameter is unknown, of the wrong type or out of range; the text names it, its value and what is allowed."""


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes
    ----------
    name, default, description
    low, high : float
        Inclusive range of a number.
    choices : tuple of str
        Allowed values of a string; empty for any.
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()

    def checked(self, value: object) -> Value:
        """The value in the type of the default.

        Raises
        ------
        ParameterError
        """
        default = self.default
        if isinstance(default, bool):
            if isinstance(value, bool):
                return value
            raise ParameterError(f"parameter {self.name}: {value!r} is not true or false")
        if isinstance(default, float):
            return self._number(value)
        if isinstance(default, list):
            if isinstance(value, Iterable) and not isinstance(value, str | bytes):
                numbers = [self._number(item) for item in value]
                if len(numbers) == len(default):
                    return numbers
            raise ParameterError(f"parameter {self.name}: {value!r} is not a list of {len(default)} numbers")
        if not isinstance(value, str):
            raise ParameterError(f"parameter {self.name}: {value!r} is not a string")
        if self.choices and value not in self.choices:
            raise ParameterError(f"parameter {self.name}: {value!r} is not one of {', '.join(self.choices)}")
        return value

    def _number(self, value: object) -> float:
        try:
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise ValueError
            number = float(value)  # text too: YAML 1.1 reads 1e-3 as such
        except ValueError:
            raise ParameterError(f"parameter {self.name}: {value!r} is not a number") from None
        if math.isnan(number) and isinstance(self.default, float) and math.isnan(self.default):
            return number
        if not math.isfinite(number):
            raise ParameterError(f"parameter {self.name}: {number:g} is not allowed")
        if not self.low <= number <= self.high:
            raise ParameterError(f"parameter {self.name}: {number:g} is outside [{self.low:g}, {self.high:g}]")
        return number


def _aid(
    name: str, topic: str, stddev: float, least: float, unit: str, where: str, patience: float
) -> tuple[Parameter, ...]:
    """What every aid has."""
    return (
        Parameter(f"{name}.enabled", True, f"use {topic}"),
        Parameter(f"{name}.default_stddev", stddev, f"of a message without covariance, each axis, {unit}", 1e-6),
        Parameter(f"{name}.min_stddev", least, f"no covariance is believed below this, {unit}", 1e-6),
        Parameter(f"{name}.lever_arm", [0.0, 0.0, 0.0], f"{where} from the IMU, base_link's axes, m", -1e3, 1e3),
        Parameter(f"{name}.delay", 0.0, "how long before its stamp it was measured, s", -1.0, 10.0),
        Parameter(f"{name}.gate", 1e-4, "probability with which a good measurement is rejected", 1e-12, 0.5),
        Parameter(
            f"{name}.patience",
            patience,
            "after so long without an accepted message 8 rejected ones that agree are believed, s; 0: never",
            0.0,
        ),
    )


PARAMETERS = (
    Parameter(
        "imu.sampling",
        "averaged",
        "what a sample is: the mean over the interval it ends (increment / interval), or the value at its stamp",
        choices=("averaged", "instantaneous"),
    ),
    Parameter(
        "imu.mounting_rpy_deg",
        [0.0, 0.0, 0.0],
        "roll, pitch, yaw of the IMU's axes in base_link, deg",
        -360.0,
        360.0,
    ),
    Parameter("imu.gyro_bias_deg_per_hour", [0.0, 0.0, 0.0], "known gyro biases on base_link's axes, deg/h"),
    Parameter("imu.accel_bias_mg", [0.0, 0.0, 0.0], "known accelerometer biases on base_link's axes, 1e-3 g"),
    Parameter(
        "imu.gyro_bias_stddev_deg_per_hour",
        0.01,
        "uncertainty of the gyro biases, deg/h; alignment cannot see the east one: it adds to the heading's sigma",
        0.0,
    ),
    Parameter(
        "imu.gyro_bias_walk_deg_per_hour_per_sqrt_hour",
        0.003,
        "random walk of the gyro biases: their change in an hour, deg/h; how soon a ZUPT is out of date",
        0.0,
    ),
    Parameter(
        "imu.accel_bias_walk_mg_per_sqrt_hour",
        0.01,
        "random walk of the accelerometer biases: their change in an hour, 1e-3 g",
        0.0,
    ),
    Parameter("imu.accel_bias_stddev_mg", 0.05, "uncertainty of the accelerometer biases, 1e-3 g", 0.0),
    Parameter(
        "imu.gyro_noise_deg_per_sqrt_hour",
        NAN,
        "white noise of the gyros; not given: learnt at rest. Needed where it exceeds stop.sway_deg_per_s",
        0.0,
        100.0,
    ),
    Parameter(
        "imu.accel_noise_ug_per_sqrt_hz",
        NAN,
        "white noise of the accelerometers; not given: learnt at rest. Needed where it exceeds stop.vibration",
        0.0,
        1e5,
    ),
    Parameter(
        "imu.max_angular_velocity", 35.0, "samples with a faster rate are rejected, rad/s (35 is 2000 deg/s)", 0.1
    ),
    Parameter("imu.max_linear_acceleration", 400.0, "samples with a larger specific force are rejected, m/s^2", 20.0),
    Parameter("imu.max_gap", 10.0, "a longer gap in the stamps restarts alignment, s; shorter ones are bridged", 0.1),
    Parameter("initial.latitude_deg", NAN, "latitude of the start; not given: from the first valid gnss/fix", -90, 90),
    Parameter("initial.longitude_deg", NAN, "longitude of the start", -360.0, 360.0),
    Parameter("initial.height", NAN, "ellipsoidal height of the start, m", -12e3, 1e6),
    Parameter("initial.position_stddev", 1.0, "uncertainty of that place, each axis, m", 0.0, 1e6),
    Parameter(
        "initial.heading_deg", NAN, "heading at rest, clockwise from north; given: only the level is sought", -360, 360
    ),
    Parameter("initial.heading_stddev_deg", 1.0, "uncertainty of that heading, deg", 0.0, 180.0),
    Parameter("alignment.duration", 60.0, "length of coarse alignment when the heading is sought, s", 5.0, 3600.0),
    Parameter("alignment.level_duration", 5.0, "length of alignment when the heading is given, s", 2.0, 3600.0),
    Parameter(
        "alignment.max_speed", 2.0, "a base that goes faster than this while aligning has moved off, m/s", 0.01, 100.0
    ),
    Parameter(
        "alignment.fine_heading_deg",
        0.0,
        "fine alignment (alignment_node) ends when the heading's sigma is below this, deg; 0: only by time",
        0.0,
        180.0,
    ),
    Parameter("alignment.fine_duration", 300.0, "or after this time since the first sample, s", 0.0, 86400.0),
    Parameter(
        "navigation.vertical_channel",
        False,
        "integrate the vertical acceleration too: unstable, for short runs only; otherwise height stays",
    ),
    Parameter(
        "zupt.zero_velocity",
        True,
        "correct velocity, and position as far as it follows, at every stop; false for a base that may drift unfelt",
    ),
    Parameter("zupt.max_rocking_deg", 10.0, "the ZUPT services refuse a base whose tilt varies more, RMS, deg", 0.0),
    Parameter("stop.window", 1.0, "length of the window over which a base must not shake, s", 0.3, 5.0),
    Parameter("stop.min_duration", 2.0, "a stop is declared after standing still for so long, s", 0.3, 10.0),
    Parameter(
        "stop.max_speed",
        0.1,
        "a base travels when it is faster on the mean of a window, m/s; swell may stay below",
        0.02,
        2.0,
    ),
    Parameter(
        "stop.vibration",
        0.02,
        "what an idling engine adds to specific force, 0.1 s means, standard deviation an axis, m/s^2",
        1e-4,
        1.0,
    ),
    Parameter("stop.sway_deg_per_s", 0.06, "what it adds to angular rate, deg/s", 1e-4, 10.0),
    Parameter(
        "stop.false_alarm_probability", 1e-3, "share of windows at rest that may be taken for shaking", 1e-9, 0.1
    ),
    Parameter(
        "stop_detector.start_sequence",
        "zupt1",
        "zupt1: call it until it has succeeded at two stops, then zupt2; zupt2: from the first stop on; none: from "
        "the second; never: for a base that may drift unfelt",
        choices=("zupt1", "zupt2", "none", "never"),
    ),
    Parameter(
        "stop_detector.zupt1_after",
        20.0,
        "length of a stop at which ins_node/zupt1 is called, s; again after as long, until it succeeds",
        1.0,
        3600.0,
    ),
    Parameter(
        "stop_detector.zupt2_after",
        20.0,
        "length of a stop at which ins_node/zupt2 is called, s; again whenever the length has doubled, or after as "
        "long when it was refused",
        1.0,
        3600.0,
    ),
    Parameter(
        "aiding.max_delay",
        2.2,
        "messages of aids that come later than this after their stamp are left out, s",
        2.2,
        8.0,
    ),
    Parameter(
        "aiding.feedback_time",
        1.0,
        "after so long what the filter has found takes effect in ins_node, s of data: what its way there may take and "
        "finding it; at N times real time that is N times as much data",
        0.2,
        3.0,
    ),
    Parameter("aiding.until_aligned", False, "use aids for fine alignment only, then navigate free inertial"),
    Parameter("aiding.height_walk", 0.3, "random walk of height where no vertical channel carries it, m/√s", 0.0, 10.0),
    Parameter(
        "aiding.stops",
        "updates",
        "what the filter takes from stops: updates: zero velocity each second and the run-off of yaw; zupt: what ZUPT "
        "calls measure, and zero velocity with them; none",
        choices=("updates", "zupt", "none"),
    ),
    Parameter("aiding.stop_velocity_stddev", 0.02, "of the mean velocity over a second of a stop, m/s", 1e-4, 1.0),
    *_aid("gnss", "gnss/fix", 3.0, 0.01, "m", "antenna", 60.0),
    Parameter("gnss.slow_stddev", 0.0, "besides, an error that changes slowly, each axis, m; 0: none", 0.0, 1e3),
    Parameter("gnss.slow_time", 60.0, "its correlation time, s", 1.0, 1e5),
    *_aid("gnss_velocity", "gnss/velocity", 0.2, 0.01, "m/s", "antenna", 60.0),
    *_aid("log", "log", 0.2, 0.005, "m/s", "log", 180.0),
    Parameter(
        "log.mounting_rpy_deg", [0.0, 0.0, 0.0], "roll, pitch, yaw of the log's axes in base_link, deg", -360, 360
    ),
    Parameter("log.max_speed", 100.0, "a message with more on an axis is left out, m/s", 0.1, 1e4),
    Parameter("log.scale", 0.0, "known error of its scale factor: 0.01 where it reads 1 % too much", -0.5, 0.5),
    Parameter("log.scale_stddev", 0.01, "uncertainty of that", 0.0, 1.0),
    Parameter("log.pitch_deg", 0.0, "known error of mounting_rpy_deg about its y axis, deg", -45.0, 45.0),
    Parameter("log.yaw_deg", 0.0, "the same about its z axis, deg", -45.0, 45.0),
    Parameter("log.misalignment_stddev_deg", 0.5, "uncertainty of these angles, each, deg", 0.0, 45.0),
    Parameter("log.slow_stddev", 0.0, "besides, an error that changes slowly, each axis, m/s; 0: none", 0.0, 10.0),
    Parameter("log.slow_time", 30.0, "its correlation time, s", 0.01, 1e5),
    Parameter("log.water_track", False, "it measures velocity through water: the current is estimated"),
    Parameter("log.current_stddev", 0.3, "of that current, east and north each, m/s", 1e-3, 10.0),
    Parameter("log.current_time", 3600.0, "its correlation time, s", 1.0, 1e6),
    *_aid("depth", "depth", 0.1, 0.005, "m", "depth gauge", 180.0),
    Parameter(
        "depth.surface_height",
        NAN,
        "ellipsoidal height of the water's surface, m; not given: found, from height and depth together",
        -500.0,
        9000.0,
    ),
    Parameter("depth.surface_stddev", 0.0, "uncertainty of that height where it is given, m", 0.0, 1e3),
    *_aid("pressure", "pressure", 1000.0, 10.0, "Pa", "pressure gauge", 180.0),
    Parameter("pressure.surface_pressure", 101325.0, "pressure of the air at the surface, Pa", 0.0, 2e5),
    Parameter("pressure.density", 1025.0, "of the water, mean from the surface to the gauge, kg/m^3", 500.0, 2000.0),
    *_aid("range", "range/<beacon>", 1.0, 0.01, "m", "transducer", 600.0),
    Parameter(
        "range.beacons",
        "",
        "names of acoustic beacons, separated by commas. The place of each is range.<beacon>.latitude_deg, .longitude_"
        "deg and .height; where these are not given it comes on beacon/<beacon>/fix",
    ),
    Parameter("range.scale_stddev", 0.0, "relative error of the speed of sound; 0: none", 0.0, 0.2),
    Parameter("range.bias_stddev", 0.0, "constant error of a beacon's ranges, m; 0: none", 0.0, 1e3),
    Parameter("range.sound_speed", 1500.0, "for the time that sound travels, m/s", 300.0, 7000.0),
    Parameter(
        "range.two_way",
        False,
        "the vehicle asks and the beacon answers, so a range is of the middle of that time; false: of its end",
    ),
    Parameter(
        "range.beacon_speed",
        1.0,
        "standard deviation of each component of the velocity of a beacon that floats, m/s",
        0.0,
        30.0,
    ),
    Parameter(
        "state_file",
        "",
        "file of biases, the log's calibration and the last pose: taken up at the start where it is there, written by "
        "ins_node/save",
    ),
    Parameter("publish.rate", 0.0, "odometry, imu/data and fix a second; 0: one for every IMU sample", 0.0, 2000.0),
    Parameter("publish.tf", False, "publish map -> base_link on /tf too (needs tf2_msgs)"),
    Parameter("map_frame", "map", "frame_id of odometry: east-north-up at the start"),
    Parameter("base_link_frame", "base_link", "frame_id of the body"),
)
ROS_OWN = ("use_sim_time", "start_type_description_service")
"""Parameters every ROS node has: no concern of this table."""
_BEACON = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_PLACE = (
    ("latitude_deg", "latitude of the beacon, deg", 90.0),
    ("longitude_deg", "longitude of the beacon", 360.0),
    ("height", "its ellipsoidal height, m", 12e3),
)


def default_values() -> dict[str, Value]:
    """Every parameter at its default."""
    return {parameter.name: parameter.default for parameter in PARAMETERS}


def beacon_names(value: object) -> list[str]:
    """Names in ``range.beacons``.

    Raises
    ------
    ParameterError
        One cannot be part of a topic, is there twice, or is that of another parameter.
    """
    names = [name.strip() for name in str(value).split(",") if name.strip()]
    taken = {parameter.name for parameter in PARAMETERS}
    for name in names:
        if not _BEACON.fullmatch(name) or f"range.{name}" in taken:
            raise ParameterError(f"parameter range.beacons: {name!r} cannot be the name of a beacon")
    if len(set(names)) < len(names):
        raise ParameterError(f"parameter range.beacons: a name is there twice in {value!r}")
    return names


def table(beacons: Iterable[str]) -> list[Parameter]:
    """Every row, those of the beacons included."""
    places = [
        Parameter(f"range.{beacon}.{key}", NAN, f"{text}; not given: from beacon/{beacon}/fix", -limit, limit)
        for beacon in beacons
        for key, text, limit in _PLACE
    ]
    return [*PARAMETERS, *places]


def checked_values(overrides: Mapping[str, object]) -> dict[str, Value]:
    """Every parameter: the overrides, checked, over the defaults.

    Raises
    ------
    ParameterError
    """
    beacons = beacon_names(overrides.get("range.beacons", ""))
    rows = {parameter.name: parameter for parameter in table(beacons)}
    values = {name: parameter.default for name, parameter in rows.items()}
    for name, value in overrides.items():
        values[name] = _known(name, rows).checked(value)
    for owner in ("initial", *(f"range.{beacon}" for beacon in beacons)):
        names = [f"{owner}.{key}" for key, _, _ in _PLACE]
        given = [not math.isnan(values[name]) for name in names]  # type: ignore[arg-type]
        if any(given) and not all(given):
            raise ParameterError(f"{names[0]}, {names[1]} and {names[2]} go together: give all three or none")
    return values


def _known(name: str, rows: Mapping[str, Parameter]) -> Parameter:
    """The row of that name, or an error with the nearest one."""
    if name in rows:
        return rows[name]
    place = re.fullmatch(rf"range\.({_BEACON.pattern})\.({'|'.join(key for key, _, _ in _PLACE)})", name)
    if place:
        raise ParameterError(f"parameter {name}: {place[1]} is not in range.beacons")
    near = difflib.get_close_matches(name, rows, n=1, cutoff=0.5)
    hint = f": did you mean {near[0]}?" if near else f"; known: {', '.join(rows)}"
    raise ParameterError(f"unknown parameter {name}{hint}")


def read_file(path: str | Path, *nodes: str) -> dict[str, object]:
    """Overrides for nodes from a ROS 2 parameter file: sections ``/**``, then ``/node`` or ``node`` of each, in order.

    Raises
    ------
    ParameterError
        The file cannot be read, has no such shape, or no section for these nodes.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"parameter file {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"parameter file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise ParameterError(f"parameter file {path} has no sections: begin with '/**: ros__parameters:'")
    overrides: dict[str, object] = {}
    sections = ["/**", *(name for node in nodes for name in (f"/{node}", node))]
    if not any(section in content for section in sections):
        found = ", ".join(map(str, content))
        raise ParameterError(f"parameter file {path} has sections {found}, but none of {', '.join(sections)}")
    for section in sections:
        if section in content:
            body = content[section]
            if not isinstance(body, dict) or not isinstance(body.get("ros__parameters"), dict):
                raise ParameterError(f"parameter file {path}: no ros__parameters under {section}")
            overrides |= _flat(body["ros__parameters"])
    return {name: value for name, value in overrides.items() if name not in ROS_OWN}


def parse_assignment(text: str) -> tuple[str, Any]:
    """Name and value of ``name:=value``, the value read as YAML.

    Raises
    ------
    ParameterError
    """
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise ParameterError(f"{text!r} is not name:=value")
    try:
        return name, yaml.safe_load(value)
    except yaml.YAMLError:
        raise ParameterError(f"parameter {name}: {value!r} is not YAML; a list is written [1, 2, 3]") from None


def _flat(tree: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{name}.")
        else:
            flat[name] = value
    return flat
