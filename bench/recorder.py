"""Hears a live ins_node as demo/recorder.py does; tells counts and latencies by one line of JSON."""

import json
from typing import Any

import numpy as np

from demo.recorder import Recorder, latency_ms
from ins_nav.nodes.runtime import init, spin
from ins_nav.recordings.bags import typestore
from ins_nav.stamps import stamp_of


def main() -> None:
    init()
    recorder = Recorder()
    spin(recorder)
    samples, solutions = (recorder.received[topic] for topic in ("imu/data_raw", "odometry"))
    stamps = [stamp_of(typestore().deserialize_cdr(data, "nav_msgs/msg/Odometry")) for _, data in solutions]
    last: Any = typestore().deserialize_cdr(
        recorder.received["/diagnostics"][-1][1], "diagnostic_msgs/msg/DiagnosticArray"
    )
    delays = latency_ms(samples, solutions)
    result = {
        "diagnostics": {item.key: item.value for item in last.status[0].values},
        "samples": len(samples),
        "solutions": len(stamps),
        "distinct": len(set(stamps)),
        "first_ns": min(stamps, default=None),
        "latency_ms": np.percentile(delays, [50, 99, 100]).tolist() if len(delays) else None,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
