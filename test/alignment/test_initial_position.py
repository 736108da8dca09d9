"""Position of alignment: parameters before the first fix before the state file."""

import math
from dataclasses import replace

import pytest

from ins_nav.alignment.initial_position import InitialPosition, Place
from ins_nav.config.sections import InitialSection
from ins_nav.config.state_file import Pose
from ins_nav.event_log import EventLog

FIX = Place(0.9, 0.6, 120.0, (1.0, 1.0, 2.0))
LATER = FIX._replace(lat=0.91)
NOT_GIVEN = InitialSection()
GIVEN = replace(NOT_GIVEN, latitude=0.8, longitude=0.5, height=10.0)
LAST = Pose(latitude_deg=55.0, longitude_deg=37.0, height=150.0, heading_deg=10.0, position_stddev=2.0, stamp=1.0)


def test_the_first_fix_is_used() -> None:
    position = InitialPosition(NOT_GIVEN, LAST, EventLog())
    position.observe(FIX, "gnss/fix", 0)
    position.observe(LATER, "gnss/fix", 1)
    assert position.found(2) == FIX
    position.renew()
    position.observe(LATER, "gnss/fix", 3)
    assert position.found(4) == LATER


def test_parameters_precede_fixes_until_renewed() -> None:
    position = InitialPosition(GIVEN, LAST, EventLog())
    position.observe(FIX, "gnss/fix", 0)
    found = position.found(1)
    assert found is not None and (found.lat, found.lon, found.height) == (0.8, 0.5, 10.0)
    position.renew()
    position.observe(FIX, "gnss/fix", 2)
    assert position.found(3) == FIX
    position.begin()
    assert position.found(4) == found


def test_the_state_file_is_the_last_resort_and_reported() -> None:
    events = EventLog()
    found = InitialPosition(NOT_GIVEN, LAST, events).found(0)
    assert found is not None and found.lat == pytest.approx(math.radians(55.0))
    assert found.stddev == (10.0,) * 3  # saved with 2 m; the vehicle may have been pushed since
    assert "state_file" in events.drain()[0].text


def test_an_unknown_position_is_reported() -> None:
    events = EventLog()
    assert InitialPosition(NOT_GIVEN, None, events).found(0) is None
    assert "publish gnss/fix or set initial.latitude_deg" in events.drain()[0].text


def test_a_fix_without_height() -> None:
    events = EventLog()
    position = InitialPosition(NOT_GIVEN, None, events)
    position.observe(FIX._replace(height=math.nan), "gnss/fix", 0)
    found = position.found(1)
    assert found is not None and found.height == 0.0 and found.stddev[2] >= 1000.0
    assert events.counts == {"no height": 1}
