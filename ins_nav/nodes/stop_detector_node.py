"""`stop_detector_node`: detects stops in the stream of the IMU and calls the ZUPT services of `ins_node` there.

`ins_node` does not depend on it: the detector there decides what is standstill, this node when a service is called.
"""

import math
import sys
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ins_nav.errors import for_people
from ins_nav.event_log import EventLog
from ins_nav.mechanization.imu_stream import ImuStream
from ins_nav.messages.cdr import ImuSample
from ins_nav.messages.diagnostics import SILENCE, silence
from ins_nav.navigator.system import NavigationSystem, ScheduledCalls
from ins_nav.nodes import parameters, runtime
from ins_nav.nodes.reporting import Reporter
from ins_nav.stop_detection.detector import Change, StopDetector
from ins_nav.stop_detection.service_schedule import ServiceSchedule
from ins_nav.stop_detection.stop_limits import StopLimits


class StopDetectorNode(Node):
    """The node; see the package's README for topics, services and parameters.

    Parameters
    ----------
    shared : bool
        The detector is that of an `ins_node` in the same process: see `attach`.

    Raises
    ------
    ParameterError
    """

    def __init__(self, shared: bool = False) -> None:
        super().__init__("stop_detector_node")
        self._shared = shared
        configuration = parameters.declare(self)
        self._events = EventLog()
        self._stream = ImuStream(self._events, configuration.imu)
        self._detector = StopDetector(StopLimits.of(configuration.stop, configuration.imu))
        self._policy = ServiceSchedule(configuration.stop_detector)
        self._calibration = {name: self.create_client(Trigger, f"ins_node/{name}") for name in ("zupt1", "zupt2")}
        self._missing = False
        self._answer = "none yet"
        self._stops = 0
        latched = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=1,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        self._stopped = self.create_publisher(Bool, "stopped", latched)
        self._reporter = Reporter(self, "stops")
        if not shared:
            runtime.subscribe_imu(self, self._events, self._on_imu)
        self.create_timer(1.0, self._on_timer)
        self._stopped.publish(Bool(data=False))
        self.get_logger().info("waiting for imu/data_raw")

    def attach(self, system: NavigationSystem) -> Callable[[], None]:
        """Use detector and services of `ins_node` in the same process; the result is to be called after each sample."""
        self._detector, self._stream, self._events = system.front_end.detector, system.front_end.stream, system.events
        calls = ScheduledCalls(system, self._publish_stopped, self._log_answer, announced=False)
        self._policy = calls.schedule
        return calls.after_sample

    def _publish_stopped(self, stopped: bool) -> None:
        self._stopped.publish(Bool(data=stopped))
        self._stops += stopped
        self.get_logger().info("stopped" if stopped else "moving")

    def _log_answer(self, name: str, success: bool, text: str) -> None:
        self._answer = f"{name} {'done' if success else 'refused'}: {text}"
        self.get_logger().info(self._answer)

    def _on_imu(self, received: ImuSample) -> None:
        detector = self._detector
        for stamp_ns, sample in self._stream.accept(*received):
            if isinstance(sample, float):
                was = detector.stopped
                detector.restart()
                self._policy.restart()
                if was:
                    self._report(Change(False, stamp_ns, stamp_ns))
                continue
            change = detector.add(stamp_ns, sample)
            if change is not None:
                self._report(change)
            if detector.stopped and detector.rest_ns >= self._policy.due_ns:
                self._call(self._policy.take())
        if self._events.pending:
            self._log()

    def _report(self, change: Change) -> None:
        self._stopped.publish(Bool(data=change.stopped))
        before = (change.decided_ns - change.stamp_ns) * 1e-9
        if change.stopped:
            self._stops += 1
            self._policy.arrive()
            self.get_logger().info(f"stopped, {before:.1f} s ago")
        else:
            self.get_logger().info(f"moving, since {before:.1f} s")

    def _call(self, name: str) -> None:
        client, stop = self._calibration[name], self._policy.stop
        if client.service_is_ready():
            self._missing = False
            client.call_async(Trigger.Request()).add_done_callback(lambda future: self._on_answer(name, stop, future))
            return
        if not self._missing:
            self.get_logger().warning(
                f"no service ins_node/{name}: is ins_node running, in this namespace? Tried again later"
            )
        self._missing = True
        self._policy.answered(name, stop, False)

    def _on_answer(self, name: str, stop: int, future: Any) -> None:
        answer = future.result()
        self._policy.answered(name, stop, answer.success)
        self._log_answer(name, answer.success, answer.message)

    def _log(self) -> None:
        if not self._shared:  # else they are those of `ins_node`, which logs them
            self._reporter.log(self._events)

    def _on_timer(self) -> None:
        self._log()
        detector, stream = self._detector, self._stream
        counts = {} if self._shared else self._events.counts  # `ins_node` reports those of the system
        gyro, accel = detector.noise
        values = {
            "stopped": str(detector.stopped).lower(),
            "length of the stop": f"{detector.rest_ns * 1e-9:.1f} s",
            "stops": str(self._stops),
            "shaking over its threshold": f"{detector.shake:.3f}",
            "speed since the last stop": f"{detector.speed:.3f} m/s",
            "its sigma": f"{detector.speed_stddev:.3f} m/s",
            "gyro noise over 0.1 s": f"{math.degrees(gyro):.5f} deg/s",
            "accelerometer noise over 0.1 s": f"{accel:.5f} m/s^2",
            "services": ", ".join(n for n, c in self._calibration.items() if c.service_is_ready()) or "none",
            "last answer": self._answer,
            "imu/data_raw received": str(stream.received),
            "imu/data_raw used": str(stream.accepted),
        } | {kind: str(count) for kind, count in counts.items()}
        level, text = 0, "stopped" if detector.stopped else "moving"
        silent_for = self._reporter.silent_for(stream.received)
        if not stream.received:
            level, text = 1, "no messages on imu/data_raw yet"
        elif not stream.accepted:
            level, text = 2, "every message on imu/data_raw was rejected: see the counts"
        elif silent_for >= SILENCE:
            level, text = 2, silence(silent_for)
        elif self._missing:
            level, text = 1, f"{text}; no service of ins_node to call"
        elif counts:
            level, text = 1, f"{text}; {', '.join(f'{kind}: {n}' for kind, n in counts.items())}"
        self._reporter.publish(level, text, values)


@for_people("stop_detector_node")
def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT or SIGTERM."""
    if runtime.wants_no_node(runtime.init(args), "stop_detector_node", __doc__):
        return
    runtime.spin(StopDetectorNode())


if __name__ == "__main__":
    sys.exit(main())
