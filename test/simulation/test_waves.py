"""Rocking of a base, and its end."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulation_harness import close

from ins_nav.simulation.scenarios import simulate


def test_rocking_rocks_and_then_stands() -> None:
    s = simulate("rocking", duration=60.0, rate=50.0, rocking_time=40.0, sway_amplitude=0.2)
    t = s.trajectory
    yaw, pitch, roll = Rotation.from_quat(t.q_nb).as_euler("ZYX", degrees=True).T
    # sampled every 0.02 s of 11 s: cos(pi * 0.02 / 11) of the peak; the truth turns with the carrier's place: 1e-7
    assert roll[:2000].max() == pytest.approx(5.0, rel=1e-4)
    assert pitch[:2000].min() == pytest.approx(-5.0, rel=1e-4)
    close(yaw, 60.0, atol=1e-5)
    assert np.abs(t.velocity_n[:2000]).max() > 0.1
    np.testing.assert_array_equal(t.velocity_n[45 * 50 + 1 :], 0.0)
    close(roll[45 * 50 + 1 :], 0.0, atol=1e-12)
