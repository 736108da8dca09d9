"""`ins_node`: from an IMU topic to a navigation solution, live.

Aligns (standing or rocking, no initial angle), then navigates free inertial at the rate of the IMU; corrects velocity
at stops, and calibrates its gyros there on request (services zupt1 and zupt2). A thin translator:
`ins_nav.navigator.system.NavigationSystem` does the work.
"""

import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Empty, Float64MultiArray, Header
from std_srvs.srv import Trigger

from ins_nav.aiding.registry import calibration_names
from ins_nav.errors import InsNavError, for_people
from ins_nav.mechanization import strapdown
from ins_nav.messages import correction_codec, diagnostics
from ins_nav.messages.cdr import ImuSample
from ins_nav.messages.named_numbers import received
from ins_nav.messages.solution import SolutionMessages, fill_bias
from ins_nav.navigator.system import NavigationSystem
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.aid_subscriptions import AidSubscriptions
from ins_nav.nodes.reporting import Reporter
from ins_nav.stamps import NS, set_stamp

_OUT_DEPTH = 200


def _nothing() -> None:
    """Do nothing."""


def _qos(depth: int, reliability: ReliabilityPolicy, latched: bool = False) -> QoSProfile:
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


class InsNode(Node):
    """The node; see the package's README for topics, services and parameters.

    Parameters
    ----------
    others : mapping, optional
        Overrides of the other nodes of `ins_system`: then the filter of this process uses the aids.

    Attributes
    ----------
    system : NavigationSystem
    after_sample : callable
        Called after every message of the IMU.

    Raises
    ------
    ParameterError
    """

    def __init__(self, others: Mapping[str, Any] | None = None) -> None:
        super().__init__("ins_node")
        self._configuration = parameters.declare(self, others)
        strapdown.prepare()  # here, not at the first correction
        self.system = NavigationSystem(self._configuration.values, aided=others is not None)
        self.after_sample: Callable[[], None] = _nothing
        self._navigator = self.system.realtime
        self._base_link = self._configuration.frames.base_link
        self._out = SolutionMessages(self._navigator)
        reliable = ReliabilityPolicy.RELIABLE
        self._odometry = self.create_publisher(Odometry, "odometry", _qos(_OUT_DEPTH, reliable))
        self._imu = self.create_publisher(Imu, "imu/data", _qos(_OUT_DEPTH, reliable))
        self._fix = self.create_publisher(NavSatFix, "fix", _qos(_OUT_DEPTH, reliable))
        self._bias = self.create_publisher(Imu, "imu/bias", _qos(1, reliable, latched=True))
        self._reporter = Reporter(self, "navigation")
        self._tf = self._transform_publisher() if self._configuration.publish.tf != "none" else None
        runtime.subscribe_imu(self, self._navigator.events, self._on_imu)
        self._aids: AidSubscriptions | None = None
        self._solution = self._align = self._zupt = None
        if others is None:
            self._connect_filter()
        self.create_service(Trigger, "~/align", self._on_align)
        self.create_service(Trigger, "~/zupt1", self._on_zupt1)
        self.create_service(Trigger, "~/zupt2", self._on_zupt2)
        self.create_service(Trigger, "~/save", self._on_save)
        self.create_timer(1.0, self._on_timer)
        self._publish_bias()
        self.get_logger().info("waiting for imu/data_raw")

    def _connect_filter(self) -> None:
        """Topics that the filter of `alignment_node`, in another process, needs; aids are needed for the place only."""
        self._aids = AidSubscriptions(self, self.system.position_aids.values(), self.system.add)
        inside = _qos(100, ReliabilityPolicy.RELIABLE)
        self._solution = self.create_publisher(Float64MultiArray, "ins/solution", inside)
        self._align = self.create_publisher(Empty, "ins/align", inside)
        self._zupt = self.create_publisher(Header, "ins/zupt", inside)
        self.create_subscription(Float64MultiArray, "ins/feedback", self._on_feedback, inside)
        self.create_subscription(Float64MultiArray, "ins/calibration", self._on_calibration, inside)

    def _transform_publisher(self) -> Any:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise InsNavError(
                f"publish.tf is {self._configuration.publish.tf} but tf2_msgs is not installed: "
                "apt install ros-jazzy-tf2-msgs, or set it to none"
            ) from None
        transform = TransformStamped()
        transform.header.frame_id = self._configuration.frames.map
        transform.child_frame_id = self._base_link
        self._transforms = TFMessage(transforms=[transform])
        return self.create_publisher(TFMessage, "/tf", 100)

    def _on_imu(self, sample: ImuSample) -> None:
        new = self.system.add_imu(*sample)
        if new and self._out.due(self._navigator.stamp_ns):
            self._publish()
        self.after_sample()
        if self.system.events.pending:
            self._log()

    def _publish(self) -> None:
        out = self._out
        if out.first:
            self._publish_bias()
        out.fill(self._navigator.entries)
        if self._tf is not None:  # first: its look-up at the stamp of the odometry needs no waiting
            transform = self._transforms.transforms[0]
            set_stamp(transform, self._navigator.stamp_ns)
            translation, rotation = transform.transform.translation, transform.transform.rotation
            translation.x, translation.y, translation.z = out.odometry.numbers[0:3].tolist()
            rotation.x, rotation.y, rotation.z, rotation.w = out.odometry.numbers[3:7].tolist()
            self._tf.publish(self._transforms)
        self._odometry.publish(out.odometry.serialized())
        self._imu.publish(out.imu.serialized())
        self._fix.publish(out.fix.serialized())

    def _publish_bias(self) -> None:
        message = Imu()
        fill_bias(message, self._navigator, self._base_link)
        if self._navigator.stamp_ns == 0:  # before the first sample
            message.header.stamp = self.get_clock().now().to_msg()
        self._bias.publish(message)

    def _on_align(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = self.system.align()
        if self._align is not None:
            self._align.publish(Empty())
        return response

    def _on_feedback(self, message: Float64MultiArray) -> None:
        events, stamp_ns = self.system.events, self.system.front_end.stamp_ns
        correction = received(correction_codec.read_correction, message, "ins/feedback", events, stamp_ns)
        if correction is not None:
            self.system.correct(correction)

    def _on_zupt1(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, *self.system.zupt1())

    def _on_zupt2(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, *self.system.zupt2())

    def _on_save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self.system.save()
        self._log()
        return response

    def _on_calibration(self, message: Float64MultiArray) -> None:
        read = partial(correction_codec.read_calibration, configuration=self._configuration, names=calibration_names())
        found = received(read, message, "ins/calibration", self.system.events, self.system.front_end.stamp_ns)
        if found is not None:
            self.system.calibration = found

    def _answer(self, response: Trigger.Response, success: bool, text: str) -> Trigger.Response:
        response.success, response.message = success, text
        if success and self._zupt is not None:
            header = Header(frame_id=self._base_link)
            header.stamp.sec, header.stamp.nanosec = divmod(self._navigator.stamp_ns, NS)
            self._zupt.publish(header)
        self._log()
        return response

    def _log(self) -> None:
        self._reporter.log(self._navigator.events)

    def _on_timer(self) -> None:
        if self._aids is not None:
            self._aids.follow_publishers()
        self._log()
        solution = self.system.solution()
        if solution is not None and self._solution is not None:
            self._solution.publish(runtime.numbers_message(correction_codec.pack_solution(*solution)))
        silent_for = self._reporter.silent_for(self.system.front_end.stream.received)
        self._reporter.publish(*diagnostics.diagnostics(self._navigator, self.system.services.solved, silent_for))


@for_people("ins_node")
def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "ins_node", __doc__):
        return
    runtime.spin(InsNode())


if __name__ == "__main__":
    sys.exit(main())
