"""Parameters of the nodes, declared from the table of `ins_nav.config`."""

import math
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ins_nav.aiding.parameters import configuration
from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import without_ros


def overrides(node: Node) -> dict[str, Any]:
    """Parameters given to the node at its start, without those of ROS."""
    return without_ros({name: given.value for name, given in node._parameter_overrides.items()})


def declare(node: Node, others: Mapping[str, Any] | None = None) -> Configuration:
    """Declare every parameter, read-only, and return their checked values.

    Parameters
    ----------
    node : Node
    others : mapping, optional
        Overrides of other nodes in the process, used where the node has none itself.

    All overrides are checked, whole numbers converted to floating point, former names replaced, and unknown names
    refused, which rclpy by itself would ignore.

    Raises
    ------
    ParameterError
    """
    found = configuration({**(others or {}), **overrides(node)})
    for warning in found.warnings:
        node.get_logger().warning(warning)
    for row in found.rows:
        descriptor = ParameterDescriptor(description=row.description, read_only=True)
        value = found.values[row.name]
        finite = isinstance(value, float) and all(map(math.isfinite, (value, row.low, row.high)))
        if finite:
            descriptor.floating_point_range = [FloatingPointRange(from_value=row.low, to_value=row.high)]
        elif row.choices:
            descriptor.additional_constraints = "one of " + ", ".join(row.choices)
        elif math.isfinite(row.low) or math.isfinite(row.high):
            descriptor.additional_constraints = f"{row.low:g} to {row.high:g}; NaN: not given"
        node.declare_parameter(row.name, value, descriptor, ignore_override=True)
    return found
