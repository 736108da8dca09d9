"""Parameters of a simulation: values in any notation, errors for people."""

import math
from typing import Any

import pytest
from simulation_harness import measure, of_beacons

from ins_nav.errors import InsNavError
from ins_nav.simulation.scenarios import simulate


@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("rockng", {}, "did you mean rocking"),
        ("static", {"imu.gyro_bias_deg_per_our": 1}, "did you mean imu.gyro_bias_deg_per_hour"),
        ("static", {"imu.gyro_bias_deg_per_hour": 1}, "3 numbers"),
        ("static", {"imu.gyro_bias_deg_per_hour": "[1, 2]"}, "3 numbers"),
        ("static", {"imu.preset": "good"}, "one of perfect"),
        ("static", {"duration": "long"}, "'long' is not a number"),
        ("static", {"seed": 1}, "no parameter 'seed'"),
        ("static", {"duration": True}, "True is not a number"),
        ("static", {"lat_deg": 91.0}, "-90 to 90"),
        ("static", {"rate": math.nan}, "not a number"),
        ("static", {"gnss.rate": 50.0, "rate": 10.0}, "lower it"),
        ("static", {"duration": 0.1, "rate": 1.0}, "no sample"),
    ],
)
def test_wrong_parameters_are_explained(name: str, parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        simulate(name, **parameters)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"log.rate": 50.0}, "log.rate 50 Hz is above the IMU's rate; lower it"),
        ({"range.rate": 50.0}, "range.rate 50 Hz is above"),
        ({"beacon.positions": (1.0, 2.0)}, "2 numbers for 2 beacons; give three a beacon"),
        ({"beacon.radii": (1.0, 2.0, 3.0)}, "beacon.radii: 3 numbers for 2 beacons"),
        ({"beacon.names": "a, a"}, "a name twice"),
        ({"beacon.names": "a, 1/b"}, "'1/b' cannot be part of a topic"),
        ({"range.outlier_span": (30.0, 10.0)}, "give the smaller number first"),
        ({"log.lost": "off"}, "one of nan, zeros, silent"),
        ({"beacon.names": 7.0}, "7.0 is not text"),
        ({"beacon.positions": "[1, 2, x]"}, "not a list of numbers"),
        ({"log.lost_duraton": 1.0}, "did you mean log.lost_duration"),
    ],
)
def test_wrong_parameters_of_aids_are_explained(parameters: dict[str, Any], expected: str) -> None:
    with pytest.raises(InsNavError, match=expected):
        measure(**parameters)


def test_lists_are_read_as_they_are_written() -> None:
    for names, positions in (
        ("[a, b]", "[0, 0, -120, 300, 400, -2]"),
        (["a", "b"], [0, 0, -120.0, 300, 400, -2]),
        ("a,b", "0, 0, -120, 300, 400, -2"),
    ):
        assert of_beacons(measure(**{"beacon.names": names, "beacon.positions": positions}), "range") == {"a", "b"}
    nothing = measure(**{"beacon.names": "", "beacon.positions": "[]", "beacon.radii": 0.0, "beacon.fix_rates": "0"})
    assert of_beacons(nothing, "range") == of_beacons(nothing, "beacon") == set()
