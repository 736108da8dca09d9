"""Configuration: sections in SI units, former names and values."""

import math
from dataclasses import fields

import pytest

from ins_nav.config.configuration import GONE, Configuration, section_rows
from ins_nav.config.declaration import Section
from ins_nav.config.parameters import Parameter, ParameterError
from ins_nav.config.sections import ImuSection


def test_fields_turn_back_into_overrides() -> None:
    bias = (1e-6, -2e-6, 0.0)
    given = ImuSection.overrides("imu", gyro_bias=bias, sampling="instantaneous", max_gap=2.0)
    assert given["imu.max_gap"] == 2.0 and set(given) == {
        "imu.sampling",
        "imu.gyro_bias_deg_per_hour",
        "imu.max_gap",
    }
    found = Configuration.from_overrides(given).imu
    assert found.gyro_bias == pytest.approx(bias) and found.instantaneous


def test_every_row_is_of_a_section_and_has_its_default() -> None:
    found = Configuration.from_overrides()
    sections = [getattr(found, field.name) for field in fields(found)]
    assert sum(len(fields(section)) for section in sections if isinstance(section, Section)) == len(section_rows())
    assert found.imu == ImuSection() or math.isnan(found.imu.gyro_noise)
    assert len({row.name for row in found.rows}) == len(found.rows)


def test_rows_of_aids_are_checked_too() -> None:
    rows = [
        Parameter("echo.delay", 0.0, "of echoes, s", 0.0, 10.0),
        Parameter("imu.colour", "red", "of its case"),
    ]
    found = Configuration.from_overrides({"echo.delay": 3}, rows)
    assert found.values["echo.delay"] == 3.0 and found.rows[-1] is rows[0]
    names = [row.name for row in found.rows]
    assert names.index("imu.colour") == names.index("imu.max_gap") + 1  # with those of its group
    with pytest.raises(ParameterError, match=r"echo.delay: 11 is outside"):
        Configuration.from_overrides({"echo.delay": 11}, rows)
    assert found.updated({"echo.delay": 4.0, "imu.max_gap": 2}).values["echo.delay"] == 4.0
    assert found.updated({"imu.max_gap": 2}).imu.max_gap == 2.0


def test_former_names_and_values_are_understood_with_a_warning() -> None:
    found = Configuration.from_overrides({"map_frame": "world", "base_link_frame": "hull", "publish.tf": True})
    assert (found.frames.map, found.frames.base_link, found.publish.tf) == ("world", "hull", "map_to_base_link")
    assert found.warnings == (
        "parameter publish.tf: true is map_to_base_link now",
        "parameter map_frame is frames.map now",
        "parameter base_link_frame is frames.base_link now",
    )
    off = Configuration.from_overrides({"publish.tf": False})
    assert off.publish.tf == "none" and len(off.warnings) == 1
    assert Configuration.from_overrides({"publish.tf": "map_to_base_link"}).warnings == ()


def test_present_name_overrides_the_former_one() -> None:
    found = Configuration.from_overrides({"frames.map": "b", "map_frame": "a"})
    assert found.frames.map == "b"
    assert found.warnings == ("parameter map_frame is frames.map now, which is given too: its value is used",)


def test_former_name_is_checked_by_the_present_one() -> None:
    with pytest.raises(ParameterError, match=r"parameter frames.map: 3 is not a string"):
        Configuration.from_overrides({"map_frame": 3})


@pytest.mark.parametrize("name", GONE)
def test_parameters_without_effect_are_accepted_with_a_warning(name: str) -> None:
    found = Configuration.from_overrides({name: 3.0})
    (warning,) = found.warnings
    assert warning.startswith(f"parameter {name} has no effect any more: ")
    assert name not in found.values
