"""Acoustic beacons: moored at a known position, or floating.

The velocity of a floating beacon is a first-order Gauss-Markov process on each axis ([1]_, one order lower). Its
position and velocity are states of the filter beside those of the vehicle: the error of its track is common to all
ranges between two fixes, and a late fix also corrects the ranges before it.

References
----------
.. [1] R. A. Singer, "Estimating Optimal Tracking Filter Performance for Manned Maneuvering Targets", IEEE Transactions
       on Aerospace and Electronic Systems, 1970, vol. 6.
"""

import math

import numpy as np

from ins_nav.estimation.error_model import Array
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.slow_state import SlowState
from ins_nav.estimation.state_layout import SIZE
from ins_nav.mechanization.earth import enu_axes, geodetic_to_ecef

_MANOEUVRE = 30.0
"""s: correlation time of a vessel's velocity."""
_ANYWHERE = 1e4
"""m: prior sigma of the distance from its first fix."""


class Beacon:
    """A beacon; states of a floating one: position relative to `reference`, m, and velocity, m/s, Earth-fixed.

    Parameters
    ----------
    place : (lat, lon, height) or None
        Of a moored one, rad and m.
    speed : float
        Standard deviation of each component of the velocity of a floating one, m/s.

    Attributes
    ----------
    reference : ndarray, shape (3,), or None
        Earth-fixed, m: the mooring, or the first fix; None before.
    states : tuple of SlowState
    """

    def __init__(self, place: tuple[float, float, float] | None, speed: float) -> None:
        self.moored = place is not None
        self.reference: Array | None = None if place is None else geodetic_to_ecef(*place)
        self._speed = speed
        self._fixed_ns: int | None = None
        velocity = SlowState(speed, speed * math.sqrt(2.0 / _MANOEUVRE), _MANOEUVRE)
        self.states = () if self.moored else (SlowState(_ANYWHERE, derivative=3),) * 3 + (velocity,) * 3

    def restart(self) -> None:
        """Reset the states together with the filter."""
        if not self.moored:
            self.reference = self._fixed_ns = None

    def at(self, own: Array, ago: float) -> Array | None:
        """Position ``ago`` seconds before, Earth-fixed, shape (3,), by the states in use; None while unknown."""
        if self.reference is None or self.moored:
            return self.reference
        place: Array = self.reference + self._way(ago) @ own
        return place

    def columns(self, direction: Array, ago: float) -> Array:
        """Jacobian by the states, shape (k,), of the position along a direction, Earth-fixed."""
        return np.zeros(0) if self.moored else np.asarray(direction @ self._way(ago), float)

    def measure(
        self, own: Array, stamp_ns: int, fix: tuple[float, float, float], covariance: Array, ago: float
    ) -> Measurement:
        """Measurement of a fix, rad and m, with that stamp, ``ago`` s before; covariance on east, north, up, m².

        The first fix after a restart is the reference. Fixes with the same delay share the error of the track since
        then, so that the variance of each is increased accordingly.
        """
        place, axes = geodetic_to_ecef(*fix), enu_axes(fix[0], fix[1])
        if self.reference is None:
            self.reference = place
        interval = math.inf if self._fixed_ns is None else abs(stamp_ns - self._fixed_ns) * 1e-9
        self._fixed_ns = stamp_ns
        alike = max(1.0, ago / interval) if interval > 0.0 else 1.0
        r = axes @ covariance @ axes.T + alike * self.way_stddev(ago) ** 2 * np.eye(3)
        way = self._way(ago)
        return Measurement(self.reference + way @ own - place, np.zeros((3, SIZE)), r, None, way)

    def _way(self, ago: float) -> Array:
        """From the states of the present to the position ``ago`` s before, shape (3, 6)."""
        back = _MANOEUVRE * (1.0 - math.exp(-ago / _MANOEUVRE))
        return np.hstack([np.eye(3), -back * np.eye(3)])

    def way_stddev(self, time: float) -> float:
        """Sigma of each component of the displacement in a time, s, with known velocity at one end of it, m."""
        kept = math.exp(-time / _MANOEUVRE)
        along = 2.0 * time / _MANOEUVRE - 3.0 + 4.0 * kept - kept**2
        return self._speed * _MANOEUVRE * math.sqrt(max(0.0, along))
