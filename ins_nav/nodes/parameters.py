"""Parameters of the nodes, declared from the table of `ins_nav.config`."""

import math

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ins_nav.aiding.parameters import configuration
from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import without_ros


def declare(node: Node) -> Configuration:
    """Declare every parameter, read-only, and return their checked values.

    All overrides are checked, whole numbers converted to floating point, former names replaced, and unknown names
    refused, which rclpy by itself would ignore.

    Raises
    ------
    ParameterError
    """
    found = configuration(without_ros({name: given.value for name, given in node._parameter_overrides.items()}))
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
