"""Layout of the error state: named blocks. No other module contains the index of a state.

The states common to all filters come first, in the order of the constants below (`ins_nav.estimation.error_model`
defines them); a solution's published covariance has the same order without the heading's cosine, heading as an angle.
Optional blocks follow, then the states of aids (`StateLayout`). A block that is not in use has no rows.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

POSITION = slice(0, 3)
"""Along n, m."""
HORIZONTAL_POSITION = slice(0, 2)
HEIGHT = 2
VELOCITY = slice(3, 6)
"""Along n, m/s."""
HORIZONTAL_VELOCITY = slice(3, 5)
VERTICAL_VELOCITY = 5
ATTITUDE = slice(6, 9)
"""On n, rad: tilt about the horizontal axes, and heading: the sine of its error."""
TILT = slice(6, 8)
HEADING = 8
GYRO_BIAS = slice(9, 12)
"""Body, rad/s."""
ACCEL_BIAS = slice(12, 15)
"""Body, m/s²."""
COSINE = 15
"""One less the cosine of the heading error."""

NAVIGATION = slice(0, 9)
"""Position, velocity and attitude: the states of the mechanization."""
MOTION = slice(0, 6)
"""Position and velocity."""
BIASES = slice(9, 15)
SENSED = slice(6, 15)
"""Attitude and biases."""
SOLUTION = slice(0, 15)
"""All but the cosine."""
SOLUTION_SIZE = 15
POSE = np.array([0, 1, 2, 6, 7, 8])
"""Position and attitude, in the order of a pose's covariance in ROS."""
SIZE = 16
"""States common to all filters."""


class StateLayout:
    """The error state of one filter: the states common to all filters, then further blocks.

    Parameters
    ----------
    blocks : mapping of name to int
        Sizes of the further blocks, in their order.

    Attributes
    ----------
    size : int
        Of the whole state.
    """

    def __init__(self, blocks: Mapping[str, int] | None = None) -> None:
        self.size = SIZE
        self._blocks: dict[str, slice] = {}
        for name, size in (blocks or {}).items():
            self._blocks[name] = slice(self.size, self.size + size)
            self.size += size

    def __contains__(self, name: str) -> bool:
        return name in self._blocks

    def __getitem__(self, name: str) -> slice:
        """A further block; KeyError where there is none of that name."""
        return self._blocks[name]

    def columns(self, *names: str) -> NDArray[np.intp]:
        """Indices of the states of further blocks, one block after the other; absent blocks are skipped."""
        found = [range(*self._blocks[name].indices(self.size)) for name in names if name in self._blocks]
        return np.array([i for block in found for i in block], np.intp)
