"""The last seconds of samples and states: finding entries, and running them again."""

import math

import numpy as np
import pytest

from ins_nav.mechanization import attitude, nav_state, strapdown
from ins_nav.mechanization.nav_state import NavState
from ins_nav.mechanization.replay_buffer import LENGTH_NS, Entry, ReplayBuffer
from ins_nav.mechanization.strapdown import Sample

STEP_NS = 20_000_000
BIAS = (1e-4, -2e-4, 3e-4)


def _without_bias(sample: Sample) -> Sample:
    h, wx, wy, wz, fx, fy, fz = sample
    return h, wx - BIAS[0], wy - BIAS[1], wz - BIAS[2], fx, fy, fz


def _filled(count: int, instantaneous: bool = False, vertical: bool = False) -> ReplayBuffer:
    """A history of random motion, biases removed as it went."""
    rng = np.random.default_rng(3)
    values = np.c_[rng.normal(0.0, 0.5, (count, 3)), [0.0, 0.0, 9.8] + rng.normal(0.0, 2.0, (count, 3))].tolist()
    history = ReplayBuffer(instantaneous, vertical)
    state = nav_state.initial_state(1.0, 0.5, 100.0, (3.0, 4.0, 0.0), attitude.from_euler(0.1, -0.2, 2.0))
    previous: Sample | None = None
    for i, row in enumerate(values):
        raw: Sample = (STEP_NS * 1e-9, *row)
        sample = _without_bias(raw)
        if previous is not None:
            block, settings = np.array([sample]), {"instantaneous": instantaneous, "vertical": vertical}
            state = NavState._make(strapdown.integrate(state, previous, block, **settings)[0].tolist())
        history.add(i * STEP_NS, raw, state)
        previous = sample
    return history


def _entries(history: ReplayBuffer) -> list[Entry]:
    return history.between(-1, 10**18)


def test_length_is_bounded() -> None:
    history = _filled(1000)  # 20 s
    stamps = [entry.stamp_ns for entry in _entries(history)]
    assert len(history) == len(stamps) == LENGTH_NS // STEP_NS + 1
    assert stamps[-1] == 999 * STEP_NS and stamps[0] == stamps[-1] - LENGTH_NS
    history.add(stamps[-1] + 100 * LENGTH_NS, (1.0,) * 7, (0.0,) * 12)  # after a gap the newest alone
    assert len(history) == 1
    history.clear()
    assert len(history) == 0


def test_finding_entries() -> None:
    history = _filled(100)
    assert history.at(50 * STEP_NS).stamp_ns == 50 * STEP_NS
    assert history.at(50 * STEP_NS + STEP_NS - 1).stamp_ns == 50 * STEP_NS  # not after the stamp
    assert history.at(10**18).stamp_ns == 99 * STEP_NS
    assert history.at(-1).stamp_ns == 0  # the oldest where all are
    stamps = [entry.stamp_ns // STEP_NS for entry in history.between(10 * STEP_NS, 13 * STEP_NS)]
    assert stamps == [11, 12, 13]
    assert history.between(13 * STEP_NS, 13 * STEP_NS) == history.between(13 * STEP_NS, 10 * STEP_NS) == []
    assert history.between(99 * STEP_NS, 10**18) == []


@pytest.mark.parametrize("instantaneous", [False, True])
@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("back", [0, 1, 7, 300, 600])
def test_run_again_with_nothing_changed_is_bit_for_bit_the_same(back: int, vertical: bool, instantaneous: bool) -> None:
    history = _filled(700, instantaneous, vertical)
    before = _entries(history)
    entry = before[-1 - back]
    assert history.reintegrate(entry.stamp_ns, entry.state, BIAS, (0.0, 0.0, 0.0)) == before[-1].state
    assert _entries(history) == before  # samples with their biases, and every state between


def test_run_again_from_another_state_with_another_bias() -> None:
    """As a run from there on its own; what came before stays."""
    history = _filled(700)
    before = _entries(history)
    start = 400
    state: NavState = nav_state.corrected(before[start].state, (3.0, -4.0, 0.0), (0.5, 0.1, 0.0), (1e-3, 2e-3, -1e-3))
    end = history.reintegrate(before[start].stamp_ns, state, (0.0,) * 3, (0.0,) * 3)
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
