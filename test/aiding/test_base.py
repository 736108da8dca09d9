"""Common parts of all aids: parameters, covariance, states, records."""

import math

import numpy as np
import pytest
from aid_harness import NAN, aids_of
from hypothesis import given
from hypothesis import strategies as st

from ins_nav.aiding.base import AidParameters, Record
from ins_nav.aiding.gnss import GnssParameters
from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.velocity_log import LogParameters
from ins_nav.estimation.observation import Update


def test_values_are_those_of_the_parameters() -> None:
    values = configuration(
        {
            "log.enabled": False,
            "log.default_stddev": 0.4,
            "log.min_stddev": 0.02,
            "log.lever_arm": [1, -2, 3],
            "log.delay": 0.25,
            "log.gate": 1e-3,
        }
    ).values
    found = LogParameters.from_values("log", values)
    assert found == LogParameters(
        enabled=False,
        default_stddev=0.4,
        min_stddev=0.02,
        lever_arm=(1.0, -2.0, 3.0),
        delay=0.25,
        gate=1e-3,
    )


def test_every_aid_has_the_common_parameters() -> None:
    common = {row.name for row in AidParameters.rows("x")}
    for aid in aids_of({"range.beacons": "a"}).values():
        assert isinstance(aid.parameters, AidParameters) and aid.parameters.enabled
        if aid.name != "beacon/a/fix":  # not to be set
            rows = {row.name for row in aid.rows({})}
            assert {name.replace("x.", f"{aid.NAME}.") for name in common} <= rows


def test_slow_states() -> None:
    found = aids_of({"gnss.slow_stddev": 2.0, "gnss.slow_time": 50.0, "log.scale_stddev": 0.03})
    drift = found["gnss"].states
    # first order: stationary deviation is walk * sqrt(time / 2)
    assert len(drift) == 3 and drift[0].walk * math.sqrt(drift[0].correlation_time / 2.0) == pytest.approx(2.0)
    assert [state.stddev for state in found["log"].states] == pytest.approx([0.03, *[math.radians(0.5)] * 2])
    assert aids_of()["gnss"].states == ()
    assert [state.stddev for state in found["depth"].states] == [1000.0]  # where the surface is
    found = aids_of({"depth.surface_height": 0.0})
    assert found["depth"].states == found["pressure"].states == ()
    values = {"log.scale": 0.01, "log.pitch_deg": -1.0, "log.yaw_deg": 2.0, "log.water_track": True}
    log = aids_of(values)["log"].states
    assert [state.value for state in log] == pytest.approx([0.01, math.radians(-1.0), math.radians(2.0), 0.0, 0.0])
    assert log[4].walk * math.sqrt(log[4].correlation_time / 2.0) == pytest.approx(log[4].stddev)


def test_given_covariance_is_used_as_it_is() -> None:
    matrix = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -0.5], [0.5, -0.5, 16.0]])
    np.testing.assert_array_equal(GnssParameters().covariance(matrix.ravel().tolist(), 3), matrix)


@pytest.mark.parametrize(
    "given_",
    [
        (),
        (0.0,) * 9,
        (NAN,) * 9,
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, NAN),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, math.inf),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, -1.0),
        (1.0, 0, 0, 0, 1.0, 0, 0, 0, 0.0),
        (-1.0,) + (0.0,) * 8,
        (1.0, 2.0),
    ],
)
def test_no_covariance_means_the_default(given_: tuple[float, ...]) -> None:
    np.testing.assert_array_equal(GnssParameters(default_stddev=2.0).covariance(given_, 3), 4.0 * np.eye(3))


def test_default_is_no_less_than_the_least() -> None:
    assert GnssParameters(default_stddev=0.1, min_stddev=0.5).covariance((), 1) == pytest.approx(0.25)


def test_covariance_that_is_not_positive_keeps_its_diagonal() -> None:
    rows = (1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    np.testing.assert_array_equal(GnssParameters().covariance(rows, 3), np.eye(3))


def test_too_small_a_covariance_is_raised_to_the_least() -> None:
    used = GnssParameters(min_stddev=0.1).covariance(np.diag([1e-12, 1e-4, 1.0]).ravel().tolist(), 3)
    np.testing.assert_allclose(used.diagonal(), [0.01, 0.01, 1.0], rtol=1e-12)


def test_axes_not_measured_do_not_change_the_others() -> None:
    rows = (0.04, NAN, 0.0, NAN, NAN, 0.0, 0.0, 0.0, -1.0)
    used = LogParameters(default_stddev=0.2).covariance(rows, 3, [1, 2])
    np.testing.assert_allclose(used, np.diag([0.04, 0.04, 0.04]))


@given(st.lists(st.floats(), min_size=9, max_size=9), st.sets(st.integers(0, 2)))
def test_covariance_is_positive_whatever_is_given(rows: list[float], missing: set[int]) -> None:
    used = GnssParameters(min_stddev=0.1).covariance(rows, 3, sorted(missing))
    assert np.isfinite(used).all() and np.array_equal(used, used.T)
    # rounding of the eigenvalues, relative to the largest
    assert np.linalg.eigvalsh(used)[0] > -1e-14 * used.max() and used.diagonal().min() >= 0.01 * (1.0 - 1e-12)


def test_record_counts() -> None:
    record = Record()
    good = Update("gnss", 7, (1.0,), (1.0,), 0.1, True, "")
    record.count(good)
    record.count(Update("gnss", 9, (9.0,), (1.0,), 5.0, False, "outside the gate"))
    assert (record.accepted, record.rejected, record.accepted_ns) == (1, 1, 7)
    assert record.last is not None and not record.last.accepted
