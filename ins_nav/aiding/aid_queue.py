"""Queue of observations: messages of aids are checked, wait, and leave in the order of their stamps."""

import heapq
import itertools
from collections.abc import Iterator, Mapping
from typing import Any

from ins_nav.aiding.base import Aid, Observation, Unusable
from ins_nav.aiding.registry import by_topic
from ins_nav.event_log import WARN, EventLog
from ins_nav.mechanization.stamped_rows import LENGTH_NS
from ins_nav.stamps import NS

_NEVER_NS = 2**62
_AHEAD_NS = 5 * NS
"""ns: a stamp further ahead of the IMU's is of another clock."""


def observe(aid: Aid[Any], message: Any, stamp_ns: int, events: EventLog) -> Observation | None:
    """A message as an observation; None where it is unusable, which is counted at the newest IMU sample's stamp."""
    try:
        return aid.observe(message)
    except Unusable as reason:
        events.count(f"{aid.name} {reason.kind}", reason.level, f"{aid.topic}: {reason}", stamp_ns)
        return None


class AidQueue:
    """Observations that wait for the filter.

    Parameters
    ----------
    aids : mapping of name to Aid
    events : EventLog

    Attributes
    ----------
    heard : set of str
        Names of the aids with a message since alignment began.
    """

    def __init__(self, aids: Mapping[str, Aid[Any]], events: EventLog) -> None:
        self._by_topic = by_topic(aids)
        self._events = events
        self._waiting: list[tuple[int, str, tuple[float, ...], int, Observation]] = []
        self._count = itertools.count()
        self._latest: dict[str, Observation] = {}
        self.restart()

    def restart(self) -> None:
        """Empty the queue at the start of alignment; there is no filter until `begin`."""
        self.heard: set[str] = set()
        self._began_ns = 0
        for aid in self._by_topic.values():
            aid.restart()

    def begin(self, stamp_ns: int) -> None:
        """Start of the filter at a stamp: drop older observations but the latest of aids that keep it."""
        self._began_ns = stamp_ns
        self._drop(stamp_ns)
        for observation in self._latest.values():
            if observation.stamp_ns <= stamp_ns:  # the others are in the queue
                self._push(observation)

    def add(self, topic: str, message: Any, now_ns: int, settled_ns: int) -> Observation | None:
        """Add a message.

        Parameters
        ----------
        topic : str
        message : message
            Of one of the aid's types.
        now_ns : int
            Stamp of the newest IMU sample; 0 before there is one.
        settled_ns : int
            Stamp of the filter's state; 0 before there is one.

        Returns
        -------
        Observation or None
            Also one that is not used for the filter: too late, too early, or of an aid that is not enabled.
        """
        aid = self._by_topic.get(topic)
        if aid is None:
            return None
        observation = observe(aid, message, now_ns, self._events)
        if aid.parameters.enabled and (now_ns or aid.KEEPS_LATEST):
            self.heard.add(aid.name)
            if observation is not None and self._is_timely(aid, observation, now_ns, settled_ns):
                if aid.KEEPS_LATEST:
                    self._latest[aid.name] = max(observation, self._latest.get(aid.name, observation), key=_order)
                if now_ns:
                    self._push(observation)
                if now_ns and not settled_ns:  # the filter begins later
                    self._drop(now_ns - LENGTH_NS)
        return observation

    @property
    def next_ns(self) -> int:
        """Stamp of the next observation; far in the future where there is none."""
        return self._waiting[0][0] if self._waiting else _NEVER_NS

    def until(self, stamp_ns: int) -> Iterator[Observation]:
        """Remove the observations up to a stamp, in their order."""
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            yield heapq.heappop(self._waiting)[-1]

    def _push(self, observation: Observation) -> None:
        # content before the serial: the order of arrival must not matter
        heapq.heappush(self._waiting, (*_order(observation), next(self._count), observation))

    def _drop(self, until_ns: int) -> None:
        for _ in self.until(until_ns):
            pass

    def _is_timely(self, aid: Aid[Any], observation: Observation, now_ns: int, settled_ns: int) -> bool:
        """Neither older than the filter's state, unless the aid can use that, nor of another clock."""
        stamp_ns = observation.stamp_ns
        if stamp_ns <= settled_ns:
            late = (now_ns - stamp_ns) * 1e-9
            used, level, text = aid.late(late)
            if stamp_ns > self._began_ns or (level == WARN and aid.KEEPS_LATEST):
                text = f"{aid.topic}: {late:.2f} s behind imu/data_raw, {text}"
                self._events.count(f"{aid.name} late", level, text, now_ns)
            return used
        if now_ns and stamp_ns - now_ns > _AHEAD_NS:
            ahead = (stamp_ns - now_ns) * 1e-9
            text = f"{aid.topic}: {ahead:.1f} s ahead of imu/data_raw, rejected: both must be stamped by one clock"
            self._events.count(f"{aid.name} ahead", WARN, text, now_ns)
            return False
        return True


def _order(observation: Observation) -> tuple[int, str, tuple[float, ...]]:
    return observation.stamp_ns, observation.aid, observation.value
