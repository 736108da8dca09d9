"""Parameters: unknown names, types, ranges, files, sections, name:=value."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from parameter_files import DUMP, SECTIONS

from ins_nav.aiding.parameters import configuration, table
from ins_nav.config.configuration import Configuration
from ins_nav.config.parameters import ParameterError, Value, parse_assignment, read_file


def _checked(overrides: dict[str, Any]) -> Mapping[str, Value]:
    return Configuration.from_overrides(overrides).values


def _refusal(**overrides: Any) -> str:
    with pytest.raises(ParameterError) as caught:
        _checked({name.replace("__", "."): value for name, value in overrides.items()})
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_defaults_are_valid() -> None:
    values = configuration().values
    assert set(values) == {parameter.name for parameter in table()}
    for parameter in table():
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


def test_values_have_the_type_of_the_default() -> None:
    given = {"alignment.duration": 90, "imu.mounting_rpy_deg": (180, 0, 0.5), "zupt.zero_velocity": False}
    values = _checked(given)
    assert isinstance(values["alignment.duration"], float) and values["alignment.duration"] == 90.0
    assert values["imu.mounting_rpy_deg"] == [180.0, 0.0, 0.5]
    assert values["zupt.zero_velocity"] is False


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("alignment.duration", "long", "parameter alignment.duration: 'long' is not a number"),
        ("alignment.duration", True, "parameter alignment.duration: True is not a number"),
        ("alignment.duration", None, "parameter alignment.duration: None is not a number"),
        ("alignment.duration", [60.0], "parameter alignment.duration: [60.0] is not a number"),
        ("zupt.zero_velocity", 1, "parameter zupt.zero_velocity: 1 is not true or false"),
        ("frames.map", 3, "parameter frames.map: 3 is not a string"),
        ("publish.tf", 1, "parameter publish.tf: 1 is not a string"),
        ("imu.sampling", "mean", "parameter imu.sampling: 'mean' is not one of averaged, instantaneous"),
        ("imu.mounting_rpy_deg", [1.0, 2.0], "parameter imu.mounting_rpy_deg: [1.0, 2.0] is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", "1, 2, 3", "parameter imu.mounting_rpy_deg: '1, 2, 3' is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", 1.0, "parameter imu.mounting_rpy_deg: 1.0 is not a list of 3 numbers"),
        ("imu.mounting_rpy_deg", [1.0, 2.0, "x"], "parameter imu.mounting_rpy_deg: 'x' is not a number"),
    ],
)
def test_wrong_types(name: str, value: object, text: str) -> None:
    with pytest.raises(ParameterError) as caught:
        _checked({name: value})
    assert str(caught.value) == text


def test_ranges() -> None:
    assert _refusal(alignment__duration=1.0) == "parameter alignment.duration: 1 is outside [5, 3600]"
    assert "91 is outside [-90, 90]" in _refusal(initial__latitude_deg=91.0)
    assert "-1 is outside [0, inf]" in _refusal(imu__accel_bias_stddev_mg=-1.0)
    assert "400 is outside [-360, 360]" in _refusal(imu__mounting_rpy_deg=[0.0, 0.0, 400.0])
    assert "nan is not allowed" in _refusal(alignment__duration=math.nan)
    assert "nan is not allowed" in _refusal(imu__gyro_bias_deg_per_hour=[0.0, math.nan, 0.0])
    # the borders belong to the range; NaN means "not given" where it is the default
    _checked({"alignment.duration": 5.0, "initial.heading_deg": math.nan})


def test_infinity_is_no_value() -> None:
    assert "inf" in _refusal(imu__gyro_bias_deg_per_hour=[math.inf, 0.0, 0.0])
    assert "inf" in _refusal(imu__gyro_bias_stddev_deg_per_hour=math.inf)


def test_position_is_given_completely_or_not_at_all() -> None:
    whole = {"initial.latitude_deg": 1.0, "initial.longitude_deg": 2.0, "initial.height": 3.0}
    _checked(whole)
    for missing in whole:
        given = {name: value for name, value in whole.items() if name != missing}
        with pytest.raises(ParameterError, match="give all three or none"):
            _checked(given)


def test_height_alone_is_refused() -> None:
    assert "give all three or none" in _refusal(initial__height=3.0)


def _file(folder: Path, text: str) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    return path


EVERY = {
    "alignment.duration": 10.0,
    "imu.sampling": "instantaneous",
    "imu.mounting_rpy_deg": [180, 0, 0],
    "zupt.max_rocking_deg": 9.0,
}
"""Set for every ins_node; the later section of the file decides, even where the earlier is for one node."""


@pytest.mark.parametrize(
    ("namespace", "more"),
    [
        ("/", {"alignment.max_speed": 4.0}),
        ("/robot", {"initial.heading_deg": 5.0, "initial.heading_stddev_deg": 6.0, "imu.max_gap": 7.0}),
        ("/ship/", {"initial.heading_stddev_deg": 6.0, "imu.max_gap": 8.0}),
        ("/robot/arm", {"imu.max_gap": 7.0}),
    ],
)
def test_sections_are_applied_as_rcl_does(tmp_path: Path, namespace: str, more: dict[str, object]) -> None:
    """`test/nodes/test_parameters.py` compares with rcl."""
    assert read_file(_file(tmp_path, SECTIONS), "ins_node", namespace=namespace) == EVERY | more


def test_namespace_is_that_of_the_sections_for_the_node(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"is for namespaces / and /robot and /ship: choose one with --namespace"):
        read_file(_file(tmp_path, SECTIONS), "ins_node")
    section = "/robot/arm/ins_node:\n  ros__parameters:\n    alignment.duration: 30.0\n"
    assert read_file(_file(tmp_path, section), "ins_node") == {"alignment.duration": 30.0}
    section = section.replace("robot/arm", "*")
    assert read_file(_file(tmp_path, section), "ins_node") == {"alignment.duration": 30.0}
    with pytest.raises(ParameterError, match=r"has sections /\*/ins_node, but none for /ins_node"):
        read_file(_file(tmp_path, section), "ins_node", namespace="/")


def test_full_names_are_in_no_other_namespace(tmp_path: Path) -> None:
    path = _file(
        tmp_path,
        "/robot/ins_node: {ros__parameters: {imu.max_gap: 1.0}}\nins_process: {ros__parameters: {publish.rate: 2.0}}\n",
    )
    assert read_file(path, "ins_node", "/ins_process") == {"imu.max_gap": 1.0, "publish.rate": 2.0}


def test_a_later_node_overrides_an_earlier_one(tmp_path: Path) -> None:
    path = _file(
        tmp_path,
        "/ins_node: {ros__parameters: {imu.max_gap: 1.0}}\n/alignment_node: {ros__parameters: {imu.max_gap: 2.0}}\n",
    )
    assert read_file(path, "alignment_node", "ins_node") == {"imu.max_gap": 1.0}
    assert read_file(path, "ins_node", "alignment_node") == {"imu.max_gap": 2.0}


def test_output_of_ros2_param_dump(tmp_path: Path) -> None:
    read = read_file(_file(tmp_path, DUMP), "ins_node")
    assert list(read) == ["alignment.duration", "initial.heading_deg", "state_file"]
    assert _checked(read)["alignment.duration"] == 30.0


def test_shipped_configurations() -> None:
    folder = Path(__file__).parents[2] / "config"
    for path in sorted(folder.glob("*.yaml")):
        assert configuration(read_file(path, "ins_node")).warnings == ()


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
        ("zupt.zero_velocity:=true", "zupt.zero_velocity", True),
        ("frames.map:=odom", "frames.map", "odom"),
        ("frames.map:=a:=b", "frames.map", "a:=b"),
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
    assert _checked({name: value})[name] == 1e-3


def test_config_shows_every_parameter_at_its_default() -> None:
    shown = read_file(Path(__file__).parents[2] / "config/ins.yaml", "ins_node")
    assert list(shown) == [parameter.name for parameter in table()]
    values, defaults = configuration(shown).values, configuration().values
    assert all(values[name] == default or values[name] != values[name] for name, default in defaults.items())


def test_file_for_others_only_is_an_error(tmp_path: Path) -> None:
    path = _file(tmp_path, "ins_nod:\n  ros__parameters:\n    alignment.duration: 30.0\n")
    with pytest.raises(ParameterError, match="has sections /ins_nod, but none for /ins_node"):
        read_file(path, "ins_node")
