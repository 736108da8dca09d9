"""Fine alignment ends by the sigma of heading, or by time."""

import pytest

from ins_nav.alignment.fine_alignment import FineAlignment
from ins_nav.config.sections import AlignmentSection


def test_end_by_time_alone() -> None:
    fine = FineAlignment(AlignmentSection(fine_heading=0.0, fine_duration=300.0))
    assert fine.end(1e-9, 299.9) == ""
    assert fine.end(1.0, 300.0) == "alignment.fine_duration (300 s) reached"
    assert fine.time_left(1.0, 100.0) == 200.0 and fine.time_left(1.0, 400.0) == 0.0


def test_end_by_sigma() -> None:
    fine = FineAlignment(AlignmentSection(fine_heading=0.01, fine_duration=300.0))
    assert fine.end(0.011, 50.0) == "" and fine.end(0.01, 50.0) == "its target reached"
    # sigma falls to an eighth in four times the time
    assert fine.time_left(0.08, 20.0) == pytest.approx(60.0)
    assert fine.time_left(0.005, 20.0) == 0.0
    assert fine.time_left(10.0, 100.0) == 200.0  # time comes first
