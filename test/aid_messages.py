"""Messages of aids from plain numbers, by short names, for tests that feed navigators."""

from typing import Any

from ins_nav.navigator.realtime import RealtimeNavigator
from ins_nav.simulation import messages

MESSAGES: dict[str, tuple[str, Any]] = {
    "fix": ("gnss/fix", messages.nav_sat_fix),
    "velocity": ("gnss/velocity", messages.twist),
    "log": ("log", messages.twist),
    "depth": ("depth", messages.depth_pose),
    "pressure": ("pressure", messages.fluid_pressure),
}
"""Topic, and what makes a message of stamp, value and covariance."""


def add(navigator: RealtimeNavigator, kind: str, stamp_ns: int, *values: Any) -> None:
    """Give a message of one of `MESSAGES`, or of "range" or "beacon" with the beacon's name first, to a navigator."""
    if kind == "range":
        navigator.add(f"range/{values[0]}", messages.acoustic_range(stamp_ns, *values[1:]))
    elif kind == "beacon":
        navigator.add(f"beacon/{values[0]}/fix", messages.nav_sat_fix(stamp_ns, *values[1:]))
    else:
        topic, make = MESSAGES[kind]
        navigator.add(topic, make(stamp_ns, *values))
