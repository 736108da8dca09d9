"""Header stamps as integer nanoseconds since the epoch."""

from typing import Any

NS = 1_000_000_000


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Header stamp from ns since the epoch."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, NS)


def stamp_of(message: Any) -> int:
    """Header stamp as ns since the epoch."""
    stamp = message.header.stamp
    stamp_ns: int = stamp.sec * NS + stamp.nanosec
    return stamp_ns
