"""Live nodes over DDS: bag_player, the nodes, a recorder, and for comparison rclpy alone (bench/floor.py).

Each is a separate process. The floor receives the same samples in the same seconds, so that the ratio of the two loads
does not depend on other load of the machine.
"""

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
_SINGLE_THREADED = "import rclpy.experimental as e; del e.EventsExecutor; from {} import main; main()"
"""A node with the SingleThreadedExecutor."""


def results(_data: Path) -> Iterator[str]:
    """The section's table."""
    columns = {
        "ins_node": _measure(_DURATION, "ins_node"),
        "ins_system": _measure(_DURATION, "ins_system", statuses=3),
        "ins_node, SingleThreadedExecutor": _measure(0.5 * _DURATION, "ins_node", single_threaded=True),
    }
    rows = [[name, *(column[name] for column in columns.values())] for name in next(iter(columns.values()))]
    yield table([f"{_RATE:g} Hz, live", *columns], rows)


def _measure(duration: float, node: str, statuses: int = 1, single_threaded: bool = False) -> dict[str, object]:
    """A column of the table; statuses: how many of the process come on /diagnostics."""
    simulation = simulate("vehicle", 2, rate=_RATE, duration=duration, stand_time=_ALIGNMENT + 5.0)
    modules = {"node": f"ins_nav.nodes.{node}", "floor": "bench.floor"}
    programs = {name: _command(module, single_threaded) for name, module in modules.items()}
    with tempfile.TemporaryDirectory() as folder:
        write_bag(simulation, Path(folder, "bag"))
        output, recorded, share = _play(Path(folder), programs, statuses)
    return _rows(output, recorded, simulation.stamps_ns, share)


def _command(module: str, single_threaded: bool) -> tuple[str, ...]:
    return ("-c", _SINGLE_THREADED.format(module)) if single_threaded else ("-m", module)


def _play(
    folder: Path, programs: dict[str, tuple[str, ...]], statuses: int
) -> tuple[str, dict[str, Any], dict[str, float]]:
    """Output of bag_player and of the recorder, and the share of a core of each process, %."""
    with Nodes(folder) as nodes:
        settings = ("--ros-args", "-p", f"alignment.duration:={_ALIGNMENT}")
        processes = {"node": nodes.start("node", *programs["node"], *settings)}
        _wait_for(nodes, lambda: "waiting for imu/data_raw" in nodes.log("node").read_text())
        processes["floor"] = nodes.start("floor", *programs["floor"])
        recorder = nodes.start("recorder", "-m", "bench.recorder", statuses)
        assert recorder.stdout is not None and recorder.stdin is not None
        recorder.stdout.readline()
        arguments = (folder / "bag", "--no-progress", "--topics", "imu/data_raw", "gnss/fix")
        player = processes["bag_player"] = nodes.start("bag_player", "-m", "ins_nav.nodes.bag_player", *arguments)
        _wait_for(nodes, lambda: "aligned in" in nodes.log("node").read_text())
        time.sleep(_SETTLED)
        readings = []
        while player.poll() is None:
            nodes.check()
            readings.append((time.monotonic(), *map(_seconds, processes.values())))
            time.sleep(0.5)
        spent = np.subtract(readings[-1], readings[0])
        output = nodes.wait_for("bag_player")
        recorder.stdin.close()
        recorded = json.loads(nodes.wait_for("recorder"))
    return output, recorded, dict(zip(processes, (100.0 * spent[1:] / spent[0]).tolist(), strict=True))


def _rows(
    output: str, recorded: dict[str, Any], stamps_ns: NDArray[np.int64], share: dict[str, float]
) -> dict[str, object]:
    published = re.search(r"/imu/data_raw (\d+)", output)
    latency = recorded["latency_ms"] or [math.nan] * 3
    return {
        "samples published": published[1] if published else "none",
        "received by ins_node": recorded["diagnostics"]["imu/data_raw received"],
        "integrated": recorded["diagnostics"]["imu/data_raw integrated"],
        "samples from the end of the alignment on": np.count_nonzero(stamps_ns >= recorded["first_ns"]),
        "Odometry received / distinct": f"{recorded['solutions']} / {recorded['distinct']}",
        "latency sample to Odometry, median, ms": f"{latency[0]:.2f}",
        "latency, 99 %, ms": f"{latency[1]:.2f}",
        "latency, greatest, ms": f"{latency[2]:.1f}",
        "the process, % of a core": f"{share['node']:.1f}",
        "bare rclpy beside it, % of a core": f"{share['floor']:.1f}",
        "difference, % of a core": f"{share['node'] - share['floor']:.1f}",
        "ratio": f"{share['node'] / share['floor']:.2f}",
        "bag_player, % of a core": f"{share['bag_player']:.1f}",
    }


def _wait_for(nodes: Nodes, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + _PATIENCE
    while not condition():
        nodes.check()
        if time.monotonic() > end:
            printed = nodes.log("node").read_text().strip()
            raise InsNavError(f"the node did not come so far within {_PATIENCE:g} s; it printed: {printed}")
        time.sleep(0.05)


def _seconds(process: "Popen[str]") -> float:
    """Processor time used so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
