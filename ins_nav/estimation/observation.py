"""Data between aids and the filter: solution, measurement, and the record of an update."""

import math
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
    """Measurement of an aid: ``innovation = h x + own x_own + noise``, computed less measured."""

    innovation: Array
    """(m,)."""
    h: Array
    """(m, SIZE)."""
    r: Array
    """(m, m), covariance of the noise."""
    direct: slice | None
    """States measured directly; None: those of the aid."""
    own: Array | None = None
    """(m, k): columns of the aid's states, then of those of other aids, in the order of ``shares``."""
    shares: tuple[str, ...] = ()
    """Other aids whose states it depends on."""
    valid_within: float = math.inf
    """m: sigma of position up to which it may be applied to another solution than the present one."""

    @property
    def finite(self) -> bool:
        """Whether all its numbers are."""
        return bool(np.isfinite(self.innovation).all() and np.isfinite(self.r).all() and np.isfinite(self.h).all())


class Solution(NamedTuple):
    """The solution as input of measurement equations."""

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
    """Record of a measurement: its innovation and the result of the gate."""

    aid: str
    stamp_ns: int
    innovation: tuple[float, ...]
    sigma: tuple[float, ...]
    """Predicted standard deviation of the innovation."""
    test_ratio: float
    """Normalized squared innovation over the limit of the gate: rejected above 1."""
    accepted: bool
    reason: str
    """Reason of a rejection, or of an acceptance above the gate; empty otherwise."""
    noise_factor: float = 1.0
    """Variance of its noise in use over the given one."""
