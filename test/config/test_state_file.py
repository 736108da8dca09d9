"""The state file: saved values are read, damage is reported."""

import math
from pathlib import Path

import pytest
from navigators import Ins

from ins_nav.aiding.parameters import configuration
from ins_nav.aiding.registry import calibration_names
from ins_nav.aiding.velocity_log import LogParameters, VelocityLog
from ins_nav.cli.process import main as process
from ins_nav.config.parameters import Value, read_file
from ins_nav.config.state_file import Pose, StateFileError, load, save
from ins_nav.navigator.front_end import Phase
from ins_nav.simulation.recording import write_bag
from ins_nav.simulation.scenarios import Simulation, simulate

LOG, NAMES = VelocityLog(LogParameters()), calibration_names()
POSE = Pose(55.7, 37.6, 150.5, 123.4, 2.5, 1_700_000_000.25)
BIASES: dict[str, Value] = {"imu.gyro_bias_deg_per_hour": [0.1, -0.2, 0.3], "imu.accel_bias_mg": [0.01, 0.02, -0.03]}


def test_saved_values_are_loaded(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    log = LOG.calibration([(0.01, 1e-4), (0.002, 1e-3), (-0.003, 2e-3), (0.2, 0.1)])
    assert log["log.yaw_deg"] == pytest.approx(math.degrees(-0.003))
    assert log["log.misalignment_stddev_deg"] == pytest.approx(math.degrees(2e-3))
    for parameters in (BIASES, BIASES | log):
        save(path, parameters, POSE)
        assert load(path, configuration(), NAMES) == (parameters, POSE)
        assert list(tmp_path.iterdir()) == [path]
    # a parameter file as any other
    assert read_file(path)["imu.gyro_bias_deg_per_hour"] == [0.1, -0.2, 0.3]
    assert "2023-11-14T22:13:20" in path.read_text()


def test_nowhere_to_write(tmp_path: Path) -> None:
    with pytest.raises(StateFileError, match=r"state_file .*/absent/state\.yaml: No such file or directory"):
        save(tmp_path / "absent" / "state.yaml", BIASES, POSE)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("ros__parameters", "parameters", "no ros__parameters under"),
        ("latitude_deg: 55.7", "latitude: 55.7", "no last_pose.latitude_deg"),
        ("latitude_deg: 55.7", "latitude_deg: 155.7", "last_pose has an invalid value"),
        ("height: 150.5", "height: .nan", "last_pose has an invalid value"),
        ("height: 150.5", "height: high", "could not convert string to float"),
        ("accel_bias_mg", "accel_bais_mg", "did you mean imu.accel_bias_mg?"),
        ("accel_bias_mg:\n    - 0.01\n    - 0.02\n    - -0.03", "max_gap: 3.0", "imu.max_gap does not belong"),
        ("- 0.1\n", "- much\n", "'much' is not a number"),
        ("imu:", "imu: [", "is not YAML"),
        ("stamp: 1700000000.25", "stamp: 1.0e+300", "timestamp"),
    ],
)
def test_damaged(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "state.yaml"
    save(path, BIASES, POSE)
    content = path.read_text().replace("      ", "    ")
    if "max_gap" in new:
        content = path.read_text()
        start, end = content.index("accel_bias_mg"), content.index("    last_pose")
        content = content[:start] + new + "\n" + content[end:]
    else:
        content = path.read_text()
        assert old in content
        content = content.replace(old, new)
    path.write_text(content)
    with pytest.raises(StateFileError) as caught:
        load(path, configuration(), NAMES)
    assert str(caught.value).startswith(f"state_file {path}: ") and text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_absent(tmp_path: Path) -> None:
    with pytest.raises(StateFileError, match="No such file"):
        load(tmp_path / "state.yaml", configuration(), NAMES)


def _stands() -> Simulation:
    return simulate("static", 1, rate=50.0, duration=4.0, **{"imu.preset": "perfect"})


def _fed(simulation: Simulation, **parameters: object) -> Ins:
    settings = {"initial.heading_deg": 0.0, "alignment.level_duration": 2.0}
    navigator = Ins(settings | {name.replace("__", "."): value for name, value in parameters.items()})
    for stamp_ns, rate, force in zip(
        simulation.stamps_ns.tolist(),
        simulation.angular_velocity.tolist(),
        simulation.linear_acceleration.tolist(),
        strict=True,
    ):
        navigator.add_imu(stamp_ns, *rate, *force)
    return navigator


def test_a_start_reads_the_saved_values(tmp_path: Path) -> None:
    path, simulation = tmp_path / "state.yaml", _stands()
    place = {f"initial__{name}": simulation.parameters[key] for name, key in (("height", "height"),)}
    place |= {"initial__latitude_deg": simulation.parameters["lat_deg"]}
    place |= {"initial__longitude_deg": simulation.parameters["lon_deg"]}
    first = _fed(simulation, state_file=str(path), **place)
    assert next(report.text for report in first.events.drain()) == (
        f"state_file {path} does not exist yet: ins_node/save writes it"
    )
    realtime = first.realtime
    realtime._compensate((1e-6, 0.0, 0.0), realtime.accel_bias, ())
    first.calibration = LOG.calibration([(0.01, 1e-4), (0.0, 1e-3), (0.0, 1e-3)])
    done, text = first.save()
    assert done and text == (
        "imu.gyro_bias_deg_per_hour, imu.accel_bias_mg, log.scale, log.scale_stddev, log.pitch_deg, log.yaw_deg, "
        f"log.misalignment_stddev_deg and the pose written to {path}"
    )
    second = _fed(simulation, state_file=str(path))
    assert second.gyro_bias[0] == pytest.approx(1e-6) and second.configuration.values["log.scale"] == 0.01
    assert second.calibration == first.calibration  # to be saved again
    # no position by parameters or fixes: the saved one
    assert second.phase is Phase.NAVIGATING and second.covariance is not None
    assert 10.0 <= math.sqrt(second.covariance[0, 0]) < 10.5
    reports = [report.text for report in second.events.drain()]
    assert (
        reports[0].startswith(f"state_file {path}: imu.gyro_bias_deg_per_hour, ") and "read, saved 2023-" in reports[0]
    )
    assert "no gnss/fix by the end of alignment: the position in state_file is used" in reports


def test_a_damaged_file_is_reported_and_not_used(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    path.write_text("/**: nothing")
    navigator = _fed(_stands(), state_file=str(path))
    assert navigator.gyro_bias == (0.0, 0.0, 0.0) and navigator.phase is Phase.COARSE
    text = navigator.events.drain()[0].text
    assert text.startswith(f"state_file {path}: ") and text.endswith("the file is not used; save again, or remove it")


def test_nothing_to_save(tmp_path: Path) -> None:
    assert Ins().save() == (False, "no state_file: start the node with a name for it")
    waiting = Ins({"state_file": str(tmp_path / "state.yaml")})
    assert waiting.save() == (False, "no navigation solution yet: waiting; call again when navigating")


def test_ins_process_saves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag(_stands(), tmp_path / "bag")
    arguments = [str(tmp_path / "bag"), "-o", str(tmp_path / "out"), "--param", "alignment.duration:=5", "--save"]
    short = ["--param", "initial.heading_deg:=0", "--param", "alignment.level_duration:=2"]
    assert process([*arguments, *short]) == 1
    assert "ins_process: --save: where to? Add --param state_file:=FILE" in capsys.readouterr().err
    path = tmp_path / "state.yaml"
    assert process([*arguments, *short, "--overwrite", "--param", f"state_file:={path}"]) == 0
    kept, pose = load(path, configuration(), NAMES)
    assert set(kept) == {"imu.gyro_bias_deg_per_hour", "imu.accel_bias_mg"} and pose.latitude_deg > 0.0
