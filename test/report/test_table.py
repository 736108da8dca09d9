"""Tables of results."""

from ins_nav.report.table import rows_of, table


def test_table_shows_the_errors(off):
    result, _, errors = off
    rows = rows_of(result, errors)
    assert rows["heading error after alignment, deg"] == "+0.5000 (sigma 0.0172)"
    assert rows["horizontal / vertical error after 1 min, m"] == "5.00 / 2.00"
    assert "horizontal / vertical error after 2 min, m" not in rows
    assert rows["horizontal / vertical error RMS, m"] == "5.00 / 2.00"
    assert rows["velocity error RMS, horizontal / up, m/s"] == "0.500 / 0.500"
    assert rows["heading drift to the end, deg"].strip("+-") == "0.0000"
    assert rows["solutions"] == "800"


def test_columns_of_different_length_keep_their_order():
    text = table({"short": {"a": "1", "z": "2"}, "long": {"a": "3", "m": "4", "z": "5"}})
    assert [line.split() for line in text.splitlines()] == [
        ["short", "long"],
        ["a", "1", "3"],
        ["m", "-", "4"],
        ["z", "2", "5"],
    ]
