"""Odds of standing against gliding evenly."""

import math
from collections import deque

import numpy as np

_GLIDES_KEPT = 100
"""Number of stored velocities of even gliding, one every 4 s."""
_GLIDE_SPREAD = 0.3
"""Standard deviation of the next glide's velocity, of these velocities."""
_SLOWER = 0.1
"""Probability of a glide at any lower speed."""
_EVENNESS = 0.005
"""1/s: mean acceleration of an even glide over 4 s, standard deviation, of its speed."""
_EVEN = 0.01
"""m/s²: its upper limit."""


class Glides:
    """Velocities at which a carrier has moved without shaking.

    Attributes
    ----------
    velocities : deque of complex
        Forward and left, m/s.
    """

    def __init__(self) -> None:
        self.velocities: deque[complex] = deque(maxlen=_GLIDES_KEPT)

    def unevenness(self, speed: float) -> float:
        """Mean acceleration over 4 s of a glide, standard deviation, m/s²; the speed, m/s, is that of the first."""
        pace = float(np.abs(np.array(self.velocities)).mean()) if self.velocities else speed
        return min(_EVEN, _EVENNESS * pace)

    def odds_of_rest(self, velocity: complex, variance: float) -> float:
        """Likelihood of rest over that of one of these glides, or a slower one.

        Parameters
        ----------
        velocity : complex
            Dead reckoned, m/s.
        variance : float
            Of a component, m²/s².
        """
        glides = np.array(self.velocities)
        spread = variance + (_GLIDE_SPREAD * np.abs(glides)) ** 2
        distance2 = np.minimum(np.abs(velocity - glides), np.abs(velocity + glides)) ** 2
        glide = float(np.mean(variance / spread * np.exp(-0.5 * distance2 / spread)))
        # slower ones: uniformly distributed from backwards to forwards
        glide += _SLOWER * min(1.0, math.sqrt(0.5 * math.pi * variance) / float(np.abs(glides).mean()))
        return math.exp(-0.5 * abs(velocity) ** 2 / variance) / glide
