"""Plays pieces of bags on demand: bag_feeder.py. A line ``BAG FROM UNTIL`` on stdin publishes the IMU samples and
fixes of that piece, s from the bag's start, at some times the live rate, and prints ``fed BAG UNTIL``.
"""

import sys
import threading
import time

from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix

from ins_nav.nodes.runtime import init, spin
from ins_nav.recordings.bags import BagReader

_PAUSE = 5e-4  # s between messages: a burst would be lost on best-effort readers


def feed(node: Node) -> None:
    qos = QoSProfile(depth=1000)
    outputs = {
        "/gnss/fix": node.create_publisher(NavSatFix, "gnss/fix", qos),
        "/imu/data_raw": node.create_publisher(Imu, "imu/data_raw", qos),
    }
    for line in sys.stdin:
        path, start, end = line.split()
        while not all(output.get_subscription_count() for output in outputs.values()):
            time.sleep(0.02)
        with BagReader(path) as bag:
            start_ns, end_ns = (bag.start_ns + round(float(s) * 1e9) for s in (start, end))
            for raw in bag.messages(list(outputs), start_ns + 1 if float(start) else start_ns):
                if raw.stamp_ns > end_ns:
                    break
                outputs[raw.topic].publish(raw.data)
                time.sleep(_PAUSE)
        print(f"fed {path} {end}", flush=True)


def main() -> None:
    init()
    node = Node("bag_feeder")
    threading.Thread(target=feed, args=(node,), daemon=True).start()
    print("ready", flush=True)
    spin(node)


if __name__ == "__main__":
    main()
