"""Results and references as arrays."""

import numpy as np
import pytest
from report_harness import RESULT, RESULT_SIGMAS, write

from ins_nav.report.comparison import compare
from ins_nav.report.series import ReportError, read_reference, read_result


@pytest.mark.parametrize(("heading_deg", "roll", "pitch"), [(90.0, 1e-4, 2e-4), (0.0, 2e-4, 1e-4), (270.0, 1e-4, 2e-4)])
def test_sigmas_of_roll_and_pitch_turn_with_the_heading(tmp_path, heading_deg, roll, pitch):
    bag = write(
        tmp_path / "bag", RESULT, np.arange(0.0, 1.0, 0.1), heading_deg=heading_deg, turn=0.0, sigmas=RESULT_SIGMAS
    )
    sigma = read_result(bag, "bag").attitude.stddev
    # the nose is 2° down: roll grows by 1 / cos 2°, heading contains tan 2° of the roll
    expected = [roll / np.cos(np.radians(2.0)), pitch, np.hypot(3e-4, np.tan(np.radians(2.0)) * roll)]
    np.testing.assert_allclose(sigma, np.tile(expected, (10, 1)), rtol=1e-9)


def test_a_reference_is_found_by_name(tmp_path, bags):
    both = tmp_path / "both"
    write(both, ("reference/fix", "reference/imu", "reference/velocity"), np.arange(0.0, 50.0, 1.0))
    reference = read_reference(both)
    assert reference.name == "/reference/fix"
    errors = compare(read_result(bags / "result", "result"), reference)
    np.testing.assert_allclose(errors.velocity.values[:, :2], np.tile([0.3, 0.4], (40, 1)), atol=1e-9)
    # another result as the reference: its own topics
    other = read_reference(bags / "plain", "fix")
    errors = compare(read_result(bags / "result", "result"), other)
    np.testing.assert_allclose(np.degrees(errors.attitude.values[:, 2]), 0.5, atol=1e-9)
    assert read_reference(bags / "plain") is None


def test_a_lone_position_is_no_result(tmp_path):
    with pytest.raises(ReportError, match="fewer than 2 valid positions"):
        read_result(write(tmp_path / "lone", RESULT, np.array([1.0])), "lone")
