"""`alignment_node`: fine alignment and aided navigation by the feedback Kalman filter, for `ins_node`.

Takes the IMU and the aids (satellite position and velocity, log, depth, pressure, ranges to beacons), aligns finely,
and sends what it finds to `ins_node`, which goes on from there. A thin translator: `delayed.DelayedNavigator`
does the work.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension

from ins_nav.aiding.registry import create_aids
from ins_nav.errors import for_people
from ins_nav.messages import correction_codec, diagnostics
from ins_nav.messages.cdr import ImuSample
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.reporting import Reporter


class AlignmentNode(Node):
    """The node; see the package's README for topics and parameters.

    Raises
    ------
    ParameterError
    """

    def __init__(self) -> None:
        super().__init__("alignment_node")
        self._navigator = DelayedNavigator(parameters.declare(self).values)
        self._reporter = Reporter(self, "alignment")
        reliable = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self._out = self.create_publisher(Float64MultiArray, "ins/feedback", reliable)
        self._calibration = self.create_publisher(Float64MultiArray, "ins/calibration", reliable)
        self._feedback = feedback_message()
        runtime.subscribe_imu(self, self._navigator.events, self._on_imu)
        for aid in create_aids(self._navigator.configuration.values).values():
            self._subscribe(runtime.message_class(aid.MESSAGE_TYPES[0]), aid.topic, partial(self._on_aid, aid.topic))
        self.create_subscription(Float64MultiArray, "ins/solution", self._on_solution, reliable)
        self.create_subscription(Header, "ins/called", self._on_called, reliable)
        self.create_timer(1.0, self._on_timer)
        self.get_logger().info("waiting for imu/data_raw")

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None]) -> None:
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        overriding = QoSOverridingOptions.with_default_policies()
        self.create_subscription(kind, topic, callback, qos, qos_overriding_options=overriding)

    def _on_aid(self, topic: str, message: Any) -> None:
        self._navigator.add(topic, message)

    def _on_imu(self, sample: ImuSample) -> None:
        navigator = self._navigator
        navigator.add_imu(*sample)
        for feedback in navigator.drain():
            correction_codec.fill_feedback(self._feedback, feedback)
            self._out.publish(self._feedback)
        if navigator.events.pending:
            self._reporter.log(navigator.events)

    def _on_solution(self, message: Float64MultiArray) -> None:
        navigator = self._navigator
        solution = correction_codec.received_feedback(message, "ins/solution", navigator.events, navigator.stamp_ns)
        if solution is not None:
            self._navigator.adopt(solution, solution.apply_ns)

    def _on_called(self, message: Header) -> None:
        """A service of `ins_node`, its name in the frame."""
        if message.frame_id == "align":
            self.get_logger().info(self._navigator.align())
        else:
            self._navigator.call_zupt(message.stamp.sec * 1_000_000_000 + message.stamp.nanosec)

    def _on_timer(self) -> None:
        self._reporter.log(self._navigator.events)
        silent_for = self._reporter.silent_for(self._navigator.stream.received)
        found = self._navigator.found_calibration
        if found:
            message = Float64MultiArray(data=list(found.values()))
            message.layout.dim = [MultiArrayDimension(label=name, size=1, stride=1) for name in found]
            self._calibration.publish(message)
        self._reporter.publish(*diagnostics.alignment_diagnostics(self._navigator, silent_for))


def feedback_message() -> Float64MultiArray:
    """An empty one; the layout names its parts."""
    message = Float64MultiArray()
    for label, size in (*correction_codec.FEEDBACK, ("covariance", 0)):
        message.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=size))
    return message


@for_people("alignment_node")
def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "alignment_node", __doc__):
        return
    runtime.spin(AlignmentNode())


if __name__ == "__main__":
    sys.exit(main())
