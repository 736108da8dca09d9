"""Corrections as messages; those of a whole run are in test_correction.py of the navigator."""

import numpy as np

from ins_nav.estimation.state_layout import SOLUTION_SIZE
from ins_nav.event_log import EventLog
from ins_nav.mechanization.nav_state import initial_state
from ins_nav.messages.correction_codec import fill_feedback, received_feedback
from ins_nav.navigator.correction import Correction
from ins_nav.recordings.bags import message

STAMP_NS = 1_700_000_000_123_456_789


def test_a_malformed_message_is_an_event() -> None:
    state = initial_state(0.9, 0.5, 10.0, (1.0, 2.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    sent = Correction(STAMP_NS, STAMP_NS + 1, state, (1e-6,) * 3, (1e-3,) * 3, np.eye(SOLUTION_SIZE), True)
    content, events = message("std_msgs/msg/Float64MultiArray"), EventLog()
    fill_feedback(content, sent)
    back = received_feedback(content, "ins/feedback", events, STAMP_NS)
    assert back is not None and back[:5] == sent[:5] and not events.counts
    np.testing.assert_array_equal(back.covariance, sent.covariance)
    content.data = content.data[:-1]
    assert received_feedback(content, "ins/feedback", events, STAMP_NS) is None
    assert events.counts == {"ins/feedback malformed": 1}
    assert events.drain()[0].text == (
        f"ins/feedback: {len(content.data)} numbers in an unknown form, rejected: do all nodes have one version?"
    )
