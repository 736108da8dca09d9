"""Console commands of the nodes: rclpy is imported when a command runs, and named when it is missing."""

import importlib

from ins_nav.errors import InsNavError, for_people


def alignment_node() -> int:
    """Run `ins_nav.nodes.alignment_node`."""
    return _run("alignment_node")


def bag_player() -> int:
    """Run `ins_nav.nodes.bag_player`."""
    return _run("bag_player")


def ins_node() -> int:
    """Run `ins_nav.nodes.ins_node`."""
    return _run("ins_node")


def ins_system() -> int:
    """Run `ins_nav.nodes.ins_system`."""
    return _run("ins_system")


def stop_detector_node() -> int:
    """Run `ins_nav.nodes.stop_detector_node`."""
    return _run("stop_detector_node")


def _run(name: str) -> int:
    @for_people(name)
    def main() -> int:
        try:
            importlib.import_module("rclpy")
        except ModuleNotFoundError as error:
            raise InsNavError(
                "rclpy is missing: source /opt/ros/jazzy/setup.bash, or pip install 'ins_nav[jazzy]'"
            ) from error
        code: int = importlib.import_module(f"ins_nav.nodes.{name}").main()
        return code

    return main()
