"""Plays a bag as fast as the nodes can follow: paced_player.py BAG RATE CORRECTIONS.

CORRECTIONS is a JSON file with two stamps, ns, for each correction of `alignment_node`: of the state, and of the sample
with which it takes effect. bag_player plays at RATE, but pauses before such a sample until the correction has come.
A loaded machine makes the replay slow; a correction that does not come at all ends it with an error.
"""

import json
import sys
import threading
import time
from argparse import Namespace
from functools import partial
from pathlib import Path

from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import Float64MultiArray

from ins_nav.messages.correction_codec import read_correction
from ins_nav.messages.named_numbers import RejectedMessageError
from ins_nav.nodes.bag_player import Player
from ins_nav.nodes.runtime import init, on_signal, serve
from ins_nav.recordings.bags import BagReader

_AHEAD_NS = 200_000_000  # of data, for the next message, and the way from alignment_node to ins_node
_PATIENCE = 30.0  # s; the solution of coarse alignment takes one on an idle machine


class PacedPlayer(Player):
    """bag_player that waits for corrections."""

    def __init__(self, bag: BagReader, options: Namespace, expected: list[tuple[int, int]]) -> None:
        super().__init__(bag, options)
        self._expected = expected
        self._received: set[int] = set()
        self._news = threading.Condition()
        self.waited = 0.0
        self.create_subscription(Float64MultiArray, "ins/feedback", self._on_feedback, QoSProfile(depth=1000))

    def _on_feedback(self, message: Float64MultiArray) -> None:
        try:
            correction = read_correction(message)
        except RejectedMessageError as error:
            sys.exit(f"ins/feedback: {error}")
        with self._news:
            self._received.add(correction.stamp_ns)
            self._news.notify()

    def wait_for_corrections(self, stamp_ns: int) -> None:
        """Pause until all have come that take effect soon after a message was published."""
        while self._expected and self._expected[0][1] <= stamp_ns + _AHEAD_NS:
            first, began = self._expected.pop(0)[0], time.monotonic()
            self.schedule.pause()
            with self._news:
                if not self._news.wait_for(partial(self._received.__contains__, first), _PATIENCE):
                    sys.exit(f"no correction of {first} ns within {_PATIENCE:g} s, the replay is at {stamp_ns} ns")
            self.schedule.resume()
            self.waited += time.monotonic() - began


def main() -> None:
    path, rate, corrections = init()
    end = Future()
    with BagReader(path) as bag:
        topics = [topic for topic in bag.topics if not topic.startswith("/truth/")]
        options = Namespace(topics=topics, remap=[], start_offset=0.0, loop=False, rate=float(rate), clock=None)
        player = PacedPlayer(bag, options, json.loads(Path(corrections).read_text()))
        on_signal(player.stop)
        services = threading.Thread(target=serve, args=((player,), end))
        services.start()
        try:
            player.wait_for_subscribers(None)
            player.schedule.resume()
            player.play(time.sleep, player.wait_for_corrections)
            player.finish()
            print(f"waited {player.waited:.1f} s for corrections", flush=True)
        finally:
            end.set_result(None)
            services.join()


if __name__ == "__main__":
    main()
