"""The test's ear in ROS, a process of its own: ros_probe.py STREAM [--latched] [TOPIC TYPE]...

Appends (topic, receive time in ns, CDR bytes) pickled to STREAM. A line ``call SERVICE`` on stdin calls a
std_srvs/Trigger service and appends ("", time, (success, message)).
"""

import pickle
import queue
import sys
import threading
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ins_nav.nodes.runtime import init, message_class, spin
from ins_nav.recordings.bags import absolute


class Probe(Node):
    """Records what it hears."""

    def __init__(self, stream: Any, topics: dict[str, str], latched: bool) -> None:
        super().__init__("probe")
        self._stream = stream
        self._requests: queue.SimpleQueue[str] = queue.SimpleQueue()
        qos = QoSProfile(
            depth=1000,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        for topic, msgtype in topics.items():
            self.create_subscription(message_class(msgtype), topic, self._recorder(topic), qos, raw=True)
        self.create_timer(0.05, self._housekeeping)
        threading.Thread(target=self._listen_to_stdin, daemon=True).start()

    def _recorder(self, topic: str) -> Any:
        name = absolute(topic)
        return lambda data: self._append(name, data)

    def _append(self, topic: str, content: Any) -> None:
        pickle.dump((topic, time.time_ns(), content), self._stream)

    def _listen_to_stdin(self) -> None:
        for line in sys.stdin:
            self._requests.put(line.split()[1])

    def _housekeeping(self) -> None:
        while not self._requests.empty():
            client = self.create_client(Trigger, self._requests.get())
            threading.Thread(target=self._call, args=(client,), daemon=True).start()
        self._stream.flush()

    def _call(self, client: Any) -> None:
        client.wait_for_service()
        client.call_async(Trigger.Request()).add_done_callback(
            lambda future: self._append("", (future.result().success, future.result().message))
        )


def main() -> None:
    stream_path, *rest = init()
    latched = "--latched" in rest
    pairs = [word for word in rest if word != "--latched"]
    with open(stream_path, "ab") as stream:
        probe = Probe(stream, dict(zip(pairs[::2], pairs[1::2], strict=True)), latched)
        print("ready", flush=True)
        spin(probe)


if __name__ == "__main__":
    main()
