"""Stochastic model of an error that changes slowly: prior, random walk, correlation time."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SlowState:
    """A quantity that is constant, walks at random, is a first-order Gauss-Markov process, or the integral of another.

    Attributes
    ----------
    stddev : float
        At the start; 0 together with ``walk`` 0 omits the state.
    walk : float
        Intensity of its random walk, unit / √s.
    correlation_time : float
        s; infinity for a random walk or a constant. Otherwise it tends to the value it has at the start of the
        filter, and its stationary deviation from it is ``walk * sqrt(correlation_time / 2)``.
    value : float
        At the start, of an aid's state.
    derivative : int
        Offset of its derivative among the aid's states; 0: none.
    """

    stddev: float = 0.0
    walk: float = 0.0
    correlation_time: float = math.inf
    value: float = 0.0
    derivative: int = 0


ABSENT = SlowState()
"""No such error."""
