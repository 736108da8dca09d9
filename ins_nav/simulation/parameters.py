"""Parameters of a simulation: what there is to set, the defaults, the limits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ins_nav.errors import InsNavError
from ins_nav.recordings.bags import suggestion
from ins_nav.simulation.sensors import PRESETS, ImuErrors

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """Something to set: its type is that of the default (a number, several numbers, text).

    Several are as many as the default has; any number of them where ``many`` is set.
    """

    default: Any
    unit: str
    text: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    many: bool = False

    def value(self, name: str, given: Any) -> Any:
        """The given value in the right type; text, as of a command line, is converted.

        Raises
        ------
        InsNavError
            If it is of another type or beyond the limits.
        """
        try:
            if self.choices:
                if given not in self.choices:
                    raise ValueError
                return given
            if isinstance(self.default, str):
                return ", ".join(_items(given))
            if not isinstance(self.default, tuple):
                return self._number(given)
            items = [given] if self.many and isinstance(given, int | float) else _items(given)
            if len(items) != len(self.default) and not self.many:
                raise ValueError
            return tuple(self._number(item) for item in items)
        except (TypeError, ValueError):
            raise InsNavError(f"parameter {name}: {given!r} is not {self._expected()}") from None

    def _number(self, given: Any) -> float:
        number = float(given)
        if isinstance(given, bool) or not (math.isfinite(number) and self.low <= number <= self.high):
            raise ValueError
        return number

    def _expected(self) -> str:
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if isinstance(self.default, str):
            return f"text ({self.unit})"
        what = f"{len(self.default)} numbers [a, b, ...]" if isinstance(self.default, tuple) else "a number"
        if self.many:
            what = "a list of numbers [a, b, ...]"
        if math.isfinite(self.low):
            what += f", {self.low:g} to {self.high:g}" if math.isfinite(self.high) else f", {self.low:g} or more"
        return f"{what} ({self.unit})"


def _items(given: Any) -> list[Any]:
    if not isinstance(given, str):
        return list(given)
    text = given.strip("[]() ")
    return [item.strip() for item in text.split(",")] if text else []


_UNITS = {
    "_deg_per_hour_per_sqrt_hour": "deg/h/√h",
    "_deg_per_hour": "deg/h",
    "_deg_per_sqrt_hour": "deg/√h",
    "_ug_per_sqrt_hour": "µg/√h",
    "_ug_per_sqrt_hz": "µg/√Hz",
    "_ug": "µg",
    "_ppm": "ppm",
    "_arcsec": "arcsec",
    "_mm_per_s": "mm/s",
}
_SIGNED = ("bias_deg_per_hour", "bias_ug", "_scale_ppm", "_misalignment_arcsec")


def _imu_parameters() -> dict[str, Parameter]:
    parameters = {}
    for field in fields(ImuErrors):
        suffix = next(end for end in _UNITS if field.name.endswith(end))
        words = field.name.removesuffix(suffix).replace("_", " ")
        low = -math.inf if field.name.endswith(_SIGNED) else 0.0
        parameters[f"imu.{field.name}"] = Parameter(field.default, _UNITS[suffix], f"{words}, if not the preset's", low)
    return parameters


def _gauge_parameters(name: str, unit: str, stddev: float) -> dict[str, Parameter]:
    """Of a depth gauge or a pressure gauge."""
    return {
        f"{name}.rate": Parameter(0.0, "Hz", "readings a second, 0 for none", 0.0, 100.0),
        f"{name}.lever_arm": Parameter((0.0, 0.0, 0.0), "m", "gauge from the IMU: forward, left, up"),
        f"{name}.noise_stddev": Parameter(stddev, unit, "white noise", 0.0),
        f"{name}.bias": Parameter(0.0, unit, "what it reads too much"),
        f"{name}.bias_stddev": Parameter(0.0, unit, "the same, drawn once a run and added", 0.0),
        f"{name}.lie_start": Parameter(0.0, "s", "when it begins to lie", 0.0),
        f"{name}.lie_duration": Parameter(0.0, "s", "for how long, 0 for never", 0.0),
        f"{name}.lie_offset": Parameter(0.0, unit, "by how much"),
    }


_AIDS: dict[str, Parameter] = {
    "gnss.lost_depth": Parameter(1e5, "m", "no fixes while the antenna is deeper than this below the surface"),
    "gnss.velocity_rate": Parameter(0.0, "Hz", "velocities a second, 0 for none", 0.0, 100.0),
    "gnss.velocity_stddev": Parameter(0.05, "m/s", "noise of a velocity, each axis", 0.0),
    "log.rate": Parameter(0.0, "Hz", "readings a second, 0 for none", 0.0, 100.0),
    "log.mounting_rpy_deg": Parameter((0.0, 0.0, 0.0), "deg", "roll, pitch, yaw of the log's axes on the body's"),
    "log.lever_arm": Parameter((0.0, 0.0, 0.0), "m", "log from the IMU: forward, left, up"),
    "log.noise_stddev": Parameter(0.01, "m/s", "white noise, each axis", 0.0),
    "log.noise_per_speed": Parameter(0.0, "", "white noise besides, each axis, as a share of speed", 0.0, 1.0),
    "log.scale": Parameter(0.0, "", "scale error: it reads 1 + scale times the velocity", -0.5, 0.5),
    "log.scale_stddev": Parameter(0.0, "", "the same, drawn once a run and added", 0.0, 0.5),
    "log.misalignment_deg": Parameter(
        (0.0, 0.0), "deg", "angles a_y, a_z about its left and up axes: it reads (0, a_y, a_z) x v more", -45.0, 45.0
    ),
    "log.misalignment_stddev_deg": Parameter(0.0, "deg", "the same, drawn once a run and added, each", 0.0, 45.0),
    "log.current": Parameter((0.0, 0.0), "m/s", "current of the water it tracks, east, north; 0 on bottom track"),
    "log.current_stddev": Parameter(0.0, "m/s", "the same, drawn once a run and added, each", 0.0),
    "log.lost": Parameter(
        "nan", "", "what it gives while it has lost the bottom; silent: nothing", choices=("nan", "zeros", "silent")
    ),
    "log.lost_start": Parameter(0.0, "s", "when it loses the bottom", 0.0),
    "log.lost_duration": Parameter(0.0, "s", "for how long, 0 for never", 0.0),
    "log.lost_period": Parameter(0.0, "s", "and again after so long, 0 for once", 0.0),
    "log.outlier_share": Parameter(0.0, "", "share of readings off by a vector of any direction", 0.0, 1.0),
    "log.outlier_span": Parameter((0.5, 3.0), "m/s", "smallest and largest length of that vector", 0.0),
    "depth.surface_height": Parameter(0.0, "m", "ellipsoidal height of the water's mean surface"),
    **_gauge_parameters("depth", "m", 0.05),
    **_gauge_parameters("pressure", "Pa", 500.0),
    "pressure.density": Parameter(1025.0, "kg/m³", "of the water", 1.0),
    "pressure.surface": Parameter(101_325.0, "Pa", "at the surface", 0.0),
    "beacon.names": Parameter("", "", "names of the acoustic beacons, e.g. vessel, north"),
    "beacon.positions": Parameter(
        (), "m", "east, north of the origin, up from the water's surface: three a beacon", many=True
    ),
    "beacon.radii": Parameter(
        (0.0,), "m", "circle it goes about its position, 0: it stands; one a beacon, or one for all", 0.0, many=True
    ),
    "beacon.speed": Parameter(1.0, "m/s", "speed on that circle", 0.0),
    "beacon.fix_rates": Parameter(
        (0.0,), "Hz", "fixes it transmits a second; one a beacon, or one for all", 0.0, 100.0, many=True
    ),
    "beacon.fix_stddev": Parameter(0.5, "m", "noise of its fixes, each axis", 0.0),
    "range.rate": Parameter(0.0, "Hz", "ranges a second to each beacon, 0 for none", 0.0, 100.0),
    "range.lever_arm": Parameter((0.0, 0.0, 0.0), "m", "transducer from the IMU: forward, left, up"),
    "range.noise_stddev": Parameter(0.5, "m", "white noise", 0.0),
    "range.bias": Parameter(0.0, "m", "what is added to every range"),
    "range.bias_stddev": Parameter(0.0, "m", "the same, drawn once a run for each beacon and added", 0.0),
    "range.scale": Parameter(0.0, "", "error of the sound speed: ranges are 1 + scale times the distance", -0.5, 0.5),
    "range.scale_stddev": Parameter(0.0, "", "the same, drawn once a run and added", 0.0, 0.5),
    "range.outlier_share": Parameter(0.0, "", "share of ranges that are wrong: nine in ten too long", 0.0, 1.0),
    "range.outlier_span": Parameter((10.0, 300.0), "m", "by how much at least, and at most", 0.0),
    "range.max": Parameter(5000.0, "m", "no reply from beyond this distance", 0.0),
    "range.delay_speed": Parameter(
        0.0, "m/s", "stamps are late by distance over this: sound speed, the reply's way; 0: not late", 0.0
    ),
}
"""Absent by default, all but the GNSS."""

SHARED: dict[str, Parameter] = {
    "duration": Parameter(600.0, "s", "length of the recording", 0.1, 1e5),
    "rate": Parameter(200.0, "Hz", "rate of the IMU", 1.0, 10_000.0),
    "lat_deg": Parameter(55.7, "deg", "latitude of the origin", -90.0, 90.0),
    "lon_deg": Parameter(37.6, "deg", "longitude of the origin", -360.0, 360.0),
    "height": Parameter(150.0, "m", "ellipsoidal height of the origin", -11_000.0, 100_000.0),
    "heading_deg": Parameter(30.0, "deg", "heading at the start, clockwise from north"),
    "imu.preset": Parameter("navigation", "", "class of the sensors", choices=tuple(PRESETS)),
    "imu.sampling": Parameter(
        "averaged",
        "",
        "averaged: increment over the interval; instantaneous: value at the stamp",
        choices=("averaged", "instantaneous"),
    ),
    **_imu_parameters(),
    "gnss.rate": Parameter(1.0, "Hz", "fixes a second, 0 for none", 0.0, 100.0),
    "gnss.horizontal_stddev": Parameter(1.0, "m", "noise of a fix, east and north each", 0.0),
    "gnss.vertical_stddev": Parameter(1.5, "m", "noise of a fix, up", 0.0),
    "gnss.lever_arm": Parameter((0.0, 0.0, 0.0), "m", "antenna from the IMU: forward, left, up"),
    **_AIDS,
    "truth.rate": Parameter(50.0, "Hz", "rate of the truth topics, at most the IMU's", 0.001, 10_000.0),
}
"""Parameters of every scenario."""


def resolved(owner: str, parameters: Mapping[str, Parameter], given: Values) -> dict[str, Any]:
    """Value of every parameter: those given, checked, else the defaults, those of the IMU from its preset.

    Raises
    ------
    InsNavError
        If a given name is unknown or a value does not fit.
    """
    for name in given:
        if name not in parameters:
            raise InsNavError(f"{owner} has no parameter {name!r}{suggestion(name, parameters)}")
    values = {name: parameter.default for name, parameter in parameters.items()}
    values |= {name: parameters[name].value(name, value) for name, value in given.items()}
    preset = PRESETS[values["imu.preset"]]
    return values | {
        f"imu.{f.name}": getattr(preset, f.name) for f in fields(ImuErrors) if f"imu.{f.name}" not in given
    }
