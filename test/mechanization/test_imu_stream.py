"""The IMU's stream: every kind of bad input, what is counted, what is told."""

import math
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ins_nav.config.sections import ImuSection
from ins_nav.event_log import ERROR, INFO, WARN, EventLog, Report
from ins_nav.mechanization.imu_stream import TOPIC, ImuStream
from ins_nav.mechanization.strapdown import Sample

START = 1_700_000_000_000_000_000
STEP = 5_000_000
"""ns: 200 Hz."""
VALUES = (0.01, -0.02, 0.03, 0.1, 0.2, 9.8)
REJECTED = (
    "zero stamps",
    "stamp outliers",
    "repeated stamps",
    "backward stamps",
    "not finite",
    "rate out of range",
    "force out of range",
    "zero force",
)


class Fed:
    """A stream and all that came out of it."""

    def __init__(self, max_gap: float = 10.0, instantaneous: bool = False) -> None:
        self.events = EventLog()
        self.stream = ImuStream(
            self.events, ImuSection(max_gap=max_gap, sampling="instantaneous" if instantaneous else "averaged")
        )
        self.out: list[tuple[int, Sample | float]] = []

    def put(self, stamp_ns: int, values: tuple[float, ...] = VALUES) -> tuple[tuple[int, Sample | float], ...]:
        out = self.stream.accept(stamp_ns, *values)  # type: ignore[arg-type]
        self.out += out
        return out

    def regular(self, count: int, start_ns: int = START, step_ns: int = STEP) -> int:
        """So many good samples; the stamp of the next."""
        for i in range(count):
            self.put(start_ns + i * step_ns)
        return start_ns + count * step_ns

    @property
    def counts(self) -> dict[str, int]:
        return self.events.counts

    @property
    def rejected(self) -> int:
        return sum(self.counts.get(kind, 0) for kind in REJECTED)

    def said(self) -> Report:
        """The one line told since the last time."""
        (report,) = self.events.drain()
        return report


def _intervals(out: Iterable[tuple[int, Sample | float]]) -> list[float]:
    return [item[0] for _, item in out if isinstance(item, tuple)]


def test_good_samples_pass_unchanged() -> None:
    fed = Fed()
    fed.regular(100)
    assert [stamp for stamp, _ in fed.out] == [START + i * STEP for i in range(100)]
    assert _intervals(fed.out) == [0.0] + [pytest.approx(0.005, abs=1e-15)] * 99
    assert all(isinstance(item, tuple) and item[1:] == VALUES for _, item in fed.out)
    assert fed.stream.nominal == pytest.approx(0.005)
    assert (fed.stream.received, fed.stream.accepted, fed.counts, fed.events.drain()) == (100, 100, {}, [])


@pytest.mark.parametrize("rate", [5.0, 10.0, 62.5, 400.0, 2000.0])
def test_rates_and_jitter(rate: float) -> None:
    """Stamps off by up to 30 % of an interval are not gaps."""
    fed = Fed()
    stamps = [START + round((i + 0.3 * math.sin(i)) / rate * 1e9) for i in range(300)]
    for stamp in stamps:
        fed.put(stamp)
    assert fed.stream.accepted == 300
    assert fed.counts == {}
    assert sum(_intervals(fed.out)) == pytest.approx((stamps[-1] - stamps[0]) * 1e-9, abs=1e-9)
    assert fed.stream.nominal == pytest.approx(1.0 / rate, rel=0.1)


@pytest.mark.parametrize("field", range(6))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_not_finite(field: int, bad: float) -> None:
    fed = Fed()
    stamp = fed.regular(50)
    values = list(VALUES)
    values[field] = bad
    assert fed.put(stamp, tuple(values)) == ()
    report = fed.said()
    name = f"{('angular_velocity', 'linear_acceleration')[field // 3]}.{'xyz'[field % 3]}"
    assert report.level == ERROR
    assert report.text.startswith(f"{TOPIC}: {name} is {bad}, sample rejected: the driver must not")
    assert fed.counts == {"not finite": 1}
    # the next sample covers the lost one: a gap of two intervals
    ((_, sample),) = fed.put(stamp + STEP)
    assert isinstance(sample, tuple) and sample[0] == pytest.approx(0.01)
    assert fed.counts == {"not finite": 1, "gaps": 1, "samples lost": 1}


def test_degrees_and_wild_values() -> None:
    fed = Fed()
    stamp = fed.regular(50)
    assert fed.put(stamp, (100.0, 0.0, 0.0, 0.0, 0.0, 9.8)) == ()
    text = fed.said().text
    assert TOPIC in text and "100.0 rad/s" in text and "imu.max_angular_velocity (35)" in text
    assert "deg/s? publish rad/s" in text
    assert fed.put(stamp, (0.0, 0.0, 0.0, 0.0, 0.0, 1e200)) == ()
    text = fed.said().text
    assert TOPIC in text and "imu.max_linear_acceleration (400)" in text and "check its unit" in text
    assert fed.put(stamp, (1e308, 1e308, 0.0, 0.0, 0.0, 9.8)) == ()
    assert fed.counts == {"rate out of range": 2, "force out of range": 1}
    assert len(fed.put(stamp)) == 1  # the good sample of that stamp is still welcome


def test_no_force_at_all_is_no_measurement() -> None:
    fed = Fed()
    then = fed.regular(30)
    assert fed.put(then, (0.01, -0.02, 0.03, 0.0, 0.0, 0.0)) == ()
    assert fed.put(then + STEP)
    assert fed.counts["zero force"] == 1
    assert "linear_acceleration is exactly 0" in fed.said().text


def test_repeated_stamp() -> None:
    fed = Fed()
    stamp = fed.regular(50)
    assert fed.put(stamp - STEP) == ()
    report = fed.said()
    assert (report.level, f"stamp {stamp - STEP} ns repeated" in report.text) == (WARN, True)
    assert "published twice?" in report.text
    assert _intervals(fed.put(stamp)) == [pytest.approx(0.005)]
    assert fed.counts == {"repeated stamps": 1}


def test_backward_stamp() -> None:
    fed = Fed()
    stamp = fed.regular(50)
    assert fed.put(stamp - 3 * STEP) == ()
    assert f"{TOPIC}: stamp goes back by 0.010000 s, sample rejected" in fed.said().text
    assert _intervals(fed.put(stamp)) == [pytest.approx(0.005)]
    assert fed.counts == {"backward stamps": 1}


@pytest.mark.parametrize("jump", [-1e6, -5.0, 2.0, 5.0, 1e6])
def test_one_wild_stamp_costs_one_sample(jump: float) -> None:
    fed = Fed()
    stamp = fed.regular(50)
    before = fed.stream.accepted
    assert fed.put(stamp + round(jump * 1e9)) == ()
    assert fed.events.drain() == []  # wait and see
    ((_, sample),) = fed.put(stamp + STEP)
    assert isinstance(sample, tuple) and sample[0] == pytest.approx(0.01)
    texts = [report.text for report in fed.events.drain()]
    assert f"{TOPIC}: one stamp jumped by {jump + 0.005:+.3f} s, sample rejected: check the driver's clock" in texts
    fed.regular(50, stamp + 2 * STEP)
    assert fed.stream.accepted == before + 51
    assert fed.counts == {"stamp outliers": 1, "gaps": 1, "samples lost": 1}
    assert sum(_intervals(fed.out)) == pytest.approx(0.005 * 101)  # nothing of the time is lost


def test_gap_is_bridged_and_counted() -> None:
    fed = Fed()
    stamp = fed.regular(50) + 400 * STEP
    assert fed.put(stamp) == ()  # a jump ahead is believed when the next goes on from it
    out = fed.put(stamp + STEP)
    assert [s for s, _ in out] == [stamp, stamp + STEP]
    assert _intervals(out) == [pytest.approx(2.005), pytest.approx(0.005)]
    text = fed.said().text
    assert f"{TOPIC}: gap of 2.005 s, about 400 samples lost, bridged by interpolation: check the QoS depth" in text
    assert fed.counts == {"long gaps": 1, "samples lost": 400}


def test_lost_samples_are_put_on_the_line_between_their_neighbours() -> None:
    """Rates that grow linearly: the mean over two intervals is then exact; a value at its stamp needs no change."""
    for instantaneous in (False, True):
        fed = Fed(instantaneous=instantaneous)
        for i in range(60):
            if i != 50:
                fed.put(START + i * STEP, (0.01 * i, 0.0, 0.0, 0.0, 0.0, 9.8))
        ((_, sample),) = [(s, x) for s, x in fed.out if s == START + 51 * STEP]
        assert isinstance(sample, tuple)
        # lost: 0.50; came: 0.51; the mean over both intervals is half their sum, the neighbours' is as good
        mean = 0.51 if instantaneous else 0.5 * (0.5 * (0.49 + 0.51) + 0.51)
        assert sample[:2] == (pytest.approx(0.01), pytest.approx(mean))
        assert fed.counts == {"gaps": 1, "samples lost": 1}


def test_gap_beyond_the_limit_starts_again() -> None:
    fed = Fed(max_gap=10.0)
    stamp = fed.regular(50) + 11_000_000_000
    fed.put(stamp)
    out = fed.put(stamp + STEP)
    assert out[0] == (stamp, pytest.approx(11.005))
    assert _intervals(out) == [0.0, pytest.approx(0.005)]
    report = fed.said()
    assert report.level == WARN
    assert "stamps jumped by +11.005 s (ahead, more than imu.max_gap (10 s)): starting again" in report.text
    assert fed.counts == {"restarts": 1}


def test_looped_bag_starts_again() -> None:
    fed = Fed()
    for _ in range(3):
        fed.regular(400)
    restarts = [item for _, item in fed.out if isinstance(item, float)]
    assert restarts == [pytest.approx(-399 * 0.005)] * 2
    assert fed.stream.accepted == 1200
    assert fed.counts == {"restarts": 2}
    assert "(back): starting again" in fed.said().text  # told once within 10 s of data


def test_restart_at_another_rate() -> None:
    fed = Fed()
    fed.regular(100, step_ns=2_500_000)
    fed.regular(100, start_ns=START + 60_000_000_000, step_ns=100_000_000)
    assert fed.stream.nominal == pytest.approx(0.1)
    assert fed.counts == {"restarts": 1}


def test_zero_and_negative_stamps() -> None:
    fed = Fed()
    for stamp in (0, 0, -5):
        assert fed.put(stamp) == ()
    report = fed.said()
    assert report.level == ERROR
    assert f"{TOPIC}: header.stamp is 0 ns, sample rejected: the driver must stamp its messages" in report.text
    fed.regular(30)
    assert fed.put(0) == ()
    assert fed.counts == {"zero stamps": 4}
    assert fed.stream.accepted == 30


@pytest.mark.parametrize("step_ns", [500_000_000, -2_000_000_000, 3_000_000_000])
def test_stamps_that_never_follow_each_other_are_told(step_ns: int) -> None:
    """2 Hz, or a clock that jumps at every message: no silence."""
    fed = Fed()
    fed.regular(20, start_ns=START, step_ns=step_ns)
    assert fed.stream.accepted == 1
    assert fed.counts == {"stamp outliers": 18}  # one is still waiting for its successor
    text = fed.events.drain()[0].text
    assert TOPIC in text and "stamps jump at every message" in text and "4 Hz is too slow" in text


def test_reports_do_not_flood() -> None:
    """200 Hz of rubbish for 25 s of data: three lines, which say how many they stand for."""
    fed = Fed()
    stamp = fed.regular(50)
    for i in range(5000):
        fed.put(stamp + i * STEP, (math.nan, *VALUES[1:]))
    reports = fed.events.drain()
    assert len(reports) == 3
    assert reports[1].text.endswith("(1999 more since the last report)")
    assert fed.counts == {"not finite": 5000}


def test_health_tells_and_drains() -> None:
    events = EventLog()
    assert not events.pending
    events.report(INFO, "one")
    events.count("kind", WARN, "two", 5)
    assert events.pending
    assert events.drain() == [Report(INFO, "one"), Report(WARN, "two")]
    assert (events.pending, events.drain(), events.counts) == (False, [], {"kind": 1})


_STAMPS = st.one_of(
    st.integers(-3 * STEP, 3 * STEP),  # from the last one
    st.just(STEP),
    st.integers(-20_000_000_000, 20_000_000_000),
    st.integers(-(2**62), 2**62),
)
_VALUE = st.one_of(st.floats(-30.0, 30.0), st.floats(allow_nan=True, allow_infinity=True))


@settings(max_examples=300)
@given(st.lists(st.tuples(_STAMPS, st.booleans(), st.tuples(*[_VALUE] * 6)), max_size=60), st.booleans())
def test_any_stream(steps: list[tuple[int, bool, tuple[float, ...]]], learned: bool) -> None:
    """Never raises; what comes out is finite, in order and complete; every message is accounted for."""
    fed = Fed()
    stamp = fed.regular(40) if learned else START
    for step, rubbish, values in steps:
        stamp += step
        fed.put(stamp, values if rubbish else VALUES)
    last = None
    for stamp, item in fed.out:
        if isinstance(item, tuple):
            assert all(math.isfinite(x) for x in item)
            if last is None:
                assert item[0] == 0.0  # the first, and the first after a restart
            else:
                assert item[0] == pytest.approx((stamp - last) * 1e-9, rel=1e-9, abs=1e-12)
                assert 0.0 < item[0] <= 10.0
            last = stamp
        else:
            last = None
    waiting = fed.stream.received - fed.stream.accepted - fed.rejected
    assert waiting in (0, 1)


def _blocks(fed: Fed, stamps: list[int], values: list[tuple[float, ...]], size: int) -> None:
    """Put a stream in blocks of this size: runs together, what ends a run by itself."""
    for i in range(0, len(stamps), size):
        at, rows = np.array(stamps[i : i + size]), np.array(values[i : i + size])
        while len(at):
            samples = fed.stream.accept_run(at, rows, 2**63 - 1)
            count = len(samples)
            fed.out += list(zip(at.tolist(), map(tuple, samples.tolist()), strict=False))
            if count < len(at):
                fed.put(int(at[count]), tuple(rows[count].tolist()))
                count += 1
            at, rows = at[count:], rows[count:]


_RARE = st.sampled_from([0, -STEP, 3 * STEP, 60 * STEP, -2_000_000_000, 2_000_000_000, 20_000_000_000, -(2**61)])
_RUN = st.tuples(st.sampled_from([STEP, STEP // 3, 2 * STEP, 60_000]), st.integers(1, 80))


@settings(max_examples=150, deadline=None)  # the first example compiles
@given(
    st.lists(st.tuples(_RUN, st.lists(st.tuples(_RARE, _VALUE), max_size=3)), min_size=1, max_size=8),
    st.integers(1, 300),
    st.booleans(),
)
def test_a_block_is_sample_after_sample(
    parts: list[tuple[tuple[int, int], list[tuple[int, float]]]], size: int, instantaneous: bool
) -> None:
    """Runs at several rates, gaps, repeated and backward stamps, restarts, invalid values: the same to the last bit."""
    stamps, values, stamp = [], [], START
    for (step, count), rare in parts:
        for i in range(count):
            stamp += step
            stamps.append(stamp)
            values.append((0.01 * i, *VALUES[1:]))
        for jump, value in rare:
            stamp = max(stamp + jump, -(2**61))
            stamps.append(stamp)
            values.append((*VALUES[:4], value, 9.8))
    one, other = Fed(instantaneous=instantaneous), Fed(instantaneous=instantaneous)
    for at, row in zip(stamps, values, strict=True):
        one.put(at, row)
    _blocks(other, stamps, values, size)
    assert other.out == one.out
    assert (other.counts, other.events.drain()) == (one.counts, one.events.drain())
    for name in ("received", "accepted", "regular"):
        assert getattr(other.stream, name) == getattr(one.stream, name)


def test_a_run_ends_at_a_stamp() -> None:
    fed = Fed()
    for i in range(100):
        fed.put(START + i * STEP, VALUES)
    stamps, values = START + np.arange(100, 110) * STEP, np.array([VALUES] * 10)
    assert len(fed.stream.accept_run(stamps, values, int(stamps[4]))) == 4
    assert len(fed.stream.accept_run(stamps[4:], values[4:], int(stamps[4]))) == 0
