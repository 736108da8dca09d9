"""Stamped rows of numbers of the last seconds in contiguous arrays, so that blocks are read without copies."""

import numpy as np
from numpy.typing import NDArray

LENGTH_NS = 12_000_000_000
"""ns: the slowest start of a drive is noticed in less."""
_CAPACITY = 4096
"""Rows at first."""

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


class StampedRows:
    """Rows of several arrays under common, increasing stamps, oldest first; at least those of the last 12 s.

    Parameters
    ----------
    width : int
        Numbers of a row of the first array, the values of which are added with the stamps.

    Attributes
    ----------
    size : int
        Number of rows; those of the arrays behind them are unused.
    stamps : ndarray of int64, shape (capacity,)
        ns.
    arrays : list of ndarray, shape (capacity, width)
        All are replaced when rows are added beyond the capacity.
    """

    def __init__(self, width: int) -> None:
        self.size = 0
        self.stamps: Stamps = np.empty(_CAPACITY, dtype=np.int64)
        self.arrays: list[Array] = [np.empty((_CAPACITY, width))]

    def add_array(self, width: int) -> int:
        """Add an array, the rows of which its user fills in; its index in `arrays`."""
        self.arrays.append(np.empty((len(self.stamps), width)))
        return len(self.arrays) - 1

    def clear(self) -> None:
        """Remove all rows."""
        self.size = 0

    @property
    def oldest(self) -> int:
        """The first row within the last 12 s."""
        return self.count(int(self.stamps[self.size - 1]) - LENGTH_NS - 1) if self.size else 0

    def count(self, until_ns: int) -> int:
        """Number of rows up to a stamp, included."""
        return int(np.searchsorted(self.stamps[: self.size], until_ns, "right"))

    def append(self, stamp_ns: int, row: tuple[float, ...]) -> None:
        """Add a row."""
        if self.size == len(self.stamps):
            self._make_room(1)
        self.stamps[self.size] = stamp_ns
        self.arrays[0][self.size] = row
        self.size += 1

    def extend(self, stamps: Stamps, rows: Array) -> None:
        """Add a block of rows.

        Parameters
        ----------
        stamps : ndarray of int64, shape (n,)
            ns.
        rows : ndarray, shape (n, width)
        """
        if self.size + len(stamps) > len(self.stamps):
            self._make_room(len(stamps))
        until = self.size + len(stamps)
        self.stamps[self.size : until] = stamps
        self.arrays[0][self.size : until] = rows
        self.size = until

    def _make_room(self, count: int) -> None:
        """Drop rows older than the last 12 s; double the capacity until at most half of it is in use."""
        retained = slice(self.oldest, self.size)
        self.size -= retained.start
        capacity = len(self.stamps)
        while self.size + count > capacity // 2:
            capacity *= 2
        stamps, arrays = self.stamps, self.arrays
        self.stamps = np.empty(capacity, dtype=np.int64)
        self.stamps[: self.size] = stamps[retained]
        self.arrays = [np.empty((capacity, array.shape[1])) for array in arrays]
        for new, old in zip(self.arrays, arrays, strict=True):
            new[: self.size] = old[retained]
