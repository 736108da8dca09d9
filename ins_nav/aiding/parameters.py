"""The whole table of parameters: the sections of `ins_nav.config.sections`, the errors of the IMU, the aids."""

from collections.abc import Mapping

from ins_nav.aiding.registry import aid_classes, aid_rows
from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import Parameter
from ins_nav.estimation import states


def configuration(overrides: Mapping[str, object] | None = None) -> Configuration:
    """The configuration of a system from its parameters.

    Raises
    ------
    ParameterError
    """
    overrides = overrides or {}
    found = Configuration.from_overrides(overrides, [*states.rows(), *aid_rows(overrides)])
    for kind in aid_classes():
        kind.check(found.values)
    return found


def table() -> tuple[Parameter, ...]:
    """Every row but those that the values of others name."""
    return configuration().rows
