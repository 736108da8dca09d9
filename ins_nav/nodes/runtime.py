"""Common to all nodes: initialization, service, end; message classes by name.

Signals end a node between two callbacks, never within one. `init` blocks SIGINT, SIGTERM and SIGHUP in the main thread
and so in all threads that start later; one thread of `on_signal` waits for the first of them. rclpy's handlers
would end the context in the middle of a callback, and those of its events executor abort the process on a second
signal.
"""

import difflib
import gc
import importlib
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from ins_nav.errors import InsNavError
from ins_nav.event_log import ERROR, EventLog
from ins_nav.messages.cdr import ImuSample, read_imu
from ins_nav.messages.named_numbers import NamedNumbers
from ins_nav.nodes.commands import block_signals, ending_signals

_IMU_DEPTH = 10_000
"""5 s at 2000 Hz: a node is busy for up to a second when it solves the alignment or a stop."""


def init(args: list[str] | None = None) -> list[str]:
    """Initialize rclpy from the command line (default: sys.argv[1:]) and return the arguments that are not ROS's.

    SIGINT, SIGTERM and SIGHUP are blocked from here on: see `on_signal`.

    Raises
    ------
    InsNavError
        If the ROS arguments are malformed.
    """
    block_signals()
    ros: list[str] = []
    rest: list[str] = []
    current = rest
    for word in sys.argv[1:] if args is None else args:
        if word == "--ros-args":
            current = ros
        current.append(word)
        if word == "--":
            current = rest
    try:
        # rcl would read words such as a:=b outside --ros-args as rules, too
        rclpy.init(args=["", *ros], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # the common base of rclpy's errors for arguments
        reason = str(error).partition(": ")[2].partition(", at ")[0] or f"unknown {error}"
        raise InsNavError(f"ROS arguments: {reason}") from error
    return rest


def on_signal(react: Callable[[], object]) -> None:
    """Call a function, in a separate thread, at the first SIGINT, SIGTERM or SIGHUP since `init`.

    Later signals have no effect.
    """

    def wait() -> None:
        signal.sigwait(ending_signals())
        react()

    threading.Thread(target=wait, daemon=True).start()


def wants_no_node(arguments: list[str], program: str, text: str | None) -> bool:
    """Print help if requested; whether it was. A node accepts ROS arguments only.

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
    """Serve the nodes until SIGINT, SIGTERM, SIGHUP or shutdown; then destroy them and shut rclpy down."""
    end = Future()
    on_signal(lambda: end.set_result(None))
    serve(nodes, end)


def serve(nodes: tuple[Node, ...], end: Future) -> None:
    """Serve the nodes until a future is done or rclpy shut down; then destroy them and shut rclpy down."""
    executor = _executor()
    gc.collect()
    gc.freeze()  # what has been imported stays: later collections need not pass over it, while samples wait
    try:
        for node in nodes:
            executor.add_node(node)
        while rclpy.ok() and not end.done():
            # Without a time-out, EventsExecutor of the PyPI wheels polls and keeps its queue locked.
            executor.spin_until_future_complete(end, 0.5)
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def subscribe_imu(node: Node, events: EventLog, receive: Callable[[ImuSample], object]) -> None:
    """Subscribe to imu/data_raw; samples are read from the bytes of the messages, other bytes are counted as events."""

    def on_message(data: bytes) -> None:
        try:
            sample = read_imu(data)
        except ValueError as error:
            events.count("malformed messages", ERROR, f"imu/data_raw: {error}, rejected: check the driver", 0)
        else:
            receive(sample)

    node.create_subscription(
        Imu,
        "imu/data_raw",
        on_message,
        QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=_IMU_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        raw=True,
    )


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


def numbers_message(numbers: NamedNumbers) -> Float64MultiArray:
    """A record of named numbers as an array of one dimension, whose label names the elements."""
    size = len(numbers.data)
    layout = MultiArrayLayout(dim=[MultiArrayDimension(label=numbers.label, size=size, stride=size)])
    return Float64MultiArray(layout=layout, data=numbers.data)


def _executor() -> Executor:
    """The fastest executor there is: at 400 Hz a quarter of the single-threaded one's load."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()
