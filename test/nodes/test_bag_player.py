"""bag_player over real DDS, in separate processes."""

import json
import re
from pathlib import Path

from ros_harness import Listener, Ros, needs_ros
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg

from ins_nav.recordings.bags import BagWriter, header, message, typestore

pytestmark = needs_ros

PLAYER = "ins_nav.nodes.bag_player"
IMU = "sensor_msgs/msg/Imu"
BOOL = "std_msgs/msg/Bool"
CLOCK = "rosgraph_msgs/msg/Clock"
START_NS = 1_700_000_000_000_000_000
STEP_NS = 2_500_000


def write_bag(path: Path, seconds: float) -> Path:
    """400 Hz of Imu; stopped, latched, at the start."""
    imu = message(IMU)
    with BagWriter(path) as bag:
        bag.add_topic("stopped", BOOL, latched=True)
        bag.write("stopped", BOOL, message(BOOL, data=True), START_NS)
        for i in range(round(seconds * 400)):
            imu.header = header(START_NS + i * STEP_NS, "imu_link")
            bag.write("imu/data_raw", IMU, imu, START_NS + i * STEP_NS)
    return path


def numbers(listener: Listener, topic: str = "imu/data_raw") -> list[int]:
    """Which of the bag's Imu messages came, in order of arrival."""
    stamps = (received.message.header.stamp for received in listener.messages(topic))
    return [(stamp.sec * 10**9 + stamp.nanosec - START_NS) // STEP_NS for stamp in stamps]


def test_every_message_arrives_once_and_in_order(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=5.0)
    with Ros(tmp_path) as ros:
        listener = ros.listen({"imu/data_raw": IMU})
        player = ros.start(PLAYER, bag)
        assert player.wait() == 0
        listener.wait_for_count("imu/data_raw", 2000)
        assert listener.stop() == 0
        assert numbers(listener) == list(range(2000))
        assert "published 2001 messages" in player.stdout
        assert player.stderr == ""


def test_topics_remap_start_offset_namespace(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=2.0)
    with Ros(tmp_path) as ros:
        listener = ros.listen({"/boat/imu/port": IMU, "/boat/stopped": BOOL, "/boat/imu/data_raw": IMU})
        options = ["--topics", "imu/data_raw", "--remap", "/imu/data_raw:=imu/port", "--start-offset", "1.5"]
        player = ros.start(PLAYER, bag, *options, "-r", "2", "--ros-args", "-r", "__ns:=/boat")
        assert player.wait() == 0
        listener.wait_for_count("/boat/imu/port", 200)
        listener.stop()
        assert numbers(listener, "/boat/imu/port") == list(range(600, 800))
        assert not listener.messages("/boat/stopped")
        assert not listener.messages("/boat/imu/data_raw")


def test_pause_resume_loop_and_ctrl_c(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=0.5)
    with Ros(tmp_path) as ros:
        listener = ros.listen({"imu/data_raw": IMU})
        player = ros.start(PLAYER, bag, "--start-paused", "--loop")
        assert listener.call("bag_player/pause") == (True, "paused")
        assert numbers(listener) == []
        assert listener.call("bag_player/toggle_paused") == (True, "playing")
        listener.wait_for_count("imu/data_raw", 450)
        assert listener.call("bag_player/toggle_paused") == (True, "paused")
        assert listener.call("bag_player/resume") == (True, "playing")
        listener.wait_for_count("imu/data_raw", 650)
        player.interrupt()
        assert player.wait() == 0
        listener.stop()
        came = numbers(listener)
        assert came == [i % 200 for i in range(len(came))]
        published = re.search(r"published (\d+) messages .*/imu/data_raw (\d+), /stopped (\d+)", player.stdout)
        assert published
        assert int(published[2]) == len(came)


def test_clock_and_latched_topics_for_whoever_comes_late(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=60.0)
    with Ros(tmp_path) as ros:
        player = ros.start(PLAYER, bag, "--clock", "100", "--wait-for-subscribers", "0")
        clock = ros.listen({"/clock": CLOCK})
        clock.wait_for_count("/clock", 20)
        late = ros.listen({"stopped": BOOL}, latched=True)
        late.wait_for_count("stopped", 1)
        player.terminate()
        assert player.wait() == 0
        times = [received.message.clock for received in clock.messages("/clock")]
        stamps = [time.sec * 10**9 + time.nanosec for time in times]
        assert stamps == sorted(stamps)  # never backwards
        assert START_NS <= stamps[0] < stamps[-1] < START_NS + 60 * 10**9


def test_ctrl_c_while_nobody_listens(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", seconds=0.1)
    with Ros(tmp_path) as ros:
        player = ros.start(PLAYER, bag)
        player.wait_for_output(r"waiting for a subscriber to .*/imu/data_raw")
        player.interrupt()
        assert player.wait() == 0
        assert "published 0 messages" in player.stdout


RUN_ALL = """
import json, sys
from ins_nav.nodes.bag_player import main
for arguments in json.loads(sys.argv[1]):
    print("code", main(arguments), file=sys.stderr)
"""


def test_errors_of_bad_arguments_and_bags(tmp_path: Path) -> None:
    """One process for all of them: the start of Python and ROS is longer than the rest."""
    bag = str(write_bag(tmp_path / "bag", seconds=1.0))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "bag" / "bag.mcap").read_bytes()[:100_000])
    script = tmp_path / "run_all.py"
    script.write_text(RUN_ALL)
    fast = ["--wait-for-subscribers", "0", "--rate", "1000"]
    cases = [
        ([bag, "--rate", "0"], r"argument -r/--rate: 0 is not above 0"),
        ([bag, "--rate", "fast"], r"argument -r/--rate: invalid .* value: 'fast'"),
        ([bag, "--start-offset", "-1"], r"argument --start-offset: -1 is below 0"),
        ([bag, "--start-offset", "2"], r"--start-offset 2: the bag is 1.0 s long"),
        ([bag, "--topics", "imu/data_rw"], r"no topic 'imu/data_rw' \(did you mean /imu/data_raw\?\)"),
        ([bag, "--remap", "imu/data_raw"], r"--remap 'imu/data_raw': expected OLD:=NEW"),
        ([bag, "--remap", "imu:=data"], r"no topic 'imu' \(there are: /imu/data_raw, /stopped\)"),
        ([bag, "--remap", "stopped:=a b"], r"'a b' is not a topic name"),
        ([bag, "--lop"], r"unknown argument '--lop' \(did you mean --loop\?\)"),
        ([], r"required: bag"),
        ([bag, "--ros-args", "-r", "x"], r"ROS arguments: .*remap rule: '-r x'"),
        ([str(tmp_path / "bagg")], r"no such bag \(did you mean .*bag\?\)"),
        ([str(cut), *fast], r"is damaged, all readable messages have been read: cut.mcap: cut off at byte 100000"),
    ]
    with Ros(tmp_path) as ros:
        process = ros.start(script, json.dumps([case[0] for case in cases]))
        assert process.wait() == 0
    answers = re.split(r"code (\d+)\n", process.stderr)
    for (arguments, expected), output, code in zip(cases, answers[::2], answers[1::2], strict=False):
        lines = [line for line in output.splitlines() if "[rcl]" not in line]  # rcl logs by itself
        assert code == "1", arguments
        assert len(lines) == 1, (arguments, output)
        assert re.match(f"bag_player: .*{expected}", lines[0]), (arguments, output)
    assert len(answers) == 2 * len(cases) + 1
    published = re.search(r"published (\d+) messages", process.stdout)
    assert published
    assert 100 < int(published[1]) < 401  # what there was of the damaged bag was played before


def test_a_type_that_is_not_installed_is_named_and_left_out(tmp_path: Path) -> None:
    msgtype = "no_such_msgs/msg/Thing"
    types = typestore().__class__()
    types.register(get_types_from_msg("float64 value", msgtype))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        thing = writer.add_connection("/thing", msgtype, typestore=types)
        stopped = writer.add_connection("/stopped", BOOL, typestore=typestore())
        writer.write(thing, START_NS, types.serialize_cdr(types.types[msgtype](value=1.0), msgtype))
        writer.write(stopped, START_NS, typestore().serialize_cdr(message(BOOL), BOOL))
    with Ros(tmp_path) as ros:
        player = ros.start(PLAYER, tmp_path / "bag", "--wait-for-subscribers", "0")
        assert player.wait() == 0
        assert re.search(r"not played: /thing \(.* package no_such_msgs is not installed", player.stdout)
        assert "published 1 messages in" in player.stdout
