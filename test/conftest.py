"""Loaded before the tests import numpy: `ins_nav` limits BLAS to one thread, which numpy asks once."""

import pytest

import ins_nav  # noqa: F401


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Side by side (``-n``), tests of nodes follow one another: each has time to keep."""
    for item in items:
        if hasattr(getattr(item, "module", None), "needs_ros"):
            item.add_marker(pytest.mark.xdist_group("nodes"))
