"""Nodes under test in processes of their own, over real DDS.

The test process never imports rclpy: ROS from PyPI re-executes Python on that import, which would lose pytest's
captured output. A probe process (ros_probe.py) subscribes and calls services in its place, and what it receives
is decoded here by rosbags.

    with Ros(tmp_path) as ros:
        listener = ros.listen({"odometry": "nav_msgs/msg/Odometry"})
        player = ros.start("ins_nav.nodes.bag_player", bag, "--rate", "5")
        listener.wait_for(lambda: len(listener.messages("odometry")) >= 100)
        assert player.wait() == 0
"""

import contextlib
import ctypes
import fcntl
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import pytest

import ins_nav
from ins_nav.recordings.bags import absolute, typestore

needs_ros = pytest.mark.skipif(find_spec("rclpy") is None, reason="rclpy is not installed")

_TIMEOUT = 20.0  # s: a loaded machine takes some seconds to start Python and to discover

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored under nohup, and by the processes that inherit it


class Received(NamedTuple):
    """A message and when the probe received it, ns since the epoch."""

    received_ns: int
    message: Any


def wait_until(condition: Callable[[], object], timeout: float, otherwise: Callable[[], str]) -> None:
    """Poll until the condition holds, or fail with what otherwise() tells."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"not within {timeout} s; {otherwise()}"
        time.sleep(0.02)


class Process:
    """A running command, its output in files."""

    def __init__(self, command: list[str], env: Mapping[str, str], folder: Path, name: str) -> None:
        self.name = name
        self._stdout = folder / f"{name}.stdout"
        self._stderr = folder / f"{name}.stderr"
        with self._stdout.open("wb") as out, self._stderr.open("wb") as err:
            self._popen = subprocess.Popen(
                command,
                env=env,
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                start_new_session=True,
                preexec_fn=_die_with_parent,
            )

    @property
    def stdout(self) -> str:
        return self._stdout.read_text(errors="replace")

    @property
    def stderr(self) -> str:
        return self._stderr.read_text(errors="replace")

    @property
    def pid(self) -> int:
        return self._popen.pid

    def send(self, line: str) -> None:
        """Write a line to its standard input."""
        stream = self._popen.stdin
        assert stream is not None
        stream.write(line.encode() + b"\n")
        stream.flush()

    def wait_for_output(self, regex: str, timeout: float = _TIMEOUT) -> re.Match[str]:
        """Wait until stdout or stderr matches; fails when the process ends before."""
        found: re.Match[str] | None = None

        def matches() -> bool:
            nonlocal found
            ended = self._popen.poll() is not None
            found = re.search(regex, self.stdout) or re.search(regex, self.stderr)
            assert found or not ended, f"{self.name} ended without {regex!r}: {self._said()}"
            return found is not None

        wait_until(matches, timeout, lambda: f"{self.name} did not say {regex!r}: {self._said()}")
        assert found
        return found

    def wait(self, timeout: float = _TIMEOUT) -> int:
        """Exit code, once it has ended."""
        wait_until(lambda: self._popen.poll() is not None, timeout, lambda: f"{self.name} runs on: {self._said()}")
        return self._popen.returncode

    def send_signal(self, number: int) -> None:
        self._popen.send_signal(number)

    def interrupt(self) -> None:
        """Send SIGINT, as Ctrl-C does."""
        self.send_signal(signal.SIGINT)

    def terminate(self) -> None:
        """Send SIGTERM, as a launch system does."""
        self.send_signal(signal.SIGTERM)

    def stop(self, timeout: float = 10.0) -> int:
        """End it by SIGINT and return its exit code; whatever is left of its group is killed."""
        try:
            if self._popen.poll() is None:
                self.interrupt()
            return self.wait(timeout)
        finally:
            self.kill()

    def kill(self) -> None:
        """Leave nothing of it behind."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._popen.pid, signal.SIGKILL)
        self._popen.wait()
        if self._popen.stdin:
            self._popen.stdin.close()

    def _said(self) -> str:
        return f"\n--- stdout\n{self.stdout[-3000:]}\n--- stderr\n{self.stderr[-3000:]}"


class Listener:
    """Messages of some topics, as they come; also calls services."""

    def __init__(self, process: Process, stream: Path, topics: Mapping[str, str]) -> None:
        self.process = process
        self._types = {absolute(topic): msgtype for topic, msgtype in topics.items()}
        self._received: dict[str, list[Received]] = {topic: [] for topic in self._types}
        self._answers: list[tuple[bool, str]] = []
        self._stream = stream.open("rb")

    def messages(self, topic: str) -> list[Received]:
        """All received so far on a topic, in order of arrival."""
        self._take_in()
        return self._received[absolute(topic)]

    def wait_for(self, predicate: Callable[[], object], timeout: float = _TIMEOUT) -> None:
        """Wait until the predicate holds, on messages() or anything else."""

        def so_far() -> str:
            self._take_in()
            return f"received so far: { {topic: len(items) for topic, items in self._received.items()} }"

        wait_until(predicate, timeout, so_far)

    def wait_for_count(self, topic: str, count: int, timeout: float = _TIMEOUT) -> None:
        """Wait until at least so many messages came on a topic."""
        self.wait_for(lambda: len(self.messages(topic)) >= count, timeout)

    def status(self, node: str) -> dict[str, str]:
        """Values of a node's last status on /diagnostics; empty before the first."""
        for received in reversed(self.messages("/diagnostics")):
            for status in received.message.status:
                if status.name.startswith(f"{absolute(node)}: "):
                    return {item.key: item.value for item in status.values}
        return {}

    def call(self, service: str, timeout: float = _TIMEOUT) -> tuple[bool, str]:
        """Call a std_srvs/Trigger service; success and message of its answer."""
        before = len(self._answers)
        self.process.send(f"call {service}")

        def answered() -> bool:
            self._take_in()
            return len(self._answers) > before

        wait_until(answered, timeout, lambda: f"no answer of {service}")
        return self._answers[-1]

    def stop(self) -> int:
        """End the probe, with all it received taken in; its exit code."""
        code = self.process.stop()
        self._take_in()
        return code

    def close(self) -> None:
        """Let go of the stream; what was taken in stays."""
        self._stream.close()

    def _take_in(self) -> None:
        while not self._stream.closed:
            place = self._stream.tell()
            try:
                topic, received_ns, content = pickle.load(self._stream)
            except (EOFError, pickle.UnpicklingError):
                self._stream.seek(place)  # the probe is still writing this one
                return
            if topic == "":
                self._answers.append(content)
            else:
                message = typestore().deserialize_cdr(content, self._types[topic])
                self._received[topic].append(Received(received_ns, message))


class Ros:
    """A ROS domain of one test's own, on this machine only; a context manager that leaves no process behind."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._processes: list[Process] = []
        self._listeners: list[Listener] = []

    def __enter__(self) -> Self:
        domain, self._lock = _own_domain()
        root = str(Path(ins_nav.__file__).parents[1])
        self.env = os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "ros_log"),
            "PYTHONPATH": os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])]),
            "PYTHONUNBUFFERED": "1",
        }
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            process.kill()
        for listener in self._listeners:
            listener.close()
        os.close(self._lock)

    def start(self, module_or_script: str | Path, *args: object) -> Process:
        """Run a module (``ins_nav.nodes.bag_player``) or a script (a Path) with this Python."""
        script = isinstance(module_or_script, Path)
        target = [str(module_or_script)] if script else ["-m", str(module_or_script)]
        name = f"{len(self._processes)}_{Path(module_or_script).stem if script else module_or_script}"
        process = Process([sys.executable, *target, *map(str, args)], self.env, self.folder, name)
        self._processes.append(process)
        return process

    def listen(self, topics: Mapping[str, str], latched: bool = False) -> Listener:
        """Subscribe to topics (name to type) in a probe process; returns when the subscriptions exist.

        The subscriptions are best effort, 1000 deep, or else reliable and transient local.
        """
        stream = self.folder / f"{len(self._processes)}_received.pickle"
        stream.touch()
        flags = ["--latched"] if latched else []
        pairs = [part for pair in topics.items() for part in pair]
        probe = self.start(Path(__file__).with_name("ros_probe.py"), stream, *flags, *pairs)
        probe.wait_for_output("^ready$")
        listener = Listener(probe, stream, topics)
        self._listeners.append(listener)
        return listener


def _own_domain() -> tuple[int, int]:
    """A domain id no other test uses now, and the descriptor of the lock file that says so.

    Ids up to 101 keep DDS's ports below the ephemeral range.
    """
    first = os.getpid()
    for i in range(100):
        domain = 1 + (first + i) % 100
        lock = os.open(Path(tempfile.gettempdir(), f"ins_nav_test_domain_{domain}.lock"), os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        return domain, lock
    raise AssertionError("all 100 ROS domains are in use by tests")


def _die_with_parent() -> None:
    """Linux: be killed when the test process is, however it ends."""
    PR_SET_PDEATHSIG = 1
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
