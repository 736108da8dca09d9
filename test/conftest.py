"""Loaded before the tests import numpy: the commands limit BLAS to one thread, which numpy asks for once."""

import pytest

import ins_nav.cli  # noqa: F401


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Side by side (``-n``), tests of nodes in one module follow one another: they share recordings and live runs.

    What lasts longest starts first, so that no core is idle at the end.
    """
    for item in items:
        module = getattr(item, "module", None)
        if hasattr(module, "needs_ros"):
            item.add_marker(pytest.mark.xdist_group(module.__name__))
    items.sort(key=_order)


def _order(item: pytest.Item) -> int:
    if item.get_closest_marker("xdist_group"):
        return 0
    return 1 if item.get_closest_marker("slow") else 2
