"""`alignment_node`: fine alignment and aided navigation by the feedback Kalman filter, for `ins_node`.

Takes the IMU and the aids (satellite position and velocity, log, depth, pressure, ranges to beacons), aligns finely,
and sends corrections to `ins_node`. A thin translator: `ins_nav.navigator.system.FilterSystem` does the work.
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
from ins_nav.mechanization import strapdown
from ins_nav.messages import correction_codec, diagnostics
from ins_nav.messages.cdr import ImuSample
from ins_nav.navigator.system import FilterSystem, NavigationSystem
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.reporting import Reporter
from ins_nav.stamps import NS


class AlignmentNode(Node):
    """The node; see the package's README for topics and parameters.

    Parameters
    ----------
    shared : bool
        The filter is that of an `ins_node` in the same process: see `attach`.

    Raises
    ------
    ParameterError
    """

    def __init__(self, shared: bool = False) -> None:
        super().__init__("alignment_node")
        configuration = parameters.declare(self)
        self._reporter = Reporter(self, "alignment")
        self._system: FilterSystem | NavigationSystem | None = None
        for aid in create_aids(configuration.values).values():
            self._subscribe(runtime.message_class(aid.MESSAGE_TYPES[0]), aid.topic, partial(self._on_aid, aid.topic))
        self.create_timer(1.0, self._on_timer)
        if not shared:
            strapdown.prepare()  # here, not at the first sample after alignment
            self._system = self._filter = FilterSystem(configuration.values)
            self._connect_ins_node()

    def attach(self, system: NavigationSystem) -> None:
        """Use the filter of `ins_node` in the same process."""
        self._system = system

    def _connect_ins_node(self) -> None:
        """Topics of an `ins_node` in another process."""
        reliable = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self._out = self.create_publisher(Float64MultiArray, "ins/feedback", reliable)
        self._calibration = self.create_publisher(Float64MultiArray, "ins/calibration", reliable)
        self._feedback = feedback_message()
        runtime.subscribe_imu(self, self._filter.events, self._on_imu)
        self.create_subscription(Float64MultiArray, "ins/solution", self._on_solution, reliable)
        self.create_subscription(Header, "ins/called", self._on_called, reliable)
        self.create_timer(1.0, self._publish_calibration)
        self.get_logger().info("waiting for imu/data_raw")

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None]) -> None:
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        overriding = QoSOverridingOptions.with_default_policies()
        self.create_subscription(kind, topic, callback, qos, qos_overriding_options=overriding)

    def _on_aid(self, topic: str, message: Any) -> None:
        if self._system is not None:
            self._system.add(topic, message)

    def _on_imu(self, sample: ImuSample) -> None:
        system = self._filter
        system.add_imu(*sample)
        for correction in system.delayed.drain():
            correction_codec.fill_feedback(self._feedback, correction)
            self._out.publish(self._feedback)
        if system.events.pending:
            self._reporter.log(system.events)

    def _on_solution(self, message: Float64MultiArray) -> None:
        system = self._filter
        stamp_ns = system.front_end.stamp_ns
        solution = correction_codec.received_feedback(message, "ins/solution", system.events, stamp_ns)
        if solution is not None:
            system.delayed.adopt(solution, solution.apply_ns)

    def _on_called(self, message: Header) -> None:
        """A service of `ins_node`, its name in the frame."""
        if message.frame_id == "align":
            self.get_logger().info(self._filter.align())
        else:
            self._filter.delayed.call_zupt(message.stamp.sec * NS + message.stamp.nanosec)

    def _publish_calibration(self) -> None:
        found = self._filter.delayed.calibration
        if found:
            message = Float64MultiArray(data=list(found.values()))
            message.layout.dim = [MultiArrayDimension(label=name, size=1, stride=1) for name in found]
            self._calibration.publish(message)

    def _on_timer(self) -> None:
        system = self._system
        if system is not None:
            self._reporter.log(system.events)
            silent_for = self._reporter.silent_for(system.front_end.stream.received)
            self._reporter.publish(*diagnostics.alignment_diagnostics(system.delayed, silent_for))


def feedback_message() -> Float64MultiArray:
    """An empty one; the layout names its parts."""
    message = Float64MultiArray()
    for label, size in (*correction_codec.FEEDBACK, ("imu_errors", 0), ("covariance", 0)):
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
