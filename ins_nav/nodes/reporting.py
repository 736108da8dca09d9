"""Reports of a node: log lines from the core's `EventLog`, a status per second on ``/diagnostics``."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ins_nav.event_log import INFO, WARN, EventLog

_LEVELS = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)


class Reporter:
    """Log and diagnostics of a node.

    Parameters
    ----------
    node : Node
    subject : str
        Second part of the status' name, after that of the node.
    """

    def __init__(self, node: Node, subject: str) -> None:
        self._node = node
        self._name = f"{node.get_fully_qualified_name()}: {subject}"
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._last_received = (0, time.monotonic())

    def log(self, events: EventLog) -> None:
        """Log the queued reports of the core."""
        logger = self._node.get_logger()
        for report in events.drain():
            if report.level == INFO:  # rclpy requires one severity per place in the source
                logger.info(report.text)
            elif report.level == WARN:
                logger.warning(report.text)
            else:
                logger.error(report.text)

    def silent_for(self, received: int) -> float:
        """Time, s, since the first call with this count of messages; to be called regularly."""
        now = time.monotonic()
        if received != self._last_received[0]:
            self._last_received = (received, now)
        return now - self._last_received[1]

    def status(self, level: int, text: str, values: dict[str, str]) -> DiagnosticStatus:
        """A status: level 0 OK, 1 warning, 2 error."""
        return DiagnosticStatus(
            level=_LEVELS[level],
            name=self._name,
            message=text,
            hardware_id="imu",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def publish(self, level: int, text: str, values: dict[str, str]) -> None:
        """Publish the status: level 0 OK, 1 warning, 2 error."""
        array = DiagnosticArray(status=[self.status(level, text, values)])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
