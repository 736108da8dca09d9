"""Kinds of errors of the IMU: every subclass of `ImuError` that a module here defines. Adding a file is enough."""

import functools
import importlib
import inspect
import pkgutil

from ins_nav.config.parameters import Parameter
from ins_nav.estimation.imu_error import ImuError


@functools.cache
def kinds() -> tuple[type[ImuError], ...]:
    """The kinds by the name of their blocks; the modules are imported at the first call."""
    found = []
    for info in pkgutil.iter_modules(__path__, f"{__name__}."):
        for _, kind in inspect.getmembers(importlib.import_module(info.name), inspect.isclass):
            if issubclass(kind, ImuError) and kind.__module__ == info.name:
                found.append(kind)
    return tuple(sorted(found, key=lambda kind: kind.block))


def rows() -> list[Parameter]:
    """Rows of the table of parameters that these declare."""
    return [row for kind in kinds() for row in kind.rows("imu")]
