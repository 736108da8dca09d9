"""Topic `integrity`: without a solution, without a fault, with fixes at fault."""

from typing import Any

from aided_harness import PLACE, SHORT, Fed, aid_events, drive, imu_events

from ins_nav.messages.integrity import integrity

START = {**PLACE, **SHORT}


def shifted(events: list[Any], after_ns: int) -> list[Any]:
    """Fixes 50 m further north from a stamp on."""
    moved = []
    for stamp, number, kind, values in events:
        if stamp > after_ns:
            values = (*values[:2], values[2] + 50.0 / 111e3, *values[3:])
        moved.append((stamp, number, kind, values))
    return moved


def test_integrity_of_a_drive() -> None:
    s = drive()
    fed = Fed(START)
    assert integrity(fed.aided.delayed) == (1, "no solution: waiting", {})
    end = s.start_ns + 70 * 10**9
    imu, fixes = ([e for e in events if e[0] <= end] for events in (imu_events(s), aid_events(s)))
    level, text, values = integrity(Fed(START).feed(imu, fixes).aided.delayed)
    assert (level, text) == (0, "no fault")
    assert values["sources at fault"] == "none" and "gnss" in values["sources in use"]
    assert 0.1 < float(values["horizontal protection level"].split()[0]) < 50.0
    level, text, values = integrity(Fed(START).feed(imu, shifted(fixes, end - 15 * 10**9)).aided.delayed)
    assert level == 1 and "gnss is rejected" in text
    assert values["sources at fault"].startswith("gnss (")
