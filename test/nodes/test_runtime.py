"""Signals end a node cleanly, whenever they come and however many: exit code 0, only the node's lines on stderr."""

import signal
import time
from pathlib import Path

import pytest
from ros_harness import Process, Ros, needs_ros, wait_until

from ins_nav.recordings.bags import BagWriter, message

pytestmark = needs_ros

_COMMAND = "import sys; from ins_nav.nodes.commands import {0}; sys.exit({0}())"


def _command(ros: Ros, name: str) -> Process:
    """The node as its command starts it: signals are blocked before the imports."""
    script = ros.folder / f"{name}.py"
    script.write_text(_COMMAND.format(name))
    return ros.start(script)


def _blocks_signals(process: Process) -> bool:
    status = Path(f"/proc/{process.pid}/status").read_text()
    mask = next(line.split()[1] for line in status.splitlines() if line.startswith("SigBlk:"))
    return bool(int(mask, 16) >> (signal.SIGTERM - 1) & 1)


@pytest.mark.parametrize("name", ["ins_node", "ins_system"])
def test_signals_in_quick_succession(tmp_path: Path, name: str) -> None:
    """The second comes while the first is worked on; 0 to 10 ms between them."""
    sequences = [
        (0.0, signal.SIGINT, signal.SIGINT),
        (0.001, signal.SIGTERM, signal.SIGINT, signal.SIGTERM),
        (0.01, signal.SIGTERM, signal.SIGTERM),
        (0.0, signal.SIGHUP),
    ]
    with Ros(tmp_path) as ros:
        nodes = [_command(ros, name) for _ in sequences]
        for node, (gap, *signals) in zip(nodes, sequences, strict=True):
            node.wait_for_output("waiting for imu/data_raw")
            for number in signals:
                node.send_signal(number)
                time.sleep(gap)
        for node in nodes:
            assert node.wait() == 0, node.stderr
            assert all("waiting for imu/data_raw" in line for line in node.stderr.splitlines()), node.stderr


def test_signals_while_the_node_starts(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        nodes = []
        for delay in (0.0, 0.5, 1.0, 1.5):  # imports, rclpy, the node itself
            node = _command(ros, "ins_node")
            wait_until(lambda node=node: _blocks_signals(node), 20.0, lambda: "signals are not blocked")
            time.sleep(delay)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
                node.send_signal(number)
            nodes.append(node)
        for node in nodes:
            assert node.wait() == 0, node.stderr
            assert "Traceback" not in node.stderr and "Fatal" not in node.stderr


def test_bag_player_ends_at_a_signal_before_it_has_subscribers(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("imu/data_raw", "sensor_msgs/msg/Imu", message("sensor_msgs/msg/Imu"), 10**18)
    with Ros(tmp_path) as ros:
        player = ros.start("ins_nav.nodes.bag_player", tmp_path / "bag", "--no-progress")
        player.wait_for_output("waiting for a subscriber")
        player.send_signal(signal.SIGTERM)
        player.send_signal(signal.SIGINT)
        assert player.wait() == 0, player.stderr
