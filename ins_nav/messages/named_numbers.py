"""Records of named numbers in a std_msgs/Float64MultiArray, for the topics between the nodes.

The array has one dimension, whose label names the record, its version and its elements in their order, such as
``calibration 1: log.scale log.pitch_deg`` or ``correction 1: ... velocity[3] ...``. Numbers return with all their bits.
A receiver with another form of the record rejects it by the name of the field.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from ins_nav.errors import InsNavError
from ins_nav.event_log import WARN, EventLog

Fields = dict[str, tuple[float, ...]]
"""Values by name, in the order of the record."""
Content = TypeVar("Content")
_FIELD = re.compile(r"([a-z][a-z0-9_.]*)(?:\[(\d{1,6})\])?")


class RejectedMessageError(InsNavError):
    """A message is not used; the text names field and value."""


class NamedNumbers(NamedTuple):
    """Label of the dimension, and the elements along it."""

    label: str
    data: list[float]


def pack(record: str, fields: Mapping[str, Sequence[float]]) -> NamedNumbers:
    """Record, with its version, and its fields; a field of one number has no size in the label."""
    names = (name if len(values) == 1 else f"{name}[{len(values)}]" for name, values in fields.items())
    return NamedNumbers(f"{record}: {' '.join(names)}", [float(x) for values in fields.values() for x in values])


def unpack(message: Any, record: str) -> Fields:
    """Fields of a std_msgs/Float64MultiArray as `pack` names them; all numbers are finite.

    Raises
    ------
    RejectedMessageError
        It is another record, or its label does not describe its numbers, or a number is not finite.
    """
    labels, data = [str(dim.label) for dim in message.layout.dim], message.data
    label = labels[0] if len(labels) == 1 else ""
    found, _, words = label.partition(": ")
    if found != record:
        known = f"not one that begins with '{record}:': do all nodes have one version?"
        raise RejectedMessageError(f"layout.dim has the labels {labels!s:.80}, {known}")
    fields: Fields = {}
    begin = 0
    for word in words.split():
        match = _FIELD.fullmatch(word)
        if match is None or match[1] in fields:
            raise RejectedMessageError(f"layout.dim[0].label has {word!r:.80}, which is not a new name of a field")
        end = begin + int(match[2] or 1)
        fields[match[1]] = tuple(float(x) for x in data[begin:end])
        begin = end
    if begin != len(data):
        raise RejectedMessageError(f"data has {len(data)} numbers, its label names {begin}")
    for name, values in fields.items():
        for i, value in enumerate(values):
            if not math.isfinite(value):
                raise RejectedMessageError(f"{element(name, i, values)} is {value}")
    return fields


def element(name: str, index: int, values: Sequence[float]) -> str:
    """Name of one number of a field."""
    return name if len(values) == 1 else f"{name}[{index}]"


def received(
    read: Callable[[Any], Content], message: Any, topic: str, events: EventLog, stamp_ns: int
) -> Content | None:
    """Read a message of a topic; None and an event where it is rejected, with the stamp of the newest sample."""
    try:
        return read(message)
    except RejectedMessageError as error:
        events.count(f"{topic} rejected", WARN, f"{topic}: {error}: rejected", stamp_ns)
        return None
