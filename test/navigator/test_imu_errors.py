"""Scale factors and misalignments through both navigators: estimated ones correct samples, in the message too."""

import numpy as np
import pytest
from aided_harness import SHORT, Fed, aid_events, imu_events, same_feedback
from decoding import as_message

from ins_nav.estimation.state_layout import SOLUTION_SIZE
from ins_nav.messages import correction_codec
from ins_nav.simulation.scenarios import simulate

SCALE = 3e-3
PARAMETERS = {**SHORT, "imu.gyro_scale_stddev_ppm": 1e6 * SCALE, "imu.gyro_scale_estimated": True}


@pytest.fixture(scope="module")
def fed() -> Fed:
    """A car whose vertical gyro reads 0.3 % too much: three turns by 90° are off by 0.8°."""
    s = simulate(
        "vehicle", 3, duration=140.0, rate=50.0, stand_time=24.0, **{"imu.gyro_scale_ppm": (0.0, 0.0, 1e6 * SCALE)}
    )
    return Fed(PARAMETERS).feed(imu_events(s), aid_events(s, ("fix", "velocity")), ins=True)


def test_a_scale_factor_is_found(fed: Fed) -> None:
    found = fed.feedback[-1]
    assert len(found.imu_errors) == 3 and found.covariance.shape == (SOLUTION_SIZE + 3,) * 2
    sigma = np.sqrt(found.covariance.diagonal()[SOLUTION_SIZE:])
    assert sigma[2] < 0.3 * SCALE
    assert abs(found.imu_errors[2] - SCALE) < 3.0 * sigma[2]


def test_it_corrects_the_samples_of_the_real_time_solution(fed: Fed) -> None:
    _, *reading = fed.ins.front_end.raw
    found = fed.ins.realtime.solution()
    assert found is not None and found.imu_errors in [
        f.imu_errors for f in fed.feedback[-3:]
    ]  # those of now are to come
    true = np.array(reading[:3]) / (1.0 + np.array(found.imu_errors)) - found.gyro_bias
    np.testing.assert_allclose(fed.ins.realtime.angular_velocity, true, atol=1e-12)


def test_message_there_and_back(fed: Fed) -> None:
    back = correction_codec.read_correction(as_message(correction_codec.pack_correction(fed.feedback[-1])))
    assert same_feedback([back], [fed.feedback[-1]])
