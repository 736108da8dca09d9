"""The solution's messages: covariances of what they carry."""

from typing import Any

import numpy as np
import pytest
from decoding import decoded
from navigators import Ins

from ins_nav.mechanization.compiled import compiled
from ins_nav.messages.solution import SolutionMessages, _write_numbers
from ins_nav.simulation.scenarios import simulate

_RATE = 100.0
_PLACE = {"initial.latitude_deg": 55.7, "initial.longitude_deg": 37.6, "initial.height": 150.0}
_HEADING = {"initial.heading_deg": 30.0, "alignment.level_duration": 20.0}


def _vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _navigated(**parameters: object) -> tuple[SolutionMessages, Ins, np.ndarray, np.ndarray]:
    """A tactical IMU at rest for 60 s: messages of the last solution; rates and forces of all, shape (n, 3)."""
    simulation = simulate("static", 4, rate=_RATE, duration=60.0, **{"imu.preset": "tactical"})
    navigator = Ins(_PLACE | _HEADING | parameters)
    out = SolutionMessages(navigator)
    rates, forces = [], []
    samples = np.column_stack([simulation.angular_velocity, simulation.linear_acceleration]).tolist()
    for stamp_ns, sample in zip(simulation.stamps_ns.tolist(), samples, strict=True):
        if navigator.add_imu(stamp_ns, *sample):
            out.fill(navigator.realtime.entries)
            imu = decoded(out.imu)
            rates.append(_vector(imu.angular_velocity))
            forces.append(_vector(imu.linear_acceleration))
    return out, navigator, np.array(rates), np.array(forces)


def test_numbers_are_written_without_compiling() -> None:
    """Another type among the arguments would compile again, for seconds, while samples wait: with a matrix, or none."""
    before = len(compiled(_write_numbers).signatures)
    SolutionMessages(Ins())
    first = len(compiled(_write_numbers).signatures)
    _navigated()
    assert before <= first <= before + 2 and len(compiled(_write_numbers).signatures) == first


@pytest.mark.parametrize(
    "parameters", [{}, {"imu.gyro_noise_deg_per_sqrt_hour": 0.1, "imu.accel_noise_ug_per_sqrt_hz": 60.0}]
)
def test_covariance_of_a_sample_has_its_white_noise(parameters: dict[str, float]) -> None:
    """Biases are constant in a minute at rest: what scatters is white noise, be it given or learnt in alignment."""
    out, navigator, rates, forces = _navigated(**parameters)
    imu = decoded(out.imu)
    twist = np.reshape(decoded(out.odometry).twist.covariance, (6, 6))[3:, 3:]
    for values, covariance, bias in (
        (rates, imu.angular_velocity_covariance, navigator.gyro_bias_covariance),
        (rates, twist, navigator.gyro_bias_covariance),
        (forces, imu.linear_acceleration_covariance, navigator.accel_bias_covariance),
    ):
        white = np.reshape(covariance, (3, 3)) - bias
        assert white[~np.eye(3, dtype=bool)] == pytest.approx(0.0, abs=1e-6 * white.max())
        # Differences of neighbours are free of biases. Their variance has a sigma of 3 % over 4000 samples, the noise
        # learnt from 2000 one of 4 %.
        scatter = 0.5 * np.diff(values, axis=0).var(axis=0)
        assert white.diagonal() == pytest.approx(scatter, rel=0.15)
