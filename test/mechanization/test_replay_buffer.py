"""The last seconds of samples and states: finding entries, and running them again."""

import math

import numpy as np
import pytest

from ins_nav.mechanization import attitude, nav_state, strapdown
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import Entry, ReplayBuffer
from ins_nav.mechanization.stamped_rows import LENGTH_NS, StampedRows
from ins_nav.mechanization.strapdown import NO_COMPENSATION, SAMPLE_SIZE, Compensation

STEP_NS = 20_000_000
COMPENSATION = Compensation((1e-4, -2e-4, 3e-4), (0.0, 0.0, 0.0))


def _filled(count: int, instantaneous: bool = False, vertical: bool = False) -> ReplayBuffer:
    """A history of random motion."""
    rng = np.random.default_rng(3)
    values = np.c_[rng.normal(0.0, 0.5, (count, 3)), [0.0, 0.0, 9.8] + rng.normal(0.0, 2.0, (count, 3))].tolist()
    samples = StampedRows(SAMPLE_SIZE)
    history = ReplayBuffer(samples, instantaneous, vertical)
    for i, row in enumerate(values):
        samples.append(i * STEP_NS, (STEP_NS * 1e-9, *row))
        if i == 0:
            history.begin(
                nav_state.initial_state(1.0, 0.5, 100.0, (3.0, 4.0, 0.0), attitude.from_euler(0.1, -0.2, 2.0))
            )
        else:
            history.integrate(1, COMPENSATION)
    return history


def _entries(history: ReplayBuffer) -> list[Entry]:
    entries = zip(*(array.tolist() for array in history.between(-1, 10**18)), strict=True)
    return [Entry(stamp_ns, tuple(raw), NavState._make(state)) for stamp_ns, raw, state in entries]


def test_at_least_the_last_seconds_are_stored() -> None:
    history = _filled(1000)  # 20 s
    oldest = history.at(0)
    assert oldest.stamp_ns == 999 * STEP_NS - LENGTH_NS
    assert _entries(history)[-1].stamp_ns == 999 * STEP_NS


def test_entries_before_the_first_state_do_not_exist() -> None:
    samples = StampedRows(SAMPLE_SIZE)
    history = ReplayBuffer(samples, False, False)
    state = nav_state.initial_state(1.0, 0.5, 100.0, (3.0, 4.0, 0.0), attitude.from_euler(0.1, -0.2, 2.0))
    for i in range(10):
        samples.append(i * STEP_NS, (STEP_NS * 1e-9, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8))
    history.begin(state)
    assert history.at(3 * STEP_NS).state == history.newest == state
    assert [entry.stamp_ns for entry in _entries(history)] == [9 * STEP_NS]


def test_finding_entries() -> None:
    history = _filled(100)
    assert history.at(50 * STEP_NS).stamp_ns == 50 * STEP_NS
    assert history.at(50 * STEP_NS + STEP_NS - 1).stamp_ns == 50 * STEP_NS  # not after the stamp
    assert history.at(10**18).stamp_ns == 99 * STEP_NS
    assert history.at(-1).stamp_ns == 0  # the oldest where all are
    assert (history.between(10 * STEP_NS, 13 * STEP_NS).stamps // STEP_NS).tolist() == [11, 12, 13]
    assert (history.last(2).stamps // STEP_NS).tolist() == [98, 99]
    for after, until in ((13, 13), (13, 10), (99, 200)):
        assert len(history.between(after * STEP_NS, until * STEP_NS).stamps) == 0


@pytest.mark.parametrize("instantaneous", [False, True])
@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("back", [0, 1, 7, 300, 600])
def test_run_again_with_nothing_changed_is_bit_for_bit_the_same(back: int, vertical: bool, instantaneous: bool) -> None:
    history = _filled(700, instantaneous, vertical)
    before = _entries(history)
    entry = before[-1 - back]
    assert history.reintegrate(entry.stamp_ns, entry.state, COMPENSATION) == before[-1].state
    assert _entries(history) == before  # samples with their biases, and every state between


def test_run_again_from_another_state_with_another_bias() -> None:
    """As a run from there on its own; what came before stays."""
    history = _filled(700)
    before = _entries(history)
    start = 400
    state: NavState = nav_state.corrected(before[start].state, (3.0, -4.0, 0.0), (0.5, 0.1, 0.0), (1e-3, 2e-3, -1e-3))
    end = history.reintegrate(before[start].stamp_ns, state, NO_COMPENSATION)
    after = _entries(history)
    assert after[:start] == before[:start]
    assert after[start].state == state and after[-1].state == end
    for earlier, later in zip(before[start:-1], before[start + 1 :], strict=True):
        state = NavState._make(
            strapdown.integrate(state, earlier.raw, np.array([later.raw]), vertical=False)[0].tolist()
        )
    assert end == state
    assert [entry.raw for entry in after] == [entry.raw for entry in before]
    assert math.dist(end[:4], before[-1].state[:4]) > 1e-4  # so that the test can fail
