"""What the filter of `delayed` found, on its way into the navigator: each takes effect at its time, once."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ins_nav.event_log import INFO, WARN, EventLog
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import Entry, ReplayBuffer

_AHEAD_NS = 5_000_000_000
"""ns ahead of the samples: a feedback of before a restart. All of 5 s may still wait in the queue of a topic."""
_FOLLOWS_NS = 5_000_000_000
"""ns after the last feedback took effect for which `alignment_node` is believed to be there."""


class Correction(NamedTuple):
    """What the filter found: a state of the past to go on from.

    Attributes
    ----------
    stamp_ns : int
        Of the state.
    apply_ns : int
        Stamp of the sample with which it takes effect: live and over a recording at the same one.
    state : NavState
    gyro_bias, accel_bias : 3 floats
        rad/s and m/s².
    covariance : ndarray, shape (SOLUTION_SIZE, SOLUTION_SIZE)
        Of the errors (`ins_nav.estimation.covariance_propagation.covariance_of`).
    aligned : bool
        Fine alignment is done.
    """

    stamp_ns: int
    apply_ns: int
    state: NavState
    gyro_bias: tuple[float, float, float]
    accel_bias: tuple[float, float, float]
    covariance: NDArray[np.float64]
    aligned: bool


class CorrectionQueue:
    """Correction that waits for its time.

    Parameters
    ----------
    events : EventLog
        Where it is counted what is left out.
    """

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self._waiting: list[Correction] = []
        self.followed_ns = 0
        """Stamp of the last state gone on from; 0 for none."""
        self._led_ns = 0

    def restart(self) -> None:
        """The stamps have jumped."""
        self._waiting.clear()
        self.followed_ns = self._led_ns = 0

    def clear(self) -> None:
        """What waits is of no use any more."""
        self._waiting.clear()

    def add(self, feedback: Correction, stamp_ns: int) -> bool:
        """Take one at the stamp of the newest sample; False where it is left out."""
        if feedback.stamp_ns > stamp_ns + _AHEAD_NS:
            ahead = (feedback.stamp_ns - stamp_ns) * 1e-9
            text = f"ins/feedback: {ahead:.1f} s ahead of imu/data_raw: left out"
            self._events.count("feedback ahead", INFO, text, stamp_ns)
            return False
        if feedback.stamp_ns <= max(self.followed_ns, *(f.stamp_ns for f in self._waiting), 0):
            text = "ins/feedback: older than the last, or repeated: left out"
            self._events.count("feedback repeated", INFO, text, stamp_ns)
            return False
        self._waiting.append(feedback)
        return True

    def is_due(self, stamp_ns: int) -> bool:
        """Whether one takes effect with the sample of that stamp."""
        return bool(self._waiting) and self._waiting[0].apply_ns <= stamp_ns

    def take(self, stamp_ns: int, history: ReplayBuffer) -> tuple[Correction, Entry] | None:
        """The newest that is due, with the sample and the state it corrects; None where they are not remembered."""
        due = (feedback for feedback in self._waiting if feedback.apply_ns <= stamp_ns)
        newest = max(due, key=lambda feedback: feedback.stamp_ns)
        self._waiting = [feedback for feedback in self._waiting if feedback.stamp_ns > newest.stamp_ns]
        entry = history.at(newest.stamp_ns)
        if entry.stamp_ns != newest.stamp_ns:  # too old, or that sample was lost here
            age = (stamp_ns - newest.stamp_ns) * 1e-9
            text = f"ins/feedback: of a time {age:.1f} s ago, of which nothing is remembered: left out"
            self._events.count("feedback lost", WARN, text, stamp_ns)
            return None
        self.followed_ns, self._led_ns = newest.stamp_ns, stamp_ns
        return newest, entry

    def follows(self, stamp_ns: int) -> bool:
        """Whether feedback has been coming lately."""
        return stamp_ns - self._led_ns < _FOLLOWS_NS
