"""Parameters: rows of a table, checking against it, and files.

Files are ROS 2 parameter YAML (``/**: ros__parameters:``). Values are checked once, when read; a name that is not
in the table is an error with the nearest one suggested. A NaN default means "not given".
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ins_nav.errors import InsNavError

NAN = math.nan
Value = bool | float | str | list[float]


class ParameterError(InsNavError):
    """A parameter is unknown, of the wrong type or out of range; the text names it, its value and the allowed ones."""


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
    former : str
        Former name, understood with a warning; empty for none.
    former_values : tuple of (bool, str)
        Former values of a string, understood with a warning, and those that replace them.
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    former: str = ""
    former_values: tuple[tuple[bool, str], ...] = ()

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

    def present(self, value: object) -> object:
        """The value that replaces a former one; any other as it is."""
        for former, now in self.former_values:
            if value is former:
                return now
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


_ROS_NAMES = ("use_sim_time", "start_type_description_service")
"""Parameters every ROS node has, besides those that begin with ``qos_overrides.``."""


def without_ros(overrides: Mapping[str, object]) -> dict[str, object]:
    """The overrides without those of the parameters that every ROS node has."""
    return {
        name: value
        for name, value in overrides.items()
        if name not in _ROS_NAMES and not name.startswith("qos_overrides.")
    }


def present_overrides(
    overrides: Mapping[str, object], rows: Iterable[Parameter], gone: Mapping[str, str]
) -> tuple[dict[str, object], list[str]]:
    """Overrides by present names and values, and a warning for each former one.

    Parameters
    ----------
    overrides : mapping
    rows : iterable of Parameter
        The table, with its former names and values.
    gone : mapping
        Names without effect, each with what to do instead.
    """
    present = {name: value for name, value in overrides.items() if name not in gone}
    warnings = [f"parameter {name} has no effect any more: {gone[name]}" for name in overrides if name in gone]
    for row in rows:
        if row.former in present:
            value = present.pop(row.former)
            warnings.append(f"parameter {row.former} is {row.name} now")
            if row.name in present:
                warnings[-1] += ", which is given too: its value is used"
            else:
                present[row.name] = value
        if row.name in present:
            value = present[row.name]
            present[row.name] = row.present(value)
            if present[row.name] is not value:
                warnings.append(f"parameter {row.name}: {str(value).lower()} is {present[row.name]} now")
    return present, warnings


def checked_values(overrides: Mapping[str, object], rows: Iterable[Parameter]) -> dict[str, Value]:
    """Every parameter of a table: the overrides, checked, over the defaults.

    Raises
    ------
    ParameterError
    """
    table = {row.name: row for row in rows}
    values = {name: row.default for name, row in table.items()}
    for name, value in overrides.items():
        if name not in table:
            near = difflib.get_close_matches(name, table, n=1, cutoff=0.5)
            hint = f": did you mean {near[0]}?" if near else f"; known: {', '.join(table)}"
            raise ParameterError(f"unknown parameter {name}{hint}")
        values[name] = table[name].checked(value)
    return values


def read_file(path: str | Path, *nodes: str, namespace: str | None = None) -> dict[str, object]:
    """Overrides for nodes from a ROS 2 parameter file, those for a later node over those for an earlier one.

    Sections are applied as rcl does: all that match the node's full name, in the order of the file. ``*`` stands for
    one part of a name, ``**`` for any number of them.

    Parameters
    ----------
    path : str or Path
    *nodes : str
        Names in the namespace; one with a leading slash is a full name.
    namespace : str, optional
        Default: the one that the file's sections for these nodes are of; the root where there is none.

    Raises
    ------
    ParameterError
        The file cannot be read, has no such shape, no section for these nodes, or sections for several namespaces.
    """
    sections = list(_sections(path))
    names = [name for name, _ in sections]
    if namespace is None:
        namespace = _namespace(path, names, nodes)
    prefix = namespace.rstrip("/")
    full_names = [node if node.startswith("/") else f"{prefix}/{node}" for node in nodes] or [""]
    overrides: dict[str, object] = {}
    found = False
    for full_name in full_names:
        for name, content in sections:
            if _pattern(name).fullmatch(full_name):
                found = True
                overrides |= content
    if not found:
        wanted = " or ".join(full_names) or "every node (/**)"
        raise ParameterError(f"parameter file {path} has sections {', '.join(names)}, but none for {wanted}")
    return without_ros(overrides)


def _sections(path: str | Path) -> Iterator[tuple[str, dict[str, object]]]:
    """Sections: name with a leading slash, and values."""
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"parameter file {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"parameter file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise ParameterError(f"parameter file {path} has no sections: begin with '/**: ros__parameters:'")
    for name, body in content.items():
        found = list(_nodes(f"/{str(name).lstrip('/')}", body))
        if not found:
            raise ParameterError(f"parameter file {path}: no ros__parameters under {name}")
        yield from found


def _nodes(name: str, body: object) -> Iterator[tuple[str, dict[str, object]]]:
    """The sections in one, which is a node or a namespace."""
    if not isinstance(body, Mapping):
        return
    for key, content in body.items():
        if key != "ros__parameters":
            yield from _nodes(f"{name}/{key}", content)
        elif isinstance(content, Mapping):
            yield name, _flat(content)


def _pattern(section: str) -> re.Pattern[str]:
    """Full names of the nodes that a section is for."""
    parts = {"*": r"/\w+", "**": r"(/\w+)*"}
    return re.compile("".join(parts.get(part, f"/{re.escape(part)}") for part in section.lstrip("/").split("/")))


def _namespace(path: str | Path, sections: Iterable[str], nodes: Iterable[str]) -> str:
    """The namespace that sections name for nodes; one part, whatever it is, for ``*``."""
    named = {section.rpartition("/")[0] for section in sections if section.rpartition("/")[2] in nodes}
    exact = {name for name in named if "*" not in name}
    if len(exact) > 1:
        shown = " and ".join(name or "/" for name in sorted(exact))
        raise ParameterError(f"parameter file {path} is for namespaces {shown}: choose one with --namespace")
    if exact:
        return exact.pop()
    return max((name.replace("/**", "").replace("*", "_") for name in named), key=len, default="")


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
