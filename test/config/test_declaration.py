"""Sections: rows of the parameter table and values in SI units from one declaration."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from ins_nav.config.declaration import DEG, Section, parameter
from ins_nav.config.parameters import ParameterError


@dataclass(frozen=True)
class Example(Section):
    """Of each kind one."""

    enabled: bool = parameter(True, "whether")
    rate: float = parameter(2.0, "how fast", name="rate_deg_per_s", unit="deg/s", low=0.0, high=90.0, scale=DEG)
    arm: tuple[float, float, float] = parameter([0.0, 1.0, 2.0], "where", unit="m", low=-10.0, high=10.0)
    height: float = parameter(math.nan, "how high", unit="m")
    way: str = parameter("a", "which", choices=("a", "b"))


def test_rows_have_the_parameters_names_units_and_ranges() -> None:
    rows = {row.name: row for row in Example.rows("example")}
    assert list(rows) == [f"example.{name}" for name in ("enabled", "rate_deg_per_s", "arm", "height", "way")]
    assert rows["example.rate_deg_per_s"].description == "how fast, deg/s"
    assert rows["example.rate_deg_per_s"].default == 2.0
    with pytest.raises(ParameterError, match=r"example.rate_deg_per_s: 91 is outside \[0, 90\]"):
        rows["example.rate_deg_per_s"].checked(91.0)
    with pytest.raises(ParameterError, match="not one of a, b"):
        rows["example.way"].checked("c")
    assert [row.name for row in Example.rows("")][1] == "rate_deg_per_s"


def test_values_are_converted_once() -> None:
    assert Example().rate == pytest.approx(math.radians(2.0))
    assert Example().arm == (0.0, 1.0, 2.0)
    values = {row.name: row.default for row in Example.rows("example")}
    values |= {"example.rate_deg_per_s": 45.0, "example.arm": [1.0, 2.0, 3.0], "example.enabled": False}
    read = Example.from_values("example", values)
    assert read.rate == pytest.approx(math.pi / 4.0)
    assert read.arm == (1.0, 2.0, 3.0)
    assert not read.enabled and math.isnan(read.height) and read.way == "a"


def test_fields_turn_back_into_the_units_of_the_parameters() -> None:
    given = Example.overrides("example", rate=math.pi / 4.0, arm=np.array([1.0, 2.0, 3.0]), way="b", enabled=False)
    assert given == {
        "example.rate_deg_per_s": pytest.approx(45.0),
        "example.arm": [1.0, 2.0, 3.0],
        "example.way": "b",
        "example.enabled": False,
    }
    with pytest.raises(KeyError, match="rat"):
        Example.overrides("example", rat=1.0)


def test_unit_is_in_the_first_clause() -> None:
    @dataclass(frozen=True)
    class Gap(Section):
        longest: float = parameter(1.0, "longest gap; a longer one restarts", unit="s")

    assert Gap.rows("gap")[0].description == "longest gap, s; a longer one restarts"
