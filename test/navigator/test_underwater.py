"""A mission under water, shortened: faults, calibration of the log, depth, surfacing, diagnostics."""

import math
import re

import numpy as np
import pytest
from underwater_harness import ALIGNED, DIVE, NS, Event, Fed, greatest, messages, mission, plain_dive, run

from ins_nav.mechanization import earth
from ins_nav.messages import diagnostics
from ins_nav.navigator.front_end import Phase

pytestmark = pytest.mark.slow

LOST = {"log.lost": "zeros", "log.lost_start": 220.0, "log.lost_duration": 100.0}
FAULT = {"depth.fault_start": 360.0, "depth.fault_duration": 60.0, "depth.fault_offset": 5.0}
FAULTS = {"range.outlier_share": 0.2, "range.bias": 3.0, **LOST, **FAULT}


def test_whole_dive_without_faults() -> None:
    fed = plain_dive()
    assert fed.aided.phase is Phase.NAVIGATING
    across, up = greatest(fed.since(DIVE))
    assert across < 3.0 and up < 3.0
    # ranges of 0.5 m and 5 s apart bound the error
    assert np.hypot(*fed.since(DIVE)[:, 1:3].T).max() < 3.0
    # the gate is 1e-4, and 0.01 for ranges
    counts = {name: fed.counts.get(f"{name} rejected", 0) for name in ("log", "depth", "range/vessel")}
    assert max(counts["log"], counts["depth"]) <= 1 and counts["range/vessel"] <= 5
    assert "log unusable" not in fed.counts


@pytest.mark.parametrize("seed", [1, 2])
def test_whole_dive_with_all_faults_at_once(seed: int) -> None:
    s = mission().redrawn(seed, **FAULTS)
    fed = run(s)
    across, up = greatest(fed.since(DIVE))
    assert across < 3.0 and up < 3.0
    ranges = s.aids["range/vessel"]
    wrong = int(ranges.outlier[ranges.stamps_ns > s.start_ns + ALIGNED * NS].sum())
    # of good ranges one in a hundred is rejected; one that is too short may be no measurement
    rejected = fed.counts["range/vessel rejected"] + fed.counts.get("range/vessel unusable", 0)
    assert wrong <= rejected <= wrong + 5
    assert fed.counts["log unusable"] == 100
    assert fed.counts["depth rejected"] == fed.aided.records["depth"].rejected == 60
    # and estimated: its prior is 1 m
    _, (bias, sigma) = fed.aided.own_states("range/vessel")
    assert sigma < 0.5 and abs(bias - 3.0) < 3.0 * sigma


@pytest.mark.parametrize("offset", [5.0, 0.5])
def test_a_faulty_gauge_is_reported_and_rejected(offset: float) -> None:
    """Also once the sigma of height has grown so much without it that its readings would be within the gate."""
    s = mission().redrawn(1, **FAULT | {"depth.fault_offset": offset})
    fed, events, middle = Fed(s), messages(s), s.start_ns + 415 * NS
    fed.feed([event for event in events if event[0] < middle])
    recent = [report.text for report in fed.aided.events.recent(fed.aided.stamp_ns)]
    assert any(
        re.match(r"depth: (outside the gate|excluded, its fault is not over): off by \d", text) for text in recent
    )
    fed.feed([event for event in events if event[0] >= middle])
    assert fed.aided.records["depth"].rejected == 60
    _, up = greatest(fed.since(DIVE))
    assert up < 3.0


def test_zeros_of_a_lost_log_are_no_velocity() -> None:
    """They have no effect, as NaN."""
    lost = [mission().redrawn(1, **LOST | {"log.lost": how}) for how in ("zeros", "nan")]
    a, b = (Fed(s).feed(messages(s, until=340.0)) for s in lost)
    np.testing.assert_array_equal(a.rows, b.rows)
    assert a.counts == b.counts


# The log


def test_calibration_finds_scale_and_misalignment() -> None:
    """A minute in the box with fixes to 10 cm, then 5 minutes more."""
    surface = (("surface_leg", 360.0), ("duration", 480.0), ("gnss.horizontal_stddev", 0.1))
    errors = {"log.scale": 0.01, "log.scale_stddev": 0.0, "log.misalignment_stddev_deg": 0.0}
    s = mission(*surface).redrawn(3, **errors, **{"log.misalignment_deg": (1.0, -1.0)})
    scale, pitch, yaw = run(s, ("range", "beacon")).aided.own_states("log")
    for (value, sigma), true, least in (
        (scale, 0.01, 1e-3),
        (pitch, math.radians(1.0), math.radians(0.1)),
        (yaw, math.radians(-1.0), math.radians(0.1)),
    ):
        assert sigma < least and abs(value - true) < 3.0 * sigma


def test_current_of_the_water_is_found() -> None:
    s = mission().redrawn(2, **{"log.current": (0.3, -0.2)})
    fed = Fed(s, {"log.water_track": True}).feed(messages(s))
    own = fed.aided.own_states("log")
    for (value, sigma), true in zip(own[3:], (0.3, -0.2), strict=True):
        # by the ranges, of a current that changes within an hour
        assert sigma < 0.05 and abs(value - true) < 3.0 * sigma
    across, _ = greatest(fed.since(DIVE))
    assert across < 3.0


# Depth


def test_pressure_is_as_good_as_depth() -> None:
    s = mission().redrawn(1)
    weight = 1025.0 * float(earth.normal_gravity(math.sin(s.trajectory.origin.lat), 0.0))
    events: list[Event] = []
    for stamp, kind, values in messages(s):
        if kind == "depth":
            kind, values = "pressure", (stamp, 101325.0 + weight * values[1], weight**2 * values[2])
        events.append((stamp, kind, values))
    arm = {"pressure.lever_arm": [-0.4, 0.0, 0.1]}
    # of aids with one stamp depth comes before fixes, pressure after: second order differs a little then
    np.testing.assert_allclose(Fed(s, arm).feed(events).rows, plain_dive().rows, rtol=0, atol=2e-3)


JUMP = 50.0


@pytest.mark.parametrize("jump", [0.0, JUMP])
def test_surfacing(jump: float) -> None:
    """Fixes return; where they have an error of tens of metres they are reported, and the solution stays right."""
    s = mission().redrawn(4)
    stamps = s.aids["gnss/fix"].stamps_ns
    gap = int(np.argmax(np.diff(stamps)))
    _, radius = earth.principal_radii(math.sin(s.trajectory.origin.lat))
    degrees = math.degrees(jump / (radius * math.cos(s.trajectory.origin.lat)))
    events: list[Event] = []
    for stamp, kind, values in messages(s, ("range", "beacon")):
        if kind == "fix" and stamp > stamps[gap]:
            values = (*values[:3], values[3] + degrees, *values[4:])
        events.append((stamp, kind, values))
    fed = Fed(s, follow=True).feed([event for event in events if event[0] < stamps[gap + 1]])
    before = fed.ins.map
    fed.feed([event for event in events if event[0] >= stamps[gap + 1]])
    returned = float(stamps[gap + 1] - s.start_ns) / NS
    rows = fed.since(returned + 10.0)
    # 1 m of noise of a fix, of which the solution is a mean
    assert len(rows) > 10 and np.hypot(rows[:, 1], rows[:, 2]).max() < 3.0
    assert fed.ins.map is before is not None
    assert ("gnss at fault" in fed.counts) == bool(jump)


INVALID = (-32.768, -32.768, -32.768)
CURRENT = (0.3, -0.2, 0.0)


@pytest.mark.parametrize("ranges", [True, False])
@pytest.mark.parametrize("output", ["water", "creeps", "marker", "two zeros"])
def test_a_log_that_lost_the_bottom_for_minutes(output: str, ranges: bool) -> None:
    """It changes to water track, freezes at some mm/s, or marks invalid velocities by a number or zeros."""
    s = mission().redrawn(1)
    begin, end = (s.start_ns + round(t * NS) for t in (200.0, 440.0))
    events: list[Event] = []
    for stamp, kind, values in messages(s, () if ranges else ("range", "beacon")):
        if kind == "log" and begin < stamp < end:
            x, y, z = values[1]
            velocity = {
                "water": (x - 0.3, y + 0.2, z),
                "creeps": (0.004, -0.003, 0.002),
                "marker": INVALID,
                "two zeros": (0.0, 0.0, z),
            }[output]
            values = (stamp, velocity, *values[2:])
        events.append((stamp, kind, values))
    fed = Fed(s).feed(events)
    across, up = greatest(fed.since(DIVE))
    assert across < 3.0 and up < 3.0
    assert fed.counts["log rejected" if output in ("water", "creeps") else "log unusable"] == 239
    assert fed.aided.records["log"].accepted > 150  # again, once the bottom is back


def test_diagnostics_name_every_aid() -> None:
    level, text, values = diagnostics.alignment_diagnostics(plain_dive().aided)
    assert (level, text) == (0, "navigating")
    for name in ("depth", "log", "gnss", "range/vessel", "beacon/vessel/fix"):
        assert int(values[f"{name}: accepted, rejected"].split(", ")[0]) > 50
    metres = float(values["beacon/vessel/fix: place sigma"].removesuffix(" m"))
    # fixes of 0.5 m a second, averaged over some, and a second of way
    assert 0.3 < metres < 1.5


def test_silent_and_useless_aids_are_reported() -> None:
    s = mission().redrawn(1)
    fed = run(s, ("range", "beacon"))
    assert fed.aided.missed() == ["range/vessel: never heard"]
    zeros = [(t, k, (v[0], (0.0, 0.0, 0.0), *v[2:]) if k == "log" else v) for t, k, v in messages(s, until=300.0)]
    (text,) = Fed(s).feed(zeros).aided.missed()
    assert re.match(r"log: nothing usable for \d+ s", text)


@pytest.mark.parametrize("gap", [0.5, 2.0, 4.5])
def test_a_gap_in_a_turn_does_not_lock_the_log_out(gap: float) -> None:
    """The covariance contains the unknown motion: heading by many degrees, velocity by as much."""
    s = mission().redrawn(1)
    begin, end = (s.start_ns + round(t * NS) for t in (230.0, 230.0 + gap))
    events = [e for e in messages(s, ("range", "beacon")) if not (e[1] == "imu" and begin < e[0] < end)]
    fed = Fed(s).feed(events)
    # level is wrong by more than its sigma after 2 s: until the vehicle turns the log may as well have failed
    assert fed.aided.records["log"].rejected < 30
    across, up = greatest(fed.since(DIVE))
    assert across < 3.0 and up < 3.0
