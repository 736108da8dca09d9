"""Check of an `ImuError` against the simulated sensors, which are written independently."""

import numpy as np
from numpy.typing import ArrayLike

from ins_nav.estimation.imu_error import ImuError, ImuErrors
from ins_nav.simulation.sensors import ImuErrors as SimulatedErrors

TRUE = np.array([0.1, -0.2, 0.3, 1.0, -2.0, 9.5])
"""rad/s and m/s²."""


def check_readings(error: ImuError, states: ArrayLike, **simulated: tuple[float, ...]) -> None:
    """Equal errors as states and as parameters of the simulation: equal readings, and the correction removes them."""
    sensors = SimulatedErrors(**simulated)  # type: ignore[arg-type]
    rate, _ = sensors.gyro.measure(TRUE[None, :3], 0.01, 0, "gyro")
    force, _ = sensors.accel.measure(TRUE[None, 3:], 0.01, 0, "accel")
    reading = np.concatenate([rate[0], force[0]])
    errors = ImuErrors([error])
    assert errors.size == len(error.components)
    np.testing.assert_allclose(TRUE + errors.columns(TRUE) @ np.asarray(states), reading, atol=1e-12)
    np.testing.assert_allclose(errors.correction(np.asarray(states)) @ reading, TRUE, atol=1e-12)
