"""Messages that are filled as bytes, decoded by rosbags; records of named numbers as messages."""

from typing import Any

import numpy as np

from ins_nav.messages.cdr import StampedMessage
from ins_nav.messages.named_numbers import NamedNumbers
from ins_nav.recordings.bags import message, typestore


def decoded(filled: StampedMessage) -> Any:
    """The message with its fields."""
    return typestore().deserialize_cdr(filled.serialized(), filled.msgtype)


def as_message(numbers: NamedNumbers) -> Any:
    """The std_msgs/Float64MultiArray that a node publishes."""
    size = len(numbers.data)
    dim = message("std_msgs/msg/MultiArrayDimension", label=numbers.label, size=size, stride=size)
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[dim])
    return message("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array(numbers.data))
