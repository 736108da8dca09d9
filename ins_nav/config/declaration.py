"""Declaration of parameters as fields of typed sections: name, unit, range and text in one place.

A section is a frozen dataclass with fields by `parameter`. It declares everything about its parameters: the rows of
the table (`Section.rows`), from which ROS declarations, YAML and documentation are generated, and the values in SI
units and radians (`Section.from_values`), converted here and nowhere else::

    @dataclass(frozen=True)
    class Imu(Section):
        max_gap: float = parameter(10.0, "a longer gap restarts alignment", unit="s", low=0.1)
        drift: float = parameter(0.01, "of the gyros", name="drift_deg_per_hour", unit="deg/h", scale=DEG_PER_HOUR)

    Imu.rows("imu")  # Parameter("imu.max_gap", ...), Parameter("imu.drift_deg_per_hour", ...)
    Imu.from_values("imu", values)  # Imu(max_gap=10.0, drift=4.8e-8)
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from ins_nav.config.parameters import Parameter, Value

DEG = math.radians(1.0)
"""rad."""
ARCSEC = DEG / 3600.0
"""rad."""
DEG_PER_HOUR = DEG / 3600.0
"""rad/s."""
DEG_PER_SQRT_HOUR = DEG / 60.0
"""rad/√s."""
MILLI_G = 9.80665e-3
"""m/s²."""
MICRO_G = 1e-3 * MILLI_G
"""m/s²; as a noise density 1 µg/√Hz, m/s/√s."""
_KEY = "ins_nav parameter"


@dataclass(frozen=True)
class _Declared:
    """Declaration in a field's metadata."""

    name: str
    default: Value
    description: str
    low: float
    high: float
    choices: tuple[str, ...]
    scale: float
    former: str
    former_values: tuple[tuple[bool, str], ...]


def parameter(
    default: Value,
    description: str,
    *,
    name: str = "",
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
    scale: float = 1.0,
    former: str = "",
    former_values: tuple[tuple[bool, str], ...] = (),
) -> Any:
    """A field of a `Section`.

    Parameters
    ----------
    default : Value
        In the unit of the parameter; a list becomes a tuple in the section; NaN: not given.
    description : str
        One phrase for YAML, ``ros2 param describe`` and documentation.
    name : str
        Of the parameter where it is not the field's: with its unit, where that is not SI.
    unit : str
        For people; appended to the first clause of the description.
    low, high : float
        Inclusive range, in the unit of the parameter.
    choices : tuple of str
        Allowed values of a string.
    scale : float
        SI value of one unit of the parameter.
    former : str
        Former full name, understood with a warning.
    former_values : tuple of (bool, str)
        Former values of a string, understood with a warning, and those that replace them.
    """
    clause, separator, rest = description.partition(";")
    text = f"{clause}, {unit}{separator}{rest}" if unit else description
    declared = _Declared(name, default, text, low, high, choices, scale, former, former_values)
    return dataclasses.field(default=_si(default, scale), metadata={_KEY: declared})


@dataclass(frozen=True)
class Section:
    """Base of the sections."""

    @classmethod
    def rows(cls, prefix: str) -> list[Parameter]:
        """Rows of the table, in the order of the fields.

        Parameters
        ----------
        prefix : str
            Of the names, without the dot; empty for none.
        """
        return [
            Parameter(
                _joined(prefix, name),
                row.default,
                row.description,
                row.low,
                row.high,
                row.choices,
                row.former,
                row.former_values,
            )
            for name, row, _ in cls._declared()
        ]

    @classmethod
    def from_values(cls, prefix: str, values: Mapping[str, Value]) -> Self:
        """The section, its values in SI units; ``values`` are checked values by full name."""
        fields = {field: _si(values[_joined(prefix, name)], row.scale) for name, row, field in cls._declared()}
        return cls(**fields)

    @classmethod
    def overrides(cls, prefix: str, **fields: Any) -> dict[str, Value]:
        """Overrides by full name, in the units of the parameters, from values of fields in SI units."""
        rows = {field: (_joined(prefix, name), row.scale) for name, row, field in cls._declared()}
        return {rows[field][0]: _in_unit(value, rows[field][1]) for field, value in fields.items()}

    @classmethod
    def _declared(cls) -> Sequence[tuple[str, _Declared, str]]:
        """Parameter name, declaration, field name."""
        rows = [(field.metadata[_KEY], field.name) for field in dataclasses.fields(cls) if _KEY in field.metadata]
        return [(row.name or field, row, field) for row, field in rows]


def _joined(prefix: str, name: str) -> str:
    return f"{prefix}.{name}" if prefix else name


def _si(value: Value, scale: float) -> Any:
    if isinstance(value, list):
        return tuple(scale * float(x) for x in value)
    return value if isinstance(value, bool | str) else scale * float(value)


def _in_unit(value: Any, scale: float) -> Value:
    if isinstance(value, bool | str):
        return value
    return [float(x) / scale for x in value] if isinstance(value, Iterable) else float(value) / scale
