"""Parameters of nodes: files as rcl reads them, declaration, former names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from parameter_files import DUMP, SECTIONS
from ros_harness import needs_ros

from ins_nav.config.parameters import ParameterError, read_file

pytestmark = needs_ros

_DOMAIN = 93
"""Not the default one: nothing that runs beside the tests matters."""


@pytest.fixture
def context() -> Iterator[Any]:
    """Of rclpy, for nodes in this process."""
    import rclpy

    found = rclpy.Context()
    found.init(args=[], domain_id=_DOMAIN)
    yield found
    found.try_shutdown()


def _node(context: Any, path: Path, *given: str, namespace: str = "/") -> Any:
    from rclpy.node import Node

    path = path / "parameters.yaml"
    parameters = [part for text in given for part in ("-p", text)]
    arguments = ["--ros-args", *(["--params-file", str(path)] if path.exists() else []), *parameters]
    return Node("ins_node", context=context, namespace=namespace, cli_args=arguments)


def _plain(value: Any) -> Any:
    """An array of rclpy as a list."""
    return list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value


@pytest.mark.parametrize("namespace", ["/", "/robot", "/ship", "/robot/arm", "/robot/ship"])
def test_files_are_read_as_rcl_reads_them(context: Any, tmp_path: Path, namespace: str) -> None:
    (tmp_path / "parameters.yaml").write_text(SECTIONS, encoding="utf-8")
    node = _node(context, tmp_path, namespace=namespace)
    by_rcl = {name: _plain(given.value) for name, given in node._parameter_overrides.items()}
    node.destroy_node()
    read = read_file(tmp_path / "parameters.yaml", "ins_node", namespace=namespace)
    assert read == {
        name: list(x) if hasattr(x, "__len__") and not isinstance(x, str) else x for name, x in by_rcl.items()
    }


def test_dump_of_a_node_configures_it_again(context: Any, tmp_path: Path) -> None:
    from ins_nav.nodes.parameters import declare

    (tmp_path / "parameters.yaml").write_text(DUMP, encoding="utf-8")
    node = _node(context, tmp_path, namespace="/robot")
    assert "use_sim_time" in node._parameter_overrides
    configuration = declare(node)
    assert configuration.alignment.duration == 30.0
    assert node.get_parameter("alignment.duration").value == 30.0
    assert configuration.warnings == ()
    node.destroy_node()


def test_former_names_set_the_present_ones(context: Any, tmp_path: Path) -> None:
    from ins_nav.nodes.parameters import declare

    node = _node(context, tmp_path, "map_frame:=world", "publish.tf:=true", "stop.window:=2.0")
    configuration = declare(node)
    assert configuration.frames.map == node.get_parameter("frames.map").value == "world"
    assert configuration.publish.tf == node.get_parameter("publish.tf").value == "map_to_base_link"
    assert len(configuration.warnings) == 3
    assert not node.has_parameter("map_frame")
    node.destroy_node()


def test_unknown_name_is_refused(context: Any, tmp_path: Path) -> None:
    from ins_nav.nodes.parameters import declare

    node = _node(context, tmp_path, "frames.mpa:=world")
    with pytest.raises(ParameterError, match=r"unknown parameter frames.mpa: did you mean frames.map\?"):
        declare(node)
    node.destroy_node()
