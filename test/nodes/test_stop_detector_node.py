"""`stop_detector_node` over real DDS, fed by `bag_player`, with services that stand in for those of `ins_node`."""

import re
from pathlib import Path

import pytest
from ros_harness import Listener, Process, Ros, needs_ros

from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import simulate

BOOL, DIAGNOSTICS = "std_msgs/msg/Bool", "diagnostic_msgs/msg/DiagnosticArray"
SERVER = Path(__file__).parents[1] / "trigger_server.py"
SOON = ("stop_detector.zupt1_after:=5", "stop_detector.zupt2_after:=5")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stands for 12 s, turns in 20 s, stands for 22 s, drives for 8 s; 50 Hz."""
    path = tmp_path_factory.mktemp("drive") / "bag"
    stops = {"first_stop": 12.0, "second_stop": 22.0, "duration": 62.0}
    write_bag(simulate("zupt1_two_positions", 2, rate=50.0, **stops, **{"truth.rate": 1.0}), path)
    return path


def node(ros: Ros, *parameters: str) -> Process:
    settings = [part for parameter in parameters for part in ("-p", parameter)]
    process = ros.start("ins_nav.nodes.stop_detector_node", "--ros-args", *settings)
    process.wait_for_output("waiting for imu/data_raw")
    return process


def server(ros: Ros, *answers: str) -> Process:
    process = ros.start(SERVER, *answers)
    process.wait_for_output("^ready$")
    return process


def play(ros: Ros, bag: Path) -> None:
    player = ros.start("ins_nav.nodes.bag_player", bag, "--no-progress", "--topics", "/imu/data_raw", "--rate", "12")
    assert player.wait(60.0) == 0


def output(process: Process) -> str:
    return process.stdout + process.stderr


def wait_for_services(ros: Ros, services: str) -> Listener:
    """Wait until the node has discovered them; a listener to diagnostics."""
    listener = ros.listen({"/diagnostics": DIAGNOSTICS})
    listener.wait_for(lambda: values(listener).get("services") == services)
    return listener


def values(listener: Listener) -> dict[str, str]:
    return listener.status("stop_detector_node")


@needs_ros
def test_stops_are_published_and_services_called(drive: Path, tmp_path: Path) -> None:
    """At 5 s of each of the first two stops zupt1, then, of 13 s and of 22 s, zupt2 at 10 s and 20 s.

    And never from a callback that waits for the answer.
    """
    with Ros(tmp_path) as ros:
        listener = ros.listen({"stopped": BOOL}, latched=True)
        services = server(ros, "ins_node/zupt1=drifts 1 2 3 deg/h", "ins_node/zupt2=drifts 4 5 6 deg/h")
        detector = node(ros, *SOON)
        diagnostics = wait_for_services(ros, "zupt1, zupt2")
        listener.wait_for_count("stopped", 1)
        play(ros, drive)
        listener.wait_for_count("stopped", 5)
        diagnostics.wait_for(lambda: "stopped" in values(diagnostics) and values(diagnostics)["stops"] == "2")
        assert [received.message.data for received in listener.messages("stopped")] == [False, True, False, True, False]
        detector.wait_for_output(r"zupt1 done: drifts 1 2 3 deg/h[^\0]*zupt1 done[^\0]*zupt2 done[^\0]*zupt2 done")
        names = ["zupt1", "zupt2", "zupt1", "zupt2", "zupt2"]
        assert re.findall("called ins_node/(.*)", services.stdout) == names
        assert values(diagnostics)["imu/data_raw used"] == values(diagnostics)["imu/data_raw received"]
        assert detector.stop() == 0
        assert services.stop() == 0


@needs_ros
def test_refusals_are_logged_and_tried_again(drive: Path, tmp_path: Path) -> None:
    """At 5 s and 10 s of the first stop, which lasts for 13 s, at 5, 10, 15 and 20 s of the second, of 22 s."""
    with Ros(tmp_path) as ros:
        services = server(ros, "ins_node/zupt2=no: the stop is too short")
        detector = node(ros, "stop_detector.start_sequence:=zupt2", *SOON)
        wait_for_services(ros, "zupt2")
        play(ros, drive)
        refusal = "zupt2 refused: no: the stop is too short"
        detector.wait_for_output(rf"(?:{refusal}[^\0]*){{6}}")
        assert services.stdout.count("called ins_node/zupt2") == 6
        assert detector.stop() == 0


@needs_ros
def test_missing_service_is_reported_once_and_tried_again(drive: Path, tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        listener = ros.listen({"stopped": BOOL}, latched=True)
        detector = node(ros, *SOON)
        listener.wait_for_count("stopped", 1)
        play(ros, drive)
        listener.wait_for_count("stopped", 5)
        missing = r"no service ins_node/zupt1: is ins_node running"
        assert len(re.findall(missing, output(detector))) == 1
        services = server(ros, "ins_node/zupt1=drifts 1 2 3 deg/h")
        wait_for_services(ros, "zupt1")
        play(ros, drive)  # the stamps jump back: everything begins again
        detector.wait_for_output(r"stamps jumped by -\d+\.\d+ s \(back\): starting again[^\0]*zupt1 done")
        listener.wait_for_count("stopped", 9)
        assert len(re.findall(missing, output(detector))) == 1
        services.terminate()
        assert services.wait() == 0
        assert detector.stop() == 0


@needs_ros
def test_parameter_errors_are_one_line(tmp_path: Path) -> None:
    with Ros(tmp_path) as ros:
        process = ros.start("ins_nav.nodes.stop_detector_node", "--ros-args", "-p", "stop.max_sped:=0.2")
        assert process.wait() == 1
        wanted = "stop_detector_node: unknown parameter stop.max_sped: did you mean stop.max_speed?"
        assert [line for line in process.stderr.splitlines() if line] == [wanted]
