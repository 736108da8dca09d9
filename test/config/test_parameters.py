"""Parameters: unknown names, types, ranges, files, sections, name:=value."""

import math
from pathlib import Path
from typing import Any

import pytest

from ins_nav.config.parameters import (
    PARAMETERS,
    ParameterError,
    checked_values,
    default_values,
    parse_assignment,
    read_file,
)


def _refusal(**overrides: Any) -> str:
    with pytest.raises(ParameterError) as caught:
        checked_values({name.replace("__", "."): value for name, value in overrides.items()})
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_defaults_satisfy_their_own_rules() -> None:
    values = checked_values({})
    assert set(values) == {parameter.name for parameter in PARAMETERS}
    for parameter in PARAMETERS:
        checked = parameter.checked(parameter.default)
        assert checked == parameter.default or math.isnan(checked)  # type: ignore[arg-type]
        assert type(checked) is type(parameter.default)
        assert parameter.description[0].islower() or parameter.description.startswith("IMU")
    assert math.isnan(values["initial.heading_deg"])  # type: ignore[arg-type]


def test_unknown_names_get_a_suggestion() -> None:
    assert _refusal(alignment__duratoin=60.0) == (
        "unknown parameter alignment.duratoin: did you mean alignment.duration?"
    )
    assert "did you mean initial.heading_deg?" in _refusal(initial__heading=1.0)
    message = _refusal(xyzzy=1.0)
    assert message.startswith("unknown parameter xyzzy; known: imu.sampling, ")


def test_values_take_the_type_of_the_default() -> None:
    values = checked_values({"alignment.duration": 90, "imu.mounting_rpy_deg": (180, 0, 0.5), "publish.tf": True})
    assert isinstance(values["alignment.duration"], float) and values["alignment.duration"] == 90.0
    assert values["imu.mounting_rpy_deg"] == [180.0, 0.0, 0.5]
    assert values["publish.tf"] is True


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("alignment.duration", "long", "parameter alignment.duration: 'long' is not a number"),
        ("alignment.duration", True, "parameter alignment.duration: True is not a number"),
        ("alignment.duration", None, "parameter alignment.duration: None is not a number"),
        ("alignment.duration", [60.0], "parameter alignment.duration: [60.0] is not a number"),
        ("publish.tf", 1, "parameter publish.tf: 1 is not true or false"),
        ("map_frame", 3, "parameter map_frame: 3 is not a string"),
        ("imu.sampling", "mean", "parameter imu.sampling: 'mean' is not one of averaged, instantaneous"),
        ("imu.mounting_rpy_deg", [1.0, 2.0], "parameter imu.mounting_rpy_deg: [1.0, 2.0] is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", "1, 2, 3", "parameter imu.mounting_rpy_deg: '1, 2, 3' is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", 1.0, "parameter imu.mounting_rpy_deg: 1.0 is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", [1.0, 2.0, "x"], "parameter imu.mounting_rpy_deg: 'x' is not a number"),
    ],
)
def test_wrong_types(name: str, value: object, text: str) -> None:
    with pytest.raises(ParameterError) as caught:
        checked_values({name: value})
    assert str(caught.value) == text


def test_ranges() -> None:
    assert _refusal(alignment__duration=1.0) == "parameter alignment.duration: 1 is outside [5, 3600]"
    assert "91 is outside [-90, 90]" in _refusal(initial__latitude_deg=91.0)
    assert "-1 is outside [0, inf]" in _refusal(imu__accel_bias_stddev_mg=-1.0)
    assert "400 is outside [-360, 360]" in _refusal(imu__mounting_rpy_deg=[0.0, 0.0, 400.0])
    assert "nan is not allowed" in _refusal(alignment__duration=math.nan)
    assert "nan is not allowed" in _refusal(imu__gyro_bias_deg_per_hour=[0.0, math.nan, 0.0])
    # the borders belong to the range; NaN means "not given" where it is the default
    checked_values({"alignment.duration": 5.0, "initial.heading_deg": math.nan})


def test_infinity_is_no_value() -> None:
    assert "inf" in _refusal(imu__gyro_bias_deg_per_hour=[math.inf, 0.0, 0.0])
    assert "inf" in _refusal(imu__gyro_bias_stddev_deg_per_hour=math.inf)


def test_position_is_given_as_a_whole() -> None:
    whole = {"initial.latitude_deg": 1.0, "initial.longitude_deg": 2.0, "initial.height": 3.0}
    checked_values(whole)
    for missing in whole:
        given = {name: value for name, value in whole.items() if name != missing}
        with pytest.raises(ParameterError, match="give all three or none"):
            checked_values(given)


def test_height_alone_is_refused() -> None:
    assert "give all three or none" in _refusal(initial__height=3.0)


def _file(folder: Path, text: str) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_file_sections_in_order(tmp_path: Path) -> None:
    path = _file(
        tmp_path,
        """
ins_node:
  ros__parameters:
    alignment.duration: 30.0
/**:
  ros__parameters:
    alignment:
      duration: 10.0
      max_speed: 3.0
    imu: {sampling: instantaneous, mounting_rpy_deg: [180, 0, 0]}
/ins_node:
  ros__parameters:
    alignment: {duration: 20.0}
    initial.heading_deg: 5.0
other_node:
  ros__parameters:
    anything: 1
""",
    )
    assert read_file(path, "ins_node") == {
        "alignment.duration": 30.0,
        "alignment.max_speed": 3.0,
        "imu.sampling": "instantaneous",
        "imu.mounting_rpy_deg": [180, 0, 0],
        "initial.heading_deg": 5.0,
    }
    checked_values(read_file(path, "ins_node"))


def test_the_configuration_that_is_shipped() -> None:
    folder = Path(__file__).parents[2] / "config"
    for path in sorted(folder.glob("*.yaml")):
        checked_values(read_file(path, "ins_node"))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has no sections: begin with '/**: ros__parameters:'"),
        ("a: [1,", "is not YAML"),
        ("/**: 5", "no ros__parameters under /**"),
        ("/**: {parameters: {}}", "no ros__parameters under /**"),
    ],
)
def test_files_of_another_shape(tmp_path: Path, text: str, reason: str) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(ParameterError) as caught:
        read_file(path, "ins_node")
    assert str(path) in str(caught.value) and reason in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="No such file"):
        read_file(tmp_path / "nowhere.yaml", "ins_node")
    with pytest.raises(ParameterError, match="Is a directory"):
        read_file(tmp_path, "ins_node")


def test_file_that_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "picture.yaml"
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ParameterError, match=r"picture\.yaml"):
        read_file(path, "ins_node")


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("alignment.duration:=30", "alignment.duration", 30),
        ("initial.heading_deg:=-1.5", "initial.heading_deg", -1.5),
        ("imu.mounting_rpy_deg:=[180, 0, 0]", "imu.mounting_rpy_deg", [180, 0, 0]),
        ("publish.tf:=true", "publish.tf", True),
        ("map_frame:=odom", "map_frame", "odom"),
        ("map_frame:=a:=b", "map_frame", "a:=b"),
    ],
)
def test_assignments(text: str, name: str, value: object) -> None:
    assert parse_assignment(text) == (name, value)


@pytest.mark.parametrize("text", ["alignment.duration=30", ":=30", "alignment.duration", ""])
def test_not_an_assignment(text: str) -> None:
    with pytest.raises(ParameterError, match="is not name:=value"):
        parse_assignment(text)


def test_assignment_that_is_not_yaml() -> None:
    with pytest.raises(ParameterError, match=r"imu\.mounting_rpy_deg"):
        parse_assignment("imu.mounting_rpy_deg:=[180, 0")


def test_numbers_as_ros_writes_them() -> None:
    """1e-3 is a number to ROS, a string to YAML 1.1."""
    name, value = parse_assignment("imu.gyro_bias_stddev_deg_per_hour:=1e-3")
    assert checked_values({name: value})[name] == 1e-3


def test_config_shows_every_parameter_at_its_default() -> None:
    shown = read_file(Path(__file__).parents[2] / "config/ins.yaml", "ins_node")
    assert list(shown) == [parameter.name for parameter in PARAMETERS]
    values, defaults = checked_values(shown), default_values()
    assert all(values[name] == default or values[name] != values[name] for name, default in defaults.items())


def test_file_for_others_only_is_an_error(tmp_path: Path) -> None:
    path = _file(tmp_path, "ins_nod:\n  ros__parameters:\n    alignment.duration: 30.0\n")
    with pytest.raises(ParameterError, match="has sections ins_nod, but none of /\\*\\*, /ins_node, ins_node"):
        read_file(path, "ins_node")
