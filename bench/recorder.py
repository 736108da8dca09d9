"""Records a live ins_node as demo/recorder.py does: recorder.py NODES. Prints counts and latencies as a line of JSON.

NODES publish diagnostics. The topics of bench/floor.py have a subscriber here too; their messages are dropped.
"""

import json
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile

from bench.floor import TOPICS
from demo.recorder import Recorder, latency_ms
from ins_nav.nodes.runtime import init, spin
from ins_nav.recordings.bags import typestore
from ins_nav.stamps import stamp_of


def main() -> None:
    (nodes,) = init()
    recorder = Recorder(int(nodes))
    for topic, kind in TOPICS.items():
        recorder.create_subscription(kind, topic, lambda _data: None, QoSProfile(depth=5000), raw=True)
    spin(recorder)
    samples, solutions = (recorder.received[topic] for topic in ("imu/data_raw", "odometry"))
    stamps = [stamp_of(typestore().deserialize_cdr(data, "nav_msgs/msg/Odometry")) for _, data in solutions]
    arrays: list[Any] = [
        typestore().deserialize_cdr(data, "diagnostic_msgs/msg/DiagnosticArray")
        for _, data in recorder.received["/diagnostics"]
    ]
    last = [status for array in arrays for status in array.status if status.name.startswith("/ins_node")][-1]
    delays = latency_ms(samples, solutions)
    result = {
        "diagnostics": {item.key: item.value for item in last.values},
        "samples": len(samples),
        "solutions": len(stamps),
        "distinct": len(set(stamps)),
        "first_ns": min(stamps, default=None),
        "latency_ms": np.percentile(delays, [50, 99, 100]).tolist() if len(delays) else None,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
