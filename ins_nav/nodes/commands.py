"""Console commands of the nodes: rclpy is imported when a command runs, and named when it is missing.

The modules of a node need a second or two to import. Signals are blocked before, so that they end the node cleanly
whenever they come.
"""

import importlib
import signal
from importlib.util import find_spec

from ins_nav.errors import ENDING_SIGNALS, InsNavError, for_people


def ending_signals() -> set[signal.Signals]:
    """Signals that end a node; without SIGHUP where it is ignored (nohup)."""
    ignored = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
    return set(ENDING_SIGNALS) - ignored


def block_signals() -> None:
    """Keep signals that end a node pending until `ins_nav.nodes.runtime.on_signal` waits for them."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ending_signals())


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
        if find_spec("rclpy") is None:
            raise InsNavError("rclpy is missing: source /opt/ros/jazzy/setup.bash, or pip install 'ins_nav[jazzy]'")
        block_signals()
        code: int = importlib.import_module(f"ins_nav.nodes.{name}").main()
        return code

    return main()
