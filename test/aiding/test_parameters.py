"""The whole table of parameters: those of aids beside those of the core."""

import pytest

from ins_nav.aiding.parameters import configuration, table
from ins_nav.config.configuration import section_rows
from ins_nav.config.parameters import ParameterError


def test_the_table_has_the_rows_of_the_core_and_of_aids_once() -> None:
    names = [row.name for row in table()]
    assert len(names) == len(set(names)) and "gnss.enabled" in names
    assert {row.name for row in section_rows()} <= set(names)


def test_beacons_name_further_rows() -> None:
    found = configuration({"range.beacons": "a, b", "range.a.height": 5.0} | _place("a"))
    assert found.values["range.a.height"] == 5.0 and "range.b.height" in found.values
    assert len(found.rows) == len(table()) + 6


def _place(beacon: str) -> dict[str, object]:
    return {f"range.{beacon}.latitude_deg": 1.0, f"range.{beacon}.longitude_deg": 2.0}


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"range.beacons": "a, a"}, "a name occurs twice"),
        ({"range.beacons": "a b"}, "cannot be the name of a beacon"),
        ({"range.beacons": "gate"}, "cannot be the name of a beacon"),
        ({"range.a.height": 1.0}, "a is not in range.beacons"),
        ({"range.beacons": "a", "range.a.height": 1.0}, "give all three or none"),
        ({"gnss.gaet": 1e-3}, "did you mean gnss.gate"),
        ({"log.scale": 2.0}, "outside"),
    ],
)
def test_refusals(overrides: dict[str, object], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        configuration(overrides)
