"""Records of named numbers: exact, and rejected by name where they are not of the form that their label describes."""

import math

import pytest
from decoding import as_message

from ins_nav.event_log import EventLog
from ins_nav.messages.named_numbers import NamedNumbers, RejectedMessageError, pack, received, unpack


def test_every_bit_returns() -> None:
    fields = {"height": (0.1,), "velocity": (1e-300, math.nextafter(1.0, 2.0), -0.0), "errors": ()}
    numbers = pack("record 1", fields)
    assert numbers.label == "record 1: height velocity[3] errors[0]"
    back = unpack(as_message(numbers), "record 1")
    assert back == fields and math.copysign(1.0, back["velocity"][2]) == -1.0


@pytest.mark.parametrize(
    ("label", "data", "text"),
    [
        (
            "record 2: a b",
            [1.0, 2.0],
            "layout.dim has the labels ['record 2: a b'], not one that begins with 'record 1:'",
        ),
        ("record 1: a b", [1.0], "data has 1 numbers, its label names 2"),
        ("record 1: a", [1.0, 2.0], "data has 2 numbers, its label names 1"),
        ("record 1: a a", [1.0, 2.0], "layout.dim[0].label has 'a', which is not a new name of a field"),
        ("record 1: a[-1]", [1.0], "layout.dim[0].label has 'a[-1]'"),
        ("record 1: a[999999999]", [1.0], "layout.dim[0].label has 'a[999999999]'"),
        ("record 1: a v[2]", [1.0, 2.0, math.inf], "v[1] is inf"),
        ("record 1: a v[2]", [math.nan, 2.0, 3.0], "a is nan"),
    ],
)
def test_another_form_is_named(label: str, data: list[float], text: str) -> None:
    with pytest.raises(RejectedMessageError) as raised:
        unpack(as_message(NamedNumbers(label, data)), "record 1")
    assert str(raised.value).startswith(text)


def test_several_dimensions_are_another_record() -> None:
    message = as_message(pack("record 1", {"a": (1.0,)}))
    message.layout.dim *= 2
    with pytest.raises(RejectedMessageError, match=r"layout\.dim has the labels"):
        unpack(message, "record 1")


def test_a_rejected_message_is_an_event() -> None:
    events = EventLog()
    message = as_message(pack("record 1", {"a": (math.nan,)}))
    assert received(lambda m: unpack(m, "record 1"), message, "ins/feedback", events, 5) is None
    assert events.counts == {"ins/feedback rejected": 1}
    assert [report.text for report in events.drain()] == ["ins/feedback: a is nan: rejected"]
