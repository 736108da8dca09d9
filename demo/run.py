"""A dive from end to end: simulate, navigate live over ROS 2, compare with the truth.

Needs rclpy (``make demo`` takes care). Output is in demo/out, or in the folder of -o.
"""

import argparse
import contextlib
import json
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Self

from demo import figure, mission
from ins_nav.cli.process import main as process_recording
from ins_nav.errors import InsNavError, for_people
from ins_nav.recordings.bags import BagReader
from ins_nav.report import figures
from ins_nav.report.comparison import compare
from ins_nav.report.series import read_reference, read_result
from ins_nav.report.table import table
from ins_nav.simulation.recording import write_bag

HERE = Path(__file__).parent
NODES = ("ins_node", "alignment_node")
PARAMETERS = HERE.parent / "config" / "auv.yaml"
_COUNTS = tuple(f"imu/data_raw {kind}" for kind in ("received", "integrated", "used"))
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
        """Run Python with these arguments; stderr goes to NAME.log unless it is shown."""
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
        """Standard output of a process, once it has ended; an error when one of them fails meanwhile."""
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
                output = self.log(name).read_text().strip().splitlines()
                raise InsNavError(
                    f"{name} ended with code {process.returncode}: {output[-1] if output else 'see above'}"
                )


def navigate(
    bag: Path,
    live: Path,
    rate: float,
    nodes: Sequence[str] = ("ins_node",),
    topics: Sequence[str] = ("imu/data_raw", "gnss/fix"),
    parameters: Path | None = None,
) -> tuple[int, list[float] | None]:
    """Play a bag into live nodes and record what ins_node publishes.

    Parameters
    ----------
    bag, live : Path
        Recording to play, recording to make.
    rate : float
        Times real time.
    nodes : sequence of str
        Each is a process of its own.
    topics : sequence of str
        That are played.
    parameters : Path, optional
        Parameter file of the nodes.

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
    given = ("--ros-args", "--params-file", parameters) if parameters else ()
    with Nodes(live.parent) as running:
        for node in nodes:
            running.start(node, "-m", f"ins_nav.nodes.{node}", *given)
        recorder = running.start("recorder", HERE / "recorder.py", live, len(nodes))
        _wait_until_ready(running, recorder)
        player = ("-m", "ins_nav.nodes.bag_player", bag, "-r", rate, "--topics", *topics)
        running.start("bag_player", *player, shows=True)
        output = running.wait_for("bag_player")
        published = re.search(r"/imu/data_raw (\d+)", output)
        if not published:
            raise InsNavError(f"bag_player played no imu/data_raw: {output.strip()}")
        _pipe(recorder.stdin).close()
        result = json.loads(running.wait_for("recorder"))
    return int(published[1]), result["latency_ms"]


def _wait_until_ready(nodes: Nodes, recorder: subprocess.Popen[str]) -> None:
    """Until the recorder has found the nodes."""
    end = time.monotonic() + _PATIENCE
    stdout = _pipe(recorder.stdout)
    while not select.select([stdout], [], [], 0.1)[0]:
        nodes.check()
        if time.monotonic() > end:
            raise InsNavError(f"the nodes and the recorder have not found each other within {_PATIENCE:g} s")
    stdout.readline()


def _pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def _processed(bag: Path, result: Path) -> None:
    """The result of ins_process for the recording; its output goes to a file, as that of the nodes."""
    command = (bag, "-o", result, "--params-file", PARAMETERS, "--nodes", *NODES, "--overwrite")
    log = result.with_suffix(".log")
    with log.open("w") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
        code = process_recording(list(map(str, command)))
    if code:
        raise InsNavError(f"ins_process ended with code {code}, see {log}")


@for_people("demo")
def main(argv: Sequence[str] | None = None) -> int:
    """The command line."""
    began = time.monotonic()
    args = _parser().parse_args(argv)
    if not 0.0 < args.rate < 1000.0:
        raise InsNavError(f"--rate {args.rate:g}: give a number above 0, below 1000")
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InsNavError(f"{args.output}: cannot make this folder: {error.strerror}") from error
    bag, live, batch, picture = (args.output / name for name in ("simulation", "live", "batch", "demo.png"))

    dive = mission.make(args.quick, args.seed)
    print(f"simulating {mission.described(dive)}\n", flush=True)
    write_bag(dive.simulation, bag, overwrite=True, progress=True)
    with BagReader(bag) as reader:
        topics = [topic for topic in reader.topics if not topic.startswith("/truth/")]
    duration = dive.phases[-1].end
    print(f"{' and '.join(NODES)}, live, at {args.rate:g} times real time: {duration / args.rate:.0f} s", flush=True)
    published, latency = navigate(bag, live, args.rate, NODES, topics, PARAMETERS)
    print("ins_process does the same over the recording, for comparison", flush=True)
    _processed(bag, batch)

    result, same, reference = read_result(live, "live"), read_result(batch, "ins_process"), read_reference(bag)
    assert reference is not None
    comparison = compare(result, reference)
    counts = {"ins_node": result.diagnostics, "alignment_node": mission.last_status(live, "alignment")}
    print(f"\n{mission.accuracy(dive, reference, comparison)}\n")
    print(f"{mission.aids(counts['alignment_node'])}\n")
    columns = {name: _handled(published, values) for name, values in counts.items()}
    if latency is not None:
        columns["ins_node"]["latency sample to Odometry, median / 99 %, ms"] = " / ".join(f"{x:.2f}" for x in latency)
    print(f"{table(columns)}\n\n{mission.agreement(result, same)}")
    figures.save(figure.figure(dive, result, reference, comparison), picture)
    print(f"figure: {picture}; all this took {time.monotonic() - began:.0f} s")
    if any(f"{published} / {published} / {published}" not in rows.values() for rows in columns.values()):
        raise InsNavError(f"samples were lost; is the machine too slow for --rate {args.rate:g}?")
    return 0


def _handled(published: int, values: dict[str, str]) -> dict[str, str]:
    """What became of the samples in a node, by its diagnostics."""
    received, used = (value for key, value in values.items() if key in _COUNTS)
    return {"IMU samples played / received / used": f"{published} / {received} / {used}"}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="demo", description="Simulate a dive, navigate live, compare with the truth.")
    parser.add_argument("--quick", action="store_true", help="a short dive")
    parser.add_argument("--rate", type=float, default=10.0, help="times real time (default %(default)g)")
    parser.add_argument("--seed", type=int, default=0, help="of the simulation (default %(default)s)")
    parser.add_argument("-o", "--output", type=Path, default=HERE / "out", metavar="FOLDER", help="default: demo/out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
