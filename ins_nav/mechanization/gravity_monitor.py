"""Specific force against gravity, second by second: its size in the mean, and its direction on the body.

On a carrier the mean specific force is the reaction to gravity and little else. Its unit shows in its size. Its
direction turns on the body by what the gyros measure and by acceleration: a sign or axes that change under way
turn it by 90° or 180° at once.
"""

import math
from collections import deque
from typing import NamedTuple

from ins_nav.event_log import ERROR, WARN
from ins_nav.mechanization.window_statistics import WindowStatistics

_GRAVITY = 9.8
_SHORT, _SHORT_RATIO = 5, 2.0
"""Windows in which the mean specific force of each is larger than gravity by this ratio, or smaller: no carrier."""
_LONG, _LONG_LOW, _LONG_HIGH = 60, 0.5, 1.5
"""Windows over which the mean size of specific force differs from gravity by less, below and above, m/s²; acceleration
only adds to it, 1.5 m/s² by 5.5 m/s² RMS."""
_UNITS = {"g": 1.0 / 9.80665, "mg": 1e3 / 9.80665, "cm/s² (Gal)": 100.0, "ft/s²": 1.0 / 0.3048}
_UNIT_TOLERANCE = 0.05
_TURN = math.radians(70.0)
"""rad by which acceleration turns the mean specific force from one window to the next, at most: 0.7 g to 0.7 g."""


class GravityFault(NamedTuple):
    """What is wrong.

    Attributes
    ----------
    kind, level, text : str
        Of the event.
    error : float
        Of specific force, m/s².
    """

    kind: str
    level: str
    text: str
    error: float


class GravityMonitor:
    """Tests windows."""

    def __init__(self) -> None:
        self._wrong = 0
        self._sizes: deque[float] = deque(maxlen=_LONG)
        self._mean: list[float] = []
        self._turned: float | None = None

    def add(self, window: WindowStatistics, duration: float) -> GravityFault | None:
        """Test a window of a duration, s."""
        force = window.mean[3:]
        size = math.hypot(*force)
        return self._direction(force, size, window, duration) or self._size(size)

    def _direction(
        self, force: list[float], size: float, window: WindowStatistics, duration: float
    ) -> GravityFault | None:
        before = self._mean or force
        turn = _angle(before, force)
        rates = zip(window.low[:3], window.high[:3], strict=True)
        explained = math.hypot(*(max(-low, high) for low, high in rates)) * duration
        if self._turned is None:
            self._mean = force
            if turn <= _TURN + explained:
                return None
            self._mean, self._turned = before, explained
        elif turn <= _TURN:  # as before the fault
            self._mean, self._turned = force, None
            return None
        text = (
            f"linear_acceleration turned by {math.degrees(turn):.0f}° within a second, angular_velocity by at most "
            f"{math.degrees(self._turned):.0f}°: have the sign or the axes of linear_acceleration changed?"
        )
        return GravityFault("force turned", ERROR, text, 2.0 * math.sin(0.5 * turn) * size)

    def _size(self, size: float) -> GravityFault | None:
        wrong = not _GRAVITY / _SHORT_RATIO < size < _SHORT_RATIO * _GRAVITY
        self._wrong = self._wrong + 1 if wrong else 0
        self._sizes.append(size)
        if self._wrong >= _SHORT:
            units = [name for name, ratio in _UNITS.items() if abs(size / (_GRAVITY * ratio) - 1.0) < _UNIT_TOLERANCE]
            named = f"it is in {units[0]}: publish m/s²" if units else "check its unit and the sensor"
            text = f"linear_acceleration is {size:.4g} m/s² in the mean, gravity is {_GRAVITY}: {named}"
            return GravityFault("force is not gravity", ERROR, text, size - _GRAVITY)
        mean = sum(self._sizes) / len(self._sizes)
        if len(self._sizes) == _LONG and not -_LONG_LOW < mean - _GRAVITY < _LONG_HIGH:
            text = (
                f"linear_acceleration is {mean:.3f} m/s² in the mean over a minute, gravity is {_GRAVITY}: check the "
                "scale of the accelerometers"
            )
            return GravityFault("force is not gravity", WARN, text, mean - _GRAVITY)
        return None


def _angle(one: list[float], other: list[float]) -> float:
    """Between two vectors, rad."""
    cosine = sum(a * b for a, b in zip(one, other, strict=True)) / max(1e-300, math.hypot(*one) * math.hypot(*other))
    return math.acos(max(-1.0, min(1.0, cosine)))
