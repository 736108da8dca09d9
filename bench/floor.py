"""The floor under a live node: cost of rclpy with the topics of `ins_node`, without computation.

Subscribes to imu/data_raw as `ins_node` does; publishes floor/odometry, floor/imu/data and floor/fix at every sample,
each filled in once.
"""

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix

from ins_nav.nodes.runtime import init, spin

_IN_DEPTH, _OUT_DEPTH = 10_000, 200
"""As `ins_node` has."""
TOPICS = {"floor/odometry": Odometry, "floor/imu/data": Imu, "floor/fix": NavSatFix}


class Floor(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("floor")
        self._outputs = []
        for topic, kind in TOPICS.items():
            message = kind()
            message.header.frame_id = "base_link"
            self._outputs.append((self.create_publisher(kind, topic, QoSProfile(depth=_OUT_DEPTH)), message))
        best_effort = QoSProfile(depth=_IN_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Imu, "imu/data_raw", self._on_imu, best_effort)

    def _on_imu(self, _message: Imu) -> None:
        for publisher, message in self._outputs:
            publisher.publish(message)


def main() -> None:
    init()
    spin(Floor())


if __name__ == "__main__":
    main()
