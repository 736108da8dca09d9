"""What went wrong and how often: counted for diagnostics, told without flooding the log."""

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
    """Counts events by kind and keeps the lines worth telling until `drain` takes them."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._told: dict[str, tuple[int, int]] = {}
        self._reports: list[Report] = []
        self._latest: dict[str, tuple[int, Report]] = {}

    def count(self, kind: str, level: str, text: str, stamp_ns: int) -> None:
        """Count an event; tell it when it is the first of its kind or the last telling was 10 s of data ago."""
        count = self.counts.get(kind, 0) + 1
        self.counts[kind] = count
        self._latest[kind] = (stamp_ns, Report(level, text))
        told_stamp, told_count = self._told.get(kind, (0, 0))
        if told_count and abs(stamp_ns - told_stamp) < _REPEAT_AFTER:
            return
        since = count - told_count - 1
        self._told[kind] = (stamp_ns, count)
        self._reports.append(Report(level, f"{text} ({since} more since the last report)" if since else text))

    def report(self, level: str, text: str) -> None:
        """A line that is always told."""
        self._reports.append(Report(level, text))

    def recent(self, stamp_ns: int) -> list[Report]:
        """The latest event of each kind that came in the last 10 s of data, latest last."""
        near = [entry for entry in self._latest.values() if abs(stamp_ns - entry[0]) < _REPEAT_AFTER]
        return [report for _, report in sorted(near, key=lambda entry: entry[0])]

    @property
    def pending(self) -> bool:
        """Whether `drain` has something to give."""
        return bool(self._reports)

    def drain(self) -> list[Report]:
        """The lines not yet taken, oldest first."""
        reports, self._reports = self._reports, []
        return reports
