"""Plays a bag as fast as the nodes can follow: paced_player.py BAG RATE CORRECTIONS.

CORRECTIONS is a JSON file with two stamps, ns, for each correction of `alignment_node`: of the state, and of the sample
with which it takes effect. The bag is played at RATE, but a sample is published only after the corrections that take
effect with it. A loaded machine makes the replay slow; a correction that does not come at all ends it with an error.
"""

import json
import sys
import threading
import time
from functools import partial
from pathlib import Path

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import Float64MultiArray

from ins_nav.messages.correction_codec import read_feedback
from ins_nav.nodes.runtime import init, message_class, on_signal, serve
from ins_nav.recordings.bags import BagReader

_AHEAD_NS = 100_000_000  # of data, for the way from alignment_node to ins_node
_QOS = QoSProfile(depth=1000)
_PATIENCE = 30.0  # s; the solution of coarse alignment takes one on an idle machine


class PacedPlayer(Node):
    """Publishes messages, and waits for corrections."""

    def __init__(self, expected: list[tuple[int, int]]) -> None:
        super().__init__("paced_player")
        self._expected = expected
        self._received: set[int] = set()
        self._news = threading.Condition()
        self.waited = 0.0
        self.create_subscription(Float64MultiArray, "ins/feedback", self._on_feedback, _QOS)

    def _on_feedback(self, message: Float64MultiArray) -> None:
        correction = read_feedback(message)
        if correction is not None:
            with self._news:
                self._received.add(correction.stamp_ns)
                self._news.notify()

    def wait_for_corrections(self, stamp_ns: int) -> None:
        """Wait for all that take effect up to a sample."""
        began = time.monotonic()
        while self._expected and self._expected[0][1] <= stamp_ns + _AHEAD_NS:
            first = self._expected.pop(0)[0]
            with self._news:
                if not self._news.wait_for(partial(self._received.__contains__, first), _PATIENCE):
                    sys.exit(f"no correction of {first} ns within {_PATIENCE:g} s, the replay is at {stamp_ns} ns")
        self.waited += time.monotonic() - began

    def play(self, path: Path, rate: float) -> None:
        """Play all but the truth."""
        with BagReader(path) as bag:
            topics = [topic for topic in bag.topics if not topic.startswith("/truth/")]
            outputs = {
                topic: self.create_publisher(
                    message_class(bag.topics[topic].msgtype), topic[1:], QoSProfile(depth=1000)
                )
                for topic in topics
            }
            while not all(self.count_subscribers(f"/{name}") for name in ("imu/data_raw", "gnss/fix")):
                time.sleep(0.02)
            time.sleep(1.0)  # for the subscriptions of the other node, and their other ends
            began = time.monotonic()
            for raw in bag.messages(topics):
                self.wait_for_corrections(raw.stamp_ns)
                due = began + self.waited + (raw.stamp_ns - bag.start_ns) * 1e-9 / rate
                time.sleep(max(0.0, due - time.monotonic()))
                outputs[raw.topic].publish(raw.data)
        time.sleep(1.0)


def main() -> None:
    path, rate, corrections = init()
    player, end = PacedPlayer(json.loads(Path(corrections).read_text())), Future()
    on_signal(lambda: end.set_result(None))
    threading.Thread(target=serve, args=((player,), end)).start()
    try:
        player.play(Path(path), float(rate))
        print(f"waited {player.waited:.1f} s for corrections", flush=True)
    finally:
        end.set_result(None)


if __name__ == "__main__":
    main()
