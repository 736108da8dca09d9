"""What every node shares: begin, serve, end; message classes by name."""

import difflib
import importlib
import sys
from typing import Any

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from ins_nav.errors import InsNavError


def init(args: list[str] | None = None, signals: SignalHandlerOptions = SignalHandlerOptions.ALL) -> list[str]:
    """Initialize rclpy from the command line (default: sys.argv[1:]) and return the arguments that are not ROS's.

    Raises
    ------
    InsNavError
        If the ROS arguments are malformed.
    """
    ros: list[str] = []
    rest: list[str] = []
    taking = rest
    for word in sys.argv[1:] if args is None else args:
        if word == "--ros-args":
            taking = ros
        taking.append(word)
        if word == "--":
            taking = rest
    try:
        # rcl would also take words such as a:=b outside --ros-args for rules of its own
        rclpy.init(args=["", *ros], signal_handler_options=signals)
    except RuntimeError as error:  # the common base of rclpy's errors for arguments
        reason = str(error).partition(": ")[2].partition(", at ")[0] or f"unknown {error}"
        raise InsNavError(f"ROS arguments: {reason}") from error
    return rest


def wants_no_node(arguments: list[str], program: str, text: str | None) -> bool:
    """Whether help was asked for, and given; a node takes no arguments but ROS's.

    Raises
    ------
    InsNavError
        There are arguments.
    """
    if not arguments:
        return False
    if arguments[0] in ("-h", "--help"):
        print(
            f"usage: {program} [--ros-args --params-file FILE -p NAME:=VALUE -r OLD:=NEW ...]\n\n{(text or '').strip()}"
        )
        return True
    raise InsNavError(f"unknown argument {arguments[0]!r}: parameters and remaps come after --ros-args")


def spin(*nodes: Node) -> None:
    """Serve the nodes until SIGINT, SIGTERM or shutdown; then destroy them and shut rclpy down."""
    try:
        executor = _executor()
        for node in nodes:
            executor.add_node(node)
        while rclpy.ok():
            # with the PyPI wheels, EventsExecutor.spin() does not end at shutdown but loops
            executor.spin_until_future_complete(Future(), 0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:  # rclpy's errors: a signal that came between two of its calls has ended the context
        if rclpy.ok():
            raise
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def message_class(msgtype: str) -> Any:
    """rclpy's class for a type such as ``sensor_msgs/msg/Imu``.

    Raises
    ------
    InsNavError
        If the package is not installed, or has no such message.
    """
    package, _, rest = msgtype.partition("/")
    name = rest.removeprefix("msg/")
    if not name or "/" in name:
        raise InsNavError(f"message type {msgtype!r}: expected the form sensor_msgs/msg/Imu")
    try:
        module = importlib.import_module(f"{package}.msg")
    except ModuleNotFoundError as error:
        apt = f"ros-jazzy-{package.replace('_', '-')}"
        raise InsNavError(f"message type {msgtype}: ROS package {package} is not installed (apt: {apt})") from error
    if not hasattr(module, name):
        close = difflib.get_close_matches(name, [n for n in dir(module) if n[0].isupper()], n=1)
        raise InsNavError(f"{package} has no message {name!r}" + (f" (did you mean {close[0]}?)" if close else ""))
    return getattr(module, name)


def _executor() -> Executor:
    """The fastest executor there is: at 400 Hz a quarter of the single-threaded one's load."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
