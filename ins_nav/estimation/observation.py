"""What passes between aids and the filter: the solution they see, their measurement, what became of it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ins_nav.estimation.error_model import (
    Array,
    Vector,
)
from ins_nav.mechanization.nav_state import NavState

_EXACT = np.zeros((3, 3))


class Measurement(NamedTuple):
    """What an aid says: ``innovation = h x + own x_own + noise``, computed less measured."""

    innovation: Array
    """(m,)."""
    h: Array
    """(m, SIZE)."""
    r: Array
    """(m, m), covariance of the noise."""
    direct: slice | None
    """States it measures as such: they give way when the aid is right and the filter is not; None: the aid's own."""
    own: Array | None = None
    """(m, k): columns of the aid's own states, then of those of others, in the order of ``shares``."""
    shares: tuple[str, ...] = ()
    """Other aids on whose states it depends, too."""


class Solution(NamedTuple):
    """What aids see of the solution."""

    state: NavState
    rate: Vector
    """Of the body in inertial space, bias removed, rad/s."""
    gyro_bias: Vector
    """In use, rad/s."""
    travels: bool
    """`ErrorFilter.travels`."""
    turn: float
    """`ErrorFilter.turn`."""
    position_covariance: Array = _EXACT
    """Shape (3, 3), on n, m²."""
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True)
class Update:
    """What became of a measurement."""

    aid: str
    stamp_ns: int
    innovation: tuple[float, ...]
    sigma: tuple[float, ...]
    """Standard deviation of the innovation, as predicted."""
    test_ratio: float
    """Its normalized square over the limit of the gate: rejected above 1."""
    accepted: bool
    reason: str
    """Why it was rejected, or accepted although above the gate; empty otherwise."""
    noise_factor: float = 1.0
    """By which the variance of its noise was taken larger than it says."""
