"""`alignment_node`: fine alignment and aided navigation by the feedback Kalman filter, for `ins_node`.

Receives the IMU and the aids (satellite position and velocity, log, depth, pressure, ranges to beacons), aligns finely,
and sends corrections to `ins_node`. A thin translator: `ins_nav.navigator.system.FilterSystem` does the work.
"""

import sys
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Empty, Float64MultiArray, Header

from ins_nav.aiding.registry import create_aids
from ins_nav.errors import for_people
from ins_nav.mechanization import strapdown
from ins_nav.messages import correction_codec, diagnostics
from ins_nav.messages.cdr import ImuSample
from ins_nav.messages.integrity import integrity
from ins_nav.messages.named_numbers import received
from ins_nav.navigator.system import FilterSystem, NavigationSystem
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.aid_subscriptions import AidSubscriptions
from ins_nav.nodes.reporting import Reporter


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
        self._shared = shared
        configuration = parameters.declare(self)
        self._reporter = Reporter(self, "alignment")
        self._integrity = self.create_publisher(DiagnosticStatus, "integrity", 10)
        self._system: FilterSystem | NavigationSystem | None = None
        self._aids = AidSubscriptions(self, create_aids(configuration.values).values(), self._on_aid)
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
        runtime.subscribe_imu(self, self._filter.events, self._on_imu)
        self.create_subscription(Float64MultiArray, "ins/solution", self._on_solution, reliable)
        self.create_subscription(Empty, "ins/align", self._on_align, reliable)
        self.create_subscription(Header, "ins/zupt", self._on_zupt, reliable)
        self.create_timer(1.0, self._publish_calibration)
        self.get_logger().info("waiting for imu/data_raw")

    def _on_aid(self, topic: str, message: Any) -> None:
        if self._system is not None:
            self._system.add(topic, message)

    def _on_imu(self, sample: ImuSample) -> None:
        system = self._filter
        system.add_imu(*sample)
        for correction in system.delayed.drain():
            self._out.publish(runtime.numbers_message(correction_codec.pack_correction(correction)))
        if system.events.pending:
            self._reporter.log(system.events)

    def _on_solution(self, message: Float64MultiArray) -> None:
        system = self._filter
        stamp_ns = system.front_end.stamp_ns
        solution = received(correction_codec.read_solution, message, "ins/solution", system.events, stamp_ns)
        if solution is not None:
            system.delayed.adopt(*solution)

    def _on_align(self, _message: Empty) -> None:
        self.get_logger().info(self._filter.align())

    def _on_zupt(self, message: Header) -> None:
        system = self._filter
        stamp_ns = system.front_end.stamp_ns
        read = partial(correction_codec.read_zupt, stamp_ns=stamp_ns)
        zupt_ns = received(read, message, "ins/zupt", system.events, stamp_ns)
        if zupt_ns is not None:
            system.delayed.call_zupt(zupt_ns)

    def _publish_calibration(self) -> None:
        found = self._filter.delayed.calibration
        if found:
            self._calibration.publish(runtime.numbers_message(correction_codec.pack_calibration(found)))

    def _on_timer(self) -> None:
        self._aids.follow_publishers()
        system = self._system
        if system is not None:
            if not self._shared:  # else they are those of `ins_node`, which logs them
                self._reporter.log(system.events)
            silent_for = self._reporter.silent_for(system.front_end.stream.received)
            self._reporter.publish(*diagnostics.alignment_diagnostics(system.delayed, silent_for))
            self._integrity.publish(self._reporter.status(*integrity(system.delayed)))


@for_people("alignment_node")
def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "alignment_node", __doc__):
        return
    runtime.spin(AlignmentNode())


if __name__ == "__main__":
    sys.exit(main())
