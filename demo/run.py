"""A drive from end to end: simulate, navigate live over ROS 2, compare with the truth.

Needs rclpy (``make demo`` takes care). Everything it makes is in demo/out, or where -o says.
"""

import argparse
import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Self

from ins_nav.errors import InsNavError, for_people
from ins_nav.report import figures
from ins_nav.report.comparison import compare
from ins_nav.report.series import read_reference, read_result
from ins_nav.report.table import rows_of, table
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

HERE = Path(__file__).parent
_PATIENCE = 30.0  # s: for a slow machine to start Python and to find the others


class Nodes:
    """Processes in a ROS domain of their own, on this machine only; none outlives the block."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._running: dict[str, subprocess.Popen[str]] = {}
        # below 102, where DDS's ports would reach the ephemeral ones
        domain = str(1 + os.getpid() % 101)
        self._environment = os.environ | {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._environment |= {"ROS_LOG_DIR": str(folder / "log"), "PYTHONUNBUFFERED": "1"}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, name: str, *command: object, shows: bool = False) -> subprocess.Popen[str]:
        """Run Python with these arguments; what it says on stderr goes to NAME.log unless it is to be shown."""
        with self.log(name).open("w") as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, *map(str, command)],
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None if shows else log,
                text=True,
            )
        return self._running[name]

    def log(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def wait_for(self, name: str) -> str:
        """What a process said till it ended; an error when one of them fails meanwhile."""
        process = self._running[name]
        while process.poll() is None:
            self.check()
            time.sleep(0.1)
        self.check()
        return _pipe(process.stdout).read()

    def check(self) -> None:
        """Raise InsNavError when a process has failed."""
        for name, process in self._running.items():
            if process.poll():
                said = self.log(name).read_text().strip().splitlines()
                raise InsNavError(f"{name} ended with code {process.returncode}: {said[-1] if said else 'see above'}")


def navigate(bag: Path, live: Path, rate: float) -> tuple[int, list[float] | None]:
    """Play a bag into a live ins_node and record what it publishes.

    Parameters
    ----------
    bag, live : Path
        Recording to play, recording to make.
    rate : float
        Times real time.

    Returns
    -------
    published : int
        IMU samples.
    latency_ms : [median, 99 %] or None
        From sample to Odometry, both as the recorder hears them.

    Raises
    ------
    InsNavError
    """
    with Nodes(live.parent) as nodes:
        nodes.start("ins_node", "-m", "ins_nav.nodes.ins_node")
        recorder = nodes.start("recorder", HERE / "recorder.py", live)
        _wait_until_ready(nodes, recorder)
        topics = ("imu/data_raw", "gnss/fix")
        nodes.start("bag_player", "-m", "ins_nav.nodes.bag_player", bag, "-r", rate, "--topics", *topics, shows=True)
        said = nodes.wait_for("bag_player")
        published = re.search(r"/imu/data_raw (\d+)", said)
        if not published:
            raise InsNavError(f"bag_player played no imu/data_raw: {said.strip()}")
        _pipe(recorder.stdin).close()
        result = json.loads(nodes.wait_for("recorder"))
    return int(published[1]), result["latency_ms"]


def _wait_until_ready(nodes: Nodes, recorder: subprocess.Popen[str]) -> None:
    """Until the recorder has found the node."""
    end = time.monotonic() + _PATIENCE
    stdout = _pipe(recorder.stdout)
    while not select.select([stdout], [], [], 0.1)[0]:
        nodes.check()
        if time.monotonic() > end:
            raise InsNavError(f"ins_node and recorder have not found each other within {_PATIENCE:g} s")
    stdout.readline()


def _pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


@for_people("demo")
def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    args = _parser().parse_args(argv)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if not 0.0 < args.rate < 1000.0:
        raise InsNavError(f"--rate {args.rate:g}: give a number above 0, below 1000")
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InsNavError(f"{args.output}: cannot make this folder: {error.strerror}") from error
    bag, live, picture = (args.output / name for name in ("simulation", "live", "demo.png"))

    stand, duration = (65.0, 100.0) if args.quick else (90.0, 390.0)
    print(f"simulating a car: stands {stand:g} s, drives {duration - stand:g} s; navigation-grade IMU", flush=True)
    write_bag(simulate("vehicle", args.seed, stand_time=stand, duration=duration), bag, overwrite=True, progress=True)
    print(
        f"ins_node aligns and navigates, live, at {args.rate:g} times real time: {duration / args.rate:.0f} s",
        flush=True,
    )
    published, latency = navigate(bag, live, args.rate)

    result, reference = read_result(live, "ins_node"), read_reference(bag)
    assert reference is not None
    comparison = compare(result, reference)
    received, integrated = (int(result.diagnostics[f"imu/data_raw {name}"]) for name in ("received", "integrated"))
    rows = rows_of(result, comparison)
    rows["IMU samples published / received / integrated"] = f"{published} / {received} / {integrated}"
    if latency is not None:
        rows["latency sample to Odometry, median / 99 %, ms"] = " / ".join(f"{x:.2f}" for x in latency)
    print(f"\n{table({result.name: rows})}\n")
    figures.save(figures.figure([result], reference, [comparison]), picture)
    print(f"figure: {picture}")
    if integrated < published:
        raise InsNavError(
            f"{published - integrated} samples were lost; is the machine too slow for --rate {args.rate:g}?"
        )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="demo", description="Simulate a drive, navigate live, compare with the truth."
    )
    parser.add_argument("--quick", action="store_true", help="a short drive")
    parser.add_argument("--rate", type=float, default=5.0, help="times real time (default %(default)g)")
    parser.add_argument("--seed", type=int, default=0, help="of the simulation (default %(default)s)")
    parser.add_argument("-o", "--output", type=Path, default=HERE / "out", metavar="FOLDER", help="default: demo/out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
