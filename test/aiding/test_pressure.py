"""Pressure under water is the weight of water."""

import math

import aid_messages
import numpy as np
import pytest
from aid_harness import NAN, SOLUTION, aids_of, observed, own_of

from ins_nav.aiding.base import Unusable
from ins_nav.mechanization import earth


def test_pressure_is_the_weight_of_water() -> None:
    values = {"pressure.surface_pressure": 100e3, "pressure.density": 1000.0, "depth.surface_height": 160.0}
    found = aids_of(values)["pressure"]
    weight = 1000.0 * earth.normal_gravity(math.sin(math.radians(55.7)), 150.0)
    seen = found.measure(SOLUTION, own_of(), observed("pressure", 100e3 + 10.5 * weight, covariance=np.eye(1) * 100.0))
    assert seen is not None
    np.testing.assert_allclose(seen.innovation, [0.5], atol=1e-9)
    np.testing.assert_allclose(seen.r, [[(10.0 / weight) ** 2]])


def test_no_pressure_is_no_measurement() -> None:
    aid = aids_of()["pressure"]
    for pressure in (0.0, -1.0, NAN):
        with pytest.raises(Unusable, match="rejected"):
            aid.read(aid_messages.MESSAGES["pressure"][1](0, pressure))
