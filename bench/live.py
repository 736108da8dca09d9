"""The live node over DDS: bag_player, ins_node and a recorder, each in a process of its own."""

import json
import math
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import Popen
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.markdown import table
from demo.run import Nodes
from ins_nav.errors import InsNavError
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

_RATE, _DURATION, _ALIGNMENT = 400.0, 60.0, 10.0
_SETTLED = 2.0
"""s after the alignment: the load is measured from there."""
_PATIENCE = 30.0
_SINGLE_THREADED = (
    "import rclpy.experimental as e; del e.EventsExecutor; from ins_nav.nodes.ins_node import main; main()"
)
"""ins_node without the executor it prefers."""


def results(_data: Path) -> Iterator[str]:
    """The section's table."""
    columns = {
        "EventsExecutor": _measure(_DURATION, "-m", "ins_nav.nodes.ins_node"),
        "SingleThreadedExecutor": _measure(0.5 * _DURATION, "-c", _SINGLE_THREADED),
    }
    rows = [[name, *(column[name] for column in columns.values())] for name in next(iter(columns.values()))]
    yield table([f"{_RATE:g} Hz, live", *columns], rows)


def _measure(duration: float, *node: str) -> dict[str, object]:
    simulation = simulate("vehicle", 2, rate=_RATE, duration=duration, stand_time=_ALIGNMENT + 5.0)
    with tempfile.TemporaryDirectory() as folder:
        write_bag(simulation, Path(folder, "bag"))
        said, heard, share = _play(Path(folder), *node)
    return _rows(said, heard, simulation.stamps_ns, share)


def _play(folder: Path, *node: str) -> tuple[str, dict[str, Any], NDArray[np.float64]]:
    """What bag_player said, what the recorder heard, and the shares of a core of ins_node and bag_player, %."""
    with Nodes(folder) as nodes:
        ins = nodes.start("ins_node", *node, "--ros-args", "-p", f"alignment.duration:={_ALIGNMENT}")
        _wait_for(nodes, lambda: "waiting for imu/data_raw" in nodes.log("ins_node").read_text())
        recorder = nodes.start("recorder", "-m", "bench.recorder")
        assert recorder.stdout is not None and recorder.stdin is not None
        recorder.stdout.readline()
        arguments = (folder / "bag", "--no-progress", "--topics", "imu/data_raw", "gnss/fix")
        player = nodes.start("bag_player", "-m", "ins_nav.nodes.bag_player", *arguments)
        _wait_for(nodes, lambda: "aligned in" in nodes.log("ins_node").read_text())
        time.sleep(_SETTLED)
        readings = []
        while player.poll() is None:
            nodes.check()
            readings.append((time.monotonic(), _seconds(ins), _seconds(player)))
            time.sleep(0.5)
        spent = np.subtract(readings[-1], readings[0])
        said = nodes.wait_for("bag_player")
        recorder.stdin.close()
        heard = json.loads(nodes.wait_for("recorder"))
    return said, heard, 100.0 * spent[1:] / spent[0]


def _rows(
    said: str, heard: dict[str, Any], stamps_ns: NDArray[np.int64], share: NDArray[np.float64]
) -> dict[str, object]:
    published = re.search(r"/imu/data_raw (\d+)", said)
    latency = heard["latency_ms"] or [math.nan] * 3
    return {
        "samples published": published[1] if published else "none",
        "received by ins_node": heard["diagnostics"]["imu/data_raw received"],
        "integrated": heard["diagnostics"]["imu/data_raw integrated"],
        "samples from the end of the alignment on": np.count_nonzero(stamps_ns >= heard["first_ns"]),
        "Odometry received / distinct": f"{heard['solutions']} / {heard['distinct']}",
        "latency sample to Odometry, median, ms": f"{latency[0]:.2f}",
        "latency, 99 %, ms": f"{latency[1]:.2f}",
        "latency, greatest, ms": f"{latency[2]:.1f}",
        "ins_node, % of a core": f"{share[0]:.1f}",
        "bag_player, % of a core": f"{share[1]:.1f}",
    }


def _wait_for(nodes: Nodes, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + _PATIENCE
    while not condition():
        nodes.check()
        if time.monotonic() > end:
            said = nodes.log("ins_node").read_text().strip()
            raise InsNavError(f"ins_node has not come so far within {_PATIENCE:g} s; it said: {said}")
        time.sleep(0.05)


def _seconds(process: "Popen[str]") -> float:
    """Processor time used so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
