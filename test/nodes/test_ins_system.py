"""`ins_system`: the nodes in one process, its help, errors and end."""

from pathlib import Path

from ros_harness import Ros, needs_ros

pytestmark = needs_ros

MODULE = "ins_nav.nodes.ins_system"


def test_help_errors_and_end_by_sigint(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        system = ros.start(MODULE)
        wrong = ros.start(MODULE, "--ros-args", "-p", "alignment.durration:=30")
        asked = ros.start(MODULE, "--help")
        assert asked.wait() == 0 and asked.stdout.startswith("usage: ins_system [--ros-args")
        assert wrong.wait() == 1
        sentence = "ins_system: unknown parameter alignment.durration: did you mean alignment.duration?"
        assert [line for line in wrong.stderr.splitlines() if line] == [sentence]
        system.wait_for_output("waiting for imu/data_raw")
        system.interrupt()
        assert system.wait() == 0 and "Traceback" not in system.stderr
