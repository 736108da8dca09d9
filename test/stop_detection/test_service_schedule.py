"""Which calibration service is called when."""

from ins_nav.config.sections import StopDetectorSection
from ins_nav.stop_detection.service_schedule import ServiceSchedule


def calls(schedule: ServiceSchedule, length: int, success: bool) -> list[tuple[str, int]]:
    """Calls in a stop of so many seconds, each answered at once."""
    called = []
    schedule.arrive()
    for second in range(length):
        while second * 10**9 >= schedule.due_ns:
            called.append((schedule.take(), second))
            schedule.answered(called[-1][0], schedule.stop, success)
    return called


def test_start_sequence() -> None:
    schedule = ServiceSchedule(StopDetectorSection("zupt1", 10.0, 20.0))
    both = ("zupt1", "zupt2")
    assert calls(schedule, 45, False) == [(name, second) for second in (10, 30) for name in both]
    assert calls(schedule, 45, True) == [("zupt1", 10), ("zupt2", 20), ("zupt2", 40)]
    assert calls(schedule, 9, True) == []
    assert calls(schedule, 15, True) == [("zupt1", 10)]
    assert calls(schedule, 90, True) == [("zupt2", 20), ("zupt2", 40), ("zupt2", 80)]
    schedule.restart()
    assert calls(schedule, 15, True) == [("zupt1", 10)]
    assert calls(ServiceSchedule(StopDetectorSection("zupt2", 10.0, 20.0)), 30, True) == [("zupt2", 20)]
    none = ServiceSchedule(StopDetectorSection("none", 10.0, 20.0))
    assert calls(none, 100, True) == []
    assert calls(none, 30, True) == [("zupt2", 20)]


def test_waits_for_the_answer() -> None:
    schedule = ServiceSchedule(StopDetectorSection("zupt1", 10.0, 20.0))
    schedule.arrive()
    first = schedule.take()
    assert schedule.due_ns > 3600 * 10**9  # not before the answer
    schedule.arrive()
    assert schedule.due_ns == 10 * 10**9  # nor does the next stop wait for a lost answer
    schedule.answered(first, 1, False)  # late, of another stop: changes nothing
    assert schedule.due_ns == 10 * 10**9
