"""Events: counted for diagnostics, reported at a limited rate."""

from dataclasses import dataclass

INFO, WARN, ERROR = "info", "warn", "error"
_REPEAT_AFTER = 10_000_000_000
"""ns of data time between two reports of the same kind."""


@dataclass(frozen=True)
class Report:
    """One line for the log."""

    level: str
    text: str


class EventLog:
    """Counts events by kind and queues lines for the log until `drain`."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._reported: dict[str, tuple[int, int]] = {}
        self._reports: list[Report] = []
        self._latest: dict[str, tuple[int, Report]] = {}

    def count(self, kind: str, level: str, text: str, stamp_ns: int) -> None:
        """Count an event; report it if it is the first of its kind or the last report is 10 s of data ago."""
        count = self.counts.get(kind, 0) + 1
        self.counts[kind] = count
        self._latest[kind] = (stamp_ns, Report(level, text))
        reported_ns, reported_count = self._reported.get(kind, (0, 0))
        if reported_count and abs(stamp_ns - reported_ns) < _REPEAT_AFTER:
            return
        since = count - reported_count - 1
        self._reported[kind] = (stamp_ns, count)
        self._reports.append(Report(level, f"{text} ({since} more since the last report)" if since else text))

    def report(self, level: str, text: str) -> None:
        """Report a line that is not throttled."""
        self._reports.append(Report(level, text))

    def recent(self, stamp_ns: int) -> list[Report]:
        """The latest event of each kind within the last 10 s of data, latest last."""
        near = [entry for entry in self._latest.values() if abs(stamp_ns - entry[0]) < _REPEAT_AFTER]
        return [report for _, report in sorted(near, key=lambda entry: entry[0])]

    @property
    def pending(self) -> bool:
        """Whether lines are queued."""
        return bool(self._reports)

    def drain(self) -> list[Report]:
        """Return the queued lines, oldest first, and empty the queue."""
        reports, self._reports = self._reports, []
        return reports
