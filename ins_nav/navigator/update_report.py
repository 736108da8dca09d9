"""Log lines about measurements: rejected ones, faults of sources, a solution that has failed."""

from ins_nav.estimation.fault_hypotheses import Verdict
from ins_nav.estimation.filter_bank import FilterBank
from ins_nav.estimation.observation import Update
from ins_nav.event_log import INFO, WARN, EventLog

_FAULTY = 4
"""Rejected measurements of a source that are reported as its fault."""
_VERDICTS = {
    Verdict.FAILED: "the solution has failed: {topic} is off by {size:.3g}; continuing from the aids, IMU on probation",
    Verdict.RESTORED: "the solution had not failed: {topic} restores the one before",
    Verdict.RECOVERED: "the IMU agrees with the aids again: no longer on probation",
}


def report_update(
    events: EventLog, bank: FilterBank, topic: str, source: str, update: Update, verdict: Verdict
) -> None:
    """Report a measurement that was not simply accepted.

    Parameters
    ----------
    events : EventLog
    bank : FilterBank
        After the update.
    topic : str
        Name of the measurement for people.
    source : str
        As of `FilterBank.update`.
    update : Update
    verdict : Verdict
    """
    size, stamp_ns = max(map(abs, update.innovation)), update.stamp_ns
    if verdict.replaced:
        events.report(WARN, _VERDICTS[verdict].format(topic=topic, size=size))
    elif not update.accepted:
        text = f"{topic}: {update.reason}: off by {size:.3g}, test ratio {update.test_ratio:.1f}"
        events.count(f"{update.aid} rejected", INFO, text, stamp_ns)
        if bank.hypotheses.suspects.get(source, 0) >= _FAULTY:
            text = f"{topic}: at fault, or the solution is: off by {size:.3g}, not used"
            events.count(f"{source} at fault", WARN, text, stamp_ns)


def report_contradictions(events: EventLog, bank: FilterBank, stamp_ns: int) -> None:
    """Report sources that contradict the others."""
    for one in bank.separation.contradictions():
        text = f"{one.source}: contradicts the other sources by {one.separation:.3g} m, {one.height:.3g} m up"
        events.count(f"{one.source} contradicts", WARN, text, stamp_ns)
