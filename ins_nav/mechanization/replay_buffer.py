"""The last seconds of samples and states: a state of the past is corrected, and the samples since re-integrated."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization import strapdown
from ins_nav.mechanization.earth import NO_WATER
from ins_nav.mechanization.nav_state import STATE_SIZE, NavState
from ins_nav.mechanization.stamped_rows import StampedRows
from ins_nav.mechanization.strapdown import Compensation, Sample, sample_of


class Entry(NamedTuple):
    """A sample, biases not removed, and the state at its stamp."""

    stamp_ns: int
    raw: Sample
    state: NavState


class Entries(NamedTuple):
    """Entries as arrays, oldest first; views, valid until the next sample.

    Attributes
    ----------
    stamps : ndarray of int64, shape (n,)
        ns.
    samples : ndarray, shape (n, 7)
        On base_link's axes, biases not removed; a `Sample` a row.
    states : ndarray, shape (n, STATE_SIZE)
        A `NavState` a row.
    """

    stamps: NDArray[np.int64]
    samples: NDArray[np.float64]
    states: NDArray[np.float64]


class ReplayBuffer:
    """The states at stored samples, from that of `begin` on.

    Parameters
    ----------
    samples : StampedRows
        Samples on base_link's axes, biases not removed.
    instantaneous, vertical, water_surface
        As in `ins_nav.mechanization.strapdown.step`.
    """

    def __init__(
        self, samples: StampedRows, instantaneous: bool, vertical: bool, water_surface: float = NO_WATER
    ) -> None:
        self._settings = instantaneous, vertical, water_surface
        self._rows = samples
        self._states = samples.add_array(STATE_SIZE)
        self._first_ns = 0

    def begin(self, state: NavState) -> None:
        """The state at the newest sample is the first."""
        rows = self._rows
        self._first_ns = int(rows.stamps[rows.size - 1])
        rows.arrays[self._states][rows.size - 1] = state

    def integrate(self, count: int, compensation: Compensation) -> None:
        """Integrate the newest samples, so many.

        Parameters
        ----------
        count : int
        compensation : Compensation
            Of the samples.
        """
        self._fill(self._rows.size - count, compensation)

    @property
    def newest(self) -> NavState:
        """The state at the newest sample."""
        return NavState._make(self._rows.arrays[self._states][self._rows.size - 1].tolist())

    def at(self, stamp_ns: int) -> Entry:
        """The newest entry that is not after the stamp; the oldest of the last 12 s where all are."""
        row = max(self._rows.count(max(stamp_ns, self._first_ns)) - 1, self._rows.oldest)
        state = NavState._make(self._rows.arrays[self._states][row].tolist())
        return Entry(int(self._rows.stamps[row]), sample_of(self._rows.arrays[0][row]), state)

    def between(self, after_ns: int, until_ns: int) -> Entries:
        """Entries with ``after_ns`` < stamp <= ``until_ns``."""
        return self._entries(self._rows.count(max(after_ns, self._first_ns - 1)), self._rows.count(until_ns))

    def last(self, count: int) -> Entries:
        """The newest entries, so many."""
        return self._entries(self._rows.size - count, self._rows.size)

    def _entries(self, first: int, until: int) -> Entries:
        rows = self._rows
        return Entries(rows.stamps[first:until], rows.arrays[0][first:until], rows.arrays[self._states][first:until])

    def reintegrate(self, stamp_ns: int, state: NavState, compensation: Compensation) -> NavState:
        """Replace the state at the entry of that stamp and integrate the samples since again.

        Parameters
        ----------
        stamp_ns : int
            Of an entry.
        state : NavState
        compensation : Compensation
            Of the samples.

        Returns
        -------
        NavState
            At the newest stamp.
        """
        following = self._rows.count(stamp_ns)
        self._rows.arrays[self._states][following - 1] = state
        self._fill(following, compensation)
        return self.newest

    def _fill(self, first: int, compensation: Compensation) -> None:
        """Integrate from the entry before this row on."""
        rows = self._rows
        strapdown.fill_states(
            rows.arrays[0], rows.arrays[self._states], first, rows.size, compensation, *self._settings
        )
