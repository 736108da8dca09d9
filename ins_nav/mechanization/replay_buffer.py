"""The last seconds of samples and states: a state of the past is corrected, and what came after it run again."""

import itertools
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.mechanization import strapdown
from ins_nav.mechanization.earth import NO_WATER
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.strapdown import Sample

Vector = tuple[float, float, float]
LENGTH_NS = 12_000_000_000
"""ns: the slowest start of a drive is noticed in less."""


class Entry(NamedTuple):
    """A sample, biases still in it, and the state at its stamp."""

    stamp_ns: int
    raw: Sample
    state: NavState


class ReplayBuffer:
    """Samples on base_link's axes with the states they led to, oldest first.

    Parameters
    ----------
    instantaneous, vertical, water_surface
        As in `ins_nav.mechanization.strapdown.step`.
    """

    def __init__(self, instantaneous: bool, vertical: bool, water_surface: float = NO_WATER) -> None:
        self._water_surface = water_surface
        self._instantaneous = instantaneous
        self._vertical = vertical
        self._entries: deque[Entry] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()

    def add(self, stamp_ns: int, raw: Sample, state: NavState) -> None:
        """Append the newest."""
        entries = self._entries
        entries.append(Entry(stamp_ns, raw, state))
        oldest = stamp_ns - LENGTH_NS
        while entries[0].stamp_ns < oldest:
            entries.popleft()

    def at(self, stamp_ns: int) -> Entry:
        """The newest entry that is not after the stamp; the oldest where all are."""
        for entry in reversed(self._entries):
            if entry.stamp_ns <= stamp_ns:
                return entry
        return self._entries[0]

    def between(self, after_ns: int, until_ns: int) -> list[Entry]:
        """Entries with ``after_ns`` < stamp <= ``until_ns``."""
        newest = itertools.dropwhile(lambda entry: entry.stamp_ns > until_ns, reversed(self._entries))
        return list(itertools.takewhile(lambda entry: entry.stamp_ns > after_ns, newest))[::-1]

    def reintegrate(
        self,
        stamp_ns: int,
        state: NavState,
        gyro_bias: Vector,
        accel_bias: Vector,
        correction: NDArray[np.float64] | None = None,
    ) -> NavState:
        """Replace the state at the entry of that stamp and integrate the samples since again.

        Parameters
        ----------
        stamp_ns : int
            Of an entry.
        state : NavState
        gyro_bias, accel_bias : 3 floats
            Removed from the samples, rad/s and m/s².
        correction : ndarray, shape (6, 6), optional
            Multiplies the readings before.

        Returns
        -------
        NavState
            At the newest stamp.
        """
        later: list[Entry] = []
        while self._entries[-1].stamp_ns > stamp_ns:
            later.append(self._entries.pop())
        start = self._entries.pop()
        self._entries.append(start._replace(state=state))
        if not later:
            return state
        later.reverse()
        samples = np.array([entry.raw for entry in (start, *later)])
        if correction is not None:
            samples[:, 1:] = samples[:, 1:] @ correction.T
        states = strapdown.integrate(
            state,
            tuple(samples[0].tolist()),
            samples[1:],
            gyro_bias,
            accel_bias,
            instantaneous=self._instantaneous,
            vertical=self._vertical,
            water_surface=self._water_surface,
        )
        for entry, row in zip(later, states.tolist(), strict=True):
            self._entries.append(entry._replace(state=NavState._make(row)))
        return self._entries[-1].state
