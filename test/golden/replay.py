"""Golden replays: `ins_process` over five simulated recordings, its output as a digest a scenario.

The digests beside this file are part of a review: a change of the engine shows in them. Once the change is understood::

    make golden                      # or: make golden ARGS="vehicle auv_dive"
"""

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from golden.digest import Digest, read_result, to_text

from ins_nav.cli.process import main as ins_process
from ins_nav.recordings.bags import BagReader, BagWriter
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

FOLDER = Path(__file__).parent
CONFIG = FOLDER.parents[1] / "config"
NS = 1_000_000_000

Edit = Callable[[str, Any, float], Iterator[tuple[Any, float]]]
"""Topic, message and its time, s since the start, to the messages that take its place."""


@dataclass(frozen=True)
class Scenario:
    """A simulated recording and how `ins_process` runs over it.

    Attributes
    ----------
    text : str
        What it covers.
    name : str
        Of the simulated scenario.
    simulated : dict
        Its parameters.
    arguments : tuple of str
        Of `ins_process`.
    every : float
        Interval of the rows, s.
    edit : Edit, optional
        Damages the recording.
    """

    text: str
    name: str
    simulated: dict[str, Any]
    arguments: tuple[str, ...] = ()
    every: float = 20.0
    edit: Edit | None = None


def _aligned(coarse: float, fine: float) -> tuple[str, ...]:
    return "--param", f"alignment.duration:={coarse:g}", "--param", f"alignment.fine_duration:={fine:g}"


def _faults(topic: str, message: Any, time: float) -> Iterator[tuple[Any, float]]:
    """Gaps, values that are no numbers, repeated and backward stamps; fixes that jump and come late."""
    if topic == "/imu/data_raw":
        if 62.0 < time < 62.3 or 90.0 < time < 93.0:
            return
        if 70.0 < time < 70.1:
            message.angular_velocity.x = math.nan
        if 75.0 < time < 75.02:
            message.header.stamp.sec -= 5
        yield message, time
        if 80.0 < time < 80.1:
            yield message, time
    elif topic == "/gnss/fix":
        if 100.0 < time < 104.0:
            message.latitude += 1e-3
        if 110.0 < time < 112.0:
            message.status.status = -1
        yield message, time + (1.5 if time > 115.0 else 0.0)
    else:
        yield message, time


SCENARIOS = {
    "vehicle": Scenario(
        "A car aligns, drives with satellite fixes, stops; ZUPT services are called",
        "vehicle",
        {"duration": 240.0, "rate": 50.0, "stand_time": 60.0},
        _aligned(30, 60),
    ),
    "faults": Scenario(
        "The same with gaps, NaN, wrong stamps in the IMU's stream and wrong, lost and late fixes",
        "vehicle",
        {"duration": 150.0, "rate": 50.0, "stand_time": 40.0},
        _aligned(20, 40),
        edit=_faults,
    ),
    "zupt2_stop": Scenario(
        "The ZUPT paper's run, rocking by 3° in 11 s",
        "zupt2_stop",
        {"duration": 260.0, "rate": 50.0, "rocking_amplitude_deg": 3.0},
        ("--params-file", str(CONFIG / "paper_zupt.yaml")),
    ),
    "swell_alignment_turn": Scenario(
        "The alignment paper's base in swell, turned by 180°, then free inertial",
        "swell_alignment_turn",
        {"duration": 280.0, "rate": 50.0, "turn_start": 90.0},
        ("--params-file", str(CONFIG / "paper_alignment.yaml"), "--param", "alignment.fine_duration:=150"),
    ),
    "auv_dive": Scenario(
        "A short dive by log, depth gauge and ranges to a drifting vessel, one in ten wrong; the log loses the bottom",
        "auv_dive",
        {
            "rate": 50.0,
            "alignment_time": 90.0,
            "turn_start": 65.0,
            "surface_leg": 20.0,
            "depth": 8.0,
            "dive_time": 80.0,
            "surface_time": 10.0,
            "log.lost_start": 145.0,
            "log.lost_duration": 10.0,
            "range.outlier_share": 0.1,
            "beacon.positions": (65.0, 45.0, -2.0),
            "beacon.radii": (20.0,),
        },
        ("--params-file", str(CONFIG / "auv.yaml"), *_aligned(40, 50)),
    ),
}


def digest_of(scenario: Scenario) -> Digest:
    """Simulate the scenario with seed 1, process it, and read the result."""
    simulation = simulate(scenario.name, 1, **scenario.simulated)
    with tempfile.TemporaryDirectory() as folder:
        bag, result = Path(folder) / "bag", Path(folder) / "result"
        write_bag(simulation, bag)
        if scenario.edit is not None:
            bag = _edited(bag, Path(folder) / "edited", scenario.edit)
        if ins_process([str(bag), "-o", str(result), *scenario.arguments]) != 0:
            raise RuntimeError(f"ins_process failed: {scenario.text}")
        return read_result(result, simulation.start_ns, scenario.every)


def _edited(bag: Path, path: Path, edit: Edit) -> Path:
    with BagReader(bag) as reader, BagWriter(path) as writer:
        for raw in reader.messages([topic for topic in reader.topics if not topic.startswith("/truth")]):
            time = (raw.stamp_ns - reader.start_ns) / NS
            for message, at in edit(raw.topic, reader.deserialize(raw), time):
                writer.write(raw.topic, raw.msgtype, message, reader.start_ns + round(at * NS))
    return path


def path_of(name: str) -> Path:
    """The stored digest of a scenario."""
    return FOLDER / f"{name}.txt"


def main(argv: Sequence[str] | None = None) -> None:
    """Renew the digests of the scenarios named, or of all."""
    parser = argparse.ArgumentParser(description="Renew the digests of golden replays.")
    parser.add_argument("names", nargs="*", metavar="SCENARIO", help=f"of {', '.join(SCENARIOS)} (default: all)")
    for name in parser.parse_args(argv).names or SCENARIOS:
        path_of(name).write_text(to_text(SCENARIOS[name].text, digest_of(SCENARIOS[name])))
        print(path_of(name))


if __name__ == "__main__":
    main()
