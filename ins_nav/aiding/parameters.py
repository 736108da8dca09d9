"""The whole table of parameters: the sections of `ins_nav.config.sections` and the aids."""

import math
import re
from collections.abc import Iterable, Mapping

from ins_nav.config.configuration import Configuration, section_rows
from ins_nav.config.parameters import NAN, Parameter, ParameterError


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


_AID_ROWS = (
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
)
_BEACON = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_PLACE = (
    ("latitude_deg", "latitude of the beacon, deg", 90.0),
    ("longitude_deg", "longitude of the beacon", 360.0),
    ("height", "its ellipsoidal height, m", 12e3),
)


def configuration(overrides: Mapping[str, object] | None = None) -> Configuration:
    """The configuration of a system from its parameters.

    Raises
    ------
    ParameterError
    """
    overrides = overrides or {}
    beacons = beacon_names(overrides.get("range.beacons", ""))
    for name in overrides:
        place = re.fullmatch(rf"range\.({_BEACON.pattern})\.({'|'.join(key for key, _, _ in _PLACE)})", name)
        if place and place[1] not in beacons:
            raise ParameterError(f"parameter {name}: {place[1]} is not in range.beacons")
    found = Configuration.from_overrides(overrides, aid_rows(beacons))
    for beacon in beacons:
        names = [f"range.{beacon}.{key}" for key, _, _ in _PLACE]
        given = [not math.isnan(float(found.values[name])) for name in names]  # type: ignore[arg-type]
        if any(given) and not all(given):
            raise ParameterError(f"{names[0]}, {names[1]} and {names[2]} go together: give all three or none")
    return found


def table(beacons: Iterable[str] = ()) -> list[Parameter]:
    """Every row, those of the beacons included."""
    return [*section_rows(), *aid_rows(beacons)]


def beacon_names(value: object) -> list[str]:
    """Names in ``range.beacons``.

    Raises
    ------
    ParameterError
        One cannot be part of a topic, is there twice, or is that of another parameter.
    """
    names = [name.strip() for name in str(value).split(",") if name.strip()]
    others = {row.name for row in _AID_ROWS}
    for name in names:
        if not _BEACON.fullmatch(name) or f"range.{name}" in others:
            raise ParameterError(f"parameter range.beacons: {name!r} cannot be the name of a beacon")
    if len(set(names)) < len(names):
        raise ParameterError(f"parameter range.beacons: a name is there twice in {value!r}")
    return names


def aid_rows(beacons: Iterable[str] = ()) -> list[Parameter]:
    """Rows of the aids, those of the beacons included."""
    places = [
        Parameter(f"range.{beacon}.{key}", NAN, f"{text}; not given: from beacon/{beacon}/fix", -limit, limit)
        for beacon in beacons
        for key, text, limit in _PLACE
    ]
    return [*_AID_ROWS, *places]
