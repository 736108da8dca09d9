"""Prints topics and frames of what `ins_node` publishes at one sample, in order; parameters come as ROS arguments.

`tf2_msgs` is not installed everywhere, so its message and all publishers are stand-ins here. Messages published as
bytes are deserialized by rclpy.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from ins_nav.nodes.runtime import init

_INTERVAL_NS = 20_000_000


class _Publisher:
    def __init__(self, kind: Any, topic: str, published: list[str]) -> None:
        self._kind = kind
        self._topic = topic
        self._published = published

    def publish(self, message: Any) -> None:
        if isinstance(message, bytes):
            message = deserialize_message(message, self._kind)
        stamped = message.transforms[0] if self._topic == "/tf" else message
        header = getattr(stamped, "header", Header())
        self._published.append(f"{self._topic}:{header.frame_id}@{header.stamp.sec}.{header.stamp.nanosec:09}")


def main() -> None:
    messages = ModuleType("tf2_msgs.msg")
    messages.TFMessage = SimpleNamespace  # type: ignore[attr-defined]
    sys.modules["tf2_msgs"], sys.modules["tf2_msgs.msg"] = ModuleType("tf2_msgs"), messages
    from ins_nav.nodes.ins_node import InsNode

    published: list[str] = []

    class Node(InsNode):
        def create_publisher(self, kind: Any, topic: str, *_: Any, **__: Any) -> Any:
            return _Publisher(kind, topic, published)

    init()
    node = Node()
    receive = next(item.callback for item in node.subscriptions if item.topic_name == "/imu/data_raw")
    sample = Imu()
    sample.linear_acceleration.z = 9.81
    for i in range(1, 1000):
        sample.header.stamp.sec, sample.header.stamp.nanosec = divmod(i * _INTERVAL_NS, 10**9)
        published.clear()
        receive(serialize_message(sample))
        if len(published) > 1:
            break
    print(*published)


if __name__ == "__main__":
    main()
