"""Messages that are filled as bytes, decoded by rosbags."""

from typing import Any

from ins_nav.messages.cdr import StampedMessage
from ins_nav.recordings.bags import typestore


def decoded(message: StampedMessage) -> Any:
    """The message with its fields."""
    return typestore().deserialize_cdr(message.serialized(), message.msgtype)
