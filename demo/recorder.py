"""Records live nodes: recorder.py BAG NODES. Prints one line of JSON: latency from sample to solution.

Waits for a given number of nodes. Ends when stdin is closed, after diagnostics newer than the last sample.
"""

import json
import struct
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from ins_nav.nodes.runtime import init, message_class, spin
from ins_nav.recordings.bags import BagWriter, typestore

_TYPES = {
    "imu/data_raw": "sensor_msgs/msg/Imu",
    "odometry": "nav_msgs/msg/Odometry",
    "imu/data": "sensor_msgs/msg/Imu",
    "fix": "sensor_msgs/msg/NavSatFix",
    "imu/bias": "sensor_msgs/msg/Imu",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
_LATCHED = ("imu/bias",)
_DEPTH = 5000  # 5 s at 10 times 100 Hz
_STAMP = struct.Struct("<iI")  # of the header, behind the 4 bytes of CDR's own


class Recorder(Node):
    """Keeps what comes, in memory: writing at once would be in the way of what it measures.

    Parameters
    ----------
    nodes : int
        How many there are to wait for: each tells of itself on /diagnostics.
    """

    def __init__(self, nodes: int = 1) -> None:
        super().__init__("recorder")
        self._nodes = nodes
        self.received: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in _TYPES}
        self._closed = threading.Event()
        self._last_ones: Counter[str] = Counter()
        for topic in _TYPES:
            if topic != "imu/data_raw":
                self._subscribe(topic)
        self._greeting = self.create_timer(0.1, self._greet)
        self._joining = self.create_timer(0.1, self._join)
        threading.Thread(target=self._wait_for_the_end, daemon=True).start()

    def _subscribe(self, topic: str) -> None:
        latched = DurabilityPolicy.TRANSIENT_LOCAL if topic in _LATCHED else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=_DEPTH, durability=latched)
        self.create_subscription(message_class(_TYPES[topic]), topic, self._keeper(topic), qos, raw=True)

    def _keeper(self, topic: str) -> Callable[[bytes], None]:
        keep, now = self.received[topic].append, time.monotonic_ns
        if topic != "/diagnostics":
            return lambda data: keep((now(), data))

        def keep_and_end(data: bytes) -> None:
            keep((now(), data))
            if not self._closed.is_set():
                return
            message: Any = typestore().deserialize_cdr(data, _TYPES["/diagnostics"])
            self._last_ones.update(status.name for status in message.status)
            # the first may tell of a moment before the last sample
            if sum(count >= 2 for count in self._last_ones.values()) >= self._nodes:
                self.context.try_shutdown()

        return keep_and_end

    def _greet(self) -> None:
        if self.count_publishers("/diagnostics") >= self._nodes and self.count_publishers("odometry"):
            print("ready", flush=True)
            self._greeting.cancel()

    def _join(self) -> None:
        """Listen to the samples, now that the node has some: the player waits for the node then, and not for us."""
        if self.received["odometry"]:
            self._subscribe("imu/data_raw")
            self._joining.cancel()

    def _wait_for_the_end(self) -> None:
        sys.stdin.read()
        self._closed.set()


def latency_ms(samples: list[tuple[int, bytes]], solutions: list[tuple[int, bytes]]) -> np.ndarray:
    """From the arrival of a sample to that of its solution, both in this process."""
    received = {_STAMP.unpack_from(data, 4): at for at, data in samples}
    back = ((at, received.get(_STAMP.unpack_from(data, 4))) for at, data in solutions)
    return np.array([(at - since) * 1e-6 for at, since in back if since is not None])


def main() -> None:
    path, nodes = init()
    recorder = Recorder(int(nodes))
    spin(recorder)
    with BagWriter(path, overwrite=True) as bag:
        for topic, msgtype in _TYPES.items():
            bag.add_topic(topic, msgtype, latched=topic in _LATCHED)
            if topic != "imu/data_raw":  # the recording that is played has it
                for at, data in recorder.received[topic]:
                    bag.write_raw(topic, msgtype, data, at)
    delays = latency_ms(recorder.received["imu/data_raw"], recorder.received["odometry"])
    percentiles = np.percentile(delays, [50, 99]).tolist() if len(delays) else None
    print(json.dumps({"latency_ms": percentiles}))


if __name__ == "__main__":
    main()
