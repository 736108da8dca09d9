"""Acoustic beacons: where one was when its sound left it."""

import math

import numpy as np
from numpy.typing import NDArray

from ins_nav.earth import enu_axes, geodetic_to_ecef

Array = NDArray[np.float64]
Place = tuple[Array, float]
"""Earth-fixed position, shape (3,), m, and the variance of each component, m²."""

_MANOEUVRE = 30.0
"""s: correlation time of a vessel's velocity."""


class Beacon:
    """A beacon that is moored, or that floats and tells its place by fixes.

    The velocity of one that floats is a first-order Gauss-Markov process on each axis (R. A. Singer, "Estimating
    Optimal Tracking Filter Performance for Manned Maneuvering Targets", IEEE Transactions on Aerospace and Electronic
    Systems, 1970, one order lower); a Kalman filter over the fixes follows it.

    Parameters
    ----------
    place : (lat, lon, height) or None
        Of one that is moored, rad and m.
    speed : float
        Standard deviation of each component of the velocity of one that floats, m/s.
    """

    def __init__(self, place: tuple[float, float, float] | None, speed: float) -> None:
        self._moored = None if place is None else geodetic_to_ecef(*place)
        self._speed = speed
        self._stamp_ns = 0
        self._asked = 0
        self._x: Array | None = None  # place and velocity, rows
        self._p: Array = np.zeros((2, 2))  # of each axis

    def take(self, stamp_ns: int, lat: float, lon: float, height: float, covariance: Array) -> None:
        """A fix of its, later than the last; covariance on east, north, up, shape (3, 3), m²."""
        place = geodetic_to_ecef(lat, lon, height)
        axes = enu_axes(lat, lon)
        variance = float(np.max((axes @ covariance @ axes.T).diagonal()))
        if self._x is None:
            self._x, self._p = np.array([place, np.zeros(3)]), np.diag([variance, self._speed**2])
        else:
            x, p = self._ahead(stamp_ns)
            gain = p[:, 0] / (p[0, 0] + variance)
            left = np.eye(2) - np.outer(gain, [1.0, 0.0])
            self._x = x + np.outer(gain, place - x[0])
            self._p = left @ p @ left.T + variance * np.outer(gain, gain)
        self._stamp_ns = stamp_ns
        self._asked = 0

    def at(self, stamp_ns: int) -> Place | None:
        """Where it was; None when nothing is known.

        What is not known of its way since its last fix is the same for all that is measured until the next: each of
        them is told a variance so much larger.
        """
        if self._moored is not None:
            return self._moored, 0.0
        if self._x is None:
            return None
        x, p = self._ahead(stamp_ns)
        self._asked += 1
        return x[0], self._asked * float(p[0, 0])

    def _ahead(self, stamp_ns: int) -> tuple[Array, Array]:
        """State and covariance at another time; the same for before, where it is the sound's way that is meant."""
        assert self._x is not None
        time = (stamp_ns - self._stamp_ns) * 1e-9
        tau = math.copysign(_MANOEUVRE, time)
        kept = math.exp(-time / tau)
        phi = np.array([[1.0, tau * (1.0 - kept)], [0.0, kept]])
        # integrals of the impulse response of place, tau (1 - exp(-t / tau)), and of velocity, exp(-t / tau)
        once, twice = abs(tau) * (1.0 - kept), 0.5 * abs(tau) * (1.0 - kept**2)
        across = math.copysign(abs(tau) * (once - twice), time)
        q = np.array([[tau**2 * (abs(time) - 2.0 * once + twice), across], [across, twice]])
        return phi @ self._x, phi @ self._p @ phi.T + 2.0 * self._speed**2 / abs(tau) * q
