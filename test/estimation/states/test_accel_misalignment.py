"""Misalignments of the accelerometers."""

import numpy as np
from estimation.imu_readings import check_readings

from ins_nav.config.declaration import ARCSEC
from ins_nav.estimation.states.accel_misalignment import AccelMisalignment


def test_readings_are_those_of_the_simulated_sensors() -> None:
    angles = (20.0, 40.0, -60.0, 80.0, -100.0, 120.0)
    check_readings(AccelMisalignment(stddev=1e-4), np.multiply(ARCSEC, angles), accel_misalignment_arcsec=angles)
