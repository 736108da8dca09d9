"""Console commands of the nodes on a machine without ROS."""

import sys

import pytest

from ins_nav.nodes import commands


def test_missing_rclpy_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)  # the import then fails as if it were not installed
    assert commands.ins_node() == 1
    assert capsys.readouterr().err == (
        "ins_node: rclpy is missing: source /opt/ros/jazzy/setup.bash, or pip install 'ins_nav[jazzy]'\n"
    )
