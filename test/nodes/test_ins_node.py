"""`ins_node` over real DDS, in a separate process, fed by `bag_player`."""

import math
from pathlib import Path

import numpy as np
import pytest
from ros_harness import Listener, Process, Ros, needs_ros
from scipy.spatial.transform import Rotation

from ins_nav.cli.process import main as process
from ins_nav.recordings.bags import BagReader, BagWriter, RawMessage, typestore
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate
from ins_nav.stamps import stamp_of

pytestmark = needs_ros

IMU, FIX, ODOMETRY = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
OUTPUTS = {"odometry": ODOMETRY, "imu/data": IMU, "fix": FIX, "/diagnostics": DIAGNOSTICS}
DURATION = "alignment.duration:=10.0"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 s standing, 18 s driving, navigation-grade sensors at 200 Hz."""
    path = tmp_path_factory.mktemp("drive") / "bag"
    write_bag(simulate("vehicle", 2, duration=30.0, stand_time=12.0, heading_deg=30.0, **{"truth.rate": 1.0}), path)
    return path


def node(ros: Ros, *parameters: str, extra: tuple[str, ...] = ()) -> Process:
    settings = [part for parameter in parameters for part in ("-p", parameter)]
    process = ros.start("ins_nav.nodes.ins_node", "--ros-args", *settings, *extra)
    process.wait_for_output("waiting for imu/data_raw")
    return process


def node_and_listener(ros: Ros, *parameters: str) -> tuple[Process, Listener]:
    """A node, and a listener that has discovered it: discovery can last longer than a short bag."""
    listener = ros.listen(OUTPUTS)
    process = node(ros, *parameters)
    listener.wait_for_count("/diagnostics", 1)
    return process, listener


def play(ros: Ros, bag: Path, *arguments: str) -> None:
    player = ros.start(
        "ins_nav.nodes.bag_player", bag, "--no-progress", "--topics", "/imu/data_raw", "/gnss/fix", *arguments
    )
    assert player.wait(60.0) == 0


def raw_messages(bag: Path) -> list[RawMessage]:
    with BagReader(bag) as reader:
        return list(reader.messages(["/imu/data_raw", "/gnss/fix"]))


def rewritten(path: Path, messages: list[RawMessage]) -> Path:
    with BagWriter(path) as writer:
        for raw in messages:
            writer.write_raw(raw.topic, raw.msgtype, raw.data, raw.stamp_ns)
    return path


def last_values(listener: Listener) -> dict[str, str]:
    received = listener.messages("/diagnostics")
    return {item.key: item.value for item in received[-1].message.status[0].values} if received else {}


def by_stamp(listener: Listener, topic: str) -> dict[int, object]:
    return {stamp_of(received.message): received.message for received in listener.messages(topic)}


def test_live_equals_ins_process(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert process([str(drive), "-o", str(out), "--nodes", "ins_node", "--param", DURATION]) == 0
    offline: dict[str, dict[int, object]] = {"/odometry": {}, "/imu/data": {}, "/fix": {}}
    with BagReader(out) as reader:
        for raw in reader.messages(list(offline)):
            content = reader.deserialize(raw)
            offline[raw.topic][stamp_of(content)] = content
    with Ros(tmp_path) as ros:
        ins, listener = node_and_listener(ros, DURATION)
        play(ros, drive, "--rate", "5")
        listener.wait_for_count("odometry", len(offline["/odometry"]))
        assert ins.stop() == 0
        listener.stop()
        assert "aligned in 10.0 s: heading" in ins.stdout + ins.stderr
        live = {topic: by_stamp(listener, topic) for topic in offline}
        assert all(len(listener.messages(topic)) == len(live[topic]) for topic in live)
    for topic in offline:
        assert live[topic].keys() == offline[topic].keys()  # every sample once, none lost
    for stamp, expected in offline["/odometry"].items():
        # the same core on the same numbers: what is asked is 1 mm and 1e-4 deg
        pose, expected_pose = live["/odometry"][stamp].pose.pose, expected.pose.pose
        assert abs(pose.position.x - expected_pose.position.x) < 1e-3
        assert abs(pose.position.y - expected_pose.position.y) < 1e-3
        q, expected_q = (
            Rotation.from_quat([o.x, o.y, o.z, o.w]) for o in (pose.orientation, expected_pose.orientation)
        )
        assert math.degrees((q * expected_q.inv()).magnitude()) < 1e-4
    last = max(offline["/fix"])
    assert live["/fix"][last].latitude == pytest.approx(offline["/fix"][last].latitude, abs=1e-9)


def test_bad_samples_are_named_counted_and_survived(drive: Path, tmp_path: Path) -> None:
    """A NaN, a repeated stamp, a stamp that goes back, a zero stamp and a 2 s gap, all while navigating."""
    messages = raw_messages(drive)
    imu = [i for i, raw in enumerate(messages) if raw.topic == "/imu/data_raw"]
    start = 2400  # s 12: still standing
    with BagReader(drive) as reader:
        sample = reader.deserialize(messages[imu[start]])
        sample.angular_velocity.y = float("nan")
        nan = bytes(typestore().serialize_cdr(sample, IMU))
        sample.angular_velocity.y = 0.0
        sample.header.stamp.sec = sample.header.stamp.nanosec = 0
        unstamped = bytes(typestore().serialize_cdr(sample, IMU))
    edited = list(messages)
    edited[imu[start]] = edited[imu[start]]._replace(data=nan)
    edited[imu[start + 50]] = edited[imu[start + 50]]._replace(data=edited[imu[start + 49]].data)
    edited[imu[start + 100]] = edited[imu[start + 100]]._replace(data=edited[imu[start + 90]].data)
    edited[imu[start + 150]] = edited[imu[start + 150]]._replace(data=unstamped)
    edited = [raw for i, raw in enumerate(edited) if not imu[start + 200] <= i <= imu[start + 600]]
    bag = rewritten(tmp_path / "bad", edited)
    with Ros(tmp_path) as ros:
        ins, listener = node_and_listener(ros, DURATION)
        play(ros, bag, "--rate", "5")
        listener.wait_for(lambda: last_values(listener).get("imu/data_raw received") == str(len(imu) - 401))
        values = last_values(listener)
        assert ins.stop() == 0
        output = ins.stdout + ins.stderr
    assert "imu/data_raw: angular_velocity.y is nan, sample rejected" in output
    assert "repeated, sample rejected: is the topic published twice?" in output
    assert "stamp goes back by 0.045000 s, sample rejected" in output
    assert "header.stamp is 0 ns, sample rejected: the driver must stamp" in output
    assert "gap of 2.010 s, about 401 samples lost, bridged" in output
    # each rejected sample leaves a gap of one interval; 401 samples were removed
    expected = {"not finite": 1, "repeated stamps": 1, "backward stamps": 1, "zero stamps": 1}
    assert {kind: int(values[kind]) for kind in expected} == expected
    assert int(values["samples lost"]) == 401 + 4
    odometry = listener.messages("odometry")[-1].message
    assert np.isfinite([odometry.pose.pose.position.x, odometry.pose.pose.orientation.w]).all()


def test_looped_bag_starts_again(drive: Path, tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        ins, listener = node_and_listener(ros, DURATION)
        player = ros.start("ins_nav.nodes.bag_player", drive, "--no-progress", "--rate", "10", "--loop")
        ins.wait_for_output(r"stamps jumped by -\d+\.\d+ s \(back\): starting again[^\0]*aligned in 10.0 s", 60.0)
        count = len(listener.messages("odometry"))
        listener.wait_for_count("odometry", count + 100)
        assert player.stop() == 0
        assert ins.stop() == 0
        listener.stop()
    stamps = np.array([stamp_of(received.message) for received in listener.messages("odometry")])
    back = np.flatnonzero(np.diff(stamps) < 0)
    assert len(back) >= 1  # more when the player was stopped late
    # each start is as clean as the first: the same samples give the same solution (to the rounding of BLAS)
    first, *again = (listener.messages("odometry")[i].message for i in (0, *(back + 1)))
    for start in again:
        assert stamp_of(first) == stamp_of(start)
        assert start.pose.pose.orientation.z == pytest.approx(first.pose.pose.orientation.z, abs=1e-8)


def test_namespace_services_bias_and_whole_numbers(drive: Path, tmp_path: Path) -> None:
    """Names follow the namespace; ``heading_deg:=30`` is good enough for a float; the bias is latched."""
    with Ros(tmp_path) as ros:
        ins = node(ros, "initial.heading_deg:=30", "imu.gyro_bias_deg_per_hour:=[1, 0, 0]", extra=("-r", "__ns:=/car"))
        player = ros.start(
            "ins_nav.nodes.bag_player", drive, "--no-progress", "--rate", "5", "--remap",
            "/imu/data_raw:=/car/imu/data_raw", "/gnss/fix:=/car/gnss/fix",
        )  # fmt: skip
        listener = ros.listen({"/car/odometry": ODOMETRY})
        listener.wait_for_count("/car/odometry", 100)
        late = ros.listen({"/car/imu/bias": IMU}, latched=True)
        late.wait_for_count("/car/imu/bias", 1)
        bias = late.messages("/car/imu/bias")[0].message
        # corrected at the stop when the subscriber comes late, by less than its sigma of 0.01
        assert math.degrees(bias.angular_velocity.x) * 3600.0 == pytest.approx(1.0, abs=0.01)
        success, text = listener.call("/car/ins_node/align")
        assert success and text == "alignment started: stand still, or rock without travelling, for 5 s"
        assert player.wait(60.0) == 0
        assert ins.stop() == 0


@pytest.mark.parametrize(
    ("parameter", "output"),
    [
        ("alignment.durration:=30.0", "unknown parameter alignment.durration: did you mean alignment.duration?"),
        ("imu.sampling:=mean", "parameter imu.sampling: 'mean' is not one of averaged, instantaneous"),
        ("alignment.duration:=true", "parameter alignment.duration: True is not a number"),
    ],
)
def test_parameter_errors_are_one_line(tmp_path: Path, parameter: str, output: str) -> None:
    with Ros(tmp_path) as ros:
        ins = ros.start("ins_nav.nodes.ins_node", "--ros-args", "-p", parameter)
        assert ins.wait() == 1
        assert [line for line in ins.stderr.splitlines() if line] == [f"ins_node: {output}"]


def test_sigterm_ends_it_cleanly(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        ins = node(ros)
        ins.terminate()
        assert ins.wait() == 0, ins.stderr


def test_help_and_arguments_that_are_not_for_ros(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        asked = ros.start("ins_nav.nodes.ins_node", "--help")
        assert asked.wait() == 0 and asked.stdout.startswith("usage: ins_node [--ros-args")
        wrong = ros.start("ins_nav.nodes.ins_node", "-p", "initial.heading_deg:=90")
        assert wrong.wait() == 1
        assert wrong.stderr.strip() == ("ins_node: unknown argument '-p': parameters and remaps come after --ros-args")


def test_transform_is_published_before_the_odometry(tmp_path: Path) -> None:
    """A look-up of the transform at the stamp of an odometry message needs no waiting."""
    place = ("initial.latitude_deg:=55.7", "initial.longitude_deg:=37.6", "initial.height:=150.0")
    given = ("publish.tf:=map_to_base_link", "initial.heading_deg:=30.0", "alignment.level_duration:=5.0", *place)
    settings = [part for parameter in given for part in ("-p", parameter)]
    with Ros(tmp_path) as ros:
        order = ros.start(Path(__file__).with_name("publication_order.py"), "--ros-args", *settings)
        assert order.wait() == 0, order.stderr
    published = [text.partition("@") for text in order.stdout.split()]
    names = ["imu/bias:base_link", "/tf:map", "odometry:map", "imu/data:base_link", "fix:base_link"]
    assert [name for name, _, _ in published] == names
    assert {stamp for _, _, stamp in published} == {"5.020000000"}  # after 250 intervals
