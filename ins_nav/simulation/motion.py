"""Building blocks of a carrier's motion: signals with exact derivatives, and the motion composed of them.

Motion is described on a plane: x and y, m, are horizontal, z is up, yaw is counter-clockwise from x. At the
origin of the plane x is east and y north; `ins_nav.simulation.trajectory` lays the plane on the ellipsoid.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

Array = NDArray[np.float64]

_STEP = [0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0]
"""Powers 0 to 7 of the smooth step from 0 to 1: its first three derivatives vanish at both ends."""


class Signal:
    """A smooth function of time: ``signal(t)`` is its value, ``signal(t, k)`` its k-th derivative.

    Signals add and multiply with each other and with numbers; the derivatives stay exact.
    """

    def __init__(self, evaluate: Callable[[Array, int], Array]) -> None:
        self._evaluate = evaluate

    def __call__(self, t: Array, order: int = 0) -> Array:
        return self._evaluate(t, order)

    def derivative(self) -> "Signal":
        """The signal's rate of change."""
        return Signal(lambda t, order: self(t, order + 1))

    def __add__(self, other: "Signal | float") -> "Signal":
        term = other if isinstance(other, Signal) else constant(other)
        return Signal(lambda t, order: self(t, order) + term(t, order))

    def __mul__(self, other: "Signal | float") -> "Signal":
        if not isinstance(other, Signal):
            return Signal(lambda t, order: other * self(t, order))
        return Signal(
            lambda t, order: np.sum(
                [math.comb(order, k) * self(t, k) * other(t, order - k) for k in range(order + 1)], axis=0
            )
        )

    __radd__ = __add__
    __rmul__ = __mul__


def constant(value: float) -> Signal:
    """A constant value."""
    return Signal(lambda t, order: np.full(np.shape(t), 0.0 if order else value))


ZERO = constant(0.0)


def sinusoid(amplitude: float, period: float, phase: float = 0.0) -> Signal:
    """``amplitude * sin(2 pi t / period + phase)``, period in s, phase in rad."""
    if amplitude == 0.0:
        return ZERO
    omega = 2.0 * math.pi / period
    return Signal(lambda t, order: amplitude * omega**order * np.sin(omega * t + (phase + order * math.pi / 2)))


def smooth_profile(initial: float, changes: Sequence[tuple[float, float, float]]) -> Signal:
    """A piecewise constant value with smooth changes.

    Parameters
    ----------
    initial : float
        Value at the start.
    changes : sequence of (start, duration, value)
        From the start, s, on, the value goes to the new one within the duration, s, by a polynomial of degree 7
        (continuous third derivative), and keeps it exactly. Sorted and not overlapping.

    Raises
    ------
    ValueError
        If the changes overlap or have no duration.
    """
    polynomial = _polynomial(initial, changes)
    return Signal(lambda t, order: polynomial(t, order))


def integral_of_profile(initial: float, changes: Sequence[tuple[float, float, float]]) -> Signal:
    """Integral of a `smooth_profile` since time 0: a height from a rate of climb, for example."""
    polynomial = _polynomial(initial, changes).antiderivative()
    start = float(polynomial(0.0))
    return Signal(lambda t, order: polynomial(t, order)) + -start


def _polynomial(initial: float, changes: Sequence[tuple[float, float, float]]) -> PPoly:
    breaks, pieces, value, end = [-1.0], [], initial, -1.0
    for start, duration, target in changes:
        if start < end or duration <= 0.0:
            raise ValueError(
                f"change at {start} s for {duration} s: the duration must be positive, the start after {end} s"
            )
        if start > end:
            breaks.append(start)
            pieces.append([value] + [0.0] * 7)
        breaks.append(start + duration)
        pieces.append([value * (k == 0) + (target - value) * c / duration**k for k, c in enumerate(_STEP)])
        value, end = target, start + duration
    breaks.append(end + 1.0)  # extrapolated without end
    pieces.append([value] + [0.0] * 7)
    return PPoly(np.array(pieces).T[::-1], np.array(breaks))


class Route:
    """A drive composed of pieces; its speed, m/s, and yaw, rad, are signals.

    Parameters
    ----------
    yaw : float
        Yaw at the start, where the vehicle stands, rad.
    """

    def __init__(self, yaw: float) -> None:
        self.time = 0.0
        self._initial_yaw = self._yaw = yaw
        self._speeds: list[tuple[float, float, float]] = []
        self._yaws: list[tuple[float, float, float]] = []

    def hold(self, duration: float) -> None:
        """Keep speed and yaw for the duration, s."""
        self.time += duration

    def reach(self, speed: float, duration: float) -> None:
        """Accelerate to the speed, m/s, within the duration, s."""
        self._speeds.append((self.time, duration, speed))
        self.time += duration

    def turn(self, angle: float, duration: float) -> None:
        """Turn by the angle, rad, counter-clockwise positive, within the duration, s."""
        self._yaw += angle
        self._yaws.append((self.time, duration, self._yaw))
        self.time += duration

    @property
    def speed(self) -> Signal:
        """Speed along the body's x axis, m/s."""
        return smooth_profile(0.0, self._speeds)

    @property
    def yaw(self) -> Signal:
        """Direction of the drive, rad."""
        return smooth_profile(self._initial_yaw, self._yaws)


class MotionSample(NamedTuple):
    """Motion at n instants; every field is an array of shape (3, n)."""

    position: Array
    """x, y, z, m."""
    velocity: Array
    acceleration: Array
    angles: Array
    """Yaw, pitch, roll, rad: turns about z, y, x in this order (REP-103)."""
    angle_rates: Array


class Motion:
    """A carrier's motion from 0 to the duration, s.

    Parameters
    ----------
    duration : float
        Length, s.
    yaw, pitch, roll : Signal
        Euler angles, rad (REP-103: a positive pitch lowers the bow).
    x, y, z : Signal
        Position on the plane, m.
    speed : Signal, optional
        Horizontal speed in the direction of yaw, m/s; its path is added to x and y.
    """

    def __init__(
        self,
        duration: float,
        *,
        yaw: Signal,
        pitch: Signal = ZERO,
        roll: Signal = ZERO,
        x: Signal = ZERO,
        y: Signal = ZERO,
        z: Signal = ZERO,
        speed: Signal | None = None,
    ) -> None:
        self.duration = duration
        self._place = (x, y, z)
        self._angles = (yaw, pitch, roll)
        self._speed = speed
        self._path = None if speed is None else _PlanarPath(speed, yaw, duration)

    def sample(self, t: Array) -> MotionSample:
        """The motion at times t, s, shape (n,)."""
        position, velocity, acceleration = (np.stack([signal(t, k) for signal in self._place]) for k in range(3))
        angles, angle_rates = (np.stack([signal(t, k) for signal in self._angles]) for k in range(2))
        if self._speed is not None and self._path is not None:
            cos, sin = np.cos(angles[0]), np.sin(angles[0])
            along, across = self._speed(t, 1), self._speed(t) * angle_rates[0]
            position[:2] += self._path.position(t)
            velocity[:2] += self._speed(t) * np.stack([cos, sin])
            acceleration[:2] += np.stack([along * cos - across * sin, along * sin + across * cos])
        return MotionSample(position, velocity, acceleration, angles, angle_rates)


class _PlanarPath:
    """Integral of a velocity given by speed and direction: 3-point Gauss-Legendre in cells of 10 ms.

    With the profiles above its error is below 1e-12 m a cell, also where a profile changes its polynomial.
    """

    CELL = 0.01
    NODES: Array = 0.5 + np.array([-0.5, 0.0, 0.5]) * math.sqrt(0.6)
    WEIGHTS: Array = np.array([5.0, 8.0, 5.0]) / 18.0

    def __init__(self, speed: Signal, yaw: Signal, duration: float) -> None:
        self._speed, self._yaw = speed, yaw
        self._starts: Array = np.asarray(np.arange(math.ceil(duration / self.CELL) + 1) * self.CELL, np.float64)
        steps = self._integral(self._starts[:-1], np.diff(self._starts))
        self._corners = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)

    def position(self, t: Array) -> Array:
        """Shape (2, n), m."""
        cell = np.clip((t / self.CELL).astype(np.int64), 0, len(self._starts) - 1)
        start = self._starts[cell]
        return self._corners[:, cell] + self._integral(start, t - start)

    def _integral(self, start: Array, length: Array) -> Array:
        t = start + length * self.NODES[:, None]
        speed, yaw = self._speed(t), self._yaw(t)
        return length * np.stack([self.WEIGHTS @ (speed * np.cos(yaw)), self.WEIGHTS @ (speed * np.sin(yaw))])
