"""Parameters of the nodes, declared from the table in `ins_nav.config.parameters`."""

import math

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ins_nav.config.parameters import ROS_OWN, Value, beacon_names, checked_values, table


def declare(node: Node) -> dict[str, Value]:
    """Declare every parameter, read-only, and return their values, checked.

    All overrides are checked, whole numbers taken for floating point, and unknown names refused, which rclpy by
    itself would ignore.

    Raises
    ------
    ParameterError
    """
    given = {
        name: parameter.value
        for name, parameter in node._parameter_overrides.items()
        if name not in ROS_OWN and not name.startswith("qos_overrides.")
    }
    values = checked_values(given)
    for parameter in table(beacon_names(values["range.beacons"])):
        descriptor = ParameterDescriptor(description=parameter.description, read_only=True)
        value = values[parameter.name]
        finite = isinstance(value, float) and all(map(math.isfinite, (value, parameter.low, parameter.high)))
        if finite:
            descriptor.floating_point_range = [FloatingPointRange(from_value=parameter.low, to_value=parameter.high)]
        elif parameter.choices:
            descriptor.additional_constraints = "one of " + ", ".join(parameter.choices)
        elif math.isfinite(parameter.low) or math.isfinite(parameter.high):
            descriptor.additional_constraints = f"{parameter.low:g} to {parameter.high:g}; NaN: not given"
        node.declare_parameter(parameter.name, value, descriptor, ignore_override=True)
    return values
