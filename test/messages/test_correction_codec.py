"""Corrections, solutions, calibrations and ZUPT calls as messages; those of a whole run are in test/navigator."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from aided_harness import same_feedback
from decoding import as_message

from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import calibration_names
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.estimation.state_layout import SOLUTION_SIZE
from ins_nav.mechanization.nav_state import initial_state
from ins_nav.messages.correction_codec import (
    pack_calibration,
    pack_correction,
    pack_solution,
    read_calibration,
    read_correction,
    read_solution,
    read_zupt,
)
from ins_nav.messages.named_numbers import NamedNumbers, RejectedMessageError, pack, unpack
from ins_nav.navigator.correction import Correction

STAMP_NS = 1_700_000_000_123_456_789
NS = 1_000_000_000


def _correction(states: int = SOLUTION_SIZE) -> Correction:
    """A covariance of random correlations, on the axes of the error state."""
    root = np.random.default_rng(1).normal(size=(states, states)) * np.geomspace(10.0, 1e-7, states)[:, None]
    covariance = root @ root.T
    state = initial_state(0.9, 0.5, 10.0, (1.0, 2.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    errors = tuple(1e-3 * i for i in range(states - SOLUTION_SIZE))
    biases = (1e-6, 2e-6, 3e-6), (1e-3, 2e-3, 3e-3)
    return Correction(STAMP_NS, STAMP_NS + 3 * NS + 1, state, *biases, 0.5 * (covariance + covariance.T), True, errors)


@pytest.mark.parametrize("states", [SOLUTION_SIZE, SOLUTION_SIZE + 3])
def test_every_bit_of_a_correction_returns(states: int) -> None:
    sent = _correction(states)
    assert same_feedback([read_correction(as_message(pack_correction(sent)))], [sent])


def test_a_correction_with_zero_variances_is_one() -> None:
    """Sigmas that a user sets to zero."""
    covariance = np.zeros((SOLUTION_SIZE, SOLUTION_SIZE))
    covariance[0, 0] = 1.0
    sent = _correction()._replace(covariance=covariance)
    assert same_feedback([read_correction(as_message(pack_correction(sent)))], [sent])


def test_a_solution_is_no_correction() -> None:
    solution, aligned_ns = _correction(), STAMP_NS - 60 * NS
    message = as_message(pack_solution(solution, aligned_ns))
    back, back_ns = read_solution(message)
    assert back_ns == aligned_ns and same_feedback([back], [solution._replace(apply_ns=STAMP_NS)])
    with pytest.raises(RejectedMessageError, match="not one that begins with 'correction 1:'"):
        read_correction(message)
    with pytest.raises(RejectedMessageError, match=r"alignment_end is 1\.0 s after stamp"):
        read_solution(as_message(pack_solution(solution, STAMP_NS + NS)))


def _changed(field: str, index: int, value: float) -> NamedNumbers:
    numbers = pack_correction(_correction())
    fields = {name: list(values) for name, values in unpack(as_message(numbers), "correction 1").items()}
    fields[field][index] = value
    return pack("correction 1", fields)


@pytest.mark.parametrize(
    ("field", "index", "value", "text"),
    [
        ("q_nb", 3, 0.5, "q_nb has the length 0.5, not 1"),
        ("q_en", 0, 1e308, "q_en has the length 1e+308, not 1"),
        ("velocity", 1, 1e308, "velocity[1] is 1e+308, more than 10000"),
        ("velocity", 2, math.nan, "velocity[2] is nan"),
        ("height", 0, -2e4, "height is -20000, not -12000 to 1e+06 m"),
        ("gyro_bias", 0, -1e308, "gyro_bias[0] is -1e+308, more than 100"),
        ("accel_bias", 2, 2e3, "accel_bias[2] is 2000, more than 1000"),
        ("fine_alignment_done", 0, 0.5, "fine_alignment_done is 0.5, not 0 or 1"),
        ("stamp_sec", 0, 1e308, "stamp_sec is 1e+308, not a whole number from 0 to 2147483647"),
        ("stamp_nanosec", 0, 0.5, "stamp_nanosec is 0.5, not a whole number from 0 to 999999999"),
        ("apply_sec", 0, 1_700_000_100.0, "apply is 100.0 s after stamp, not 0 to 12 s"),
        ("apply_sec", 0, 1_699_999_999.0, "apply is -1.0 s after stamp, not 0 to 12 s"),
        ("covariance", 0, -1.0, "covariance[0, 0] is -1, not 0 to 4e+14"),
        ("covariance", 16, 1e308, "covariance[1, 1] is 1e+308, not 0 to 4e+14"),
        ("covariance", 1, 1e308, "covariance[0, 1] is 1e+308, more than its variances allow"),
        ("covariance", 1, 0.0, "covariance[0, 1] is 0, covariance[1, 0] "),
    ],
)
def test_an_implausible_number_is_named(field: str, index: int, value: float, text: str) -> None:
    with pytest.raises(RejectedMessageError) as raised:
        read_correction(as_message(_changed(field, index, value)))
    assert str(raised.value).startswith(text)


def test_an_indefinite_covariance_is_rejected() -> None:
    covariance = np.eye(SOLUTION_SIZE)
    for i, j, sign in ((0, 1, 1.0), (1, 2, 1.0), (0, 2, -1.0)):
        covariance[i, j] = covariance[j, i] = 0.9 * sign
    sent = _correction()._replace(covariance=covariance)
    with pytest.raises(RejectedMessageError, match=r"covariance has an eigenvalue of -0\.8 as correlation"):
        read_correction(as_message(pack_correction(sent)))


def test_another_number_of_states_is_named() -> None:
    sent = _correction()._replace(imu_errors=(0.0,))
    with pytest.raises(
        RejectedMessageError, match="covariance has 225 numbers, not 256: do all nodes have one version"
    ):
        read_correction(as_message(pack_correction(sent)))


def test_calibration() -> None:
    found = VelocityLog(LogParameters()).calibration([(0.01, 1e-4), (0.002, 1e-3), (-0.003, 2e-3)])
    known, names = configuration(), calibration_names()
    assert read_calibration(as_message(pack_calibration(found)), known, names) == found
    for name, value, text in (
        ("log.delay", 0.0, "log.delay is not the name of a calibration"),
        ("log.scale", 7.0, r"parameter log.scale: 7 is outside \[-0.5, 0.5\]"),
        ("log.scale", 1e308, "parameter log.scale: 1e[+]308 is outside"),
    ):
        with pytest.raises(RejectedMessageError, match=text):
            read_calibration(as_message(pack_calibration({**found, name: value})), known, names)


def test_a_zupt_call_is_near_the_samples() -> None:
    message = SimpleNamespace(stamp=SimpleNamespace(sec=STAMP_NS // NS, nanosec=STAMP_NS % NS), frame_id="base_link")
    assert read_zupt(message, STAMP_NS + 5 * NS) == STAMP_NS
    with pytest.raises(RejectedMessageError, match=r"stamp is -60\.0 s after the newest of imu/data_raw"):
        read_zupt(message, STAMP_NS + 60 * NS)
