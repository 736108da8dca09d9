"""Errors of a result against a reference: known offsets, sigmas, gaps."""

import numpy as np
import pytest
from report_harness import RESULT, RESULT_SIGMAS, START_NS, write

from ins_nav.report.comparison import compare
from ins_nav.report.series import read_reference, read_result


def test_known_offsets_are_the_errors(off):
    _, _, errors = off
    assert errors.position.stamps_ns[0] == START_NS + 10_030_000_000
    assert len(errors.position.stamps_ns) == 320
    # 1 mm: the radii of curvature are those of one latitude
    np.testing.assert_allclose(errors.position.values, np.tile([3.0, -4.0, 2.0], (320, 1)), atol=1e-3)
    # spherical interpolation is exact for a constant rate: rounding only, also across north
    np.testing.assert_allclose(np.degrees(errors.attitude.values), np.tile([0.1, -0.2, 0.5], (320, 1)), atol=1e-9)
    # between samples the velocity is interpolated after its rotation, so rounding only
    np.testing.assert_allclose(errors.velocity.values, np.tile([0.3, 0.4, -0.5], (320, 1)), atol=1e-9)


def test_errors_have_the_sigmas_of_the_result(off, bags):
    _, _, errors = off
    np.testing.assert_allclose(errors.position.stddev, np.tile(RESULT_SIGMAS["enu"], (320, 1)), rtol=1e-12)
    plain = compare(read_result(bags / "plain", "plain"), read_reference(bags / "truth"))
    assert np.isnan(plain.position.stddev).all()
    assert np.isnan(plain.attitude.stddev).all()


def test_nothing_is_interpolated_across_a_gap(tmp_path, bags):
    times = np.concatenate([np.arange(20.0, 30.0, 0.1), np.arange(40.0, 50.0, 0.1)])
    result = read_result(write(tmp_path / "gap", RESULT, times), "gap")
    stamps = compare(result, read_reference(bags / "truth")).position.stamps_ns
    seconds = (stamps - START_NS) * 1e-9
    assert not ((seconds > 29.91) & (seconds < 40.0)).any()
    assert seconds.max() > 49.0


def test_a_reference_of_positions_only(tmp_path, bags):
    path = tmp_path / "gnss"
    write(path, ("gnss/fix", "other/imu", "other/velocity"), np.arange(0.0, 50.0, 1.0))
    reference = read_reference(path)
    errors = compare(read_result(bags / "result", "result"), reference)
    assert errors.attitude is None
    assert errors.velocity is None
    assert errors.position.values[:, 0].mean() == pytest.approx(3.0, abs=1e-3)
