"""Registry of aids: every subclass of `Aid` that a module of this package defines. Adding a file is enough."""

import functools
import importlib
import inspect
import pkgutil
from collections.abc import Mapping
from typing import Any

import ins_nav.aiding
from ins_nav.aiding.base import Aid
from ins_nav.config.parameters import Parameter, Value


@functools.cache
def aid_classes() -> tuple[type[Aid[Any]], ...]:
    """Classes of aids, by name; the modules are imported at the first call."""
    found = []
    for info in pkgutil.iter_modules(ins_nav.aiding.__path__, f"{ins_nav.aiding.__name__}."):
        module = importlib.import_module(info.name)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if issubclass(kind, Aid) and kind.__module__ == info.name and not inspect.isabstract(kind):
                found.append(kind)
    return tuple(sorted(found, key=lambda kind: (kind.NAME, kind.TOPIC)))


def aid_rows(overrides: Mapping[str, object]) -> list[Parameter]:
    """Rows of the parameter table of all aids.

    Parameters
    ----------
    overrides : mapping
        Values by full name; they may name further rows.

    Raises
    ------
    ParameterError
    """
    return [row for kind in aid_classes() for row in kind.rows(overrides)]


def create_aids(values: Mapping[str, Value]) -> dict[str, Aid[Any]]:
    """Aids by name, from checked values of the parameters, those that are not enabled too."""
    return {aid.name: aid for kind in aid_classes() for aid in kind.create(values)}


def by_topic(aids: Mapping[str, Aid[Any]]) -> dict[str, Aid[Any]]:
    """The aids by topic."""
    return {aid.topic: aid for aid in aids.values()}


@functools.cache
def calibration_names() -> tuple[str, ...]:
    """Names of all parameters that aids calibrate (`Aid.calibration`)."""
    return tuple(name for kind in aid_classes() for name in kind.CALIBRATION)
