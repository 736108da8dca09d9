"""The last seconds of samples and states: a state of the past is corrected, and what came after it run again."""

import itertools
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from ins_nav.mechanization import strapdown
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.strapdown import Sample

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
    instantaneous, vertical : bool
        As in `ins_nav.mechanization.strapdown.step`.
    """

    def __init__(self, instantaneous: bool, vertical: bool) -> None:
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

    def rerun(self, stamp_ns: int, state: NavState, without_bias: Callable[[Sample], Sample]) -> NavState:
        """Put a state at the entry of that stamp, and run what came after it again.

        Parameters
        ----------
        stamp_ns : int
            Of an entry.
        state : NavState
        without_bias : callable
            Takes the biases now in use from a sample.

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
        previous = without_bias(start.raw)
        for entry in reversed(later):
            sample = without_bias(entry.raw)
            state = strapdown.step(state, previous, sample, self._instantaneous, self._vertical)
            self._entries.append(Entry(entry.stamp_ns, entry.raw, state))
            previous = sample
        return state
