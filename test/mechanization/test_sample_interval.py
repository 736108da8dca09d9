"""The interval between samples is learnt from any stream, all the time: gaps and lost samples are right afterwards."""

import math

import numpy as np
import pytest

from ins_nav.config.sections import ImuSection
from ins_nav.event_log import EventLog
from ins_nav.mechanization.imu_stream import ImuStream
from ins_nav.mechanization.sample_interval import FIRST_GAP

START = 1_700_000_000_000_000_000
MS = 1_000_000


class Fed:
    """A stream with its counts."""

    def __init__(self) -> None:
        self.events = EventLog()
        self.stream = ImuStream(self.events, ImuSection())
        self.now = START

    def steps_ms(self, *steps: float) -> None:
        for step in steps:
            self.now += round(step * MS)
            self.stream.accept(self.now, 0.0, 0.0, 0.0, 0.0, 0.0, 9.8)

    def lost(self) -> int:
        """Samples reported as lost since the last call."""
        return self.events.counts.pop("samples lost", 0)


def _knows(fed: Fed, interval_ms: float, longest_ms: float) -> None:
    """One sample lost is counted as one; nothing else is."""
    assert fed.stream.nominal == pytest.approx(1e-3 * interval_ms, rel=0.1)
    assert fed.stream.regular > 1e-3 * longest_ms
    fed.lost()


@pytest.mark.parametrize("burst", [5, 25, 200])
def test_a_backlog_at_the_start(burst: int) -> None:
    """Samples published at once, 0.1 ms apart, then 100 Hz: not a single one is lost."""
    fed = Fed()
    fed.steps_ms(*[0.1] * burst, *[10.0] * 1000)
    assert fed.events.counts == {}
    _knows(fed, 10.0, 10.0)
    fed.steps_ms(20.0)
    assert fed.lost() == 1


def test_a_long_backlog_at_the_start() -> None:
    """10 s of samples within 0.2 s: 5 kHz is believed until three windows say otherwise."""
    fed = Fed()
    fed.steps_ms(*[0.2] * 1000, *[10.0] * 200)
    _knows(fed, 10.0, 10.0)
    fed.steps_ms(*[10.0] * 1000)
    assert fed.lost() == 0


@pytest.mark.parametrize(("before", "after"), [(10.0, 20.0), (20.0, 10.0), (2.5, 100.0), (100.0, 2.5), (10.0, 5.0)])
def test_another_rate_under_way(before: float, after: float) -> None:
    """Known after two whole windows of the new rate, within 1.5 s or 75 samples; the line names both."""
    fed = Fed()
    fed.steps_ms(*[before] * 400)
    assert fed.events.counts == {}
    fed.steps_ms(*[after] * max(75, round(1500.0 / after)))
    _knows(fed, after, after)
    assert fed.events.counts["interval changes"] == 1
    assert f"{after:g} ms now, {before:g} ms before" in fed.events.drain()[-1].text
    fed.steps_ms(*[after] * 400)
    assert fed.lost() == 0
    fed.steps_ms(3.0 * after, after)
    assert fed.lost() == 2


@pytest.mark.parametrize("size", [2, 4, 10, 40])
def test_batches_with_the_stamps_of_their_arrival(size: int) -> None:
    """100 Hz read in batches: pauses are no gaps, the mean is known, the cause is named."""
    fed = Fed()
    batch = [*[0.1] * (size - 1), 10.0 * size - 0.1 * (size - 1)]
    fed.steps_ms(*batch * (2000 // size))
    assert set(fed.events.counts) == {"batches"}
    assert "stamps come in batches, 100 Hz in the mean" in fed.events.drain()[0].text
    _knows(fed, 10.0, batch[-1])
    fed.steps_ms(3.0 * batch[-1], 0.1)
    assert fed.lost() == pytest.approx(3 * size, abs=2)


def test_stalls_that_are_caught_up() -> None:
    """A publisher that stops for 0.2 s every 5 s and then publishes what it has: the interval stays."""
    fed = Fed()
    for _ in range(10):
        fed.steps_ms(*[10.0] * 480, 200.0, *[0.1] * 19)
        assert fed.stream.nominal == pytest.approx(0.01, rel=0.2)
    assert "batches" not in fed.events.counts and "interval changes" not in fed.events.counts


def test_one_stall_at_the_start() -> None:
    fed = Fed()
    fed.steps_ms(*[2.5] * 10, 240.0, *[2.5] * 400)
    assert fed.events.counts == {}  # nothing was known yet
    _knows(fed, 2.5, 2.5)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.25])
def test_lost_samples_do_not_change_the_interval(share: float) -> None:
    """At random, 100 Hz: counted to the sample once the interval is known."""
    fed = Fed()
    fed.steps_ms(*[10.0] * 100)
    rng = np.random.default_rng(1)
    kept = np.flatnonzero(np.append(rng.random(5000) >= share, True)) + 1
    fed.steps_ms(*(10.0 * np.diff(kept, prepend=0)))
    assert fed.stream.nominal == pytest.approx(0.01, rel=1e-3)
    assert fed.lost() == kept[-1] - len(kept)


@pytest.mark.parametrize("pattern", [(5.0, 15.0), (7.0, 10.0, 13.0), (3.0, 17.0)])
def test_jitter_is_no_gap(pattern: tuple[float, ...]) -> None:
    fed = Fed()
    fed.steps_ms(*pattern * 600)
    assert fed.lost() == 0
    assert fed.stream.nominal == pytest.approx(0.01, rel=0.05)


def test_unknown_at_first() -> None:
    fed = Fed()
    fed.steps_ms(*[10.0] * 10)
    assert math.isnan(fed.stream.nominal) and fed.stream.regular == FIRST_GAP
