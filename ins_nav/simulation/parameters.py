"""Parameters of a simulation: names, defaults, limits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ins_nav.aiding.registry import aid_classes
from ins_nav.config.parameters import Parameter as Row
from ins_nav.errors import InsNavError
from ins_nav.recordings.bags import suggestion
from ins_nav.simulation.sensors import PRESETS, ImuErrors

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """A parameter; its type is that of the default (a number, several numbers, text).

    Several numbers are as many as in the default; any number of them where ``many`` is set.
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
            return "text"
        what = f"{len(self.default)} numbers [a, b, ...]" if isinstance(self.default, tuple) else "a number"
        if self.many:
            what = "a list of numbers [a, b, ...]"
        if math.isfinite(self.low):
            what += f", {self.low:g} to {self.high:g}" if math.isfinite(self.high) else f", {self.low:g} or more"
        return f"{what} ({self.unit})" if self.unit else what


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


def _aid_parameters() -> dict[str, Parameter]:
    """Parameters that aids declare for their simulated readings."""
    parameters: dict[str, Parameter] = {}
    for kind in aid_classes():
        if kind.SIMULATED is not None:
            prefix, section = kind.SIMULATED
            parameters |= {row.name: _of_row(row) for row in section.rows(prefix)}
    return parameters


def _of_row(row: Row) -> Parameter:
    """A default list of at most one number allows any number of them."""
    default: Any = tuple(row.default) if isinstance(row.default, list) else row.default
    many = isinstance(default, tuple) and len(default) < 2
    return Parameter(default, "", row.description, row.low, row.high, row.choices, many)


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
    **_aid_parameters(),
    "truth.rate": Parameter(50.0, "Hz", "rate of the truth topics, at most the IMU's", 0.001, 10_000.0),
}
"""Parameters of every scenario."""


def resolved(owner: str, parameters: Mapping[str, Parameter], given: Values) -> dict[str, Any]:
    """Value of every parameter: given values, checked, else defaults; those of the IMU come from its preset.

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
