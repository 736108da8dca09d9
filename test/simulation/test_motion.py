"""Signals with exact derivatives, profiles, paths."""

import numpy as np
import pytest
from scipy.integrate import quad
from simulation_harness import car, close

from ins_nav.simulation.motion import Signal, integral_of_profile, sinusoid, smooth_profile


@pytest.mark.parametrize(
    "signal",
    [
        sinusoid(2.0, 7.0, 0.3),
        smooth_profile(1.0, [(2.0, 10.0, 5.0), (15.0, 10.0, -3.0)]),
        smooth_profile(1.0, [(0.0, 30.0, 0.0)]) * sinusoid(1.0, 9.0) + 2.0,
    ],
)
def test_derivatives_of_signals(signal: Signal) -> None:
    t = np.array([0.7, 3.3, 8.1, 17.0, 23.9])
    h = 1e-4
    for order in (0, 1, 2):
        slope = (signal(t + h, order) - signal(t - h, order)) / (2.0 * h)
        # rounding 1e-16 * 5 / h = 5e-12, truncation h²/6 * f''' < 1e-8
        close(signal(t, order + 1), slope, atol=2e-8)


def test_profile_keeps_its_values_exactly() -> None:
    profile = smooth_profile(12.1, [(1.0, 2.0, 0.3), (3.0, 1.0, 0.0)])
    np.testing.assert_array_equal(profile(np.array([0.0, 0.99, 4.0, 1e4])), [12.1, 12.1, 0.0, 0.0])
    np.testing.assert_array_equal(profile(np.array([0.5, 4.0, 1e4]), 1), 0.0)
    with pytest.raises(ValueError, match="start after 3"):
        smooth_profile(0.0, [(1.0, 2.0, 1.0), (2.9, 1.0, 2.0)])


def test_path_is_the_integral_of_speed_and_direction() -> None:
    drive = car().motion
    route_speed, yaw = drive._speed, drive._angles[0]
    assert route_speed is not None
    for t in (12.3, 33.333, 59.9):
        x, y = drive.sample(np.array([t])).position[:2, 0]
        for value, part in ((x, np.cos), (y, np.sin)):
            true, _ = quad(lambda s: route_speed(s) * part(yaw(s)), 0.0, t, points=[5, 15, 23, 33, 41], epsabs=1e-11)  # noqa: B023
            assert value == pytest.approx(true, abs=1e-9)


def test_integral_of_a_profile() -> None:
    changes = [(1.0, 2.0, 0.3), (3.0, 1.0, -0.1)]
    rate, integral = smooth_profile(0.2, changes), integral_of_profile(0.2, changes)
    t = np.array([0.0, 0.5, 1.7, 3.4, 4.0, 50.0])
    for order in range(3):
        close(integral(t, order + 1), rate(t, order), atol=1e-13)  # rounding of terms of 10
    # the smooth step is symmetric: half of the way in a change is at the mean of its ends
    close(integral(t)[[0, 1, 4, 5]], [0.0, 0.1, 0.2 + 0.5 + 0.1, 0.8 - 4.6], atol=1e-14)
