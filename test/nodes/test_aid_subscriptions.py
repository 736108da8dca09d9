"""Subscriptions follow the message type that is published."""

from pathlib import Path

import pytest
from ros_harness import Ros, needs_ros

from ins_nav.recordings.bags import BagWriter, message

NS = 1_000_000_000
PLAIN, WITH, POSE = (
    f"geometry_msgs/msg/{name}" for name in ("TwistStamped", "TwistWithCovarianceStamped", "PoseStamped")
)


ABSENT = "absent_msgs/msg/Speed"


@pytest.mark.parametrize(
    ("used", "published", "chosen", "text"),
    [
        (WITH, set(), WITH, ""),
        (PLAIN, set(), PLAIN, ""),
        (WITH, {WITH}, WITH, ""),
        (WITH, {PLAIN}, PLAIN, ""),
        (PLAIN, {PLAIN, WITH}, PLAIN, f"log: {WITH} is published there besides {PLAIN}: only the latter is received"),
        (WITH, {PLAIN, POSE}, PLAIN, f"log: {POSE} is published there besides {PLAIN}: only the latter is received"),
        (WITH, {POSE}, WITH, f"log: {POSE} is published there; supported here: {WITH}, {PLAIN}"),
    ],
)
@needs_ros
def test_choice_of_the_type(used: str, published: set[str], chosen: str, text: str) -> None:
    from ins_nav.nodes.aid_subscriptions import choose_type

    assert choose_type("log", (WITH, PLAIN), used, published) == (chosen, text)


def _play(ros: Ros, name: str, msgtype: str) -> None:
    """Messages of 10 s, on the topic log; the player ends with the test."""
    with BagWriter(ros.folder / name) as bag:
        for i in range(100):
            bag.write("log", msgtype, message(msgtype), 10**18 + i * NS // 10)
    ros.start("ins_nav.nodes.bag_player", ros.folder / name, "--no-progress", "--loop")


@needs_ros
@pytest.mark.parametrize("msgtype", [PLAIN, POSE])
def test_a_publisher_of_another_type(tmp_path: Path, msgtype: str) -> None:
    """One of the aid's second type is received, one of another type is named."""
    with Ros(tmp_path) as ros:
        node = ros.start(Path(__file__).with_name("aid_listener.py"), "log", ABSENT, WITH, PLAIN)
        node.wait_for_output("subscribed to log")
        _play(ros, "bag", msgtype)
        if msgtype == PLAIN:
            node.wait_for_output(f"log: {PLAIN} is published there, subscribed")
            node.wait_for_output("received TwistStamped on log", 30.0)
        else:
            node.wait_for_output(f"log: {POSE} is published there; supported here: {WITH}, {PLAIN}")
        assert node.stop() == 0
