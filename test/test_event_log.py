"""All events are counted, and reported once in 10 s of data."""

from ins_nav.event_log import ERROR, INFO, WARN, EventLog, Report

S = 1_000_000_000


def test_a_kind_is_reported_once_in_ten_seconds() -> None:
    log = EventLog()
    for i in range(25):
        log.count("gap", WARN, f"gap {i}", i * S)
    assert log.counts == {"gap": 25}
    assert log.drain() == [
        Report(WARN, "gap 0"),
        Report(WARN, "gap 10 (9 more since the last report)"),
        Report(WARN, "gap 20 (9 more since the last report)"),
    ]
    assert log.drain() == []


def test_kinds_are_throttled_apart_and_a_report_is_not() -> None:
    log = EventLog()
    log.count("gap", WARN, "gap", 0)
    log.count("not finite", ERROR, "nan", 0)
    for _ in range(2):
        log.report(INFO, "aligned")
    assert log.pending
    assert [report.text for report in log.drain()] == ["gap", "nan", "aligned", "aligned"]
    assert not log.pending


def test_stamps_that_go_back_are_reported_again() -> None:
    """A recording that loops starts at its first stamp: 60 s before."""
    log = EventLog()
    log.count("gap", WARN, "gap", 60 * S)
    log.count("gap", WARN, "gap again", 0)
    assert [report.text for report in log.drain()] == ["gap", "gap again"]


def test_recent_is_the_latest_of_each_kind() -> None:
    log = EventLog()
    log.count("old", WARN, "old", 0)
    log.count("nan", ERROR, "second", 12 * S)
    log.count("gap", WARN, "first", 11 * S)
    log.count("gap", WARN, "third", 13 * S)
    assert [report.text for report in log.recent(15 * S)] == ["second", "third"]
