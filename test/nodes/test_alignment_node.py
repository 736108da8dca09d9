"""`alignment_node` and `ins_node` over real DDS, each in a separate process, and both in `ins_system`."""

import json
import math
import random
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from decoding import as_message
from ros_harness import Listener, Process, Ros, needs_ros
from scipy.spatial.transform import Rotation

from ins_nav.aiding.parameters import configuration
from ins_nav.cli.process import main as process
from ins_nav.config.state_file import load
from ins_nav.messages.named_numbers import pack
from ins_nav.navigator.correction import Correction
from ins_nav.navigator.delayed import DelayedNavigator
from ins_nav.recordings.bags import BagReader, BagWriter, header, message
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate
from ins_nav.stamps import stamp_of

pytestmark = needs_ros

NS = 1_000_000_000
ODOMETRY, IMU, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
PARAMETERS = ("alignment.duration:=15.0", "alignment.fine_duration:=30.0")
DIVE = Path(__file__).resolve().parents[2] / "config" / "auv.yaml"
_REPLAY = 200.0
"""s: a replay of 17 s where the machine is loaded."""
OUTPUTS = {"odometry": ODOMETRY, "/diagnostics": DIAGNOSTICS}


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """17 s standing, 33 s driving; 50 Hz; fixes once a second, logged 0.5 s late and then out of order."""
    folder = tmp_path_factory.mktemp("drive")
    write_bag(
        simulate("vehicle", 2, duration=50.0, stand_time=17.0, rate=50.0, **{"truth.rate": 1.0}), folder / "plain"
    )
    late = random.Random(3)
    with BagReader(folder / "plain") as reader:
        messages = list(reader.messages(["/imu/data_raw", "/gnss/fix"]))
        begin = messages[0].stamp_ns
    moved = []
    for raw in messages:
        behind = 0.0
        if raw.topic == "/gnss/fix" and raw.stamp_ns > begin + 2 * NS:  # the first gives the place
            behind = 0.5 + late.uniform(0.0, 1.1)
        moved.append((raw.stamp_ns + round(behind * 1e9), raw))
    with BagWriter(folder / "late") as writer:
        for stamp, raw in sorted(moved, key=lambda item: item[0]):
            writer.write_raw(raw.topic, raw.msgtype, raw.data, stamp)
    return folder / "late"


@pytest.fixture(scope="module")
def processed(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[int, Any], list[tuple[int, int]]]:
    """As `_processed` returns it; from the recording in the order of stamps it is the same, bit for bit."""
    folder = tmp_path_factory.mktemp("offline")
    given = [part for text in PARAMETERS for part in ("--param", text)]
    late, plain = (_processed(bag, folder / bag.name, *given) for bag in (drive, drive.with_name("plain")))
    assert late[0].keys() == plain[0].keys() and late[1] == plain[1]
    for stamp, odometry in late[0].items():
        assert _numbers(odometry) == _numbers(plain[0][stamp])
    return late


@pytest.fixture(scope="module")
def offline(processed: tuple[dict[int, Any], list[tuple[int, int]]]) -> dict[int, Any]:
    """Odometry of `ins_process`."""
    return processed[0]


def _numbers(message: Any) -> tuple[float, ...]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w, *message.pose.covariance, *message.twist.covariance)


def _start(ros: Ros, *names: str, **more: object) -> tuple[Listener, list[Process]]:
    """Nodes, and a listener that has discovered them: discovery can take longer than a short bag."""
    started = [_node(ros, name, **more) for name in names]
    listener = ros.listen(OUTPUTS)
    expected = ("/ins_node: navigation", "/alignment_node: alignment")
    listener.wait_for(lambda: all(_status(listener, name) is not None for name in expected))
    return listener, started


def _node(ros: Ros, name: str, **more: object) -> Process:
    given = (*PARAMETERS, *(f"{key}:={value}" for key, value in more.items()))
    settings = [part for text in given for part in ("-p", text)]
    return ros.start(f"ins_nav.nodes.{name}", "--ros-args", *settings)


def _processed(bag: Path, out: Path, *given: str) -> tuple[dict[int, Any], list[tuple[int, int]]]:
    """Odometry of `ins_process` by stamp; stamps of its corrections, and of the samples with which they take effect."""
    corrections = []
    drain = DelayedNavigator.drain

    def recorded(navigator: DelayedNavigator) -> list[Correction]:
        drained = drain(navigator)
        corrections.extend((correction.stamp_ns, correction.apply_ns) for correction in drained)
        return drained

    with mock.patch.object(DelayedNavigator, "drain", recorded):
        assert process([str(bag), "-o", str(out), *given]) == 0
    with BagReader(out) as reader:
        odometry = map(reader.deserialize, reader.messages(["/odometry"]))
        return {stamp_of(message): message for message in odometry}, corrections


def _play_paced(ros: Ros, bag: Path, rate: float, corrections: list[tuple[int, int]]) -> Process:
    """Play at a rate, or as slowly as a loaded machine needs for each correction to come in time."""
    file = ros.folder / "corrections.json"
    file.write_text(json.dumps(corrections))
    return ros.start(Path(__file__).parents[1] / "paced_player.py", bag, rate, file)


def _play(ros: Ros, bag: Path, rate: float) -> Process:
    return ros.start("ins_nav.nodes.bag_player", bag, "--no-progress", "--rate", rate)


def _status(listener: Listener, name: str) -> Any:
    """The last of that name, or None."""
    every = [status for item in listener.messages("/diagnostics") for status in item.message.status]
    return next((status for status in reversed(every) if status.name == name), None)


def _values(listener: Listener, name: str) -> dict[str, str]:
    status = _status(listener, name)
    return {item.key: item.value for item in status.values} if status else {}


def _differences(listener: Listener, offline: dict[int, Any]) -> tuple[set[int], np.ndarray, np.ndarray]:
    """Stamps, and how far live and offline are apart there, m and deg."""
    live = {stamp_of(received.message): received.message for received in listener.messages("odometry")}
    common = sorted(live.keys() & offline.keys())
    away, turned = [], []
    for stamp in common:
        a, b = live[stamp].pose.pose, offline[stamp].pose.pose
        away.append(math.dist(*((p.x, p.y, p.z) for p in (a.position, b.position))))
        q, expected = (Rotation.from_quat([o.x, o.y, o.z, o.w]) for o in (a.orientation, b.orientation))
        turned.append(math.degrees((q * expected.inv()).magnitude()))
    return live.keys(), np.array(away), np.array(turned)


@pytest.mark.parametrize("nodes", [("ins_node", "alignment_node"), ("ins_system",)])
def test_live_equals_ins_process(
    nodes: tuple[str, ...], drive: Path, processed: tuple[dict[int, Any], list[tuple[int, int]]], tmp_path: Path
) -> None:
    """Fixes come late and out of order, on a DDS that is not in step with the samples."""
    offline, corrections = processed
    with Ros(tmp_path) as ros:
        listener, started = _start(ros, *nodes, state_file=tmp_path / "state.yaml")
        player = _play_paced(ros, drive, 5.0, corrections if len(nodes) > 1 else [])  # in one process none travels
        assert player.wait(_REPLAY) == 0, player.stderr
        listener.wait_for_count("odometry", len(offline))

        def done() -> bool:
            return _values(listener, "/alignment_node: alignment").get("imu/data_raw received") == "2500"

        listener.wait_for(done)  # its last diagnostics
        values = _values(listener, "/alignment_node: alignment")
        output = "".join(process.stdout + process.stderr for process in started)
        success, text = listener.call("ins_node/save")
        assert success and text.startswith("imu.gyro_bias_deg_per_hour, imu.accel_bias_mg and the pose written to ")
        kept, pose = load(tmp_path / "state.yaml", configuration(), ())
        assert kept.keys() == {"imu.gyro_bias_deg_per_hour", "imu.accel_bias_mg"} and pose.position_stddev < 5.0
        # the service of one node is for both
        success, text = listener.call("ins_node/align")
        assert success and "alignment started" in text
        for name in ("/ins_node: navigation", "/alignment_node: alignment"):
            listener.wait_for(lambda name=name: _values(listener, name)["phase"] == "coarse")
        for process in started:
            assert process.stop() == 0
        listener.stop()
    stamps, away, turned = _differences(listener, offline)
    print(f"{nodes}: {away.max():.1e} m, {turned.max():.1e} deg, {(away > 0).sum()} of {len(away)} differ")
    assert stamps == offline.keys()  # every sample once, none lost
    # what is asked; the same core on the same numbers: nothing at all, where no feedback came late
    assert away.max() < 1e-3 and turned.max() < 1e-4
    logger = "alignment_node" if len(nodes) > 1 else "ins_node"  # in one process the events are those of one engine
    lines = [line for line in output.splitlines() if "fine alignment ended after 30 s" in line]
    assert len(lines) == 1 and f"[{logger}]: " in lines[0]
    assert values["phase"] == "navigating" and values["imu/data_raw used"] == "2500"
    accepted, rejected = map(int, values["gnss: accepted, rejected"].split(", "))
    assert accepted >= 30 and rejected <= 1
    for name in ("position sigma", "height sigma", "velocity sigma", "level sigma", "heading sigma"):
        assert float(values[name].split()[0]) > 0.0
    assert 0.0 <= float(values["gnss: test ratio"]) < 1.0 and values["gnss: innovation"].count("±") == 3
    assert float(values["gnss: last accepted"].removesuffix(" s ago")) < 2.0
    assert not any("late" in key for key in values)


def test_a_dive_at_up_to_ten_times_real_time_equals_ins_process(tmp_path: Path) -> None:
    """All aids, wrong ranges, a log that loses the bottom, swell: coarse alignment needs a second."""
    changes = {"alignment_time": 60.0, "turn_start": 35.0, "surface_leg": 20.0, "depth": 8.0, "dive_time": 80.0}
    faults = {"log.lost_start": 115.0, "log.lost_duration": 10.0, "range.outlier_share": 0.2}
    simulation = simulate("auv_dive", 1, **changes, **faults, surface_time=10.0, rate=50.0, **{"truth.rate": 1.0})
    write_bag(simulation, tmp_path / "dive")
    given = (
        "--params-file",
        str(DIVE),
        "--param",
        "alignment.duration:=30.0",
        "--param",
        "alignment.fine_duration:=60.0",
    )
    offline, corrections = _processed(tmp_path / "dive", tmp_path / "result", *given)
    with Ros(tmp_path) as ros:
        settings = [part.replace("--param", "-p") if part == "--param" else part for part in given]
        for name in ("ins_node", "alignment_node"):
            ros.start(f"ins_nav.nodes.{name}", "--ros-args", *settings)
        listener = ros.listen(OUTPUTS)
        names = ("/ins_node: navigation", "/alignment_node: alignment")
        listener.wait_for(lambda: all(_status(listener, name) is not None for name in names))
        player = _play_paced(ros, tmp_path / "dive", 10.0, corrections)
        assert player.wait(_REPLAY) == 0, player.stderr
        listener.wait_for_count("odometry", len(offline))
        count = str(len(simulation.stamps_ns))
        listener.wait_for(lambda: _values(listener, names[1]).get("imu/data_raw received") == count)
        values = [_values(listener, name) for name in names]
        listener.stop()
    stamps, away, turned = _differences(listener, offline)
    assert not any("late" in key for each in values for key in each), values
    assert stamps == offline.keys() and away.max() < 1e-3 and turned.max() < 1e-4
    # each fault by its name
    assert values[1]["log unusable"] == "50" and int(values[1]["range/vessel rejected"]) >= 2


def test_killed_and_started_again(drive: Path, offline: dict[int, Any], tmp_path: Path) -> None:
    """Killed after 5 s of fine alignment: `ins_node` continues without a gap.

    The filter that is started again adopts its solution, and corrects it.
    """
    with Ros(tmp_path) as ros:
        listener, (ins, filtering) = _start(ros, "ins_node", "alignment_node")
        player = _play(ros, drive, 4.0)
        listener.wait_for_count("odometry", 250, 60.0)
        filtering.kill()
        killed_ns = _last_stamp(listener)
        listener.wait_for_count("odometry", 650, 60.0)
        assert listener.call("bag_player/pause") == (True, "paused")  # a loaded machine needs long to start a node
        again = _node(ros, "alignment_node")
        listener.wait_for(lambda: _values(listener, "/alignment_node: alignment").get("imu/data_raw received") == "0")
        assert listener.call("bag_player/resume") == (True, "playing")
        again.wait_for_output("starts from the solution of ins_node")
        adopted_ns = _last_stamp(listener)
        listener.wait_for_count("odometry", len(offline), 60.0)
        assert player.wait() == 0
        values = _values(listener, "/alignment_node: alignment")
        assert ins.stop() == again.stop() == 0
        listener.stop()
    stamps = np.array([stamp_of(received.message) for received in listener.messages("odometry")])
    assert len(stamps) == len(offline) and np.diff(stamps).max() == np.diff(stamps).min() == 20_000_000
    # alone its position sigma grows, once the last correction has taken effect; with corrections it is less again
    variance = {stamp_of(r.message): r.message.pose.covariance[0] for r in listener.messages("odometry")}
    alone = [v for stamp, v in variance.items() if killed_ns + 3 * NS < stamp < adopted_ns]
    after = [v for stamp, v in variance.items() if stamp > adopted_ns + 5 * NS]
    assert (np.diff(alone) >= 0.0).all() and after[-1] < alone[-1]
    accepted, rejected = map(int, values["gnss: accepted, rejected"].split(", "))
    assert accepted >= 5 and rejected <= 1
    _, away, _ = _differences(listener, offline)
    # apart from what it navigated alone, it is where ins_process is, to the sigma of some fixes
    assert away[-1] < 3.0


def _last_stamp(listener: Listener) -> int:
    return stamp_of(listener.messages("odometry")[-1].message)


def test_parameter_errors_and_help(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        wrong = ros.start("ins_nav.nodes.alignment_node", "--ros-args", "-p", "gnss.default_stdev:=2.0")
        asked = ros.start("ins_nav.nodes.alignment_node", "--help")
        system = ros.start("ins_nav.nodes.ins_system", "--ros-args", "-p", "gnss.slow_time:=0.0")
        assert wrong.wait() == 1
        assert wrong.stderr.strip() == (
            "alignment_node: unknown parameter gnss.default_stdev: did you mean gnss.default_stddev?"
        )
        assert asked.wait() == 0 and asked.stdout.startswith("usage: alignment_node [--ros-args")
        assert system.wait() == 1
        assert system.stderr.strip() == "ins_system: parameter gnss.slow_time: 0 is outside [1, 100000]"


def test_implausible_messages_between_the_nodes_have_no_effect(tmp_path: Path) -> None:
    """Each is counted by its topic and named once; the nodes go on."""
    infinite = as_message(pack("correction 1", {"stamp_sec": (1e308,)}))
    unknown = as_message(pack("calibration 1", {"log.scale": (1e308,)}))
    far = message("std_msgs/msg/Header", stamp=header(2 * 10**18, "").stamp)
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(3):
            for topic, content in (
                ("feedback", infinite),
                ("solution", infinite),
                ("calibration", unknown),
                ("zupt", far),
            ):
                bag.write(f"ins/{topic}", content.__msgtype__, content, NS * (10**9 + i))
    with Ros(tmp_path) as ros:
        listener, started = _start(ros, "ins_node", "alignment_node")
        assert _play(ros, tmp_path / "bag", 5.0).wait() == 0
        expected = {
            "/ins_node: navigation": {
                "feedback": "stamp_nanosec has 0 numbers, not 1: do all nodes have one version?",
                "calibration": r"parameter log.scale: 1e\+308 is outside \[-0.5, 0.5\]",
            },
            "/alignment_node: alignment": {
                "solution": "layout.dim has the labels .*, not one that begins with 'solution 1:'",
                "zupt": "stamp is 2000000000.0 s after the newest of imu/data_raw",
            },
        }
        for process, (status, texts) in zip(started, expected.items(), strict=True):
            for topic, text in texts.items():
                process.wait_for_output(f"ins/{topic}: {text}.*: rejected")
                listener.wait_for(lambda s=status, t=topic: _values(listener, s).get(f"ins/{t} rejected") == "3")
            assert process.stop() == 0
        listener.stop()
