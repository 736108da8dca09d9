"""Fixes of beacons: repeated places, late ones, and the beacons of a simulation."""

import math

import numpy as np
import pytest
from aid_harness import SOLUTION, aids_of, own_of
from aid_messages import FIX

from ins_nav.aiding.base import Unusable
from ins_nav.mechanization.earth import geodetic_to_ecef

HERE, THERE = (55.7, 37.6, 2.0), (55.701, 37.6, 2.0)


def test_a_beacon_that_never_moved_may_repeat_its_place() -> None:
    aid = aids_of({"range.beacons": "a"})["beacon/a/fix"]
    for k in range(3):
        assert aid.read(FIX(k, 0, *HERE)).stamp_ns == k


def test_a_repeated_place_of_a_moving_beacon_is_rejected() -> None:
    aid = aids_of({"range.beacons": "a"})["beacon/a/fix"]
    aid.read(FIX(0, 0, *HERE))
    aid.read(FIX(1, 0, *THERE))
    with pytest.raises(Unusable, match="place repeated under a new stamp") as caught:
        aid.read(FIX(2, 0, *THERE))
    assert caught.value.kind == "repeated"
    assert aid.read(FIX(3, 0, *HERE)).stamp_ns == 3


def test_a_place_needs_a_height() -> None:
    aid = aids_of({"range.beacons": "a"})["beacon/a/fix"]
    with pytest.raises(Unusable, match="rejected"):
        aid.read(FIX(0, 0, 55.7, 37.6, math.nan))


def test_how_late_a_fix_is_of_use() -> None:
    """A past place of a beacon is used until the sigma of its way since is large."""
    aid = aids_of({"range.beacons": "a", "range.beacon_speed": 5.0})["beacon/a/fix"]
    assert aid.late(1e4)[0]  # the first of all
    aid.measure(SOLUTION, own_of(*[0.0] * 6), aid.observe(FIX(0, 0, *HERE)))
    assert aid.late(20.0) == (True, "info", "used for the beacon's place at that time")
    assert aid.late(60.0)[:2] == (True, "warn")
    assert aid.late(1e4) == (False, "warn", "rejected: check its clock")
    aid.restart()
    assert aid.late(1e4)[0]


def test_status_is_the_sigma_of_its_place() -> None:
    aid = aids_of({"range.beacons": "a"})["beacon/a/fix"]
    assert aid.status([(0.0, 2.0), (0.0, 3.0), (0.0, 6.0), *[(0.0, 1.0)] * 3]) == {"place sigma": "7.00 m"}
    assert aid.status([]) == {}


def test_a_fix_is_a_measurement_of_the_beacon_alone() -> None:
    aid = aids_of({"range.beacons": "a"})["beacon/a/fix"]
    aid.measure(SOLUTION, own_of(*[0.0] * 6), aid.observe(FIX(0, 0, *HERE)))
    measurement = aid.measure(SOLUTION, own_of(*[0.0] * 6), aid.observe(FIX(0, 0, *THERE)))
    assert measurement is not None and not measurement.h.any() and measurement.direct is None
    places = [geodetic_to_ecef(math.radians(lat), math.radians(lon), h) for lat, lon, h in (HERE, THERE)]
    np.testing.assert_allclose(measurement.innovation, np.subtract(*places), atol=1e-9)
