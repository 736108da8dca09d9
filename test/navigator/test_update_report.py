"""Log lines about measurements: a rejection, a fault after some, a verdict."""

import itertools
import math

import numpy as np

from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import ErrorModel
from ins_nav.estimation.fault_hypotheses import Verdict
from ins_nav.estimation.filter_bank import FilterBank
from ins_nav.estimation.observation import Measurement
from ins_nav.estimation.state_layout import POSITION, SIZE
from ins_nav.event_log import WARN, EventLog
from ins_nav.navigator.update_report import report_update


def a_bank() -> FilterBank:
    model = ErrorModel(vertical=False, gyro_noise=1e-5, accel_noise=1e-3)
    return FilterBank(ErrorFilter(model, (1.0,) * 3, (0.1,) * 3, np.diag([1e-6, 1e-6, 1e-4])))


def test_rejected_measurements_become_a_fault() -> None:
    events, bank = EventLog(), a_bank()
    texts = []
    for second in range(1, 7):
        wrong = Measurement(np.array([50.0 if second > 1 else 0.0, 0.0]), np.eye(2, SIZE), np.eye(2), POSITION)
        update, verdict = bank.update("gnss", "gnss", second * 10**9, wrong)
        report_update(events, bank, "gnss/fix", "gnss", update, verdict)
        texts.append([(report.level, report.text) for report in events.drain()])
    assert not texts[0]
    assert texts[1] == [("info", texts[1][0][1])] and texts[1][0][1].startswith("gnss/fix: outside the gate: off by 50")
    faults = [text for level, text in itertools.chain.from_iterable(texts) if level == WARN]
    assert faults == ["gnss/fix: at fault, or the solution is: off by 50, not used"]
    assert events.counts["gnss at fault"] == 2 and events.counts["gnss rejected"] == 5


def test_a_verdict_is_a_warning() -> None:
    events, bank = EventLog(), a_bank()
    update, _ = bank.update("gnss", "gnss", 10**9, Measurement(np.zeros(2), np.eye(2, SIZE), np.eye(2), POSITION))
    report_update(events, bank, "gnss/fix", "gnss", update, Verdict.FAILED)
    (report,) = events.drain()
    assert report.level == WARN and report.text.startswith("the solution has failed: gnss/fix is off by 0")
    assert not math.isnan(update.test_ratio)
