"""Corrections of the delayed filter on their way into the real-time navigator: each takes effect at its time, once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.event_log import INFO, WARN, EventLog
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import Entry, ReplayBuffer

_AHEAD_NS = 5_000_000_000
"""ns ahead of the samples: a correction from before a restart. All of 5 s may still wait in the queue of a topic."""
_LEADS_NS = 5_000_000_000
"""ns after the last correction took effect until its source counts as lost."""
NEVER_NS = 2**63 - 1
_MOST = 100
"""Corrections that may wait: 50 s of them at the rate of their source, ten times what may be ahead."""


class Correction(NamedTuple):
    """A corrected state of the past, from which the solution is re-integrated.

    Attributes
    ----------
    stamp_ns : int
        Of the state.
    apply_ns : int
        Stamp of the sample with which it takes effect: the same one live and over a recording.
    state : NavState
    gyro_bias, accel_bias : 3 floats
        rad/s and m/s².
    covariance : ndarray, shape (15, 15)
        Of the errors, as `ins_nav.estimation.error_model` defines them.
    aligned : bool
        Fine alignment is done.
    imu_errors : tuple of float
        Further errors of the IMU that correct samples (`ins_nav.estimation.imu_error`); empty: none.
    """

    stamp_ns: int
    apply_ns: int
    state: NavState
    gyro_bias: tuple[float, float, float]
    accel_bias: tuple[float, float, float]
    covariance: NDArray[np.float64]
    aligned: bool
    imu_errors: tuple[float, ...] = ()


class CorrectionQueue:
    """Corrections from one source that wait for their time.

    Parameters
    ----------
    events : EventLog
        Counts what is rejected.
    topic : str
        Of the source, for people.

    Attributes
    ----------
    corrected_ns : int
        Stamp of the last state that a correction replaced; 0 for none.
    leads_until_ns : int
        5 s after a correction took effect; 0 for none.
    """

    def __init__(self, events: EventLog, topic: str) -> None:
        self._events = events
        self._topic = topic
        self.restart()

    def restart(self) -> None:
        """Forget everything: the stamps have jumped."""
        self._waiting: list[Correction] = []
        self.corrected_ns = self.leads_until_ns = 0

    def clear(self) -> None:
        """Drop what waits."""
        self._waiting.clear()

    def add(self, correction: Correction, stamp_ns: int) -> bool:
        """Queue a correction at the stamp of the newest sample; False where it is rejected.

        One that is not newer than the last is rejected, so is one from before a restart.
        """
        if correction.stamp_ns > stamp_ns + _AHEAD_NS:
            ahead = (correction.stamp_ns - stamp_ns) * 1e-9
            text = f"{self._topic}: {ahead:.1f} s ahead of imu/data_raw: rejected"
            self._events.count("correction ahead", INFO, text, stamp_ns)
            return False
        newest = max((waiting.stamp_ns for waiting in self._waiting), default=0)
        if correction.stamp_ns <= max(self.corrected_ns, newest):
            text = f"{self._topic}: not newer than the last: rejected"
            self._events.count("correction repeated", INFO, text, stamp_ns)
            return False
        if len(self._waiting) == _MOST:
            text = f"{self._topic}: {_MOST} corrections wait and none is due: the oldest is dropped"
            self._events.count("corrections dropped", WARN, text, stamp_ns)
            del self._waiting[0]
        self._waiting.append(correction)
        return True

    @property
    def due_ns(self) -> int:
        """Stamp from which the next takes effect; far in the future where none waits."""
        return self._waiting[0].apply_ns if self._waiting else NEVER_NS

    def pop(self, stamp_ns: int, buffer: ReplayBuffer) -> tuple[Correction, Entry] | None:
        """The newest that is due, with the entry it corrects; None where the buffer has no entry of its stamp."""
        due = (correction for correction in self._waiting if correction.apply_ns <= stamp_ns)
        newest = max(due, key=lambda correction: correction.stamp_ns)
        self._waiting = [correction for correction in self._waiting if correction.stamp_ns > newest.stamp_ns]
        entry = buffer.at(newest.stamp_ns)
        if entry.stamp_ns != newest.stamp_ns:  # too old, or that sample was lost here
            age = (stamp_ns - newest.stamp_ns) * 1e-9
            text = f"{self._topic}: corrects a state {age:.1f} s ago, which is not in the replay buffer: rejected"
            self._events.count("correction lost", WARN, text, stamp_ns)
            return None
        self.corrected_ns, self.leads_until_ns = newest.stamp_ns, stamp_ns + _LEADS_NS
        return newest, entry

    def leads(self, stamp_ns: int) -> bool:
        """Whether a correction took effect within the last 5 s."""
        return stamp_ns < self.leads_until_ns
