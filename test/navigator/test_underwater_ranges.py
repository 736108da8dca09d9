"""A mission under water, shortened: ranges to beacons, and the fixes of beacons that float."""

import math
import random
from typing import Any

import numpy as np
import pytest
from underwater_harness import ALIGNED, DIVE, NS, Event, Fed, greatest, messages, mission, plain_dive, rms, run

from ins_nav.mechanization import earth

pytestmark = pytest.mark.slow


def test_order_of_arrival_does_not_matter() -> None:
    """Of ranges, and of the beacon's fixes; they are up to 1.5 s late once the filter runs."""
    s = mission().redrawn(1)
    events, late = messages(s), random.Random(3)
    mixed: list[Event] = []
    for stamp, kind, values in events:
        behind = kind in ("range", "beacon") and stamp > s.start_ns + (ALIGNED + 5.0) * NS
        mixed.append((stamp + behind * late.randrange(1_500_000_000), kind, values))
    mixed.sort(key=lambda event: event[0])
    assert [event[2] for event in mixed] != [event[2] for event in events]
    a, b = plain_dive(), Fed(s).feed(mixed)
    assert len(a.feedback) == len(b.feedback) > 400
    for x, y in zip(a.feedback, b.feedback, strict=True):
        assert x.state == y.state and np.array_equal(x.covariance, y.covariance)
    assert a.counts == b.counts


def test_two_ways_of_sound() -> None:
    """Sound is slow here: a reply's stamp is late by a second, 1.5 m of way."""
    precise = {"range.noise_stddev": 0.1, "range.delay_speed": 300.0, "beacon.fix_stddev": 0.1}
    s = mission().redrawn(1, **precise)
    slow = {"range.sound_speed": 300.0, "range.bias_stddev": 0.0, "range.scale_stddev": 0.0}
    right = Fed(s, slow).feed(messages(s))
    across, _ = greatest(right.since(DIVE))
    assert across < 3.0 and right.aided.records["range/vessel"].rejected <= 2
    # with one way the stamps are wrong: by 2 sigma of its noise and the beacon's, to and fro
    wrong = Fed(s, slow | {"range.two_way": False}).feed(messages(s))
    assert wrong.aided.records["range/vessel"].rejected > 2
    distances = [float(np.hypot(*fed.since(DIVE)[:, 1:3].T).mean()) for fed in (right, wrong)]
    assert distances[1] > 1.3 * distances[0]


def test_a_floating_beacon_without_fixes_is_reported_and_not_used() -> None:
    s = mission().redrawn(1)
    unknown, none = run(s, ("beacon",)), run(s, ("beacon", "range"))
    np.testing.assert_array_equal(unknown.rows, none.rows)
    assert any(kind.startswith("range/vessel") for kind in unknown.counts)
    assert any("range/vessel" in text for text in unknown.reports)


def test_an_ambiguous_place_keeps_a_large_sigma() -> None:
    """No GNSS, a start wrong by 175 m: ranges from nearly one direction fit a mirror image as well."""
    s = mission().redrawn(5, **{"gnss.rate": 0.0, "beacon.positions": (0.0, -300.0, -2.0)})
    lat, lon = s.trajectory.origin.lat, s.trajectory.origin.lon
    meridian, radius = earth.principal_radii(math.sin(lat))
    for direction in (45.0, 135.0, 225.0, 315.0):
        north, east = (175.0 * f(math.radians(direction)) for f in (math.cos, math.sin))
        start = {
            "initial.latitude_deg": math.degrees(lat + north / meridian),
            "initial.longitude_deg": math.degrees(lon + east / (radius * math.cos(lat))),
            "initial.height": 0.0,
            "initial.position_stddev": 200.0,
            "depth.surface_height": 0.0,
        }
        fed = Fed(s, start).feed(messages(s, until=400.0))
        across, _ = greatest(fed.since(ALIGNED + 1.0))
        # ranges are accepted all the time
        assert across < 3.0 and fed.aided.records["range/vessel"].accepted > 50


def test_a_wrong_beacon_is_rejected_after_accepted_gnss_fixes() -> None:
    """Its fixes have an error of 100 m throughout, and so its ranges for minutes."""
    s = mission().redrawn(1)
    _, radius = earth.principal_radii(math.sin(s.trajectory.origin.lat))
    degrees = math.degrees(100.0 / (radius * math.cos(s.trajectory.origin.lat)))
    events = [
        (stamp, kind, (*values[:4], values[4] + degrees, *values[5:]) if kind == "beacon" else values)
        for stamp, kind, values in messages(s)
    ]
    fed = Fed(s).feed(events)
    across, _ = greatest(fed.since(DIVE))
    assert across < 3.0 and np.hypot(*fed.since(DIVE)[:, 1:3].T).max() < 5.0
    # some ranges fit, where their circle crosses the solution
    assert fed.aided.records["range/vessel"].rejected > 60 > 5 * fed.aided.records["range/vessel"].accepted
    assert any(text.startswith("range/vessel: excluded") for text in fed.aided.missed())
    # the ranges contradict the solution; the fixes agree with each other
    assert fed.aided.records["beacon/vessel/fix"].rejected <= 2


def test_late_fixes_of_a_beacon_are_used_at_their_stamps() -> None:
    """5 s late, as by an acoustic modem: too late for other aids, not for the past place of the beacon."""
    s = mission().redrawn(1)
    events = [(stamp + 5 * NS * (kind == "beacon"), kind, values) for stamp, kind, values in messages(s)]
    events = [event for event in events if event[0] <= s.stamps_ns[-1]]
    late = Fed(s).feed(sorted(events, key=lambda event: event[0]))
    across, _ = greatest(late.since(DIVE))
    assert across < 3.0
    assert late.counts["beacon/vessel/fix late"] > 300
    plain, none = plain_dive(), run(s, ("range", "beacon"))
    worst, best, with_late = (rms(fed.since(DIVE + 60.0)[:, 4]) for fed in (none, plain, late))
    # a vessel at 1 m/s moves by some metres in 5 s, more than a range of 0.5 m corrects; better than no ranges
    assert best < with_late < 0.8 * worst


def test_a_single_fix_before_the_filter_defines_the_place_of_a_beacon() -> None:
    """It does not move, and range.beacon_speed is 0."""
    still = (("beacon.radii", (0.0,)), ("dive_time", 120.0))
    s = mission(*still).redrawn(1)
    events = messages(s)
    first = next(event for event in events if event[1] == "beacon" and event[0] > s.start_ns + 20 * NS)
    kept = [event for event in events if event[1] != "beacon" or event is first]
    fed = Fed(s, {"range.beacon_speed": 0.0}).feed(kept)
    assert fed.aided.records["beacon/vessel/fix"].accepted == 1
    assert fed.aided.records["range/vessel"].accepted > 40
    across, _ = greatest(fed.since(DIVE))
    assert across < 3.0


def test_a_fix_before_the_first_sample_is_not_lost() -> None:
    """Nor by a restart of alignment."""
    still = (("beacon.radii", (0.0,)), ("dive_time", 120.0))
    s = mission(*still).redrawn(1)
    events = messages(s)
    first = next(event for event in events if event[1] == "beacon")
    early = (first[0] - NS, "beacon", (first[0] - NS, *first[2][1:]))
    kept = [early, *(event for event in events if event[1] != "beacon")]
    fed = Fed(s, {"range.beacon_speed": 0.0}).feed(kept)
    assert fed.aided.records["range/vessel"].accepted > 40
    fed.aided.align()
    assert fed.aided.filter is None and "beacon/vessel/fix" in fed.aided._aid_queue._latest


def test_a_repeated_place_of_a_moving_beacon_is_rejected() -> None:
    """A new one every 20 s, published each second; of a beacon that never moved it is always used."""
    s = mission().redrawn(1)
    events: list[Event] = []
    last: tuple[Any, ...] = ()
    for stamp, kind, values in messages(s):
        if kind == "beacon":
            if round((stamp - s.start_ns) / NS) % 20 == 0:
                last = values[1:]
            if not last:
                continue
            values = (stamp, *last)
        events.append((stamp, kind, values))
    fed = Fed(s).feed(events)
    across, _ = greatest(fed.since(DIVE))
    assert across < 3.0
    record = fed.aided.records["beacon/vessel/fix"]
    assert 20 <= record.accepted + record.rejected <= 27 and record.rejected <= 1
    assert fed.counts["beacon/vessel/fix repeated"] > 300
    assert fed.aided.records["range/vessel"].rejected <= 5
    same = [(t, kind, (t, *last) if kind == "beacon" else v) for t, kind, v in messages(s, until=120.0)]
    assert Fed(s).feed(same).aided.records["beacon/vessel/fix"].accepted > 50
