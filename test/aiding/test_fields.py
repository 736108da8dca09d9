"""Fields that several aids read: fixes and velocities."""

import math

import pytest
from aid_messages import FIX, MESSAGES

from ins_nav.aiding.base import Unusable
from ins_nav.aiding.fields import read_fix, read_velocity

ROWS = (1.0, 0.1, 0.2, 0.1, 4.0, 0.3, 0.2, 0.3, 9.0)


def test_a_fix_is_in_radians() -> None:
    reading = read_fix(FIX(7, 0, 60.0, -30.0, 5.0, ROWS))
    assert reading.value == (math.radians(60.0), math.radians(-30.0), 5.0)
    assert (reading.covariance, reading.stamp_ns) == (ROWS, 7)
    assert read_fix(FIX(7, 0, 60.0, -30.0, 5.0)).covariance == ()  # of type unknown


def test_height_may_be_unknown() -> None:
    for height in (math.nan, math.inf):
        assert math.isnan(read_fix(FIX(7, 0, 60.0, -30.0, height, ROWS)).value[2])


@pytest.mark.parametrize(
    "place", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (91.0, 0.0, 0.0), (0.0, 0.0, -2e4), (0.0, 0.0, 1e6)]
)
def test_no_place_is_refused(place: tuple[float, float, float]) -> None:
    with pytest.raises(Unusable, match="must publish status -1") as caught:
        read_fix(FIX(7, 0, *place, ROWS))
    assert (caught.value.kind, caught.value.level) == ("invalid", "warn")


def test_no_fix_differs_from_an_invalid_one() -> None:
    with pytest.raises(Unusable, match="no fix") as caught:
        read_fix(FIX(7, -1, 91.0, 0.0, 0.0))
    assert (caught.value.kind, caught.value.level) == ("no fix", "info")


def test_velocity_has_the_covariance_of_its_linear_part() -> None:
    reading = read_velocity(MESSAGES["velocity"][1](7, (1.0, -2.0, math.nan), ROWS))
    assert reading.value[:2] == (1.0, -2.0) and math.isnan(reading.value[2])
    assert (reading.covariance, reading.stamp_ns) == (ROWS, 7)
