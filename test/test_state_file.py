"""The file from one start to the next: what is written is read, what is damaged is told."""

import math
from pathlib import Path

import pytest

from ins_nav.parameters import Value, read_file
from ins_nav.state_file import Pose, StateFileError, load, log_calibration, save

POSE = Pose(55.7, 37.6, 150.5, 123.4, 2.5, 1_700_000_000.25)
BIASES: dict[str, Value] = {"imu.gyro_bias_deg_per_hour": [0.1, -0.2, 0.3], "imu.accel_bias_mg": [0.01, 0.02, -0.03]}


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    log = log_calibration([(0.01, 1e-4), (0.002, 1e-3), (-0.003, 2e-3), (0.2, 0.1)])
    assert log["log.yaw_deg"] == pytest.approx(math.degrees(-0.003))
    assert log["log.misalignment_stddev_deg"] == pytest.approx(math.degrees(2e-3))
    for parameters in (BIASES, BIASES | log):
        save(path, parameters, POSE)
        assert load(path) == (parameters, POSE)
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
        ("latitude_deg: 55.7", "latitude_deg: 155.7", "last_pose has a value that is none"),
        ("height: 150.5", "height: .nan", "last_pose has a value that is none"),
        ("height: 150.5", "height: high", "could not convert string to float"),
        ("accel_bias_mg", "accel_bais_mg", "did you mean imu.accel_bias_mg?"),
        ("accel_bias_mg:\n    - 0.01\n    - 0.02\n    - -0.03", "max_gap: 3.0", "imu.max_gap is not kept"),
        ("- 0.1\n", "- much\n", "'much' is not a number"),
        ("imu:", "imu: [", "is not YAML"),
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
        load(path)
    assert str(caught.value).startswith(f"state_file {path}: ") and text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_absent(tmp_path: Path) -> None:
    with pytest.raises(StateFileError, match="No such file"):
        load(tmp_path / "state.yaml")
