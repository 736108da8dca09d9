"""Stops over real DDS: services refuse and calibrate, the detector calls them, in separate processes and in one."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_harness import Listener, Process, Ros, needs_ros
from scipy.spatial.transform import Rotation

from ins_nav.cli.process import main as process
from ins_nav.recordings.bags import BagReader
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import START_NS, simulate
from ins_nav.stamps import stamp_of

pytestmark = needs_ros

IMU, ODOMETRY, BOOL = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "std_msgs/msg/Bool"
LIVE = {"odometry": ODOMETRY, "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
LATCHED = {"imu/bias": IMU, "stopped": BOOL}
SETTINGS = ("alignment.duration:=30", "stop_detector.zupt1_after:=10")
"""Calls: while it aligns two, zupt1 at 40 s of the first stop, at 10 s of the second, then zupt2 at 20 s."""
DRIFT = math.degrees(1e-7) * 3600.0
"""deg/h, of zupt1_two_positions: minus, minus, plus."""
DRIFTS = [-DRIFT, -DRIFT, DRIFT]
RATE = 8.0
LEAVES = 115.0
"""s: end of the second stop of the bag `chain`."""


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stands for 50 s, turns by 180° in 20 s, stands for 45 s, drives for 9 s; drifts, no noise; 50 Hz."""
    path = tmp_path_factory.mktemp("chain") / "bag"
    stops = {"first_stop": 50.0, "second_stop": 45.0, "duration": LEAVES + 9.0}
    write_bag(simulate("zupt1_two_positions", 3, rate=50.0, **stops, **{"truth.rate": 1.0}), path)
    return path


def parameters(*assignments: str) -> tuple[str, ...]:
    return ("--ros-args", *(part for assignment in assignments for part in ("-p", assignment)))


def start(ros: Ros, name: str, *arguments: str) -> Process:
    node = ros.start(f"ins_nav.nodes.{name}", *arguments)
    node.wait_for_output("waiting for imu/data_raw")
    return node


def seconds(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def bias(message: Any) -> list[float]:
    """Of the gyros, deg/h."""
    rate = message.angular_velocity
    return [math.degrees(x) * 3600.0 for x in (rate.x, rate.y, rate.z)]


def last_stamp(listener: Listener, topic: str = "odometry") -> float:
    received = listener.messages(topic)
    return seconds(received[-1].message) if received else 0.0


def test_every_refusal_says_what_to_do(tmp_path: Path) -> None:
    """A person calls at the wrong moment; the solution goes on."""
    stops = {"first_stop": 20.0, "turn_time": 10.0, "second_stop": 30.0, "duration": 60.0}
    simulation = simulate("zupt1_two_positions", 3, rate=50.0, **stops)
    simulation.angular_velocity[50 * 25 :, 0] += math.radians(5.0) / 3600.0  # in the turn the x gyro changes by 5 deg/h
    stands, rocks = tmp_path / "stands", tmp_path / "rocks"
    write_bag(simulation, stands)
    amplitudes = {"roll_amplitude_deg": 0.5, "pitch_amplitude_deg": 0.5, "imu.preset": "perfect"}
    write_bag(simulate("rocking", 3, rate=50.0, duration=30.0, heading_deg=45.0, **amplitudes), rocks)
    settings = ("initial.heading_deg:=45", "alignment.level_duration:=5", "zupt.max_rocking_deg:=0.2")
    with Ros(tmp_path) as ros:
        listener = ros.listen(LIVE)
        latched = ros.listen(LATCHED, latched=True)
        ins = start(ros, "ins_node", *parameters(*settings))
        feeder = ros.start(Path(__file__).parents[1] / "bag_feeder.py")
        listener.wait_for_count("/diagnostics", 1)

        def feed(bag: Path, begin: float, end: float) -> None:
            feeder.send(f"{bag} {begin} {end}")
            feeder.wait_for_output(f"fed {bag} {end}")

        def refused(service: str, sentence: str) -> None:
            success, text = listener.call(f"ins_node/{service}")
            assert not success and sentence in text, text

        refused("zupt1", "no navigation solution yet: waiting, 0 % of alignment done; call again when navigating")
        feed(stands, 0.0, 3.0)
        listener.wait_for(lambda: listener.status("ins_node").get("alignment progress") == "60 %")
        refused("zupt2", "no navigation solution yet: coarse, 60 % of alignment done; call again when navigating")
        feed(stands, 3.0, 18.0)
        listener.wait_for(lambda: last_stamp(listener) >= 17.99)
        success, text = listener.call("ins_node/zupt1")
        assert success and text.startswith("position 1 recorded after 16 s at rest"), text
        refused(
            "zupt1", "no turn between the positions: yaw differs by 0.0°, at least 20° are needed; turn the vehicle"
        )
        feed(stands, 18.0, 25.0)
        listener.wait_for(lambda: last_stamp(listener) >= 24.99)
        for service in ("zupt1", "zupt2"):
            refused(service, "moving for 4.")
            refused(service, "stand still until stopped is true")
        feed(stands, 25.0, 34.0)
        listener.wait_for(lambda: last_stamp(listener) >= 33.99)
        for service in ("zupt1", "zupt2"):
            refused(service, "stop too short: 4.")
            refused(service, "at least 8.3 s are needed; stand still and call again")
        feed(stands, 34.0, 50.0)
        listener.wait_for(lambda: last_stamp(listener) >= 49.99)
        success, text = listener.call("ins_node/zupt1")
        assert not success and text.startswith("inconsistent: no drift and azimuth explain both stops"), text
        assert "its drift changed between them; this is position 1 now" in text
        # the filter has found the drifts that changed between the stops meanwhile, and no sample is missing
        biases = [bias(received.message) for received in latched.messages("imu/bias")]
        assert biases[:2] == [[0.0] * 3] * 2 and np.abs(biases).max() < 1.1 * np.abs(DRIFTS).max()
        stamps = [stamp_of(received.message) for received in listener.messages("odometry")]
        assert set(np.diff(stamps)) == {20_000_000} and stamps[0] <= START_NS + 5.1e9
        feed(rocks, 0.0, 30.0)  # the stamps jump back: it starts again
        listener.wait_for(lambda: 29.99 <= last_stamp(listener) < 30.01)
        for service in ("zupt1", "zupt2"):
            refused(service, "rocking too much: 0.")
            refused(service, "zupt.max_rocking_deg is 0.2; wait until the vehicle is calmer and call again")
        assert np.isfinite(listener.messages("odometry")[-1].message.pose.pose.position.x)
        assert "zupt1 refused: inconsistent" in ins.stdout + ins.stderr
        assert ins.stop() == 0 and "Traceback" not in ins.stderr


@dataclass(frozen=True)
class Outcome:
    """What nodes or `ins_process` have published over the bag `chain`."""

    odometry: dict[int, Any]
    biases: list[Any]
    stopped: list[bool]
    status: dict[str, str]
    late: list[Any]
    """What a subscriber received that came after all."""


def by_stamp(messages: list[Any]) -> dict[int, Any]:
    return {stamp_of(message): message for message in messages}


def offline(bag: Path, out: Path, *arguments: str) -> Outcome:
    settings = (word for assignment in SETTINGS for word in ("--param", assignment))
    assert process([str(bag), "-o", str(out), *settings, *arguments]) == 0
    found: dict[str, list[Any]] = {"/odometry": [], "/imu/bias": [], "/stopped": []}
    with BagReader(out) as reader:
        for raw in reader.messages(list(found)):
            found[raw.topic].append(reader.deserialize(raw))
    return Outcome(by_stamp(found["/odometry"]), found["/imu/bias"], [m.data for m in found["/stopped"]], {}, [])


@pytest.fixture(scope="module")
def batch(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Outcome]:
    folder = tmp_path_factory.mktemp("batch")
    two = ("--nodes", "ins_node", "stop_detector_node")
    return {"processes": offline(chain, folder / "two", *two), "ins_system": offline(chain, folder / "all")}


@pytest.fixture(scope="module")
def live(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Outcome]:
    """One play of the bag, received by nodes in separate processes, and by `ins_system` in the namespace ``one``."""
    with Ros(tmp_path_factory.mktemp("live")) as ros:
        spaces = ("", "one/")
        listener = ros.listen({f"{space}odometry": ODOMETRY for space in spaces} | LIVE)
        latched = ros.listen({space + topic: kind for space in spaces for topic, kind in LATCHED.items()}, latched=True)
        settings = parameters(*SETTINGS)
        inputs = ("-r", "imu/data_raw:=/imu/data_raw", "-r", "gnss/fix:=/gnss/fix")
        nodes = [
            start(ros, "ins_node", *settings),
            start(ros, "stop_detector_node", *settings),
            start(ros, "ins_system", *settings, *inputs, "-r", "__ns:=/one"),
        ]
        for space in spaces:
            ready = status(listener, f"{space}stop_detector_node")
            listener.wait_for(lambda ready=ready: ready().get("services") == "zupt1, zupt2")
            listener.wait_for(lambda space=space: listener.status(f"{space}ins_node"))
        player = play(ros, chain)
        assert player.wait(60.0) == 0
        with BagReader(chain) as reader:
            samples = str(reader.topics["/imu/data_raw"].count)
        outcomes = {}
        for space in spaces:
            ins, detector = (status(listener, f"{space}{name}") for name in ("ins_node", "stop_detector_node"))
            listener.wait_for(lambda ins=ins: ins().get("imu/data_raw integrated") == samples)
            listener.wait_for(lambda detector=detector: detector().get("imu/data_raw used") == samples)
            late = ros.listen({f"{space}imu/bias": IMU, f"{space}stopped": BOOL}, latched=True)
            late.wait_for(lambda late=late, space=space: all(late.messages(space + topic) for topic in LATCHED))
            outcomes[space] = Outcome(
                by_stamp([received.message for received in listener.messages(f"{space}odometry")]),
                [received.message for received in latched.messages(f"{space}imu/bias")],
                [received.message.data for received in latched.messages(f"{space}stopped")],
                ins() | detector(),
                [late.messages(space + topic)[-1].message for topic in LATCHED],
            )
        for node in nodes:
            assert node.stop() == 0 and "Traceback" not in node.stderr
    return {"processes": outcomes[""], "ins_system": outcomes["one/"]}


def status(listener: Listener, node: str) -> Callable[[], dict[str, str]]:
    return lambda: listener.status(node)


def play(ros: Ros, bag: Path) -> Process:
    topics = ("--topics", "/imu/data_raw", "/gnss/fix")
    return ros.start("ins_nav.nodes.bag_player", bag, "--no-progress", "--rate", RATE, *topics)


def test_detector_has_the_node_calibrate_itself(live: dict[str, Outcome]) -> None:
    outcome = live["processes"]
    assert outcome.stopped == [False, True, False, True, False]
    # at first and aligned: none; then ZUPT-1 at 10 s of the second stop, ZUPT-2 at 20 s and 40 s
    assert [bias(message) for message in outcome.biases[:2]] == [[0.0] * 3] * 2
    assert len(outcome.biases) > 5, outcome.status  # and with every correction at the stops
    latched, stopped = outcome.late
    assert stamp_of(latched) == stamp_of(outcome.biases[-1]) and stopped.data is False
    # 40 s of rest without noise: floor of the blocks' trend
    assert bias(latched) == pytest.approx(DRIFTS, abs=1e-3)
    covariance = np.asarray(latched.angular_velocity_covariance).reshape(3, 3)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    sigma = np.degrees(np.sqrt(np.diag(covariance))) * 3600.0
    assert (sigma < 0.1 * 0.01).all()  # of what was known before, 0.01 deg/h
    assert outcome.status["ZUPT calibrations"] == "3" and outcome.status["stops"] == "2"
    assert outcome.status["last answer"].startswith("zupt2 done: gyro drifts in °/h: x -0.02")
    assert "samples lost" not in outcome.status


def test_filter_has_the_stops_to_itself(live: dict[str, Outcome]) -> None:
    """With `alignment_node`, too, the detector calls and is answered; the filter's own updates correct."""
    outcome = live["ins_system"]
    assert outcome.stopped == [False, True, False, True, False]
    assert outcome.status["stops"] == "2" and outcome.status["ZUPT calibrations"] == "3"
    assert outcome.status["last answer"].startswith("zupt2 done: gyro drifts in °/h: x -0.02")
    covariance = np.asarray(outcome.biases[-1].angular_velocity_covariance).reshape(3, 3)
    sigma = np.degrees(np.sqrt(np.diag(covariance))) * 3600.0
    error = np.abs(np.subtract(bias(outcome.biases[-1]), DRIFTS))
    assert (error < 3.0 * sigma).all() and sigma[2] < 0.003  # the vertical one shows at once


@pytest.mark.parametrize("how", ["processes", "ins_system"])
def test_live_equals_ins_process(how: str, live: dict[str, Outcome], batch: dict[str, Outcome]) -> None:
    outcome, alone = live[how], batch[how]
    assert outcome.stopped == alone.stopped
    # a call that comes later by its latency, here eight times that, measures the same blocks, or one more
    assert bias(outcome.biases[-1]) == pytest.approx(bias(alone.biases[-1]), abs=1e-4)
    common = sorted(outcome.odometry.keys() & alone.odometry.keys())
    assert common[-1] == max(alone.odometry)
    for i in (-1, -2, -5, np.searchsorted(common, START_NS + round(LEAVES * 1e9)) - 1):
        found, wanted = (of.odometry[common[i]].pose.pose for of in (outcome, alone))
        # what is asked, in the stop and after the drive; without noise 0.02 mm for a call that comes 50 ms later
        assert math.hypot(found.position.x - wanted.position.x, found.position.y - wanted.position.y) < 1e-3
        q, p = (Rotation.from_quat([o.x, o.y, o.z, o.w]) for o in (found.orientation, wanted.orientation))
        assert math.degrees((q * p.inv()).magnitude()) < 1e-4


def test_without_the_detector_nobody_calls(chain: Path, batch: dict[str, Outcome], tmp_path: Path) -> None:
    assert bias(batch["processes"].biases[-1]) == pytest.approx(DRIFTS, abs=1e-3)
    alone = offline(chain, tmp_path / "alone", "--nodes", "ins_node")
    # zero velocity alone shows the horizontal drifts to the scatter of its sway
    sigma = np.degrees(np.sqrt(np.asarray(alone.biases[-1].angular_velocity_covariance)[::4])) * 3600.0
    assert (np.abs(np.subtract(bias(alone.biases[-1]), DRIFTS)) < 3.0 * sigma).all()
    assert alone.stopped == []


def test_killed_detector_is_started_again(chain: Path, tmp_path: Path) -> None:
    """By SIGKILL, in a stop and in a turn; `ins_node` does not notice, the new one finds its bearings."""
    settings = parameters("alignment.duration:=10", "stop_detector.zupt1_after:=15", "stop_detector.zupt2_after:=15")
    with Ros(tmp_path) as ros:
        listener = ros.listen(LIVE)
        latched = ros.listen(LATCHED, latched=True)
        ins = start(ros, "ins_node", *settings)
        detector = start(ros, "stop_detector_node", *settings)
        ready = status(listener, "stop_detector_node")
        listener.wait_for(lambda: ready().get("services") == "zupt1, zupt2")
        player = play(ros, chain)

        def start_again(detector: Process) -> Process:
            """While the player is paused."""
            assert listener.call("bag_player/pause") == (True, "paused")
            detector.kill()
            count = len(latched.messages("stopped"))
            new = start(ros, "stop_detector_node", *settings)
            latched.wait_for_count("stopped", count + 1)
            # of the new one: it has received nothing yet
            listener.wait_for(lambda: ready().get("imu/data_raw received") == "0")
            listener.wait_for(lambda: ready().get("services") == "zupt1, zupt2")
            assert listener.call("bag_player/resume") == (True, "playing")
            return new

        detector.wait_for_output("zupt1 done: position 1 recorded after ")
        detector = start_again(detector)
        detector.wait_for_output("stopped, .* s ago")
        # the same stop: position 1 is that of ins_node, which knows it still
        detector.wait_for_output(r"zupt1 refused: .*no turn between the positions[^\0]*zupt2 done: ")
        detector.wait_for_output("moving, since")
        detector = start_again(detector)
        detector.wait_for_output(r"stopped, .* s ago[^\0]*zupt1 done: gyro drifts in °/h")
        assert player.wait(60.0) == 0
        with BagReader(chain) as reader:
            samples = str(reader.topics["/imu/data_raw"].count)
        listener.wait_for(lambda: listener.status("ins_node").get("imu/data_raw integrated") == samples)
        assert "samples lost" not in listener.status("ins_node")
        assert bias(latched.messages("imu/bias")[-1].message) == pytest.approx(DRIFTS, abs=1e-3)
        stamps = np.array([stamp_of(received.message) for received in listener.messages("odometry")])
        assert set(np.diff(stamps)) == {20_000_000}
        wanted = [False, True, False, True, False, False, True, False]
        assert [received.message.data for received in latched.messages("stopped")] == wanted
        assert ins.stop() == 0 and detector.stop() == 0
    with BagReader(chain) as reader:
        truth = by_stamp([reader.deserialize(raw) for raw in reader.messages(["/truth/odometry"])])
    solution = by_stamp([received.message for received in listener.messages("odometry")])
    last = max(truth.keys() & solution.keys())
    found, true = (of[last].pose.pose.position for of in (solution, truth))
    # heading to 0.1° over a turn of 30 m before it was calibrated, velocity to 5 mm/s for 9 s
    assert math.hypot(found.x - true.x, found.y - true.y) < 0.2
