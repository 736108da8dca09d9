"""All parameters of a system: checked and converted once, as typed sections."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, get_type_hints

from ins_nav.config.declaration import Section
from ins_nav.config.parameters import Parameter, Value, checked_values, present_overrides
from ins_nav.config.sections import (
    AidingSection,
    AlignmentSection,
    FramesSection,
    ImuSection,
    InitialSection,
    NavigationSection,
    PublishSection,
    StateFileSection,
    StopDetectorSection,
    StopSection,
    ZuptSection,
)

_DETECTOR = "the stop detector's default is used; stop.vibration and stop.sway_deg_per_s describe the vehicle"
_PATIENCE = "rejected measurements no longer override the filter after a time: the odds of a fault decide"
GONE: Mapping[str, str] = {
    "aiding.stops": "zupt.zero_velocity: false replaces zupt and none",
    "stop.window": _DETECTOR,
    "stop.min_duration": _DETECTOR,
    "stop.false_alarm_probability": _DETECTOR,
    "depth.patience": _PATIENCE,
    "gnss.patience": _PATIENCE,
    "gnss_velocity.patience": _PATIENCE,
    "heading.patience": _PATIENCE,
    "log.patience": _PATIENCE,
    "pressure.patience": _PATIENCE,
    "range.patience": _PATIENCE,
    "log.current_time": "3600 s is used; log.current_stddev describes the current",
}
"""Parameters that have become defaults of their class, each with its replacement."""


@dataclass(frozen=True)
class Configuration:
    """Every parameter of a system.

    Attributes
    ----------
    imu, initial, alignment, navigation, zupt, stop, stop_detector, aiding, publish, frames, state_file : Section
        In SI units and radians.
    rows : tuple of Parameter
        The whole table: those of the sections, then the others.
    values : mapping
        Checked values of ``rows`` by full name, in the units of the parameters.
    warnings : tuple of str
        One for each former name or value among the overrides.
    """

    imu: ImuSection
    initial: InitialSection
    alignment: AlignmentSection
    navigation: NavigationSection
    zupt: ZuptSection
    stop: StopSection
    stop_detector: StopDetectorSection
    aiding: AidingSection
    publish: PublishSection
    frames: FramesSection
    state_file: StateFileSection
    rows: tuple[Parameter, ...]
    values: Mapping[str, Value]
    warnings: tuple[str, ...]

    @classmethod
    def from_overrides(
        cls,
        overrides: Mapping[str, object] | None = None,
        others: Iterable[Parameter] = (),
        gone: Mapping[str, str] = GONE,
    ) -> Self:
        """The overrides, checked, over the defaults.

        Parameters
        ----------
        overrides : mapping, optional
            Values by full name, in the units of the parameters; former names are understood.
        others : iterable of Parameter
            Further rows of the table: those of aids.
        gone : mapping
            Names that are accepted without effect, each with what to do instead.

        Raises
        ------
        ParameterError
        """
        rows = grouped([*section_rows(), *others])
        present, warnings = present_overrides(overrides or {}, rows, gone)
        return cls._of(checked_values(present, rows), rows, warnings)

    def updated(self, overrides: Mapping[str, object]) -> Self:
        """A configuration with some other values, by present names.

        Raises
        ------
        ParameterError
        """
        checked = checked_values(overrides, self.rows)
        values = {name: checked[name] if name in overrides else value for name, value in self.values.items()}
        return self._of(values, self.rows, self.warnings)

    @classmethod
    def _of(cls, values: Mapping[str, Value], rows: Sequence[Parameter], warnings: Sequence[str]) -> Self:
        sections: dict[str, Any] = {name: kind.from_values(prefix, values) for name, prefix, kind in _sections()}
        return cls(**sections, rows=tuple(rows), values=values, warnings=tuple(warnings))


def section_rows() -> list[Parameter]:
    """Rows of the table that are not of aids."""
    return [row for _, prefix, kind in _sections() for row in kind.rows(prefix)]


def grouped(rows: Iterable[Parameter]) -> list[Parameter]:
    """The rows, those with the same prefix one after the other."""
    groups: dict[str, list[Parameter]] = {}
    for row in rows:
        groups.setdefault(row.name.rpartition(".")[0], []).append(row)
    return [row for group in groups.values() for row in group]


def _sections() -> Iterator[tuple[str, str, type[Section]]]:
    """Field, prefix of the parameters' names, type."""
    for name, kind in get_type_hints(Configuration).items():
        if isinstance(kind, type) and issubclass(kind, Section):
            yield name, "" if kind is StateFileSection else name, kind
