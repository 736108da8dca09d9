"""Diagnostics of a node whose IMU falls silent."""

from pathlib import Path

from ros_harness import Ros, needs_ros

from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

pytestmark = needs_ros


def test_silence_of_the_imu_is_an_error(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    write_bag(simulate("static", duration=2.0, rate=50.0, **{"truth.rate": 1.0}), bag)
    with Ros(tmp_path) as ros:
        listener = ros.listen({"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"})
        ins = ros.start("ins_nav.nodes.ins_node")
        listener.wait_for_count("/diagnostics", 1)
        player = ros.start("ins_nav.nodes.bag_player", bag, "--no-progress", "--topics", "/imu/data_raw")
        assert player.wait(60.0) == 0

        def status() -> tuple[bytes | int, str]:
            last = listener.messages("/diagnostics")[-1].message.status[0]
            return last.level, last.message

        listener.wait_for(lambda: "no messages on imu/data_raw for" in status()[1])
        assert status()[0] == 2
        assert ins.stop() == 0
