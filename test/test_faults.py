"""The bench of faults: rows that run to their end, and what a row says of errors and reports."""

import math
from functools import partial

import numpy as np
import pytest

from bench import fault_injection as inject
from bench.fault_injection import Fault, Span
from bench.fault_run import COMPONENTS, PROTECTED, Line, Run, Track, recording_of
from bench.fault_table import CARRIERS, FIX, ROWS, Carrier, Row, simulated
from bench.faults import chosen, evaluate, summary, track_of
from ins_nav.errors import InsNavError

SHORT = Carrier(
    "vehicle",
    {"duration": 110.0, "stand_time": 24.0, "rate": 50.0},
    {"alignment.duration": 20.0, "alignment.fine_duration": 40.0},
    45.0,
)
JUMP = Fault((FIX,), partial(inject.offset, size=[1e-3, 0.0, 0.0]), Span(60.0, 80.0))


def row(*faults: Fault) -> Row:
    return Row("short", "jump" if faults else "none", faults, faults[0].span if faults else Span(45.0), FIX)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CARRIERS, "short", SHORT)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_two_rows_end_to_end() -> None:
    clean, track = track_of(row(), 1), track_of(row(JUMP), 1)
    usual, result = (evaluate(row(*faults), x, clean) for faults, x in (((), clean), ((JUMP,), track)))
    assert not track.raised
    # fixes of 1 m, the solution is better; 0.001 deg of latitude are 111 m, and the gate rejects such a jump
    assert usual.error[0] < 5.0
    assert usual.none_time == 0.0
    assert track.counts["gnss rejected"] > clean.counts.get("gnss rejected", 0)
    assert result.error[0] < 20.0
    assert "short: jump" in result.text()


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_a_fork_goes_on_as_the_run_itself() -> None:
    simulation = simulated("short", 1)
    faulty = JUMP(recording_of(simulation))
    whole = Run(simulation, faulty, SHORT.parameters).until().track
    track = track_of(row(JUMP), 1)
    np.testing.assert_array_equal(track.error, whole.error)
    assert track.lines == whole.lines


@pytest.mark.usefixtures("short")
def test_an_exception_is_in_the_row() -> None:
    recording = {**recording_of(simulated("short", 1))}
    recording[FIX] = recording[FIX]._replace(values=recording[FIX].values[:, :2])  # a message that cannot be made
    clean = constant(0.1)
    result = evaluate(row(JUMP), Run(simulated("short", 1), recording, SHORT.parameters).until().track, clean)
    assert "TypeError" in result.report
    assert result.fails == ["raised"]
    assert math.isinf(result.right)


def constant(error: float, *lines: Line, level: float = math.nan, begin: float = 60.0, end: float = 80.0) -> Track:
    """A track with sigmas of 1 and errors of 0.1, but between two times."""
    time = np.arange(0.5, 110.0, 0.5)
    errors = np.full((len(time), len(COMPONENTS)), 0.1)
    errors[(time >= begin) & (time < end), 0] = error
    return Track(time, errors, np.ones_like(errors), np.full((len(time), PROTECTED), level), list(lines), {}, "")


@pytest.mark.usefixtures("short")
def test_a_report_in_time_is_no_failure() -> None:
    clean = constant(0.1)
    silent = evaluate(row(JUMP), constant(9.0, level=2.0), clean)
    assert silent.fails == ["over its protection level, unreported", "over 5 sigma, unreported"]
    assert silent.over_time == 20.0
    assert silent.level == 4.5
    reported = evaluate(row(JUMP), constant(9.0, Line(64.0, "gnss/fix: jumped"), level=2.0), clean)
    assert reported.fails == ["over 5 sigma, reported"]
    assert reported.reported == 4.0
    assert "9" in summary([silent, reported])


@pytest.mark.usefixtures("short")
def test_diagnostics_count_where_they_name_the_source_and_say_something_new() -> None:
    usual = Line(20.0, "log: silent for 3 s")
    lines = (usual._replace(time=61.0), Line(62.0, "depth: off", True), Line(63.0, "gnss/fix: off", True))
    assert evaluate(row(JUMP), constant(9.0, *lines), constant(0.1, usual)).reported == 3.0


@pytest.mark.usefixtures("short")
def test_right_again_counts_from_the_end_of_the_fault() -> None:
    clean = constant(0.1)
    assert evaluate(row(JUMP), constant(9.0), clean).right == 0.0
    assert evaluate(row(JUMP), constant(9.0, end=90.0), clean).right == 9.5
    assert math.isinf(evaluate(row(JUMP), constant(9.0, end=120.0), clean).right)


def test_there_are_sixty_rows_of_three_carriers() -> None:
    assert len(ROWS) >= 60
    assert all(len(chosen(f"{carrier}*")) > 15 for carrier in ("vehicle", "dive", "MEMS car"))
    with pytest.raises(InsNavError, match="no row matches"):
        chosen("submarine")


@pytest.mark.parametrize("carrier", CARRIERS)
def test_every_row_has_messages_to_change(carrier: str) -> None:
    recording = recording_of(simulated(carrier, 1))
    for entry in (entry for entry in ROWS.values() if entry.carrier == carrier):
        for fault in entry.faults:
            (topic,) = fault.topics
            after = fault(recording)
            changed = [a is not b for a, b in zip(after[topic], recording[topic], strict=True)]
            assert any(changed), entry.name
            assert recording[topic].within(fault.span).any(), entry.name
