"""Messages of aids from plain numbers, by short names, for tests that feed navigators."""

from functools import partial
from typing import Any

from navigators import Ins

from ins_nav.aiding.acoustic_range import range_message
from ins_nav.aiding.depth import depth_message
from ins_nav.aiding.pressure import pressure_message
from ins_nav.aiding.simulated import fix_message, velocity_message
from ins_nav.recordings.bags import message

FIX, RANGE = partial(fix_message, message), partial(range_message, message)
MESSAGES: dict[str, tuple[str, Any]] = {
    "fix": ("gnss/fix", FIX),
    "velocity": ("gnss/velocity", partial(velocity_message, message)),
    "log": ("log", partial(velocity_message, message)),
    "depth": ("depth", partial(depth_message, message)),
    "pressure": ("pressure", partial(pressure_message, message)),
}
"""Topic, and factory of a message from stamp, value and covariance."""


def add(navigator: Ins, kind: str, stamp_ns: int, *values: Any) -> None:
    """Add a message of one of `MESSAGES`, or of "range" or "beacon" with the beacon's name first, to a navigator."""
    if kind == "range":
        navigator.add(f"range/{values[0]}", RANGE(stamp_ns, *values[1:]))
    elif kind == "beacon":
        navigator.add(f"beacon/{values[0]}/fix", FIX(stamp_ns, *values[1:]))
    else:
        topic, make = MESSAGES[kind]
        navigator.add(topic, make(stamp_ns, *values))
