"""Loaded before the tests import numpy: the commands limit BLAS to one thread, which numpy asks for once."""

import pytest

import ins_nav.cli  # noqa: F401


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Side by side (``-n``), tests of nodes follow one another: each has time to keep."""
    for item in items:
        if hasattr(getattr(item, "module", None), "needs_ros"):
            item.add_marker(pytest.mark.xdist_group("nodes"))
