"""Fixtures of the reports' tests."""

from pathlib import Path

import pytest
from report_harness import write_bags

from ins_nav.report.comparison import compare
from ins_nav.report.series import read_reference, read_result


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bags(tmp_path_factory.mktemp("bags"))


@pytest.fixture(scope="module")
def off(bags):
    result, reference = read_result(bags / "result", "result"), read_reference(bags / "truth")
    return result, reference, compare(result, reference)
