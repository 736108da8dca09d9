"""Scale factors of the accelerometers."""

from estimation.imu_readings import check_readings

from ins_nav.estimation.states.accel_scale import AccelScale


def test_readings_are_those_of_the_simulated_sensors() -> None:
    check_readings(AccelScale(stddev=1e-4), [3e-4, -2e-4, 1e-4], accel_scale_ppm=(300.0, -200.0, 100.0))
