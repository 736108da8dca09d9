"""`ins_process`: a simulated recording in, the live node's topics out, compared with the truth beside them."""

import math
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ins_nav.cli.process import main
from ins_nav.recordings.bags import BagReader, BagWriter, message
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate
from ins_nav.stamps import stamp_of

POSITION = ("--param", "initial.latitude_deg:=60", "--param", "initial.longitude_deg:=30", "--param")
ALONE = ("--nodes", "ins_node")
START = (*POSITION, "initial.height:=0", "--param", "alignment.duration:=30", *ALONE)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """30 s standing, then 60 s of driving with a turn; sensors without errors, 100 Hz."""
    path = tmp_path_factory.mktemp("drive") / "bag"
    perfect = {"imu.preset": "perfect", "truth.rate": 10.0, "lat_deg": 60.0, "lon_deg": 30.0, "height": 0.0}
    write_bag(simulate("vehicle", 1, duration=90.0, rate=100.0, stand_time=32.0, heading_deg=75.0, **perfect), path)
    return path


def series(path: Path, topic: str) -> dict[int, object]:
    with BagReader(path) as reader:
        return {stamp_of(m): m for m in map(reader.deserialize, reader.messages([topic]))}


def vector(v: object) -> np.ndarray:
    return np.array([v.x, v.y, v.z])  # type: ignore[attr-defined]


def rotation(q: object) -> Rotation:
    return Rotation.from_quat([q.x, q.y, q.z, q.w])  # type: ignore[attr-defined]


def test_result_agrees_with_the_truth_in_every_field(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([str(drive), "-o", str(out), *START]) == 0
    odometry, imu, fix = (series(out, t) for t in ("odometry", "imu/data", "fix"))
    true_odometry, true_imu, true_fix = (series(drive, t) for t in ("truth/odometry", "truth/imu", "truth/fix"))
    common = sorted(odometry.keys() & true_odometry.keys())
    # the alignment has a sample or two more than 30 s; all samples after it have solutions, and so all truths
    assert len(odometry) >= 5998 and len(common) >= 599
    assert odometry.keys() == imu.keys() == fix.keys()
    # Perfect sensors at 100 Hz: 0.01 mm measured, by alignment, the two-sample algorithm and the zero velocity until
    # shortly before the start.
    for stamp in common:
        o, t = odometry[stamp], true_odometry[stamp]
        assert (o.header.frame_id, o.child_frame_id) == ("map", "base_link")
        pose, true_pose = o.pose.pose, t.pose.pose
        assert vector(pose.position)[:2] == pytest.approx(vector(true_pose.position)[:2], abs=1e-3)
        turn = rotation(pose.orientation) * rotation(true_pose.orientation).inv()
        assert turn.magnitude() < 1e-4
        assert vector(o.twist.twist.linear)[:2] == pytest.approx(vector(t.twist.twist.linear)[:2], abs=2e-3)
        i, ti = imu[stamp], true_imu[stamp]
        assert i.header.frame_id == "base_link"
        assert (rotation(i.orientation) * rotation(ti.orientation).inv()).magnitude() < 1e-4
        # means over 10 ms against values at its end
        assert vector(i.angular_velocity) == pytest.approx(vector(ti.angular_velocity), abs=5e-3)
        assert vector(i.linear_acceleration) == pytest.approx(vector(ti.linear_acceleration), abs=5e-2)
        f, tf = fix[stamp], true_fix[stamp]
        assert f.latitude == pytest.approx(tf.latitude, abs=2e-7)
        assert f.longitude == pytest.approx(tf.longitude, abs=4e-7)
        assert f.altitude == pytest.approx(0.0, abs=1e-6)  # rounding of corrections at the stop


def test_publish_rate_and_bias_and_diagnostics(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([str(drive), "-o", str(out), *START, "--param", "publish.rate:=10"]) == 0
    stamps = sorted(series(out, "odometry"))
    assert np.diff(stamps).max() == np.diff(stamps).min() == 100_000_000
    with BagReader(out) as reader:
        assert reader.topics["/imu/bias"].latched and reader.topics["/imu/bias"].count >= 1
        statuses = [reader.deserialize(raw).status[0] for raw in reader.messages(["diagnostics"])]
    assert len(statuses) == 92  # one a second from the first sample to the last, and one at the end
    phases = [next(kv.value for kv in status.values if kv.key == "phase") for status in statuses]
    assert phases[1:] == sorted(phases[1:]) and set(phases) == {"coarse", "navigating", "waiting"}
    assert statuses[-1].message == "navigating"


def test_parameter_file(drive: Path, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    alignment: {level_duration: 2}\n    frames.map: odom\n"
        "ins_process:\n  ros__parameters:\n    initial.heading_deg: 75\n"
    )
    out = tmp_path / "out"
    assert main([str(drive), "-o", str(out), "--params-file", str(file)]) == 0
    first = next(iter(series(out, "odometry").values()))
    assert first.header.frame_id == "odom"
    yaw = rotation(first.pose.pose.orientation).as_euler("ZYX")[0]
    assert math.degrees(yaw) == pytest.approx(15.0, abs=1e-3)


def test_dumps_of_nodes_in_a_namespace(drive: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """As `ros2 param dump` writes them, by a version with another name for frames.map."""
    files = []
    for node, more in (("ins_node", "alignment.level_duration: 2.0"), ("alignment_node", "map_frame: odom")):
        files.append(tmp_path / f"{node}.yaml")
        files[-1].write_text(
            f"/robot/{node}:\n  ros__parameters:\n    {more}\n    initial.heading_deg: 75.0\n    use_sim_time: false\n"
            "    qos_overrides: {/imu/data_raw: {subscription: {depth: 10}}}\n"
        )
    given = [part for file in files for part in ("--params-file", str(file))]
    assert main([str(drive), "-o", str(tmp_path / "out"), *given]) == 0
    assert next(iter(series(tmp_path / "out", "odometry").values())).header.frame_id == "odom"
    assert capfd.readouterr().err.count("parameter map_frame is frames.map now") == 1
    other = ["--namespace", "/ship", "--overwrite"]
    assert main([str(drive), "-o", str(tmp_path / "out"), *given, *other]) == 1
    assert "has sections /robot/ins_node, but none for /ship/" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "output"),
    [
        (["--param", "aligment.duration:=30"], "unknown parameter aligment.duration: did you mean alignment.duration?"),
        (["--param", "alignment.duration:=-1"], "parameter alignment.duration: -1 is outside [5, 3600]"),
        (["--param", "initial.latitude_deg:=60"], "give all three or none"),
        (["--param", "alignment.duration"], "is not name:=value"),
        (["--params-file", "nowhere.yaml"], "parameter file nowhere.yaml: No such file"),
        (
            ["--nodes", "ins_node", "stop_detector"],
            "--nodes: no node 'stop_detector' (did you mean stop_detector_node?)",
        ),
        (["--remap", "/imu"], "is not OLD:=NEW"),
        (["--remap", "/imu/dat:=/imu/data_raw"], "did you mean /imu/data_raw?"),
        (["--remap", "/imu/data_raw:=/other"], "add --remap /truth/imu:=/imu/data_raw"),
        (["--remap", "/truth/odometry:=/gnss/fix"], "is nav_msgs/msg/Odometry; /gnss/fix must be"),
        (["--param", "alignment.duration:=100"], "ended while coarse: alignment had "),
    ],
)
def test_errors_are_one_line(
    drive: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], output: str
) -> None:
    assert main([str(drive), "-o", str(tmp_path / "out"), *arguments]) == 1
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("ins_process: ")]
    assert len(lines) == 1 and output in lines[0]


def test_damaged_recording_is_used_as_far_as_it_goes(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = next(drive.glob("*.mcap"))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    out = tmp_path / "out"
    assert main([str(cut), "-o", str(out), *START]) == 1
    captured = capsys.readouterr()
    assert "is damaged, all readable messages have been read" in captured.err
    assert len(series(out, "odometry")) > 1000


_SIGNALLED = """
import signal, sys
from ins_nav.cli.process import main
from ins_nav.recordings.bags import BagWriter

class Signalled(BagWriter):
    count = 0

    def write_raw(self, *arguments):
        self.count += 1
        if self.count == 3000:
            for number in {0}:
                signal.raise_signal(number)
        super().write_raw(*arguments)

main.__wrapped__.__globals__["BagWriter"] = Signalled
for number in {0}:  # a process started in the background inherits them as ignored
    signal.signal(number, signal.SIG_DFL)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("numbers", "code"),
    [((signal.SIGTERM,), 143), ((signal.SIGINT, signal.SIGTERM), 130), ((signal.SIGHUP, signal.SIGHUP), 129)],
)
def test_a_signal_ends_the_bag_in_order(drive: Path, tmp_path: Path, numbers: tuple[int, ...], code: int) -> None:
    """A process that gets signals before the 3000th message."""
    out = tmp_path / "out"
    script = _SIGNALLED.format([int(number) for number in numbers])
    command = [sys.executable, "-c", script, str(drive), "-o", str(out), *START]
    ended = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=120)
    assert ended.returncode == code, ended.stderr
    assert ended.stderr.splitlines()[-1] == f"ins_process: interrupted; {out} ends there"
    assert (out / "metadata.yaml").exists()
    with BagReader(out) as reader:
        assert not reader.damage
        assert len(list(reader.messages())) == sum(topic.count for topic in reader.topics.values()) == 3000


def test_no_position_is_reported(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    simulation = simulate("static", 1, duration=8.0, rate=50.0, **{"imu.preset": "perfect"})
    with BagWriter(bag) as writer:
        for stamp, w, f in zip(
            simulation.stamps_ns.tolist(), simulation.angular_velocity, simulation.linear_acceleration, strict=True
        ):
            sample = message("sensor_msgs/msg/Imu")
            sample.header.stamp.sec, sample.header.stamp.nanosec = divmod(stamp, 10**9)
            sample.angular_velocity.x, sample.angular_velocity.y, sample.angular_velocity.z = w
            sample.linear_acceleration.x, sample.linear_acceleration.y, sample.linear_acceleration.z = f
            writer.write("imu/data_raw", "sensor_msgs/msg/Imu", sample, stamp)
    assert main([str(bag), "-o", str(tmp_path / "out"), "--param", "alignment.duration:=5"]) == 1
    output = capfd.readouterr().err
    assert "alignment has its data but no position" in output and "the bag has no valid gnss/fix" in output


def test_recording_is_never_overwritten_by_its_result(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(drive.iterdir())
    assert main([str(drive), "-o", str(drive), "--overwrite", *START]) == 1
    assert "is where the recording itself is" in capsys.readouterr().err
    assert sorted(drive.iterdir()) == before


def test_stops_services_and_the_restart_of_a_loop(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Stands for 20 s, turns for 10 s, stands for 20 s; the first time it ends in the turn and restarts."""
    stops = {"first_stop": 20.0, "turn_time": 10.0, "second_stop": 20.0, "duration": 50.0, "truth.rate": 1.0}
    once, looped, out = (tmp_path / name for name in ("once", "looped", "out"))
    write_bag(simulate("zupt1_two_positions", 3, rate=50.0, **stops), once)
    with BagReader(once) as reader, BagWriter(looped) as writer:
        pieces = ((0, reader.start_ns + 25 * 10**9), (25 * 10**9, reader.end_ns))
        for shift_ns, end_ns in pieces:
            for raw in reader.messages(["/imu/data_raw", "/gnss/fix"]):
                if raw.stamp_ns <= end_ns:
                    writer.write_raw(raw.topic, raw.msgtype, raw.data, raw.stamp_ns + shift_ns)
    settings = ("initial.heading_deg:=45", "alignment.level_duration:=5", "stop_detector.zupt1_after:=15")
    two = ("--nodes", "ins_node", "stop_detector_node")
    assert main([str(looped), "-o", str(out), *two, *(word for text in settings for word in ("--param", text))]) == 0
    output = [line for line in capfd.readouterr().err.splitlines() if line.startswith(("[info] zupt", "[warn"))]
    kept, found = "[info] zupt1: position 1 recorded", "[info] zupt1: gyro drifts in °/h"
    events = [next((text for text in (kept, "starting again", found) if text in line), line) for line in output]
    assert events == [kept, "starting again", kept, found]
    with BagReader(out) as reader:
        assert reader.topics["/stopped"].latched
        stopped = [reader.deserialize(raw).data for raw in reader.messages(["stopped"])]
    assert stopped == [False, True, True, False, False, True]  # by stamp: both rounds
